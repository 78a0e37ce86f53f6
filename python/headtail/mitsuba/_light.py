"""The environment of a scene with its sampler, and the directions it draws at hits."""

import drjit as dr
import mitsuba as mi
import numpy as np

import headtail
from headtail import HeadtailError, _native

from ._emitters import attached
from ._head import HeadOverPatches, HeadOverTail
from ._pairs import Pairs
from ._patches import Patches, Point
from ._portals import Portals
from ._surface import Surfaces
from ._table import Table
from ._warp import remap


def environment_of(emitter):
    """Converts Mitsuba's environment emitter to a map of headtail in the emitter's own frame; None if it is
    black."""
    kind, parameters = emitter.class_name(), mi.traverse(emitter)
    if kind == "ConstantBackgroundEmitter":
        return headtail.Environment.from_array(np.ones((1, 1, 3), np.float32), "constant")
    if kind != "EnvironmentMapEmitter":
        raise HeadtailError(f"environment: there are samplers for envmap and constant, not for {kind}")
    texels = unpadded(np.array(dr.detach(parameters["data"])))
    scale = np.array(dr.detach(parameters["scale"])).ravel()[0]
    if texels.shape[2] == 1:
        texels = np.repeat(texels, 3, 2)
    texels = texels[..., :3] * scale
    return headtail.Environment.from_array(texels, "scene") if (texels > 0).any() else None


def unpadded(data):
    """Returns the texels of `data` without the columns that Mitsuba 3.9 adds: the last one before the first,
    and the first one after the last."""
    if data.shape[1] < 4 or not (np.array_equal(data[:, 0], data[:, -2]) and np.array_equal(data[:, -1], data[:, 1])):
        raise HeadtailError(
            f"environment: data of the shape {data.shape} do not repeat their first and last columns as those of Mitsuba 3.9 do; "
            f"this is Mitsuba {mi.__version__}"
        )
    return data[:, 1:-1]


class State:
    """The inputs of samplers: texels, scale and orientation of the map, as indices of Dr.Jit variables, so
    that nothing is evaluated; and the sampling weights of emitters."""

    def __init__(self, scene):
        self.scene, self.environment = scene, scene.environment()
        parameters = {} if self.environment is None else mi.traverse(self.environment)
        # References keep the indices from being reused, and make in-place writes create new variables.
        self.kept = [parameters[name] for name in ("data", "scale", "to_world") if name in parameters]
        self.numbers = [number for value in self.kept for number in numbers(value)]
        self.numbers += [float(emitter.sampling_weight()) for emitter in scene.emitters()]

    def is_of(self, other):
        """Returns whether a sampler for `self` is valid for `other`."""
        return self.scene is other.scene and self.environment == other.environment and self.numbers == other.numbers


def numbers(value):
    """Returns the variable indices of a parameter."""
    if hasattr(value, "matrix"):
        return [entry.index for row in value.matrix for entry in row]
    return [getattr(value, "array", value).index]


def product_of(arrays, loops=None):
    """Returns the sampler of `arrays`. `loops` is as in `Network`."""
    if "head.layers" in arrays:
        return (HeadOverPatches if "patches.clusters" in arrays else HeadOverTail)(arrays, loops)
    if "table.along" in arrays:
        return Table(arrays)
    if "portals.sums" in arrays:
        return Portals(arrays)
    return (Patches if "patches.clusters" in arrays else Pairs)(arrays)


def arrays_of(map, file, spec, portals, to_map):
    """Returns the arrays of the sampler of a file, of portals, or of a specification; `to_map` rotates the scene into the map's
    frame."""
    if portals is not None:
        return _native.portal_arrays(portals, map._native, [[float(number) for number in row] for row in to_map])
    if file:
        sampler = headtail.Sampler.open(file, map)
    elif spec == "table":
        sampler = headtail.bake(map)
    else:
        sampler = headtail.Sampler.from_spec("mis-comp" if spec == "mis2-comp" else spec, map)
    return sampler._native.arrays()


