"""Samplers over batches."""

import json
import os
from typing import NamedTuple

import numpy as np

from . import _native
from ._arrays import numbers, result, rows
from ._environment import environment


class Draws(NamedTuple):
    """Sampled directions. Rows with pdf 0 are rejected samples; their other values are 0."""

    wi: np.ndarray
    pdf: np.ndarray
    radiance: "np.ndarray | None"


class Sampler:
    """Samples directions for batches of shading points. Created by `from_spec`, `open`, `bake` or `fit`."""

    def __init__(self, native):
        if not isinstance(native, _native.Sampler):
            raise TypeError("use Sampler.from_spec, Sampler.open, bake or fit")
        self._native = native

    @classmethod
    def from_spec(cls, spec, env):
        """Creates the sampler of a SPEC for a map: "auto" ("patches" without a scene), "mis", "direct:FILE",
        "head+mis:FILE", ... as on the command line."""
        return cls(_native.Sampler.from_spec(spec, environment(env)._native))

    @classmethod
    def open(cls, path, env=None):
        """Opens a sampler file. Without its map there is no radiance."""
        return cls(_native.Sampler.open(os.fspath(path), None if env is None else environment(env)._native))

    @property
    def info(self):
        """The sampler's name and the metadata of its file."""
        description = self._native.description()
        return {"name": self._native.name, **(json.loads(description) if description else {})}

    def sample(self, n, wo=None, alpha=None, f0=None, u=None, *, count=None, seed=0, radiance=True, out=None):
        """Samples a direction per row.

        n: unit shading normals [count, 3], or one for all. wo: unit directions to the viewer, by default the normals. alpha: Trowbridge-Reitz
        widths (and f0 reflectances at normal incidence, 1 by default) of glossy surfaces; diffuse by default. u: points of [0, 1)^2; by
        default random numbers from `seed`. out: (wi, pdf, radiance) to write to, each may be None.
        """
        n, wo, surface = _points(n, wo, alpha, f0)
        u = None if u is None else rows(u, "u", 2)
        count = _count(count, n, wo, *(surface or ()), u)
        out_wi, out_pdf, out_radiance = out or (None, None, None)
        wi, pdf = result(out_wi, "wi", (count, 3)), result(out_pdf, "pdf", (count,))
        wants_radiance = out_radiance is not None or (radiance and self._native.has_map)
        light = result(out_radiance, "radiance", (count, 3)) if wants_radiance else None
        _check_apart(wi, pdf, light)
        self._native.sample(n, wo, surface, u, _seed(seed), wi, pdf, light)
        return Draws(wi, pdf, light)

    def pdf(self, wi, n, wo=None, alpha=None, f0=None, *, out=None):
        """Returns the solid-angle pdfs [count] of unit directions under `sample`."""
        n, wo, surface = _points(n, wo, alpha, f0)
        wi = rows(wi, "wi", 3)
        count = _count(None, n, wo, *(surface or ()), wi)
        if len(wi) != count:
            wi = np.ascontiguousarray(np.broadcast_to(wi, (count, 3)))
        out = result(out, "pdf", (count,))
        self._native.pdf(n, wo, surface, wi, out)
        return out

    def save(self, path):
        """Writes the sampler's file; only samplers of `bake`, `fit` and `open` have one."""
        self._native.save(os.fspath(path))

    def __repr__(self):
        return f"Sampler({self._native.name!r})"


def bake(source, *, normals=(16, 32), cells=(32, 32), tail="hierarchical"):
    """Tabulates a map (light x cosine, without training) or a trained head; returns a `Sampler`."""
    if isinstance(source, Sampler):
        if not hasattr(_native, "bake_head"):
            raise _native.HeadtailError("bake: heads are baked by builds with training alone")
        return Sampler(_native.bake_head(source._native, _grid(normals, "normals"), _grid(cells, "cells")))
    return Sampler(_native.Sampler.direct(environment(source)._native, _grid(normals, "normals"), _grid(cells, "cells"), tail))


def _points(n, wo, alpha, f0):
    n = rows(n, "n", 3)
    wo = None if wo is None else rows(wo, "wo", 3)
    if alpha is None:
        if f0 is not None:
            raise _native.HeadtailError("f0: is for glossy surfaces: give alpha too")
        return n, wo, None
    return n, wo, (numbers(alpha, "alpha"), numbers(1.0 if f0 is None else f0, "f0"))


def _count(count, *arrays):
    """Returns the number of rows: that of the longest array. The compiled part rejects other lengths except
    1."""
    if count is None:
        return max(len(array) for array in arrays if array is not None)
    count = int(count)
    if not 0 <= count <= 1 << 40:
        raise _native.HeadtailError(f"count: {count} is not a number of rows")
    return count


def _seed(seed):
    seed = int(seed)
    if not 0 <= seed < 1 << 64:
        raise _native.HeadtailError(f"seed: {seed} is not in 0..2^64")
    return seed


def _grid(shape, name):
    try:
        first, second = (int(count) for count in shape)
    except (TypeError, ValueError) as error:
        raise _native.HeadtailError(f"{name}: write two counts, as in (16, 32)") from error
    if min(first, second) < 0:
        raise _native.HeadtailError(f"{name}: counts are not negative")
    return [first, second]


def _check_apart(*arrays):
    """Rejects overlapping result arrays, which would be written concurrently."""
    arrays = [array for array in arrays if array is not None]
    for k, first in enumerate(arrays):
        if any(np.may_share_memory(first, other) for other in arrays[:k]):
            raise _native.HeadtailError("out: its arrays share memory")
