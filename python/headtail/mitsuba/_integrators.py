"""The integrators `headtail_direct` and `headtail_path`."""

import drjit as dr
import mitsuba as mi
import numpy as np

import headtail
from headtail import HeadtailError

from ._head import HeadOverPatches, HeadOverTail
from ._patches import Patches, Point
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
    texels = unpadded(np.array(parameters["data"]))
    scale = np.array(parameters["scale"]).ravel()[0]
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
    """The inputs of a sampler: texels, scale and orientation of the map, as indices of Dr.Jit variables, so
    that nothing is evaluated."""

    def __init__(self, scene):
        self.scene, self.environment = scene, scene.environment()
        parameters = {} if self.environment is None else mi.traverse(self.environment)
        # References keep the indices from being reused, and make in-place writes create new variables.
        self.kept = [parameters[name] for name in ("data", "scale", "to_world") if name in parameters]
        self.numbers = [number for value in self.kept for number in numbers(value)]

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
    return (Table if "table.along" in arrays else Patches)(arrays)


class Light:
    """The environment of a scene with its sampler, built on first use."""

    def __init__(self, scene, file, spec):
        emitters = scene.emitters()
        environment = scene.environment()
        if environment is None or len(emitters) != 1:
            raise HeadtailError(
                f"scene: has {len(emitters)} emitters; headtail's integrators light a scene by one environment map and nothing else"
            )
        self.environment, self.surfaces = environment, Surfaces(scene)
        self.to_world = environment.world_transform()
        self.to_map = self.to_world.inverse()
        axes = np.array(self.to_world.matrix).reshape(4, 4)[:3, :3]
        if not np.allclose(axes @ axes.T, np.eye(3), atol=1e-4):
            raise HeadtailError("environment: its to_world is not a rotation")
        map = environment_of(environment)
        if map is None:
            self.product = None
            return
        if file:
            sampler = headtail.Sampler.open(file, map)
        elif spec == "table":
            sampler = headtail.bake(map)
        else:
            sampler = headtail.Sampler.from_spec(spec, map)
        self.product = product_of(sampler._native.arrays())

    def radiance(self, ray, wi, active):
        """Returns the radiance from a direction in world space."""
        far = dr.zeros(mi.SurfaceInteraction3f)
        far.wi, far.wavelengths, far.time = -wi, ray.wavelengths, ray.time
        return self.environment.eval(far, active)

    def estimate(self, scene, sampler, ray, si, bsdf, active):
        """Samples directions of light at hits. For each: (wi in world space, weighted BSDF x cosine / pdf,
        mask of valid samples)."""
        if self.product is None:
            return []
        toward = dr.dot(si.sh_frame.n, -ray.d)
        n, wo = self.to_map @ mi.Vector3f(dr.mulsign(si.sh_frame.n, toward)), self.to_map @ mi.Vector3f(-ray.d)
        if isinstance(self.product, Patches):
            if self.surfaces.are_diffuse:
                return [self.patches_alone(sampler, si, bsdf, n, wo, active)]
            return [self.patches_beside_bsdf(sampler, si, bsdf, n, wo, active)]
        sees_lobes = self.product.sees_lobes
        *lobes, can_draw = self.surfaces.lobes(bsdf, si, active) if sees_lobes else (None, active)
        prepared = self.product.prepare(Point(n, wo, lobes if sees_lobes else None))
        if self.surfaces.are_diffuse:
            return [self.product_alone(sampler, si, bsdf, prepared, active)]
        if self.product.has_mixture_weight:
            mixture_weight = dr.select(can_draw, self.product.mixture_weight(prepared), 0)
            return [self.product_beside_bsdf(sampler, si, bsdf, prepared, mixture_weight, active)]
        return self.product_and_bsdf(sampler, si, bsdf, prepared, active)

    def patches_alone(self, sampler, si, bsdf, n, wo, active):
        """Samples one direction by patches, for diffuse surfaces."""
        local, pdf = self.product.sample(Point(n, wo, None), sampler.next_2d(active), None, None, active)
        return self.weighted(si, bsdf, local, pdf, active)

    def product_alone(self, sampler, si, bsdf, prepared, active):
        """Samples one direction by a table or a head, for diffuse surfaces."""
        local, pdf = self.product.sample(prepared, sampler.next_2d(active), active)
        return self.weighted(si, bsdf, local, pdf, active)

    def weighted(self, si, bsdf, local, pdf, active):
        wi = self.to_world @ local
        value = bsdf.eval(mi.BSDFContext(), si, si.to_local(wi), active)
        return wi, dr.select(pdf > 0, value / pdf, 0), active & (pdf > 0)

    def patches_beside_bsdf(self, sampler, si, bsdf, n, wo, active):
        """Samples one direction by patches or the BSDF, with the mixture's pdf."""
        context, z = mi.BSDFContext(), sampler.next_2d(active)
        *lobes, can_draw = self.surfaces.lobes(bsdf, si, active)
        at = Point(n, wo, lobes)
        mixture_weight = dr.select(can_draw, self.product.mixture_weight(at), 0)
        by_product = z.x < mixture_weight
        by_bsdf = active & ~by_product
        drawn, weight = bsdf.sample(context, si, sampler.next_1d(active), sampler.next_2d(active), by_bsdf)
        z.x = dr.select(by_product, remap(z.x, 0, mixture_weight), 0)
        local, pdf = self.product.sample(at, z, by_bsdf, self.to_map @ si.to_world(drawn.wo), active)
        wi = dr.select(by_bsdf, si.to_world(drawn.wo), self.to_world @ local)
        return self.mixed(si, bsdf, mixture_weight, pdf, wi, by_bsdf, drawn, weight, active)

    def product_beside_bsdf(self, sampler, si, bsdf, prepared, mixture_weight, active):
        """Samples one direction by a head or the BSDF, with the mixture's pdf and the head's selection
        probability."""
        z = sampler.next_2d(active)
        by_bsdf = active & ~(z.x < mixture_weight)
        drawn, weight = bsdf.sample(mi.BSDFContext(), si, sampler.next_1d(active), sampler.next_2d(active), by_bsdf)
        z.x = dr.select(by_bsdf, 0, remap(z.x, 0, mixture_weight))
        local, pdf = self.product.sample(prepared, z, active & ~by_bsdf)
        wi = dr.select(by_bsdf, si.to_world(drawn.wo), self.to_world @ local)
        pdf = dr.select(by_bsdf, self.product.pdf(prepared, self.to_map @ wi, by_bsdf), pdf)
        return self.mixed(si, bsdf, mixture_weight, pdf, wi, by_bsdf, drawn, weight, active)

    @staticmethod
    def mixed(si, bsdf, mixture_weight, pdf, wi, by_bsdf, drawn, weight, active):
        """Weights a direction of the product or of the BSDF by the mixture's pdf."""
        value, other = bsdf.eval_pdf(mi.BSDFContext(), si, si.to_local(wi), active)
        mixed = mixture_weight * pdf + (1 - mixture_weight) * other
        # A delta lobe has no density, so it is a separate technique.
        is_delta = by_bsdf & mi.has_flag(drawn.sampled_type, mi.BSDFFlags.Delta)
        ratio = dr.select(is_delta, weight / (1 - mixture_weight), dr.select(mixed > 0, value / mixed, 0))
        return wi, ratio, active & (by_bsdf | (pdf > 0))

    def product_and_bsdf(self, sampler, si, bsdf, prepared, active):
        """Samples two directions, by a table or head and by the BSDF, combined with the power heuristic."""
        context = mi.BSDFContext()
        local, pdf = self.product.sample(prepared, sampler.next_2d(active), active)
        wi = self.to_world @ local
        value, other = bsdf.eval_pdf(context, si, si.to_local(wi), active & (pdf > 0))
        first = (wi, dr.select(pdf > 0, value * pdf / (pdf * pdf + other * other), 0), active & (pdf > 0))
        drawn, weight = bsdf.sample(context, si, sampler.next_1d(active), sampler.next_2d(active), active)
        wi = si.to_world(drawn.wo)
        is_delta = mi.has_flag(drawn.sampled_type, mi.BSDFFlags.Delta)
        pdf = dr.select(is_delta, 0, self.product.pdf(prepared, self.to_map @ wi, active & ~is_delta))
        fraction = dr.square(drawn.pdf) / (dr.square(drawn.pdf) + dr.square(pdf))
        return [first, (wi, dr.select(drawn.pdf > 0, weight * fraction, 0), active)]

    def reflected(self, scene, sampler, ray, si, bsdf, hit, misses):
        """Returns the environment's light reflected at hits, and that along the rays of `misses`."""
        result = mi.Spectrum(0)
        for index, (wi, ratio, lit) in enumerate(self.estimate(scene, sampler, ray, si, bsdf, hit)):
            # A new array: in-place changes would also affect the caller's.
            lit = lit & (dr.max(ratio) > 0)
            lit &= ~scene.ray_test(si.spawn_ray(wi), lit)
            # The first lookup serves hits and misses, so the kernel has no separate one.
            seen = misses if index == 0 else mi.Bool(False)
            radiance = self.radiance(ray, dr.select(hit, wi, ray.d), lit | seen)
            result += dr.select(lit, radiance * ratio, dr.select(seen, radiance, 0))
        return result


