"""Monotone rational-quadratic splines in Dr.Jit, like `sampling/src/spline`: on [0, 1] and on the circle."""

import drjit as dr
import mitsuba as mi

LEAST_BIN = LEAST_SLOPE = 1e-4
SLOPE_OFFSET = 0.5411666523385311
BELOW_ONE = 1 - 2.0**-24


def wrap(x):
    """Wraps to [0, 1): x - floor(x) rounds to 1 for a tiny negative x."""
    fraction = x - dr.floor(x)
    return dr.select(fraction >= 1, 0, fraction)


def softplus(x):
    return dr.maximum(x, 0) + dr.log(1 + dr.exp(-abs(x)))


def quadratic(t, s, d0, d1):
    """Returns value and slope in a bin at t, both in [0, 1] (Durkan et al. 2019, eq. 4 and 5); s is the
    secant."""
    o = 1 - t
    numerator = d1 * t * t + 2 * s * t * o + d0 * o * o
    by_d = dr.rcp(s * (1 - 2 * t * o) + (d0 + d1) * t * o)
    return (s * t + d0 * o) * t * by_d, dr.square(s * by_d) * numerator


def root_of(value, s, d0, d1):
    """Returns the position at which a bin has a value: the root in its cancellation-free form."""
    o = 1 - value
    b = d0 - (d0 + d1 - 2 * s) * value
    ends = d0 * o - d1 * value
    root = dr.sqrt(ends * ends + 4 * s * s * value * o)
    over, under = dr.select(b >= 0, 2 * s * value, root - b), dr.select(b >= 0, b + root, 2 * (s - b))
    return dr.clip(over / under, 0, 1)


class Spline:
    """A spline per lane, from a network's logits."""

    def __init__(self, logits, is_circle):
        self.bins, self.is_circle = (len(logits) - 1) // 3, is_circle
        count = self.bins
        self.widths, self.heights = self.sizes(logits[:count]), self.sizes(logits[count : 2 * count])
        self.slopes = logits[2 * count : 3 * count + (not is_circle)]
        if is_circle:
            self.slopes = [*self.slopes, self.slopes[0]]
            self.turn = logits[-1] - dr.round(logits[-1])

    @staticmethod
    def sizes(logits):
        """Returns widths or heights of bins."""
        largest = logits[0]
        for logit in logits[1:]:
            largest = dr.maximum(largest, logit)
        exponentials = [dr.exp(logit - largest) for logit in logits]
        total = exponentials[0]
        for number in exponentials[1:]:
            total = total + number
        scale = (1 - len(logits) * LEAST_BIN) / total
        return [LEAST_BIN + number * scale for number in exponentials]

    def bin(self, at, first, second):
        """Returns the bin of a point along the first axis: starts and sizes along both axes, and the slopes
        at its ends."""
        zero = at * 0
        left, bottom, found = zero, zero, [zero] * 6
        for k in range(self.bins):
            candidate = left, bottom, first[k], second[k], self.slopes[k], self.slopes[k + 1]
            reached = at >= left
            found = [dr.select(reached, new, old) for new, old in zip(candidate, found)]
            left, bottom = left + first[k], bottom + second[k]
        *sizes, d0, d1 = found
        return *sizes, LEAST_SLOPE + softplus(d0 + SLOPE_OFFSET), LEAST_SLOPE + softplus(d1 + SLOPE_OFFSET)

    def forward(self, z):
        """Evaluates the sampling direction: (y, dz/dy)."""
        z = dr.clip(z, 0, 1)
        bottom, left, height, width, d0, d1 = self.bin(z, self.heights, self.widths)
        s = height / width
        t = root_of(dr.clip((z - bottom) / height, 0, 1), s, d0, d1)
        y, slope = left + width * t, quadratic(t, s, d0, d1)[1]
        if self.is_circle:
            return wrap(dr.minimum(y, 1) - self.turn), slope
        return dr.minimum(y, BELOW_ONE), slope

    def inverse(self, y):
        """Evaluates the density direction: (z, dz/dy)."""
        x = wrap(wrap(y) + self.turn) if self.is_circle else dr.clip(y, 0, 1)
        left, bottom, width, height, d0, d1 = self.bin(x, self.widths, self.heights)
        t = dr.clip((x - left) / width, 0, 1)
        value, slope = quadratic(t, height / width, d0, d1)
        return dr.clip(bottom + height * value, 0, 1), slope
