"""The row-column tail and the flow tail in Dr.Jit, and the choice of a tail from its arrays."""

import drjit as dr
import mitsuba as mi

from ._warp import BELOW_ONE, Cells, Tail, invert_linear, remap, sample_linear, upload


def tail_of(arrays):
    """Returns the tail of `arrays` (see `Tail::flat` in the crate headtail-sampling)."""
    if "tail.levels" in arrays:
        return Tail(arrays)
    return Flow(arrays) if "tail.cells" in arrays else RowColumn(arrays)


class RowColumn(Cells):
    """The row-column tail (see `RowColumn::window` in the crate headtail-sampling): first a row in proportion to
    its light, then a column within the row. There is no light outside the window.
    """

    def __init__(self, arrays):
        super().__init__(*(int(count) for count in arrays["tail.shape"]))
        # First row and row count, first column and column count, and the starts of the four lists.
        self.window, self.numbers = [int(number) for number in arrays["tail.windows"][0]], upload(arrays["tail.numbers"])

    def last_at_most(self, count, target, value):
        """Returns the last index below count whose value is at most the target; 0 if there is none."""
        low, size = mi.UInt32(0), count
        while size > 1:
            half = size >> 1
            low = dr.select(value(low + half) <= target, low + half, low)
            size -= half
        return low

    def number(self, place, active):
        return dr.gather(mi.Float, self.numbers, place, active)

    def before(self, row, t, column, active):
        """Returns the integral of the blended row from the window's left edge to a cell's."""
        stride = self.window[3] + 1
        upper = self.window[7] + row * stride + column
        return dr.lerp(self.number(upper, active), self.number(upper + stride, active), t)

    def edges(self, row, t, column, active):
        """Returns the densities at the left and right edges of a cell, at a height in it."""
        stride = self.window[3] + 1
        upper = self.window[4] + row * stride + column
        a, b, c, d = (self.number(upper + step, active) for step in (0, 1, stride, stride + 1))
        return dr.lerp(a, c, t), dr.lerp(b, d, t)

    def around(self, start, row, active):
        """Returns the entries of a list above and below a row of cells."""
        return self.number(start + row, active), self.number(start + row + 1, active)

    def forward(self, y, active=True):
        """Returns x for a point of Y, and the density |dy/dx| there."""
        u, v, window = remap(y.x, 0, 1), remap(y.y, 0, 1), self.window
        row = self.last_at_most(window[1], v, lambda row: self.number(window[6] + row, active))
        t = sample_linear(remap(v, *self.around(window[6], row, active)), *self.around(window[5], row, active))
        edge = lambda column: self.before(row, t, column, active)
        goal = u * edge(window[3])
        column = self.last_at_most(window[3], goal, edge)
        west, east = self.edges(row, t, column, active)
        s = sample_linear(remap(goal, edge(column), edge(column + 1)), west, east)
        return self.point(window[2] + column, window[0] + row, s, t), dr.lerp(west, east, s)

    def pull_back(self, x, active=True):
        """Returns y for a point of X, and |dy/dx|."""
        window, (cell, inside) = self.window, self.cell(x)
        # Cells before the window wrap to large indices.
        row, column = cell // self.width - window[0], cell % self.width - window[2]
        active = (row < window[1]) & (column < window[3]) & active
        first, last = self.around(window[6], row, active)
        v = first + invert_linear(inside.y, *self.around(window[5], row, active)) * (last - first)
        west, east = self.edges(row, inside.y, column, active)
        edge = lambda column: self.before(row, inside.y, column, active)
        start, total = edge(column), edge(window[3])
        within = start + invert_linear(inside.x, west, east) * (edge(column + 1) - start)
        u = dr.select(total > 0, within / total, inside.x)
        return dr.minimum(mi.Point2f(u, v), BELOW_ONE), dr.lerp(west, east, inside.x)


def cross(a, b):
    return a.x * b.y - a.y * b.x


