"""Portal-masked sampling in Dr.Jit (Bitterli, Novák and Jarosz 2015), like `sampling/src/portals` for SIMD lanes."""

import drjit as dr
import mitsuba as mi
import numpy as np

from ._pairs import Pairs
from ._warp import BELOW_ONE, positive, remap, upload

LEAST_DISTANCE = 1e-5
# Fraction of the samples beside emitter sampling, at points that see a portal.
MIXTURE_WEIGHT = 0.875


class Opening:
    """A portal at shading points: the tangents of its left, right, lower and upper sides, these in pixels, the sum over the
    pixels between, and the probability that it is chosen."""

    def __init__(self, sides, pixels, total, chance):
        self.sides, self.pixels, self.total, self.chance = sides, pixels, total, chance


class Portals:
    """Directions through portals, and of the map: with a few of the samples, light that misses portals is noise and not a
    rare surprise. From `arrays` (see `PortalSampler::flat` in the crate headtail-sampling) in the map's frame."""

    sees_lobes, has_mixture_weight = False, False

    def __init__(self, arrays):
        self.emitter = Pairs(arrays)
        self.rectangles = [[float(number) for number in row] for row in arrays["portals.rectangles"]]
        self.axes = upload(arrays["portals.rectangles"][:, :9])
        self.images = [int(number) for number in arrays["portals.image"]]
        self.size = arrays["portals.sums"].shape[1] - 1
        self.sums = upload(arrays["portals.sums"])

    def prepare(self, at):
        """Returns the portals at shading points, and the fraction of the samples that they have beside emitter sampling."""
        openings, sum_of_chances = [], mi.Float(0)
        for rectangle, image in zip(self.rectangles, self.images):
            opening = self.opening(rectangle, image, at)
            sum_of_chances += opening.chance
            openings.append(opening)
        for opening in openings:
            opening.chance = dr.select(sum_of_chances > 0, opening.chance / sum_of_chances, 0)
        return openings, dr.select(sum_of_chances > 0, mi.Float(MIXTURE_WEIGHT), 0)

    def opening(self, rectangle, image, at):
        """Returns a portal at shading points, with an unnormalised probability: its light times the mean cosine of its corners
        and its middle."""
        right, up, normal = axes_of(rectangle)
        middle, (half_width, half_height) = rectangle[9:12], rectangle[12:]
        least = LEAST_DISTANCE * (half_width + half_height)
        distance = dr.dot(normal, at.p) - middle[2]
        scale = dr.rcp(dr.maximum(distance, least))
        x, y = middle[0] - dr.dot(right, at.p), middle[1] - dr.dot(up, at.p)
        sides = mi.Vector4f(x - half_width, x + half_width, y - half_height, y + half_height) * scale
        left, far, bottom, top = sides
        axes = dr.dot(right, at.n), dr.dot(up, at.n), dr.dot(normal, at.n)
        corners = (left, bottom), (far, bottom), (left, top), (far, top), (0.5 * (left + far), 0.5 * (bottom + top))
        cosine = sum(cosine_of(axes, *corner) for corner in corners)
        pixels = self.pixel(sides)
        sees = (distance > least) & (cosine > 0)
        cells = [self.cell(pixel) for pixel in pixels]
        bound = self.sum_between(image, cells[0], cells[1] + 1, cells[2], cells[3] + 1, sees)
        band = Band(self, image, pixels, sees)
        start, end = ends(pixels[0], pixels[1], self.size, band.left_of)
        return Opening(sides, pixels, mi.Float(end - start), dr.select(sees, cosine * bound, 0))

    def sample(self, prepared, z, active=True):
        """Samples a direction from a uniform point z: (direction, solid-angle pdf)."""
        openings, weight = prepared
        by_portal = z.x < weight
        z = mi.Point2f(remap(z.x, dr.select(by_portal, 0, weight), dr.select(by_portal, weight, 1)), z.y)
        number, through, own = self.draw(openings, z, active & by_portal)
        toward, of_emitter = self.emitter.sample((), z, active & ~by_portal)
        wi = dr.select(by_portal, through, toward)
        own = dr.select(by_portal, own, 0)
        of_portals = own + self.densities(openings, wi, dr.select(by_portal, number, len(openings)), active)
        of_emitter = dr.select(by_portal, self.emitter.pdf((), wi, active & by_portal), of_emitter)
        pdf = positive(weight * of_portals + (1 - weight) * of_emitter)
        return wi, dr.select(dr.select(by_portal, own > 0, of_emitter > 0), pdf, 0)

    def pdf(self, prepared, wi, active=True):
        """Returns the solid-angle pdf of a direction under `sample`."""
        openings, weight = prepared
        of_portals = self.densities(openings, wi, mi.UInt32(len(openings)), active)
        return positive(weight * of_portals + (1 - weight) * self.emitter.pdf((), wi, active))

    def draw(self, openings, z, active):
        """Returns the number of a portal, a direction through it, and its part of the pdf."""
        number, image, start, below = mi.UInt32(0), mi.UInt32(0), mi.Float(0), mi.Float(0)
        pixels, chance = mi.Vector4f(0), mi.Float(0)
        for k, opening in enumerate(openings):
            # The last portal takes what is left by rounding.
            chosen = (opening.chance > 0) & (below <= z.x)
            number, image = dr.select(chosen, k, number), dr.select(chosen, self.images[k], image)
            start, chance = dr.select(chosen, below, start), dr.select(chosen, opening.chance, chance)
            pixels = dr.select(chosen, opening.pixels, pixels)
            below += opening.chance
        active = active & (chance > 0)
        band = Band(self, image, pixels, active)
        across, column, _, total = invert(pixels[0], pixels[1], remap(z.x, start, start + chance), self.size, band.left_of)
        base = self.of_column(image, column, self.cell(pixels[2]), active)
        below_row = lambda row: signed(self.of_column(image, column, row, active) - base)  # noqa: E731
        along, _, value, _ = invert(pixels[2], pixels[3], z.y, self.size, below_row)
        density = mi.Float(dr.select(total > 0, value / total, 0))
        x, y = self.tangent(across), self.tangent(along)
        right, up, normal = (dr.gather(mi.Vector3f, self.axes, 3 * number + k, active) for k in range(3))
        wi = dr.normalize(x * right + y * up - normal)
        return number, wi, dr.select(active, positive(chance * density / self.solid_angle(x, y)), 0)

    def densities(self, openings, wi, drawn, active):
        """Returns the sum of the pdfs through all portals but the one that was drawn."""
        result = mi.Float(0)
        for k, (opening, rectangle) in enumerate(zip(openings, self.rectangles)):
            right, up, normal = axes_of(rectangle)
            x, y, z = dr.dot(right, wi), dr.dot(up, wi), -dr.dot(normal, wi)
            left, far, bottom, top = opening.sides
            is_through = (x >= left * z) & (x <= far * z) & (y >= bottom * z) & (y <= top * z)
            is_through &= active & (z > 0) & (opening.chance > 0) & (opening.total > 0) & (drawn != k)
            x, y = x / z, y / z
            column, row = (self.cell(self.pixel(tangent)) for tangent in (x, y))
            value = self.sum_between(self.images[k], column, column + 1, row, row + 1, is_through)
            density = opening.chance * value / (opening.total * self.solid_angle(x, y))
            result += dr.select(is_through, density, 0)
        return result

    def pixel(self, tangent):
        """Returns the place of a tangent, in pixels."""
        return 0.5 * self.size * (1 + tangent / (1 + abs(tangent)))

    def tangent(self, pixel):
        """Returns the tangent of a place in pixels."""
        within = dr.clip(pixel / (0.5 * self.size) - 1, -BELOW_ONE, BELOW_ONE)
        return within / (1 - abs(within))

    def solid_angle(self, x, y):
        """Returns the solid angle per pixel at tangents."""
        across, along, pixel = 1 + abs(x), 1 + abs(y), 2 / self.size
        squared = 1 + x * x + y * y
        return (pixel * across) * (across / squared) * (pixel * along) * (along / dr.sqrt(squared))

    def cell(self, pixel):
        return cell_of(pixel, self.size)

    def sum(self, image, column, row, active):
        return dr.gather(mi.UInt32, self.sums, (image * (self.size + 1) + row) * (self.size + 1) + column, active)

    def of_column(self, image, column, row, active):
        """Returns the sum of a column's pixels below a row."""
        return self.sum(image, column + 1, row, active) - self.sum(image, column, row, active)

    def sum_between(self, image, left, right, bottom, top, active):
        upper = self.sum(image, right, top, active) - self.sum(image, left, top, active)
        return mi.Float(upper - (self.sum(image, right, bottom, active) - self.sum(image, left, bottom, active)))


