"""Environment maps."""

import os
import warnings

from . import _native
from ._arrays import floats, result, rows


class Environment:
    """An environment map: a built-in one (overcast, window, studio, sunset), a Radiance .hdr or OpenEXR file, or an array."""

    def __init__(self, name_or_path, *, layout=None, layer=None):
        """Opens a map. `layout` (latlong, equal-area, cube, cross or angular) is needed if the file does not
        state it; `layer` selects the layer of an OpenEXR file. Repaired values raise warnings; see `warnings`
        and `notes`."""
        self._native = _native.Environment.open(os.fspath(name_or_path), layout, layer)
        self._warn(name_or_path)

    @classmethod
    def from_array(cls, texels, name="array", *, layout=None):
        """Creates a map from linear Rec.709 radiance `[height, width, 3]`, rows from the top; layouts other
        than latlong are converted."""
        texels = floats(texels, "texels")
        if texels.ndim != 3 or texels.shape[2] != 3:
            raise _native.HeadtailError(f"texels: has the shape {texels.shape}, not [height, width, 3]")
        self = cls.__new__(cls)
        self._native = _native.Environment.from_array(texels, name, layout)
        self._warn(name)
        return self

    def _warn(self, name):
        for text in self.warnings:
            warnings.warn(f"{name}: {text}", stacklevel=3)

    @property
    def name(self):
        """The map's short name."""
        return self._native.name

    @property
    def shape(self):
        """(height, width)"""
        return self._native.height, self._native.width

    @property
    def hash(self):
        """Hexadecimal BLAKE3 hash of size and texels, which identifies the map in sampler files."""
        return self._native.hash

    @property
    def notes(self):
        """One message per conversion that the file required, and for the chosen layer."""
        return self._native.notes

    @property
    def warnings(self):
        """One message per kind of repaired value."""
        return self._native.warnings

    def array(self):
        """The repaired texels `[height, width, 3]`."""
        return self._native.array()

    def radiance(self, wi, out=None):
        """Radiance `[count, 3]` from unit directions, by bilinear lookup."""
        wi = rows(wi, "wi", 3)
        out = result(out, "radiance", wi.shape)
        self._native.radiance(wi, out)
        return out

    def __repr__(self):
        return f"Environment({self.name!r}, {self.shape[1]} x {self.shape[0]})"


def environment(value):
    """Returns a map from a map, a name, a path or an array."""
    if isinstance(value, Environment):
        return value
    if isinstance(value, (str, os.PathLike)):
        return Environment(value)
    return Environment.from_array(value)


__all__ = ["Environment", "environment"]