class Flow:
    """A smooth warp of the square as a table, bilinear in each cell."""

    FAR, ROOM = 1e30, 48

    def __init__(self, arrays):
        self.cells, self.boxes = upload(arrays["tail.cells"]), upload(arrays["tail.boxes"])
        self.side = round(len(arrays["tail.cells"]) ** 0.5)
        self.left, self.right = float(arrays["tail.boxes"][0, 0]), float(arrays["tail.boxes"][0, 2])

    def quad(self, index, active):
        """Returns p, e, f and g of a cell's image p + s e + t f + s t g."""
        a, b = (dr.gather(mi.Vector4f, self.cells, 2 * index + k, active) for k in (0, 1))
        return [mi.Point2f(v.x, v.y) for v in (a, mi.Vector2f(a.z, a.w), b, mi.Vector2f(b.z, b.w))]

    def density(self, quad, st):
        """Returns |dy/dx| at a position in a cell."""
        _, e, f, g = quad
        return dr.rcp((cross(e, f) + st.x * cross(e, g) + st.y * cross(g, f)) * (self.side * self.side))

    def forward(self, y, active=True):
        """Returns x for a point of Y, and the density |dy/dx| there."""
        at = mi.Point2f(remap(y.x, 0, 1), remap(y.y, 0, 1)) * self.side
        column, row = mi.UInt32(at.x), mi.UInt32(at.y)
        st = at - mi.Point2f(mi.Float(column), mi.Float(row))
        quad = self.quad(row * self.side + column, active)
        p, e, f, g = quad
        x = p + st.x * e + st.y * f + st.x * st.y * g
        u = x.x - dr.floor(x.x)
        return mi.Point2f(dr.select(u >= 1, 0, u), dr.clip(x.y, 0, 1)), self.density(quad, st)

    def candidate(self, quad, h, t):
        """Returns one root of the quadratic: (position, its distance outside the cell)."""
        _, e, f, g = quad
        along = e + t * g
        s = dr.dot(h - t * f, along) / dr.dot(along, along)
        outside = dr.maximum(dr.maximum(dr.maximum(-s, s - 1), dr.maximum(-t, t - 1)), 0)
        known = (abs(s) < 1e6) & (abs(t) < 1e6)
        return mi.Point2f(dr.select(known, s, 0.5), dr.select(known, t, 0.5)), dr.select(known, outside, self.FAR)

    def invert(self, quad, x):
        """Returns the position in a cell that maps to x, and its distance outside the cell."""
        p, e, f, g = quad
        # (h - t f) x (e + t g) = 0.
        h = x - p
        a, b, c = cross(g, f), cross(h, g) + cross(e, f), cross(h, e)
        root = dr.sqrt(dr.maximum(b * b - 4 * a * c, 0))
        q = -0.5 * (b + dr.select(b < 0, -root, root))
        first, by_first = self.candidate(quad, h, c / q)
        second, by_second = self.candidate(quad, h, q / a)
        return dr.select(by_first <= by_second, first, second), dr.minimum(by_first, by_second)

    def pull_back(self, x, active=True):
        """Returns y for a point of X and |dy/dx|, from the cell that the point is least outside of."""
        index, st = self.search(mi.Point2f(x), mi.Bool(active))
        st = dr.clip(st, 0, 1)
        corner = mi.Point2f(mi.Float(index % self.side), mi.Float(index // self.side))
        y = dr.clip((corner + st) / self.side, 0, BELOW_ONE)
        return y, self.density(self.quad(index, active), st)

    @dr.syntax
    def search(self, x, active):
        """Finds (index of the cell, position in it) in the tree of bounding boxes."""
        # A pending box is one number: level, then its index in the level.
        waiting = dr.alloc_local(mi.UInt32, self.ROOM)
        zero = x.x * 0
        index, outside, at = mi.UInt32(zero), zero + self.FAR, mi.Float(x.x)
        st = mi.Point2f(zero + 0.5, zero + 0.5)
        at += dr.ceil(self.left - at)
        count = dr.select(active & (at <= self.right), mi.UInt32(1), 0)
        waiting[0] = mi.UInt32(zero)
        while (count > 0) & (outside > 0):
            count -= 1
            box = waiting[count]
            level, place = box >> 20, box & 0xFFFFF
            side = mi.UInt32(1) << level
            # Levels before this one have (4^level - 1) / 3 boxes.
            bounds = dr.gather(mi.Vector4f, self.boxes, (side * side - 1) // 3 + place)
            is_inside = (at >= bounds.x) & (at <= bounds.z) & (x.y >= bounds.y) & (x.y <= bounds.w)
            if is_inside & (side == self.side):
                found, by = self.invert(self.quad(place, True), mi.Point2f(at, x.y))
                nearer = by < outside
                index, st, outside = dr.select(nearer, place, index), dr.select(nearer, found, st), dr.select(nearer, by, outside)
            if is_inside & (side < self.side):
                row, column = 2 * (place >> level), 2 * (place & (side - 1))
                for child in (0, 1, 2, 3):
                    own = (row + (child >> 1)) * (2 * side) + column + (child & 1)
                    waiting[count] = ((level + 1) << 20) | own
                    count += 1
            # In the next period of the circle.
            is_over = (count == 0) & (outside > 0) & (at + 1 <= self.right)
            at = dr.select(is_over, at + 1, at)
            if is_over:
                waiting[0] = mi.UInt32(zero)
                count = mi.UInt32(1)
        return index, st