class Band:
    """The part of an image between two rows, which are places and not whole numbers."""

    def __init__(self, portals, image, pixels, active):
        self.portals, self.image, self.active = portals, image, active
        self.rows = [portals.cell(at) for at in pixels[2:]]
        self.fractions = [mi.Float64(at) - mi.Float64(row) for at, row in zip(pixels[2:], self.rows)]
        self.base = self.corners(portals.cell(pixels[0]))

    def corners(self, column):
        """Returns the sums left of a column, below the rows and the ones above each."""
        rows = (row + offset for row in self.rows for offset in (0, 1))
        return [self.portals.sum(self.image, column, row, self.active) for row in rows]

    def left_of(self, column):
        """Returns the sum between the base and a column."""
        bottom, above_bottom, top, above_top = (signed(own - base) for own, base in zip(self.corners(column), self.base))
        below = bottom + self.fractions[0] * (above_bottom - bottom)
        return top + self.fractions[1] * (above_top - top) - below


def axes_of(rectangle):
    """Returns the directions of the width, the height and the normal of a portal."""
    return [mi.Vector3f(*rectangle[k : k + 3]) for k in (0, 3, 6)]


def cell_of(place, size):
    """Returns the whole number below a place, at most `size` - 1."""
    return mi.UInt32(dr.clip(mi.Int32(place), 0, size - 1))