def make():
    """Returns the classes for the current variant."""

    class Base(mi.SamplingIntegrator):
        def __init__(self, props):
            super().__init__(props)
            self.file = str(props.get("file", ""))
            self.spec = str(props.get("sampler", "auto"))
            self.hide_emitters = bool(props.get("hide_emitters", False))
            if self.spec not in ("auto", "table", "patches", "patches:fine"):
                raise HeadtailError(f"sampler '{self.spec}': is not one of auto, table, patches, patches:fine")
            if self.spec == "auto":
                self.spec = "patches"
            self._light, self._state = None, None

        def light(self, scene):
            """Returns the scene's light, rebuilt for another scene, map or orientation. Mitsuba does not
            notify integrators of changed emitters."""
            if self._light is None or not self._state.is_of(State(scene)):
                self._light = Light(scene, self.file, self.spec)
                # Afterwards, because access to a parameter can replace its variable.
                self._state = State(scene)
            return self._light

        def aov_names(self):
            return []

    class Direct(Base):
        """Direct light of the environment."""

        def sample(self, scene, sampler, ray, medium=None, active=True):
            light = self.light(scene)
            si = scene.ray_intersect(ray, active=active)
            hit = active & si.is_valid()
            misses = active & ~hit
            if self.hide_emitters:
                misses &= False
            result = light.reflected(scene, sampler, ray, si, si.bsdf(ray), hit, misses)
            return result, hit if self.hide_emitters else active, []

        def to_string(self):
            return f"HeadtailDirect[sampler={self.file or self.spec}]"

    class Path(Base):
        """Environment light over `max_depth` - 1 surfaces, as in Mitsuba's `path`; -1 means no limit."""

        def __init__(self, props):
            super().__init__(props)
            self.max_depth = int(props.get("max_depth", -1))
            self.rr_depth = int(props.get("rr_depth", 5))
            if self.max_depth < -1 or self.rr_depth < 1:
                raise HeadtailError("max_depth must be -1 or more, rr_depth at least 1")

        @dr.syntax
        def sample(self, scene, sampler, ray, medium=None, active=True):
            light = self.light(scene)
            limit = self.max_depth if self.max_depth >= 0 else 0xFFFFFFFF
            ray, result, weight = mi.Ray3f(ray), mi.Spectrum(0), mi.Spectrum(1)
            depth, eta, seen, active = mi.UInt32(0), mi.Float(1), mi.Bool(False), mi.Bool(active)
            if self.max_depth == 0:
                active = mi.Bool(False)
            while active:
                si = scene.ray_intersect(ray, active)
                hit = active & si.is_valid()
                misses = active & ~hit & (depth == 0)
                seen |= hit
                if self.hide_emitters:
                    misses &= False
                hit &= depth + 1 < limit
                bsdf = si.bsdf(ray)
                result += weight * light.reflected(scene, sampler, ray, si, bsdf, hit, misses)
                depth += 1
                active = hit & (depth + 1 < limit)
                drawn, factor = bsdf.sample(
                    mi.BSDFContext(), si, sampler.next_1d(active), sampler.next_2d(active), active
                )
                ray = si.spawn_ray(si.to_world(drawn.wo))
                weight *= factor
                eta *= drawn.eta
                largest = dr.max(weight)
                survives = dr.minimum(largest * eta * eta, 0.95)
                roulette = active & (depth >= self.rr_depth)
                active &= largest > 0
                active &= ~roulette | (sampler.next_1d(active) < survives)
                weight[roulette] *= dr.rcp(survives)
            return result, seen if self.hide_emitters else mi.Bool(True), []

        def to_string(self):
            return f"HeadtailPath[sampler={self.file or self.spec}, max_depth={self.max_depth}]"

    return {"headtail_direct": Direct, "headtail_path": Path}
