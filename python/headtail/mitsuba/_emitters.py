"""The emitters of a scene beside its environment, sampled as Mitsuba's integrators do."""

import drjit as dr
import mitsuba as mi
import numpy as np


def power_heuristic(own, other):
    """Returns the weight of a technique by the power heuristic with exponent 2."""
    own, other = dr.square(own), dr.square(other)
    return dr.select(own > 0, own / (own + other), 0)


def attached(bsdf, si, wi, drawn, weight, active):
    """Returns the weight of a BSDF sample in the detached direction `wi`, with derivatives of the BSDF and the
    cosine. Delta lobes keep the weight of their sample."""
    if not dr.grad_enabled(weight, drawn.wo, si):
        return weight
    value, pdf = bsdf.eval_pdf(mi.BSDFContext(), si, si.to_local(wi), active)
    return dr.select(pdf > 0, value / dr.detach(pdf), weight)


def per_area(ds):
    """Returns the solid angle of an emitter per area."""
    return dr.abs(dr.dot(ds.n, ds.d)) / dr.square(ds.dist)


class Emitters:
    """The emitters of a scene other than its environment, each chosen in proportion to its `sampling_weight`."""

    def __init__(self, scene):
        chosen = [index for index, emitter in enumerate(scene.emitters()) if not emitter.is_environment()]
        emitters = [scene.emitters()[index] for index in chosen]
        weights = np.array([emitter.sampling_weight() for emitter in emitters], np.float32)
        # Without weights, emitters are met by BSDF samples alone.
        self.indices, self.distribution = mi.UInt32(chosen), mi.DiscreteDistribution(weights) if weights.any() else None
        self.are_surfaces = any(mi.has_flag(emitter.flags(), mi.EmitterFlags.Surface) for emitter in emitters)

    @staticmethod
    def of(scene):
        """Returns the emitters of a scene; None if it has none beside its environment."""
        return Emitters(scene) if any(not emitter.is_environment() for emitter in scene.emitters()) else None

    def sampled(self, scene, sampler, si, bsdf, active):
        """Samples an emitter and a direction towards it: reflected light, weighted for MIS with BSDF samples."""
        if self.distribution is None:
            return mi.Spectrum(0)
        active = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        u = sampler.next_2d(active)
        chosen, u.x, probability = self.distribution.sample_reuse_pmf(u.x, active)
        index = dr.gather(mi.UInt32, self.indices, chosen, active)
        emitter = dr.gather(mi.EmitterPtr, scene.emitters_dr(), index, active)
        at = dr.detach(si)
        ds, radiance = emitter.sample_direction(at, u, active)
        ds = dr.detach(ds)
        active &= ds.pdf > 0
        if dr.grad_enabled(si, radiance):
            # The position on the emitter stays; direction, distance and solid angle follow the surface.
            toward, solid_angle = ds.p - si.p, per_area(ds)
            ds.dist = dr.norm(toward)
            ds.d = toward / ds.dist
            follows = dr.select(mi.has_flag(emitter.flags(), mi.EmitterFlags.Surface), per_area(ds) / solid_angle, 1)
            radiance = emitter.eval_direction(si, ds, active) / ds.pdf * follows
        active &= ~scene.ray_test(at.spawn_ray_to(ds.p), active)
        value, by_bsdf = bsdf.eval_pdf(mi.BSDFContext(), si, si.to_local(ds.d), active)
        weight = dr.select(ds.delta, 1, power_heuristic(ds.pdf * probability, dr.detach(by_bsdf)))
        return dr.select(active, value * radiance * (weight / probability), 0)

    def seen(self, scene, si, previous, pdf, is_delta, active):
        """Returns the light that a hit emits towards `previous`, weighted for MIS, where `pdf` is that of the BSDF
        sample that led to the hit."""
        emitted, by_emitter = self.emitted(scene, si, active), mi.Float(0)
        if self.distribution is not None:
            ds = dr.detach(mi.DirectionSample3f(scene, si, previous))
            compared = active & ~is_delta & (ds.emitter != None)  # noqa: E711: compares each lane
            probability = ds.emitter.sampling_weight() * self.distribution.normalization()
            by_emitter = ds.emitter.pdf_direction(dr.detach(previous), ds, compared) * probability
            by_emitter = dr.select(compared, by_emitter, 0)
        weight = dr.select(is_delta, 1, power_heuristic(pdf, by_emitter))
        is_lit = active & (si.emitter(scene, active) != None)  # noqa: E711: compares each lane
        return dr.select(is_lit, emitted * dr.detach(weight), 0)

    def reflected(self, scene, sampler, si, bsdf, active):
        """Returns an estimate of the emitters' light reflected at hits."""
        result = self.sampled(scene, sampler, si, bsdf, active)
        return result + self.by_bsdf(scene, sampler, si, bsdf, active) if self.are_surfaces else result

    def by_bsdf(self, scene, sampler, si, bsdf, active):
        """Samples a direction by the BSDF: reflected light of the emitter that it meets, weighted for MIS with
        `sampled`."""
        drawn, weight = bsdf.sample(mi.BSDFContext(), si, sampler.next_1d(active), sampler.next_2d(active), active)
        wi = dr.detach(si.to_world(drawn.wo))
        active = active & (dr.max(weight) > 0)
        weight = attached(bsdf, si, wi, drawn, weight, active)
        met = scene.ray_intersect(dr.detach(si).spawn_ray(wi), active)
        active &= met.is_valid()
        is_delta = mi.has_flag(drawn.sampled_type, mi.BSDFFlags.Delta)
        return weight * self.seen(scene, met, mi.Interaction3f(si), dr.detach(drawn.pdf), is_delta, active)

    @staticmethod
    def emitted(scene, si, active):
        """Returns the light that hits emit."""
        emitter = si.emitter(scene, active)
        active = active & (emitter != None)  # noqa: E711: compares each lane
        return dr.select(active, emitter.eval(si, active), 0)
