"""Renderings and comparisons by the native renderer."""

import json
import math
import os
import warnings
from typing import NamedTuple

import numpy as np

from . import _native
from ._arrays import floats
from ._environment import environment
from ._sampler import Sampler


class Rendering(NamedTuple):
    """A picture: linear Rec.709 [height, width, 3], the covered fraction of each pixel [height, width], and
    facts about the rendering; `sampler` is the choice of "auto", or the given sampler."""

    image: np.ndarray
    coverage: np.ndarray
    sampler: str
    spp: int
    seconds: float
    rays_per_sample: float


class Scene:
    """A built-in scene (temple, dishes, ...) or a glTF 2.0 file, with material, ground and camera as on the
    command line."""

    def __init__(self, name_or_path, *, material=None, ground=False, camera=None):
        """Opens a scene; unsupported parts of its file raise warnings, see `warnings` and `notes`."""
        self._native = _native.Scene.open(os.fspath(name_or_path), material, ground, camera)
        for text in self.warnings:
            warnings.warn(f"{name_or_path}: {text}", stacklevel=2)

    @property
    def notes(self):
        """One message per conversion that the file required."""
        return self._native.notes

    @property
    def warnings(self):
        """One message per unsupported part of the file."""
        return self._native.warnings

    @property
    def triangle_count(self):
        """Number of triangles."""
        return self._native.triangle_count

    def triangles(self):
        """The vertices of all triangles in metres, [triangles, 3, 3]."""
        return self._native.triangles()

    @property
    def camera(self):
        """(position, target, vertical field of view in degrees)"""
        return self._native.camera

    @property
    def is_diffuse(self):
        """Whether all surfaces are Lambertian."""
        return self._native.is_diffuse

    def __repr__(self):
        return f"Scene({self._native.name!r}, {self.triangle_count} triangles)"


class Reference(NamedTuple):
    """The image that errors are measured against.

    image: linear Rec.709 [height, width, 3]. covered: the measured pixels, which surfaces cover entirely [height, width]. spp: samples per
    pixel; 0 for a given picture. mse, relmse: its own errors; NaN if unknown.
    """

    image: np.ndarray
    covered: np.ndarray
    spp: int
    mse: float
    relmse: float


def render(
    scene,
    sampler="auto",
    env=None,
    *,
    spp=None,
    seconds=None,
    width=640,
    height=480,
    points="lattice",
    seed=0,
    depth=1,
    unshadowed=False,
    look_from=None,
    look_at=None,
    fov=None,
    progress=None,
):
    """Renders one picture. sampler: a `Sampler`, or a SPEC, which needs env; "auto" chooses by a short pilot
    rendering. Ctrl-C raises KeyboardInterrupt after the current pass."""
    scene = scene if isinstance(scene, Scene) else Scene(scene)
    if not isinstance(sampler, Sampler):
        if env is None:
            raise _native.HeadtailError("env: a SPEC needs a map")
    elif env is not None:
        raise _native.HeadtailError("env: a Sampler has its map already")
    if spp is None and seconds is None:
        spp = 16
    result = _native.render(
        scene._native,
        _sampler(sampler, env),
        _view(width, height, points, depth, unshadowed, look_from, look_at, fov),
        None if spp is None else _counter(spp, "spp"),
        seconds,
        _counter(seed, "seed", bits=64),
        progress,
    )
    return Rendering(**result)


def compare(
    scene, env, samplers, *, spp=(4, 16), seconds=(), runs=3, seed=1, reference_spp=1024, reference=None, progress=None, **view
):
    """Measures samplers as `headtail compare` does, with the same pictures and errors for equal seeds.

    samplers: SPECs or `Sampler`s. spp, seconds: budgets of a run. seed: of the first run; run k has seed + k. The first run of every sampler
    at every budget comes before the second of any. view: size, camera, points, depth and unshadowed of `render`. progress: called with the
    completed fraction of the runs. Ctrl-C raises KeyboardInterrupt after the current run.

    Errors are means over the pixels that surfaces cover entirely. The reference is rendered with `patches` in two independent halves, whose
    difference gives its noise; the noise is subtracted from the errors. reference_spp: samples per pixel of the reference, increased up to
    4x until its noise is at most 5 % of the smallest MSE. reference: a `Reference` of an earlier call, or a picture
    [height, width, 3], to use instead.

    Returns (runs, `Reference`). runs: a structured array with the fields of `headtail compare --json`, NaN for unknown numbers.
    """
    scene = scene if isinstance(scene, Scene) else Scene(scene)
    env, view = environment(env), _view(**view)
    if reference is not None:
        errors = [reference.mse, reference.relmse] if isinstance(reference, Reference) else [math.nan] * 2
        image, shape = floats(getattr(reference, "image", reference), "reference"), (view["height"], view["width"], 3)
        if image.shape != shape:
            raise _native.HeadtailError(f"reference: has the shape {image.shape}, not {shape}")
        reference = image, errors
    runs, reference = _native.compare(
        scene._native,
        env._native,
        [_sampler(sampler, env) for sampler in samplers],
        view,
        [_counter(count, "spp") for count in spp],
        list(seconds),
        _counter(runs, "runs"),
        _counter(seed, "seed", bits=64),
        _counter(reference_spp, "reference_spp"),
        reference,
        progress,
    )
    return _table(json.loads(runs)), Reference(**reference)


def _table(rows):
    """Returns a structured array from dictionaries with equal keys. JSON has null instead of NaN."""
    columns = {name: np.array([math.nan if row[name] is None else row[name] for row in rows]) for name in rows[0]}
    table = np.empty(len(rows), [(name, column.dtype) for name, column in columns.items()])
    for name, column in columns.items():
        table[name] = column
    return table


def _sampler(sampler, env):
    return sampler._native if isinstance(sampler, Sampler) else _native.Sampler.in_scene(sampler, environment(env)._native)


def _view(width=640, height=480, points="lattice", depth=1, unshadowed=False, look_from=None, look_at=None, fov=None):
    return {
        "width": _side(width, "width"),
        "height": _side(height, "height"),
        "points": points,
        "depth": _counter(depth, "depth"),
        "unshadowed": unshadowed,
        "look_from": _point(look_from, "look_from"),
        "look_at": _point(look_at, "look_at"),
        "fov": fov,
    }


def _counter(value, name, bits=32):
    value = int(value)
    if not 0 <= value < 1 << bits:
        raise _native.HeadtailError(f"{name}: {value} is not in 0..2^{bits}")
    return value


def _side(value, name):
    value = int(value)
    if not 1 <= value <= 1 << 14:
        raise _native.HeadtailError(f"{name}: {value} is not between 1 and 16384")
    return value


def _point(value, name):
    if value is None:
        return None
    array = np.asarray(value, dtype=np.float64)
    if array.shape != (3,):
        raise _native.HeadtailError(f"{name}: has the shape {array.shape}, not [3]")
    return array.tolist()
