"""Samplers of light directions in proportion to environment light x BRDF x cosine.

World space is right-handed with Y up; directions are unit vectors that point away from the surface, in rows of three 32-bit floats. Every pdf
is over solid angle, and a pdf of 0 means that there is no sample. A map's layout is that of Mitsuba 3's `envmap` without a transform.
"""

from . import _native
from ._environment import Environment
from ._native import HeadtailError
from ._render import Reference, Rendering, Scene, compare, render
from ._sampler import Draws, Material, PreparedPoints, Sampler, bake, brdf_cosine

__all__ = [
    "Draws",
    "Environment",
    "HeadtailError",
    "Material",
    "PreparedPoints",
    "Reference",
    "Rendering",
    "Sampler",
    "Scene",
    "bake",
    "brdf_cosine",
    "compare",
    "render",
]

# A build can leave training out.
if hasattr(_native, "fit"):
    from ._fit import fit, settings  # noqa: F401

    __all__ += ["fit", "settings"]
