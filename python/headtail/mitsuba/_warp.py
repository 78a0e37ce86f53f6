"""The quad-tree tail in Dr.Jit: maps points of Y to X, and cells of X; and helper functions of all
samplers."""

import drjit as dr
import mitsuba as mi
import numpy as np

BELOW_ONE = float(np.nextafter(np.float32(1), np.float32(0)))
LEAST_SINE = 1e-7


def remap(at, start, end):
    """Returns the position of a number in an interval, in [0, 1): rescales the uniform number that chose the
    interval."""
    inside = (at - start) / (end - start)
    # This order turns NaN into 0.
    inside = dr.select(inside > 0, inside, 0)
    return dr.select(inside < BELOW_ONE, inside, BELOW_ONE)


def positive(pdf):
    """Returns a pdf; 0 if it is invalid."""
    return dr.select((pdf > 0) & (pdf < dr.inf), pdf, 0)


def directions(x):
    """Returns the unit direction of a point of X, and the factor from densities over X to solid-angle
    pdfs."""
    sin_phi, cos_phi = dr.sincos(x.x * dr.two_pi)
    sin_theta, cos_theta = dr.sincos(x.y * dr.pi)
    factor = dr.rcp(2 * dr.pi**2 * dr.maximum(sin_theta, LEAST_SINE))
    return mi.Vector3f(sin_phi * sin_theta, cos_theta, -cos_phi * sin_theta), factor


def squares(w):
    """Returns the point of X of a unit direction, and the same factor."""
    horizontal = dr.sqrt(w.x * w.x + w.z * w.z)
    u = dr.atan2(w.x, -w.z) * dr.inv_two_pi
    u = dr.select(u < 0, u + 1, u)
    # Uses the arc tangent: near the poles the arc cosine loses half of the digits.
    v = dr.atan2(horizontal, w.y) * dr.inv_pi
    factor = dr.rcp(2 * dr.pi**2 * dr.maximum(horizontal, LEAST_SINE))
    return mi.Point2f(dr.select(u >= 1, 0, u), dr.minimum(v, 1)), factor


def sample_linear(u, a, b):
    """Returns the point at which the linear density from a to b has accumulated the fraction u."""
    root = dr.sqrt(dr.maximum(a * a + u * (b * b - a * a), 0))
    below = a + root
    return dr.select(below > 0, dr.minimum(u * (a + b) / below, BELOW_ONE), 0)


def invert_linear(t, a, b):
    """The inverse of `sample_linear`."""
    total = a + b
    return dr.select(total > 0, dr.minimum(t * (a * (2 - t) + b * t) / total, BELOW_ONE), t)


def upload(array):
    """Returns a flat Dr.Jit array from numpy."""
    kind = mi.Float if array.dtype == np.float32 else mi.UInt32
    return kind(np.ascontiguousarray(array).ravel())


class Cells:
    """The cells between the texels of a map: columns of texels, rows of cells."""

    def __init__(self, width, rows):
        self.width, self.rows = width, rows

    def cell(self, x):
        """Returns the index of the cell of a point of X, and the position inside."""
        across = x.x * self.width - 0.5
        across = dr.select(across < 0, across + self.width, across)
        down = x.y * self.rows
        column = mi.UInt32(dr.clip(mi.Int32(across), 0, self.width - 1))
        row = mi.UInt32(dr.clip(mi.Int32(down), 0, self.rows - 1))
        inside = mi.Point2f(dr.clip(across - mi.Float(column), 0, 1), dr.clip(down - mi.Float(row), 0, 1))
        return row * self.width + column, inside

    def point(self, column, row, across, down):
        """Returns the point of X at a position in a cell."""
        x = mi.Point2f((mi.Float(column) + across + 0.5) / self.width, (mi.Float(row) + down) / self.rows)
        x.x = dr.select(x.x >= 1, dr.clip(x.x - 1, 0, BELOW_ONE), x.x)
        return x


