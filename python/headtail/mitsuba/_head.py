"""Head warps in Dr.Jit, as `render/src/head` has them for SIMD lanes: two splines over Y whose logits are networks of the condition."""

import drjit as dr
import mitsuba as mi

from headtail import HeadtailError

from ._network import Layer, Network
from ._spline import Spline
from ._tails import tail_of
from ._warp import directions, squares

NORMAL, VIEW, WIDTH = 3, 10, 12
SELECTION_FLOOR = 0.02


class Head:
    """The sampler of a head of `arrays` (see `Head::flat` in the crate headtail-render) over its tail."""

    def __init__(self, arrays, loops=None):
        self.tail = tail_of(arrays)
        self.condition, coupled, encoder, elevation, azimuth, selection, *_ = (int(number) for number in arrays["head.shape"])
        if self.condition not in (NORMAL, VIEW, WIDTH):
            raise HeadtailError("file: holds a head for measured materials, of which Mitsuba's BSDFs say nothing")
        self.is_coupled, self.has_selection = bool(coupled), selection > 0
        layers = [Layer(arrays["head.weights"], row) for row in arrays["head.layers"]]
        slope = float(arrays["head.slope"][0])
        parts = []
        for count in (encoder, elevation, azimuth, selection):
            parts.append(Network(layers[:count], slope, ends_leaky=not parts, loops=loops))
            layers = layers[count:]
        self.encoder, self.elevation, self.azimuth, self.selection = parts

    def prepare(self, at):
        """What the networks see of a shading point: the condition, and what the encoder makes of it."""
        seen = list(at.n)
        if self.condition != NORMAL:
            cosine = dr.dot(at.n, at.wo)
            seen = [*at.wo, *at.n, *(2 * cosine * at.n - at.wo), cosine]
        if self.condition == WIDTH:
            seen += [at.alpha, dr.log(at.alpha)]
        return seen + self.encoder(seen)

    def share(self, seen):
        """The learned share of samples beside BSDF sampling."""
        (logit,) = self.selection(seen)
        return SELECTION_FLOOR + (1 - 2 * SELECTION_FLOOR) / (1 + dr.exp(-logit))

    def elevation_spline(self, seen, u):
        if self.is_coupled:
            sin, cos = dr.sincos(u * dr.two_pi)
            seen = [*seen, cos, sin]
        return Spline(self.elevation(seen), False)

    def azimuth_spline(self, seen, v):
        return Spline(self.azimuth([*seen, v]), True)

    def sample(self, seen, z, active=True):
        """Draws a direction for a uniform point z: (direction, solid-angle pdf)."""
        if self.is_coupled:
            u, by_u = self.azimuth_spline(seen, z.y).forward(z.x)
            v, by_v = self.elevation_spline(seen, u).forward(z.y)
        else:
            v, by_v = self.elevation_spline(seen, None).forward(z.y)
            u, by_u = self.azimuth_spline(seen, v).forward(z.x)
        x, density = self.tail.forward(mi.Point2f(u, v), active)
        direction, factor = directions(x)
        return direction, positive(by_u * by_v * density * factor)

    def pdf(self, seen, wi, active=True):
        """The solid-angle pdf with which `sample` draws a direction."""
        x, factor = squares(wi)
        y, density = self.tail.pull_back(x, active)
        z, by_v = self.elevation_spline(seen, y.x).inverse(y.y)
        _, by_u = self.azimuth_spline(seen, z if self.is_coupled else y.y).inverse(y.x)
        return positive(by_u * by_v * density * factor)


def positive(pdf):
    return dr.select((pdf > 0) & (pdf < dr.inf), pdf, 0)
