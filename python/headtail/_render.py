"""Pictures and comparisons of the native renderer."""

import os
from typing import NamedTuple

import numpy as np

from . import _native
from ._environment import environment
from ._sampler import Sampler


class Rendering(NamedTuple):
    """A picture: linear Rec.709 [height, width, 3], the share of each pixel that surfaces cover [height, width], and how it came about."""

    image: np.ndarray
    coverage: np.ndarray
    spp: int
    seconds: float
    rays_per_sample: float


class Scene:
    """A built-in scene (temple, dishes, ...) or a glTF 2.0 file; material and ground as on the command line."""

    def __init__(self, name_or_path, *, material=None, ground=False):
        self._native = _native.Scene.open(os.fspath(name_or_path), material, ground)

    @property
    def triangle_count(self):
        """How many triangles."""
        return self._native.triangle_count

    def triangles(self):
        """The vertices of all triangles in metres, [triangles, 3, 3]."""
        return self._native.triangles()

    @property
    def camera(self):
        """(position, the point that it looks at, vertical field of view in degrees)"""
        return self._native.camera

    @property
    def is_diffuse(self):
        """Whether all surfaces are Lambert's."""
        return self._native.is_diffuse

    def __repr__(self):
        return f"Scene({self._native.name!r}, {self.triangle_count} triangles)"


def render(
    scene,
    sampler,
    env=None,
    *,
    spp=None,
    seconds=None,
    width=640,
    height=480,
    points="sobol",
    seed=0,
    depth=1,
    unshadowed=False,
    look_from=None,
    look_at=None,
    fov=None,
    progress=None,
):
    """One picture. sampler: a `Sampler`, or a SPEC, which needs env. Ctrl-C raises KeyboardInterrupt after the current pass."""
    scene = scene if isinstance(scene, Scene) else Scene(scene)
    if not isinstance(sampler, Sampler):
        if env is None:
            raise _native.HeadtailError("env: a SPEC needs a map")
        sampler = Sampler.from_spec(sampler, env)
    elif env is not None:
        raise _native.HeadtailError("env: a Sampler has its map already")
    if spp is None and seconds is None:
        spp = 16
    size = [_side(width, "width"), _side(height, "height")]
    camera = (_point(look_from, "look_from"), _point(look_at, "look_at"), fov)
    result = _native.render(
        scene._native,
        sampler._native,
        size,
        None if spp is None else _counter(spp, "spp"),
        seconds,
        points,
        _counter(seed, "seed", bits=64),
        _counter(depth, "depth"),
        unshadowed,
        *camera,
        progress,
    )
    return Rendering(**result)


ROW = np.dtype(
    [
        ("sampler", "U128"),
        ("spp", "i4"),
        ("run", "i4"),
        ("seconds", "f8"),
        ("rays_per_sample", "f8"),
        ("mse", "f8"),
        ("relmse", "f8"),
        ("relmse_trimmed", "f8"),
    ]
)


def compare(scene, env, samplers, *, spp=(4, 16), runs=3, seed=1, reference_spp=1024, reference=None, **view):
    """Errors of samplers against a reference, over the pixels that surfaces cover entirely: (a structured array of `ROW`, the reference).

    samplers: SPECs or `Sampler`s. The first run of all comes before the second of any. view: size, camera and points of `render`.
    """
    scene = scene if isinstance(scene, Scene) else Scene(scene)
    env = environment(env)
    samplers = [s if isinstance(s, Sampler) else Sampler.from_spec(s, env) for s in samplers]
    if reference is None:
        by = "patches" if scene.is_diffuse else "ris:8:patches"
        settings = {**view, "points": "sobol"}
        reference = render(scene, by, env, spp=reference_spp, seed=seed ^ 0x5EED_0000_0000, **settings)
    covered = reference.coverage == 1
    if not covered.any():
        raise _native.HeadtailError("no pixel is covered by a surface: move the camera")
    truth = np.ascontiguousarray(reference.image[covered])
    table = []
    for run in range(runs):
        for count in spp:
            for sampler in samplers:
                picture = render(scene, sampler, spp=count, seed=seed + run, **view)
                errors = _native.errors(np.ascontiguousarray(picture.image[covered]), truth)
                table.append((sampler._native.name, count, run, picture.seconds, picture.rays_per_sample, *errors))
    return np.array(table, ROW), reference


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
