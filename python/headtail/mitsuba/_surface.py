"""Approximates Mitsuba's BSDFs by a diffuse and a Trowbridge-Reitz lobe."""

import drjit as dr
import mitsuba as mi

# BSDFs that are proportional to the cosine with the shading normal. All others are mixed with their own
# sampling: a bump map, for example, changes the cosine.
DIFFUSE = "SmoothDiffuse"
TWO_SIDED = "TwoSided"

LEAST_ALPHA = 1e-3


def is_diffuse(bsdf):
    """Returns whether a BSDF is purely diffuse on both sides."""
    diffuse = int(mi.BSDFFlags.DiffuseReflection)
    if any(int(bsdf.flags(k)) & 0x7FFF & ~diffuse for k in range(bsdf.component_count())):
        return False
    # Nested BSDFs are visible only in the description, where a class name precedes each bracket.
    text = str(bsdf)
    if text.startswith(TWO_SIDED):
        sides = [line for line in text.splitlines() if line.lstrip().startswith("brdf[")]
        return bool(sides) and all(f"= {DIFFUSE}[" in line for line in sides)
    return text.startswith(f"{DIFFUSE}[")


def luminance(color):
    """Returns the luminance of a colour with three channels or one."""
    return mi.luminance(color) if len(color) == 3 else color.x


class Kind:
    """Properties of a BSDF that do not depend on a hit."""

    def __init__(self, bsdf):
        flags = int(bsdf.flags())
        has = lambda name: bool(bsdf.has_attribute(name)[0])
        self.is_diffuse = is_diffuse(bsdf)
        self.has_diffuse = bool(flags & int(mi.BSDFFlags.DiffuseReflection))
        self.has_glossy = bool(flags & int(mi.BSDFFlags.GlossyReflection))
        self.attributes = {name for name in ("alpha", "roughness", "base_color", "metallic") if has(name)}

    def lobes(self, bsdf, si, active):
        """Returns (diffuse, specular, f0, alpha, whether product sampling applies) at hits."""
        zero = si.t * 0
        if self.is_diffuse:
            return zero + 1, zero, zero + 1, zero + 1, active
        if not self.has_diffuse and not self.has_glossy:
            return zero, zero + 1, zero + 1, zero + LEAST_ALPHA, mi.Bool(False) & active
        if "alpha" in self.attributes:
            alpha = bsdf.eval_attribute_1("alpha", si, active)
        elif "roughness" in self.attributes:
            alpha = dr.square(bsdf.eval_attribute_1("roughness", si, active))
        else:
            # Diffuse below a smooth coat, or an unknown lobe.
            alpha = zero + 0.1
        diffuse, f0 = zero, zero + 0.8
        if {"base_color", "metallic"} <= self.attributes:
            color = luminance(bsdf.eval_attribute("base_color", si, active))
            metallic = bsdf.eval_attribute_1("metallic", si, active)
            diffuse, f0 = (1 - metallic) * color, dr.lerp(0.04, color, metallic)
        elif self.has_diffuse:
            diffuse, f0 = luminance(bsdf.eval_diffuse_reflectance(si, active)), zero + 0.04
        return diffuse, zero + 1, f0, dr.clip(alpha, LEAST_ALPHA, 1), active


class Surfaces:
    """The BSDFs of a scene."""

    def __init__(self, scene):
        self.kinds = []
        for shape in scene.shapes():
            bsdf = shape.bsdf()
            if bsdf is not None and self.kind(bsdf) is None:
                self.kinds.append((bsdf, Kind(bsdf)))
        self.are_diffuse = all(kind.is_diffuse for _, kind in self.kinds)

    def kind(self, bsdf):
        """Returns the kind of a BSDF; None for parts of others."""
        return next((kind for known, kind in self.kinds if known == bsdf), None)

    def lobes(self, bsdf, si, active):
        """Like `Kind.lobes`, for the BSDF of each lane."""

        def lobes(bsdf, si, active):
            kind = self.kind(bsdf)
            if kind is None:
                zero = si.t * 0
                return zero, zero, zero, zero, mi.Bool(False) & active
            return kind.lobes(bsdf, si, active)

        return dr.dispatch(bsdf, lobes, si, active)
