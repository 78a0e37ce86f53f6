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


class Material:
    """A measured or neural material: "nbrdf:FILE#NAME" or "neural:FILE"."""

    def __init__(self, name):
        self._native = _native.Material(name)

    @property
    def name(self):
        return self._native.name

    def __repr__(self):
        return f"Material({self.name!r})"


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

    def sample(self, n, wo=None, alpha=None, f0=None, u=None, *, count=None, seed=0, radiance=True, out=None, p=None, **surface):
        """Samples a direction per row.

        n: unit shading normals [count, 3], or one for all. wo: unit directions to the viewer, by default the normals. Surfaces are diffuse by
        default; alpha: Trowbridge-Reitz widths (and f0 reflectances at normal incidence, 1 by default) of glossy ones; roughness, metallic (0
        by default) and base_color (white by default): those of glTF. material: a `Material` of all rows; if it is neural, uv are texture
        coordinates [count, 2] (the texture repeats with period 1), tangent [count, 4] directions in which u grows and 1, or -1 where the
        texture is mirrored, and footprint (0 by default) the standard deviations of pixels' footprints in units of uv. p: positions [count, 3],
        which samplers with visibility or portals need. u: points of [0, 1)^2; by default random numbers from `seed`. out: (wi, pdf, radiance)
        to write to, each may be None.
        """
        at = _points(n, wo, p, alpha, f0, **surface)
        u = _uniform(u)
        draws = _results(_count(count, *_arrays(at), u), radiance, out, self._native)
        self._native.sample(at, u, _seed(seed), tuple(draws))
        return draws

    def pdf(self, wi, n, wo=None, alpha=None, f0=None, *, out=None, p=None, **surface):
        """Returns the solid-angle pdfs [count] of unit directions under `sample`; arguments as for it."""
        at = _points(n, wo, p, alpha, f0, **surface)
        wi = rows(wi, "wi", 3)
        count = _count(None, *_arrays(at), wi)
        out = result(out, "pdf", (count,))
        self._native.pdf(at, _for_all(wi, count), out)
        return out

    def prepare(self, n, wo=None, alpha=None, f0=None, *, count=None, p=None, **surface):
        """Returns points with which `sample` and `pdf` cost less, as `PreparedPoints`; arguments as for `sample`."""
        at = _points(n, wo, p, alpha, f0, **surface)
        return PreparedPoints(self._native.prepare(at, _count(count, *_arrays(at))))

    def save(self, path):
        """Writes the sampler's file; only samplers of `bake`, `fit` and `open` have one."""
        self._native.save(os.fspath(path))

    def __repr__(self):
        return f"Sampler({self._native.name!r})"


class PreparedPoints:
    """Points prepared for a sampler by `Sampler.prepare`."""

    def __init__(self, native):
        if not isinstance(native, _native.Prepared):
            raise TypeError("use Sampler.prepare")
        self._native = native

    def __len__(self):
        return self._native.count

    def sample(self, u=None, *, seed=0, radiance=True, out=None):
        """Samples a direction per point, as `Sampler.sample`."""
        draws = _results(len(self), radiance, out, self._native)
        self._native.sample(_uniform(u), _seed(seed), tuple(draws))
        return draws

    def pdf(self, wi, *, out=None):
        """Returns the solid-angle pdfs [count] of unit directions under `sample`."""
        out = result(out, "pdf", (len(self),))
        self._native.pdf(_for_all(rows(wi, "wi", 3), len(self)), out)
        return out


def bake(source, *, normals=(16, 32), cells=(32, 32), tail="hierarchical"):
    """Tabulates a map (light x cosine, without training) or a trained head; returns a `Sampler`."""
    if isinstance(source, Sampler):
        if not hasattr(_native, "bake_head"):
            raise _native.HeadtailError("bake: heads are baked by builds with training alone")
        return Sampler(_native.bake_head(source._native, _grid(normals, "normals"), _grid(cells, "cells")))
    return Sampler(_native.Sampler.direct(environment(source)._native, _grid(normals, "normals"), _grid(cells, "cells"), tail))


def brdf_cosine(wi, n, wo=None, alpha=None, f0=None, *, out=None, **surface):
    """Returns BRDF times max(0, n . wi) [count, 3], in 1/sr, for unit directions; surfaces as for `Sampler.sample`."""
    at = _points(n, wo, None, alpha, f0, **surface)
    wi = rows(wi, "wi", 3)
    count = _count(None, *_arrays(at), wi)
    out = result(out, "brdf_cosine", (count, 3))
    _native.brdf_cosine(at, _for_all(wi, count), out)
    return out


def _points(n, wo, p, alpha, f0, roughness=None, metallic=None, base_color=None, material=None, uv=None, tangent=None, footprint=None):
    """Returns positions, normals, directions to the viewer, and the arrays of surfaces that are not diffuse."""
    n = rows(n, "n", 3)
    wo, p = (None if given is None else rows(given, name, 3) for given, name in ((wo, "wo"), (p, "p")))
    kinds = {"alpha": alpha, "roughness": roughness, "material": material}
    given = [name for name, value in kinds.items() if value is not None]
    if len(given) > 1:
        raise _native.HeadtailError(f"{' and '.join(given)}: are of different surfaces; give one")
    others = {"f0": (f0, "alpha"), "metallic": (metallic, "roughness"), "base_color": (base_color, "roughness"),
              "uv": (uv, "material"), "tangent": (tangent, "material"), "footprint": (footprint, "material")}
    for name, (value, kind) in others.items():
        if value is not None and kinds[kind] is None:
            raise _native.HeadtailError(f"{name}: is of surfaces that have {kind}")
    if alpha is not None:
        return p, n, wo, (numbers(alpha, "alpha"), numbers(1.0 if f0 is None else f0, "f0"))
    if roughness is not None:
        color = rows([1.0, 1.0, 1.0] if base_color is None else base_color, "base_color", 3)
        return p, n, wo, (color, numbers(0.0 if metallic is None else metallic, "metallic"), numbers(roughness, "roughness"))
    if material is not None:
        if not isinstance(material, Material):
            raise TypeError('material: use Material("neural:FILE")')
        uv, tangent = (None if given is None else rows(given, name, width) for given, name, width in ((uv, "uv", 2), (tangent, "tangent", 4)))
        return p, n, wo, (material._native, uv, tangent, None if footprint is None else numbers(footprint, "footprint"))
    return p, n, wo, None


def _arrays(at):
    """Returns all arrays of points."""
    p, n, wo, surface = at
    return p, n, wo, *(array for array in surface or () if not isinstance(array, _native.Material))


def _uniform(u):
    return None if u is None else rows(u, "u", 2)


def _for_all(wi, count):
    return np.ascontiguousarray(np.broadcast_to(wi, (count, 3))) if len(wi) == 1 else wi


def _results(count, radiance, out, native):
    """Returns the arrays of draws; that of radiance if it is wanted and there is a map."""
    out_wi, out_pdf, out_radiance = out or (None, None, None)
    wi, pdf = result(out_wi, "wi", (count, 3)), result(out_pdf, "pdf", (count,))
    wants_radiance = out_radiance is not None or (radiance and native.has_map)
    light = result(out_radiance, "radiance", (count, 3)) if wants_radiance else None
    _check_apart(wi, pdf, light)
    return Draws(wi, pdf, light)


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
