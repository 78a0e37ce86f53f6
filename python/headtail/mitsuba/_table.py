"""Tables over normals in Dr.Jit, like `sampling/src/bake` for SIMD lanes: for diffuse surfaces."""

import drjit as dr
import mitsuba as mi
import numpy as np

from ._tails import tail_of
from ._warp import BELOW_ONE, directions, positive, remap, squares, upload


def fast_atan2(y, x):
    """The native polynomial (Abramowitz and Stegun 1964, 4.4.49), so that tables are interpolated equally."""
    small, large = dr.minimum(abs(y), abs(x)), dr.maximum(abs(y), abs(x))
    a = small / dr.maximum(large, 1.17549435e-38)
    s = a * a
    angle = a * (0.999866 + s * (-0.3302995 + s * (0.180141 + s * (-0.085133 + s * 0.0208351))))
    angle = dr.select(abs(y) > abs(x), 0.5 * dr.pi - angle, angle)
    angle = dr.select(x < 0, dr.pi - angle, angle)
    return dr.copysign(angle, y)


class Table:
    """The sampler of a table from `arrays` (see `BakedTable::flat` in the crate headtail-sampling) over its
    tail."""

    sees_lobes = has_mixture_weight = False

    def __init__(self, arrays):
        self.tail = tail_of(arrays)
        self.polar, self.azimuth, self.rows, self.columns = (int(count) for count in arrays["table.shape"])
        self.down = upload(self.around(arrays["table.down"]))
        self.along = upload(self.around(arrays["table.along"]))
        self.masses = upload(self.around(arrays["table.masses"]))

    def around(self, sums):
        """Returns the running sums of the four nodes around each cell of the grid of normals, side by
        side."""
        sums = sums.reshape(self.polar, self.azimuth, *sums.shape[1:])
        east = np.roll(sums, -1, 1)
        return np.stack([sums[:-1], east[:-1], sums[1:], east[1:]], -1)

    def prepare(self, at):
        """Returns the cell of the grid of normals at a shading point, and four weights."""
        n = at.n
        a = fast_atan2(n.x, -n.z) * (self.azimuth * dr.inv_two_pi)
        a = dr.select(a < 0, a + self.azimuth, a)
        p = dr.maximum(fast_atan2(dr.sqrt(n.x * n.x + n.z * n.z), n.y), 0) * ((self.polar - 1) * dr.inv_pi)
        column = mi.UInt32(dr.clip(mi.Int32(a), 0, self.azimuth - 1))
        row = mi.UInt32(dr.clip(mi.Int32(p), 0, self.polar - 2))
        s, t = dr.clip(a - mi.Float(column), 0, 1), dr.clip(p - mi.Float(row), 0, 1)
        return row * self.azimuth + column, mi.Vector4f((1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t)

    @staticmethod
    def search(count, target, sums):
        """Returns (first index whose running sum exceeds the target, the sum before it)."""
        low, before, size = mi.UInt32(0), mi.Float(0), count
        # Over Python integers: unrolled.
        while size > 1:
            half = size // 2
            value = sums(low + (half - 1))
            passed = value <= target
            low, before = dr.select(passed, low + half, low), dr.select(passed, value, before)
            size -= half
        return low, before

    def down_sum(self, node, weights, row, active):
        """Returns the running sum of rows."""
        return dr.dot(weights, dr.gather(mi.Vector4f, self.down, node * self.rows + row, active))

    def along_sum(self, node, weights, row, column, active):
        """Returns the running sum of a row's columns."""
        at = (node * self.rows + row) * self.columns + column
        return dr.dot(weights, dr.gather(mi.Vector4f, self.along, at, active))

    def mass(self, node, weights, row, column, active):
        """Returns the mass of a cell, which rounded differences of running sums would not give for small
        cells."""
        at = (node * self.rows + row) * self.columns + column
        return dr.dot(weights, dr.gather(mi.Vector4f, self.masses, at, active))

    def sample(self, prepared, z, active=True):
        """Samples a direction from a uniform point z: (direction, solid-angle pdf)."""
        node, weights = prepared
        total = self.down_sum(node, weights, self.rows - 1, active)
        target = z.y * total
        row, before = self.search(self.rows, target, lambda row: self.down_sum(node, weights, row, active))
        below = remap(target, before, self.down_sum(node, weights, row, active))
        target = z.x * self.along_sum(node, weights, row, self.columns - 1, active)
        column, low = self.search(self.columns, target, lambda column: self.along_sum(node, weights, row, column, active))
        high = self.along_sum(node, weights, row, column, active)
        y = mi.Point2f(inside(column, remap(target, low, high)) / self.columns, inside(row, below) / self.rows)
        x, density = self.tail.forward(y, active)
        direction, factor = directions(x)
        return direction, self.solid_angle(density * factor, self.mass(node, weights, row, column, active), total)

    def pdf(self, prepared, wi, active=True):
        """Returns the solid-angle pdf of a direction under `sample`."""
        node, weights = prepared
        x, factor = squares(wi)
        y, density = self.tail.pull_back(x, active)
        row = dr.minimum(mi.UInt32(y.y * self.rows), self.rows - 1)
        column = dr.minimum(mi.UInt32(y.x * self.columns), self.columns - 1)
        mass = self.mass(node, weights, row, column, active)
        return self.solid_angle(density * factor, mass, self.down_sum(node, weights, self.rows - 1, active))

    def solid_angle(self, pdf, mass, total):
        """Returns the solid-angle pdf of a cell's mass."""
        return positive(pdf * mass * (self.rows * self.columns) / total)


def inside(index, position):
    """Returns a position in a row of cells, below the next one even if the sum is rounded."""
    index = mi.Float(index)
    return dr.minimum(index + position, (index + 1) * BELOW_ONE)
