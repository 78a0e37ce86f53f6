"""Head warps in Dr.Jit, like `sampling/src/head` for SIMD lanes: two splines over the square whose logits are
networks of the condition."""

import drjit as dr
import mitsuba as mi

from headtail import HeadtailError

from ._network import Layer, Network
from ._patches import Patches, mixture_weight_by_width
from ._spline import Spline
from ._tails import tail_of
from ._warp import directions, positive, squares

NORMAL, VIEW, WIDTH = 3, 10, 12
MIXTURE_WEIGHT_FLOOR = 0.02


class Head:
    """A head from `arrays` (see `Head::flat` in the crate headtail-sampling): warps points of the square, and
    evaluates their density."""

    def __init__(self, arrays, loops=None):
        self.condition, coupled, encoder, elevation, azimuth, mixture_weight, *_ = (int(number) for number in arrays["head.shape"])
        if self.condition not in (NORMAL, VIEW, WIDTH):
            raise HeadtailError("file: holds a head for measured materials, of which Mitsuba's BSDFs say nothing")
        self.is_coupled, self.has_mixture_weight = bool(coupled), mixture_weight > 0
        layers = [Layer(arrays["head.weights"], row) for row in arrays["head.layers"]]
        slope = float(arrays["head.slope"][0])
        parts = []
        for count in (encoder, elevation, azimuth, mixture_weight):
            parts.append(Network(layers[:count], slope, ends_leaky=not parts, loops=loops))
            layers = layers[count:]
        self.encoder, self.elevation, self.azimuth, self.mixture_weight_network = parts

    def prepare(self, at):
        """Returns the networks' input at a shading point: the condition and the encoder's output."""
        seen = list(at.n)
        if self.condition != NORMAL:
            cosine = dr.dot(at.n, at.wo)
            seen = [*at.wo, *at.n, *(2 * cosine * at.n - at.wo), cosine]
        if self.condition == WIDTH:
            seen += [at.alpha, dr.log(at.alpha)]
        return seen + self.encoder(seen)

    def mixture_weight(self, seen, prior=0):
        """Returns the learned mixture weight of the head beside BSDF sampling; `prior` is added to its
        logit."""
        (logit,) = self.mixture_weight_network(seen)
        return MIXTURE_WEIGHT_FLOOR + (1 - 2 * MIXTURE_WEIGHT_FLOOR) / (1 + dr.exp(-logit - prior))

    def elevation_spline(self, seen, u):
        if self.is_coupled:
            sin, cos = dr.sincos(u * dr.two_pi)
            seen = [*seen, cos, sin]
        return Spline(self.elevation(seen), False)

    def azimuth_spline(self, seen, v):
        return Spline(self.azimuth([*seen, v]), True)

    def draw(self, seen, z):
        """Returns the images of uniform points z, and the densities there."""
        if self.is_coupled:
            u, by_u = self.azimuth_spline(seen, z.y).forward(z.x)
            v, by_v = self.elevation_spline(seen, u).forward(z.y)
        else:
            v, by_v = self.elevation_spline(seen, None).forward(z.y)
            u, by_u = self.azimuth_spline(seen, v).forward(z.x)
        return mi.Point2f(u, v), by_u * by_v

    def density(self, seen, point):
        """Returns the densities at points."""
        z, by_v = self.elevation_spline(seen, point.x).inverse(point.y)
        _, by_u = self.azimuth_spline(seen, z if self.is_coupled else point.y).inverse(point.x)
        return by_u * by_v


class HeadOverTail:
    """The sampler of a head over its tail."""

    def __init__(self, arrays, loops=None):
        self.head, self.tail = Head(arrays, loops), tail_of(arrays)
        # Without directions in its condition, the head's mixture weight is learned for diffuse surfaces only.
        self.sees_lobes = self.head.condition != NORMAL
        self.has_mixture_weight = self.sees_lobes and self.head.has_mixture_weight

    def prepare(self, at):
        """Returns the networks' input at a shading point."""
        return self.head.prepare(at)

    def mixture_weight(self, seen):
        """Returns the learned mixture weight beside BSDF sampling."""
        return self.head.mixture_weight(seen)

    def sample(self, seen, z, active=True):
        """Samples a direction from a uniform point z: (direction, solid-angle pdf)."""
        y, q = self.head.draw(seen, z)
        x, density = self.tail.forward(y, active)
        direction, factor = directions(x)
        return direction, positive(q * density * factor)

    def pdf(self, seen, wi, active=True):
        """Returns the solid-angle pdf of a direction under `sample`."""
        x, factor = squares(wi)
        y, density = self.tail.pull_back(x, active)
        return positive(self.head.density(seen, y) * density * factor)


class HeadOverPatches:
    """The sampler of a head over patches of sky, whose residual the head samples."""

    sees_lobes = has_mixture_weight = True

    def __init__(self, arrays, loops=None):
        self.head, self.patches = Head(arrays, loops), Patches(arrays)

    def prepare(self, at):
        """Returns the patches' masses at a shading point and the networks' input there."""
        return self.patches.prepare(at), self.head.prepare(at)

    def mixture_weight(self, prepared):
        """Returns the mixture weight beside BSDF sampling: the odds of patches times a learned
        factor."""
        of_patches, seen = prepared
        at = of_patches.at
        mixture_weight = mi.Float(1) if at.is_diffuse else mixture_weight_by_width((at.diffuse, at.specular, at.f0, at.alpha))
        if not self.head.has_mixture_weight:
            return mixture_weight
        inside = dr.clip((mixture_weight - MIXTURE_WEIGHT_FLOOR) / (1 - 2 * MIXTURE_WEIGHT_FLOOR), 1e-3, 1 - 1e-3)
        return self.head.mixture_weight(seen, dr.log(inside / (1 - inside)))

    def sample(self, prepared, z, active=True):
        """Samples a direction from a uniform point z: (direction, solid-angle pdf)."""
        of_patches, seen = prepared
        through, q = self.head.draw(seen, z)
        direction, pdf = self.patches.sample(of_patches, through, active)
        return direction, positive(q * pdf)

    def pdf(self, prepared, wi, active=True):
        """Returns the solid-angle pdf of a direction under `sample`."""
        of_patches, seen = prepared
        through, pdf = self.patches.invert(of_patches, wi, active)
        return positive(self.head.density(seen, through) * pdf)