class Light:
    """The environment of a scene with its sampler, built on first use.

    Directions and pdfs are detached: they do not carry derivatives, while BSDFs, cosines and radiance do.
    """

    def __init__(self, scene, file, spec, portals=None):
        environment = scene.environment()
        if environment is None:
            raise HeadtailError("scene: has no environment map to sample; use Mitsuba's own integrators")
        self.environment, self.surfaces = environment, Surfaces(scene)
        self.to_world = dr.detach(environment.world_transform())
        self.to_map = self.to_world.inverse()
        axes = np.array(self.to_world.matrix).reshape(4, 4)[:3, :3]
        if not np.allclose(axes @ axes.T, np.eye(3), atol=1e-4):
            raise HeadtailError("environment: its to_world is not a rotation")
        map = environment_of(environment)
        if map is None:
            self.product = None
            return
        self.product = product_of(arrays_of(map, file, spec, portals, axes.T))

    def radiance(self, ray, wi, active):
        """Returns the radiance from a direction in world space."""
        far = dr.zeros(mi.SurfaceInteraction3f)
        far.wi, far.wavelengths, far.time = -wi, ray.wavelengths, ray.time
        return self.environment.eval(far, active)

    def prepare(self, ray, si, bsdf, active):
        """Returns what the sampler needs of hits for any number of directions; None under a black map."""
        if self.product is None:
            return None
        normal, back = mi.Vector3f(dr.detach(si.sh_frame.n)), mi.Vector3f(dr.detach(-ray.d))
        n, wo = self.to_map @ dr.mulsign(normal, dr.dot(normal, back)), self.to_map @ back
        is_patches = isinstance(self.product, Patches)
        sees_lobes = not self.surfaces.are_diffuse if is_patches else self.product.sees_lobes
        *lobes, can_draw = self.lobes(bsdf, si, active) if sees_lobes else (None, active)
        # Samplers that ignore positions do not evaluate them.
        p = self.to_map @ mi.Vector3f(dr.detach(si.p))
        prepared = self.product.prepare(Point(n, wo, lobes if sees_lobes else None, p))
        if self.surfaces.are_diffuse or not (is_patches or self.product.has_mixture_weight):
            return prepared, None
        mixture_weight = prepared.mixture_weight if is_patches else self.product.mixture_weight(prepared)
        return prepared, dr.select(can_draw, mixture_weight, 0)

    def estimate(self, sampler, si, bsdf, prepared, active):
        """Samples directions of light at hits. For each: (wi in world space, weighted BSDF x cosine / pdf,
        mask of valid samples)."""
        if prepared is None:
            return []
        prepared, mixture_weight = prepared
        if self.surfaces.are_diffuse and not isinstance(self.product, Pairs):
            return [self.product_alone(sampler, si, bsdf, prepared, active)]
        if mixture_weight is None:
            return self.product_and_bsdf(sampler, si, bsdf, prepared, active)
        beside_bsdf = self.patches_beside_bsdf if isinstance(self.product, Patches) else self.product_beside_bsdf
        return [beside_bsdf(sampler, si, bsdf, prepared, mixture_weight, active)]

    def lobes(self, bsdf, si, active):
        return [dr.detach(value) for value in self.surfaces.lobes(bsdf, dr.detach(si), active)]

    def product_alone(self, sampler, si, bsdf, prepared, active):
        """Samples one direction by the product, for diffuse surfaces."""
        local, pdf = self.product.sample(prepared, sampler.next_2d(active), active)
        wi = self.to_world @ local
        value = bsdf.eval(mi.BSDFContext(), si, si.to_local(wi), active)
        return wi, dr.select(pdf > 0, value / pdf, 0), active & (pdf > 0)

    def patches_beside_bsdf(self, sampler, si, bsdf, prepared, mixture_weight, active):
        """Samples one direction by patches or the BSDF, with the mixture's pdf."""
        context, z = mi.BSDFContext(), sampler.next_2d(active)
        by_product = z.x < mixture_weight
        by_bsdf = active & ~by_product
        drawn, weight = bsdf.sample(context, si, sampler.next_1d(active), sampler.next_2d(active), by_bsdf)
        toward = dr.detach(si.to_world(drawn.wo))
        z.x = dr.select(by_product, remap(z.x, 0, mixture_weight), 0)
        local, pdf = self.product.sample_or_pdf(prepared, z, by_bsdf, self.to_map @ toward, active)
        wi = dr.select(by_bsdf, toward, self.to_world @ local)
        return self.mixed(si, bsdf, mixture_weight, pdf, wi, by_bsdf, drawn, weight, active)

    def product_beside_bsdf(self, sampler, si, bsdf, prepared, mixture_weight, active):
        """Samples one direction by a head or the BSDF, with the mixture's pdf and the head's selection
        probability."""
        z = sampler.next_2d(active)
        by_bsdf = active & ~(z.x < mixture_weight)
        drawn, weight = bsdf.sample(mi.BSDFContext(), si, sampler.next_1d(active), sampler.next_2d(active), by_bsdf)
        z.x = dr.select(by_bsdf, 0, remap(z.x, 0, mixture_weight))
        local, pdf = self.product.sample(prepared, z, active & ~by_bsdf)
        wi = dr.select(by_bsdf, dr.detach(si.to_world(drawn.wo)), self.to_world @ local)
        pdf = dr.select(by_bsdf, self.product.pdf(prepared, self.to_map @ wi, by_bsdf), pdf)
        return self.mixed(si, bsdf, mixture_weight, pdf, wi, by_bsdf, drawn, weight, active)

    @staticmethod
    def mixed(si, bsdf, mixture_weight, pdf, wi, by_bsdf, drawn, weight, active):
        """Weights a direction of the product or of the BSDF by the mixture's pdf."""
        value, other = bsdf.eval_pdf(mi.BSDFContext(), si, si.to_local(wi), active)
        mixed = mixture_weight * pdf + (1 - mixture_weight) * dr.detach(other)
        # A delta lobe has no density, so it is a separate technique.
        is_delta = by_bsdf & mi.has_flag(drawn.sampled_type, mi.BSDFFlags.Delta)
        ratio = dr.select(is_delta, weight / (1 - mixture_weight), dr.select(mixed > 0, value / mixed, 0))
        return wi, ratio, active & (by_bsdf | (pdf > 0))

    def product_and_bsdf(self, sampler, si, bsdf, prepared, active):
        """Samples two directions, by a table or head and by the BSDF, combined with the power heuristic."""
        first = self.product_beside(sampler, si, bsdf, prepared, active)
        drawn, weight = bsdf.sample(mi.BSDFContext(), si, sampler.next_1d(active), sampler.next_2d(active), active)
        wi = dr.detach(si.to_world(drawn.wo))
        weight, drawn = attached(bsdf, si, wi, drawn, weight, active), dr.detach(drawn)
        fraction = self.fraction_of_bsdf(prepared, wi, drawn, active)
        return [first, (wi, dr.select(drawn.pdf > 0, weight * fraction, 0), active)]

    def product_beside(self, sampler, si, bsdf, prepared, active):
        """Samples one direction by the product, weighted for two-sample MIS with the BSDF."""
        local, pdf = self.product.sample(prepared, sampler.next_2d(active), active)
        wi = self.to_world @ local
        value, other = bsdf.eval_pdf(mi.BSDFContext(), si, si.to_local(wi), active & (pdf > 0))
        other = dr.detach(other)
        return wi, dr.select(pdf > 0, value * pdf / (pdf * pdf + other * other), 0), active & (pdf > 0)

    def fraction_of_bsdf(self, prepared, wi, drawn, active):
        """Returns the weight of a direction of the BSDF in two-sample MIS."""
        is_delta = mi.has_flag(drawn.sampled_type, mi.BSDFFlags.Delta)
        pdf = dr.select(is_delta, 0, self.product.pdf(prepared, self.to_map @ wi, active & ~is_delta))
        return dr.square(drawn.pdf) / (dr.square(drawn.pdf) + dr.square(pdf))

    @property
    def has_pairs(self):
        """Whether light is estimated by directions of the product and of the BSDF, as two techniques."""
        if self.product is None or isinstance(self.product, Patches) or self.product.has_mixture_weight:
            return False
        return not self.surfaces.are_diffuse or isinstance(self.product, Pairs)

    def reflected(self, scene, sampler, ray, si, bsdf, prepared, hit, misses, is_beside=False):
        """Returns an estimate of the environment's light reflected at hits, and its light along the rays of `misses`.
        With `is_beside`, the BSDF's direction of a pair is left to the caller."""
        result, origin = mi.Spectrum(0), dr.detach(si)
        if is_beside:
            directions = [self.product_beside(sampler, si, bsdf, prepared[0], hit)]
        else:
            directions = self.estimate(sampler, si, bsdf, prepared, hit)
        for index, (wi, ratio, lit) in enumerate(directions):
            # A new array: in-place changes would also affect the caller's.
            lit = lit & (dr.max(ratio) > 0)
            lit &= ~scene.ray_test(origin.spawn_ray(wi), lit)
            # The first lookup serves hits and misses, so the kernel has no separate one.
            seen = misses if index == 0 else mi.Bool(False)
            radiance = self.radiance(ray, dr.select(hit, wi, ray.d), lit | seen)
            result += dr.select(lit, radiance * ratio, dr.select(seen, radiance, 0))
        return result
