"""A rough mirror whose masking-shadowing is height-correlated (Heitz 2014, eq. 99), as in headtail.

Mitsuba's `roughconductor` multiplies the masking of both directions as if they were independent. The lobe, its sampling and its
pdf are reused; only that factor is replaced."""

import drjit as dr
import mitsuba as mi


class HeightCorrelated(mi.BSDF):
    def __init__(self, props):
        super().__init__(props)
        self.alpha = props["alpha"]
        self.separable = mi.load_dict({"type": "roughconductor", "material": "none", "distribution": "ggx", "alpha": self.alpha})
        self.m_components = [mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide]
        self.m_flags = self.m_components[0]

    def correction(self, wi, wo):
        """G2 / (G1(wi) G1(wo)), with lambda = (sqrt(1 + (alpha tan)^2) - 1) / 2 and G1 = 1 / (1 + lambda)."""
        smith = lambda w: 0.5 * (dr.sqrt(1 + self.alpha**2 * (1 - w.z**2) / dr.maximum(w.z**2, 1e-12)) - 1)
        a, b = smith(wi), smith(wo)
        return (1 + a) * (1 + b) / (1 + a + b)

    def sample(self, ctx, si, sample1, sample2, active=True):
        drawn, weight = self.separable.sample(ctx, si, sample1, sample2, active)
        return drawn, weight * self.correction(si.wi, drawn.wo)

    def eval(self, ctx, si, wo, active=True):
        return self.separable.eval(ctx, si, wo, active) * self.correction(si.wi, wo)

    def pdf(self, ctx, si, wo, active=True):
        return self.separable.pdf(ctx, si, wo, active)

    def eval_pdf(self, ctx, si, wo, active=True):
        return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

    def to_string(self):
        return f"HeightCorrelated[alpha={self.alpha}]"


mi.register_bsdf("height_correlated", HeightCorrelated)
