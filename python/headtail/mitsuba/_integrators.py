"""The integrators `headtail_direct` and `headtail_path`."""

import drjit as dr
import mitsuba as mi

from headtail import HeadtailError

from ._emitters import Emitters, attached
from ._light import Light, State
from ._pilot import choose
from ._rooms import FOUND, find_portals, is_portals, portals_for_auto, portals_of_file

SAMPLERS = ("auto", "table", "patches", "patches:fine", "mis2-comp")
# What `auto` chooses from, and the time of a sample of each on diffuse and on other surfaces, relative to one another.
CHOICES = {"patches": (1.4, 2.2), "mis2-comp": (1.0, 1.0)}
MOST_SAMPLES = 64


def cost_of_portals(count):
    """Returns the time of a sample through portals, as those of CHOICES."""
    return 1.2 + 0.2 * count


def has_media(scene):
    """Returns whether a shape of a scene bounds a medium."""
    return any(shape.is_medium_transition() for shape in scene.shapes())


def make():
    """Returns the classes for the current variant."""

    class Base(mi.SamplingIntegrator):
        def __init__(self, props):
            super().__init__(props)
            self.file = str(props.get("file", ""))
            self.spec = str(props.get("sampler", "auto"))
            self.hide_emitters = bool(props.get("hide_emitters", False))
            if self.spec not in SAMPLERS and not is_portals(self.spec):
                raise HeadtailError(f"sampler '{self.spec}': is not one of {', '.join(SAMPLERS)}, {FOUND}, {FOUND}:FILE")
            self._light, self._state, self._emitters = None, None, None
            # What `auto` has chosen, and the portals that were found, for a scene.
            self.chosen, self.portals, self.chosen_for = "patches", None, None
            self._volumes, self._loop = None, None

        def lights(self, scene):
            """Returns the scene's environment, rebuilt for another scene, map or orientation, and its other
            emitters. Mitsuba does not notify integrators of changed emitters."""
            if self._light is None or not self._state.is_of(State(scene)):
                # Inside another integrator, the view is not known.
                if self.spec == FOUND and self.chosen_for is not scene:
                    self.open_view(scene, scene.sensors()[0])
                self.keep(scene, self.light_of(scene, self.chosen if self.spec == "auto" else self.spec))
            return self._light, self._emitters

        def light_of(self, scene, spec):
            """Returns a scene's environment with the sampler of a specification."""
            if self.file or not is_portals(spec):
                return Light(scene, self.file, spec)
            return Light(scene, "", spec, self.portals if spec == FOUND else portals_of_file(spec))

        def render(self, scene, sensor=0, seed=0, spp=0, develop=True, evaluate=True):
            if self.spec in ("auto", FOUND) and not self.file and self.chosen_for is not scene:
                self.open_view(scene, scene.sensors()[sensor] if isinstance(sensor, int) else sensor)
            return super().render(scene, sensor, seed, spp, develop, evaluate)

        def open_view(self, scene, sensor):
            """Finds portals, or chooses the sampler of `auto`, for a view."""
            self.chosen, self.portals, self.chosen_for = "patches", None, scene
            if has_media(scene):
                return
            if self.spec == FOUND:
                self.portals = find_portals(scene, sensor)
                return
            self.portals, need_no_pilot = portals_for_auto(scene, sensor)
            self.chosen = FOUND if need_no_pilot else self.choice(scene, sensor)
            mi.Log(mi.LogLevel.Info, f"{self.to_string()}: {self.chosen}")

        def choice(self, scene, sensor):
            """Returns the name of the sampler of CHOICES for a view, or of portals, and keeps its environment."""
            names = [*CHOICES, FOUND] if self.portals else list(CHOICES)
            lights = [self.light_of(scene, name) for name in names]
            if lights[0].product is None:
                self.keep(scene, lights[0])
                return names[0]
            kind = 0 if lights[0].surfaces.are_diffuse else 1
            costs = [cost_of_portals(len(self.portals)) if name == FOUND else CHOICES[name][kind] for name in names]
            index = choose(lights, costs, scene, sensor)
            self.keep(scene, lights[index])
            return names[index]

        def keep(self, scene, light):
            """Keeps a scene's environment for `lights`."""
            self._light, self._emitters = light, Emitters.of(scene)
            # Afterwards, because access to a parameter can replace its variable.
            self._state = State(scene)

        def volumes(self, scene, medium):
            """Returns Mitsuba's integrator for a scene with media, which has no sampler here; else None."""
            if medium is None and not has_media(scene):
                return None
            if self._volumes is None:
                mi.Log(mi.LogLevel.Warn, f"{self.to_string()}: the scene has media; it is rendered by Mitsuba's volpath instead")
                self._volumes = mi.load_dict({"type": "volpath", "hide_emitters": self.hide_emitters, **self.depths()})
            return self._volumes

        def first_hit(self, scene, ray, emitters, active):
            """Returns what a camera ray meets, beyond emitters if these are hidden."""
            met = scene.ray_intersect_preliminary(ray, coherent=True, active=active)
            if self.hide_emitters and emitters is not None and emitters.are_surfaces:
                is_emitter = active & met.is_valid() & (met.shape.emitter() != None)  # noqa: E711: compares each lane
                si = met.compute_surface_interaction(ray, mi.RayFlags.Minimal, is_emitter)
                met = dr.select(is_emitter, self.skip_area_emitters(scene, si.spawn_ray(ray.d), True, is_emitter), met)
            return met

        def render_backward(self, *arguments, **settings):
            # A symbolic loop has no derivatives in reverse mode.
            self._loop = "evaluated"
            try:
                return super().render_backward(*arguments, **settings)
            finally:
                self._loop = None

        def aov_names(self):
            return []

    class Direct(Base):
        """Direct light of the environment and of other emitters."""

        def __init__(self, props):
            super().__init__(props)
            self.samples = int(props.get("shading_samples", 1))
            if not 1 <= self.samples <= MOST_SAMPLES:
                raise HeadtailError(f"shading_samples: {self.samples} is not between 1 and {MOST_SAMPLES}")

        def depths(self):
            return {"max_depth": 2}

        def sample(self, scene, sampler, ray, medium=None, active=True):
            if volumes := self.volumes(scene, medium):
                return volumes.sample(scene, sampler, ray, medium, active)
            light, emitters = self.lights(scene)
            si = self.first_hit(scene, ray, emitters, active).compute_surface_interaction(ray, mi.RayFlags.All, active)
            hit = active & si.is_valid()
            misses = active & ~hit
            if self.hide_emitters:
                misses &= False
            bsdf = si.bsdf(ray)
            result = self.reflected(scene, sampler, ray, si, bsdf, hit, misses)
            if emitters is not None and not self.hide_emitters:
                result += emitters.emitted(scene, si, hit)
            return result, hit if self.hide_emitters else active, []

        @dr.syntax
        def reflected(self, scene, sampler, ray, si, bsdf, hit, misses):
            """Returns the mean of estimates at hits, and the environment's light along the rays of `misses`."""
            light, emitters = self._light, self._emitters
            prepared = light.prepare(ray, si, bsdf, hit)
            result = light.reflected(scene, sampler, ray, si, bsdf, prepared, hit, misses)
            if emitters is not None:
                result += emitters.reflected(scene, sampler, si, bsdf, hit)
            drawn, nothing = mi.UInt32(1), mi.Bool(False)
            if self.samples > 1:
                while dr.hint(hit & (drawn < self.samples), mode=self._loop):
                    result += light.reflected(scene, sampler, ray, si, bsdf, prepared, hit, nothing)
                    if emitters is not None:
                        result += emitters.reflected(scene, sampler, si, bsdf, hit)
                    drawn += 1
                result[hit] /= self.samples
            return result

        def to_string(self):
            return f"HeadtailDirect[sampler={self.file or self.spec}]"

    class Path(Base):
        """Light over `max_depth` - 1 surfaces, as in Mitsuba's `path`; -1 means no limit."""

        def __init__(self, props):
            super().__init__(props)
            self.max_depth = int(props.get("max_depth", -1))
            self.rr_depth = int(props.get("rr_depth", 5))
            if self.max_depth < -1 or self.rr_depth < 1:
                raise HeadtailError("max_depth must be -1 or more, rr_depth at least 1")

        def depths(self):
            return {"max_depth": self.max_depth, "rr_depth": self.rr_depth}

        def sample(self, scene, sampler, ray, medium=None, active=True):
            if volumes := self.volumes(scene, medium):
                return volumes.sample(scene, sampler, ray, medium, active)
            return self.paths(scene, sampler, ray, active)

        @dr.syntax
        def paths(self, scene, sampler, ray, active):
            light, emitters = self.lights(scene)
            limit = self.max_depth if self.max_depth >= 0 else 0xFFFFFFFF
            ray, result, weight = mi.Ray3f(ray), mi.Spectrum(0), mi.Spectrum(1)
            depth, eta, seen, active = mi.UInt32(0), mi.Float(1), mi.Bool(False), mi.Bool(active)
            if self.max_depth == 0:
                active = mi.Bool(False)
            met = self.first_hit(scene, ray, emitters, active)
            # The surface before, and the BSDF sample that led on from it, which is also one of a pair for the environment.
            previous, pdf, is_delta = dr.zeros(mi.Interaction3f), mi.Float(1), mi.Bool(True)
            has_pairs, fraction = light.has_pairs, mi.Float(1)
            while dr.hint(active, mode=self._loop):
                si = met.compute_surface_interaction(ray, mi.RayFlags.All, active)
                hit = active & si.is_valid()
                misses = active & ~hit & ((depth == 0) | has_pairs)
                seen |= hit
                if self.hide_emitters:
                    misses &= depth > 0
                if emitters is not None:
                    result += weight * emitters.seen(scene, si, previous, pdf, is_delta, hit)
                hit &= depth + 1 < limit
                bsdf = si.bsdf(ray)
                prepared = light.prepare(ray, si, bsdf, hit)
                environment = light.reflected(scene, sampler, ray, si, bsdf, prepared, hit, misses, has_pairs)
                result += weight * dr.select(misses, fraction, 1) * environment
                if emitters is not None:
                    result += weight * emitters.sampled(scene, sampler, si, bsdf, hit)
                depth += 1
                # A last surface shows emitters, and nothing else.
                goes_on = has_pairs or emitters is not None and emitters.are_surfaces
                active = hit & (depth + (0 if goes_on else 1) < limit)
                drawn, factor = bsdf.sample(
                    mi.BSDFContext(), si, sampler.next_1d(active), sampler.next_2d(active), active
                )
                wi = dr.detach(si.to_world(drawn.wo))
                weight *= attached(bsdf, si, wi, drawn, factor, active)
                eta *= drawn.eta
                if has_pairs:
                    fraction = light.fraction_of_bsdf(prepared[0], wi, dr.detach(drawn), active)
                previous, pdf = mi.Interaction3f(dr.detach(si)), dr.detach(drawn.pdf)
                is_delta = mi.has_flag(drawn.sampled_type, mi.BSDFFlags.Delta)
                largest = dr.max(dr.detach(weight))
                survives = dr.minimum(largest * eta * eta, 0.95)
                roulette = active & (depth >= self.rr_depth)
                active &= largest > 0
                active &= ~roulette | (sampler.next_1d(active) < survives)
                weight[roulette] *= dr.rcp(survives)
                ray = dr.detach(si).spawn_ray(wi)
                met = scene.ray_intersect_preliminary(ray, active=active)
            return result, seen if self.hide_emitters else mi.Bool(True), []

        def to_string(self):
            return f"HeadtailPath[sampler={self.file or self.spec}, max_depth={self.max_depth}]"

    return {"headtail_direct": Direct, "headtail_path": Path}
