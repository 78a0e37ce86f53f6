"""Compact emitters in Dr.Jit, in a mixture with a sampler of the rest of the light."""

import drjit as dr
import mitsuba as mi

from ._tails import Windows
from ._warp import directions, remap, squares, upload

LEAST_SHARE, LEAST_REST, SEEN = 0.01, 0.05, (32, 16)


class WithCompactEmitters:
    """The mixture of `arrays` (see `CompactEmitters::flat` in the crate headtail-render). Shares are those of a diffuse surface."""

    def __init__(self, arrays, rest):
        self.rest = rest
        self.emitters = Windows(*(arrays[f"compact.{name}"] for name in ("shape", "windows", "numbers")))
        self.powers = [float(power) for power in arrays["compact.powers"]]
        self.towards = [[mi.Vector3f(*map(float, point)) for point in points] for points in arrays["compact.towards"]]
        self.seen = upload(arrays["compact.seen"])

    def prepare(self, at):
        """What the sampler of the rest sees of a point, and shares of samples of each emitter and of the rest."""
        light = []
        for power, points in zip(self.powers, self.towards):
            cosines = sum(dr.maximum(dr.dot(at.n, point), 0) for point in points)
            light.append(cosines * (power * dr.inv_pi / len(points)))
        light.append(self.reflected_rest(at.n))
        total, count = sum(light), len(light)
        free = 1 - LEAST_REST - LEAST_SHARE * (count - 1)
        shares = [dr.select(total > 0, part / total, 1 / count) * free + LEAST_SHARE for part in light]
        shares[-1] += LEAST_REST - LEAST_SHARE
        return self.rest.prepare(at), shares

    def reflected_rest(self, n):
        """What a diffuse surface reflects of the rest, bilinear between the middles of cells of the map."""
        place, _ = squares(n)
        columns, rows = SEEN
        x, y = place.x * columns + (columns - 0.5), dr.clip(place.y * rows - 0.5, 0, rows - 1)
        left, top = mi.UInt32(x), dr.minimum(mi.UInt32(y), rows - 2)
        s, t = x - mi.Float(left), y - mi.Float(top)

        def along(row):
            near = dr.gather(mi.Float, self.seen, row * columns + left % columns)
            return dr.lerp(near, dr.gather(mi.Float, self.seen, row * columns + (left + 1) % columns), s)

        return dr.lerp(along(top), along(top + 1), t)

    def mixed(self, shares, wi, rest, active):
        """The mixture's pdf of a direction, for that of the rest."""
        x, factor = squares(wi)
        pdf = shares[-1] * rest
        for index, share in enumerate(shares[:-1]):
            _, density = self.emitters.pull_back_in(index, x, active)
            pdf += share * density * factor
        return pdf

    def share(self, prepared):
        """The share of samples beside BSDF sampling."""
        return self.rest.share(prepared[0])

    def sample(self, prepared, z, active=True):
        """Draws a direction for a uniform point z: (direction, solid-angle pdf)."""
        of_rest, shares = prepared
        before, start, end, part = mi.Float(0), mi.Float(0), mi.Float(1), mi.UInt32(0)
        for index, share in enumerate(shares):
            is_here = z.x >= before
            part, start = dr.select(is_here, index, part), dr.select(is_here, before, start)
            end = dr.select(is_here, 1 if index + 1 == len(shares) else before + share, end)
            before = before + share
        by_rest = part == len(shares) - 1
        z = mi.Point2f(remap(z.x, start, end), z.y)
        local, pdf = self.rest.sample(of_rest, z, active & by_rest)
        x, density = self.emitters.forward_in(dr.minimum(part, len(shares) - 2), z, active & ~by_rest)
        toward, _ = directions(x)
        wi = dr.select(by_rest, local, toward)
        drawn = dr.select(by_rest, pdf, density) > 0
        pdf = dr.select(by_rest, pdf, self.rest.pdf(of_rest, wi, active & ~by_rest))
        return wi, dr.select(drawn, self.mixed(shares, wi, pdf, active), 0)

    def pdf(self, prepared, wi, active=True):
        """The solid-angle pdf with which `sample` draws a direction."""
        of_rest, shares = prepared
        return self.mixed(shares, wi, self.rest.pdf(of_rest, wi, active), active)