def signed(difference):
    """Returns a wrapped difference of sums: by rounding, the far side of a thin rectangle may be before its base."""
    return mi.Float64(mi.Int32(difference))


def cosine_of(axes, x, y):
    """Returns the cosine of the direction of two tangents, at least 0, from those of the axes."""
    return dr.maximum(x * axes[0] + y * axes[1] - axes[2], 0) * dr.rsqrt(1 + x * x + y * y)


def ends(start, end, size, sum_below):
    """Returns a sum at both ends of an interval of places, from the sum up to whole numbers, which is 0 at the first one."""
    first, last = cell_of(start, size), cell_of(end, size)
    below = sum_below(last)
    at_end = below + (mi.Float64(end) - mi.Float64(last)) * (sum_below(last + 1) - below)
    return (mi.Float64(start) - mi.Float64(first)) * sum_below(first + 1), at_end


def invert(start, end, u, size, sum_below):
    """Finds where a sum, as that of `ends`, reaches the fraction u of its growth: (place, whole number below it, growth in that
    cell, growth over the interval)."""
    at_start, at_end = ends(start, end, size, sum_below)
    target = at_start + mi.Float64(u) * (at_end - at_start)
    low, last = cell_of(start, size), cell_of(end, size)
    high, below = dr.maximum(last, low) + 1, mi.Float64(0)
    # Over Python integers: unrolled.
    for _ in range(int(np.ceil(np.log2(size)))):
        middle = (low + high) >> 1
        at = sum_below(middle)
        goes_on = high - low > 1
        right = goes_on & (at <= target)
        low, below, high = dr.select(right, middle, low), dr.select(right, at, below), dr.select(goes_on & ~right, middle, high)
    value = sum_below(low + 1) - below
    inside = mi.Float(dr.select(value > 0, (target - below) / value, 0.5))
    return mi.Float(low) + dr.clip(inside, 0, BELOW_ONE), low, value, at_end - at_start