class Tail(Cells):
    """The quad-tree warp from `arrays` (see `Hierarchical::flat` in the crate headtail-sampling)."""

    def __init__(self, arrays):
        cuts, levels = arrays["tail.cuts"], arrays["tail.levels"]
        nodes = arrays["tail.nodes"]
        super().__init__(nodes.shape[1], nodes.shape[0] - 1)
        east = np.roll(nodes, -1, 1)
        self.corners = upload(np.stack([nodes[:-1], east[:-1], nodes[1:], east[1:]], -1))
        self.levels = [tuple(int(number) for number in level) for level in levels]
        self.cuts = upload(cuts)
        self._numpy_cuts, self._rectangles = cuts, None

    def forward(self, y, active=True):
        """Returns x for a point of Y, and the density |dy/dx| there."""
        index, column, row = mi.UInt32(0), mi.UInt32(0), mi.UInt32(0)
        left, right, top, bottom = mi.Float(0), mi.Float(1), mi.Float(0), mi.Float(1)
        u, v = remap(y.x, 0, 1), remap(y.y, 0, 1)
        for column_bits, row_bits, start in self.levels:
            cut = dr.gather(mi.Vector4f, self.cuts, index + start, active)
            lower = v >= cut.x if row_bits else mi.Bool(False)
            if row_bits:
                top, bottom = dr.select(lower, cut.x, top), dr.select(lower, bottom, cut.x)
            vertical = dr.select(lower, cut.z, cut.y)
            east = u >= vertical if column_bits else mi.Bool(False)
            if column_bits:
                left, right = dr.select(east, vertical, left), dr.select(east, right, vertical)
            down, across = dr.select(lower, mi.UInt32(1), 0), dr.select(east, mi.UInt32(1), 0)
            index = (index << (column_bits + row_bits)) + (down << column_bits) + across
            column, row = (column << column_bits) + across, (row << row_bits) + down
        a, b, c, d = dr.gather(mi.Vector4f, self.corners, row * self.width + column, active)
        inside_v = sample_linear(remap(v, top, bottom), a + b, c + d)
        west, east = dr.lerp(a, c, inside_v), dr.lerp(b, d, inside_v)
        inside_u = sample_linear(remap(u, left, right), west, east)
        return self.point(column, row, inside_u, inside_v), dr.lerp(west, east, inside_u)

    def density(self, cell, inside, active=True):
        """Returns |dy/dx| at a position in a cell."""
        a, b, c, d = dr.gather(mi.Vector4f, self.corners, cell, active)
        return dr.lerp(dr.lerp(a, c, inside.y), dr.lerp(b, d, inside.y), inside.x)

    def pull_back(self, x, active=True):
        """Returns y for a point of X, and |dy/dx|."""
        cell, inside = self.cell(x)
        if self._rectangles is None:
            self._rectangles = upload(self.rectangles())
        a, b, c, d = dr.gather(mi.Vector4f, self.corners, cell, active)
        left, right, top, bottom = dr.gather(mi.Vector4f, self._rectangles, cell, active)
        west, east = dr.lerp(a, c, inside.y), dr.lerp(b, d, inside.y)
        across, down = invert_linear(inside.x, west, east), invert_linear(inside.y, a + b, c + d)
        y = mi.Point2f(left + across * (right - left), top + down * (bottom - top))
        return dr.minimum(y, BELOW_ONE), dr.lerp(west, east, inside.x)

    def rectangles(self):
        """Returns [rows * width, 4]: left, right, top, bottom in Y of every cell."""
        bounds, places = np.array([[0, 1, 0, 1]], np.float32), np.zeros((1, 2), np.int64)
        for column_bits, row_bits, start in self.levels:
            cuts = self._numpy_cuts[start : start + len(bounds)]
            parts = []
            for lower in range(1 << row_bits):
                for east in range(1 << column_bits):
                    part, place = bounds.copy(), (places << [column_bits, row_bits]) + [east, lower]
                    if row_bits:
                        part[:, 2 if lower else 3] = cuts[:, 0]
                    if column_bits:
                        part[:, 0 if east else 1] = cuts[:, 2 if lower else 1]
                    parts.append((part, place))
            bounds = np.stack([part for part, _ in parts], 1).reshape(-1, 4)
            places = np.stack([place for _, place in parts], 1).reshape(-1, 2)
        own = (places[:, 0] < self.width) & (places[:, 1] < self.rows)
        out = np.empty((self.rows * self.width, 4), np.float32)
        out[places[own, 1] * self.width + places[own, 0]] = bounds[own]
        return out
