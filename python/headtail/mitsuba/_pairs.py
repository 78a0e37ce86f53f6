"""Pairs of directions, one of the environment and one of the BSDF: two-sample MIS, whose map is compensated."""

from ._tails import tail_of
from ._warp import directions, positive, squares


class Pairs:
    """Directions of the map alone, from `arrays` of its tail, where MIS compensation (Karlik et al. 2019) leaves out
    dim light: BSDF samples find it."""

    sees_lobes, has_mixture_weight = False, False

    def __init__(self, arrays):
        self.tail = tail_of(arrays)

    def prepare(self, at):
        """Returns what sampling needs of a shading point: nothing."""
        return ()

    def sample(self, prepared, z, active=True):
        """Samples a direction from a uniform point z: (direction, solid-angle pdf)."""
        x, density = self.tail.forward(z, active)
        direction, factor = directions(x)
        return direction, positive(density * factor)

    def pdf(self, prepared, wi, active=True):
        """Returns the solid-angle pdf of a direction under `sample`."""
        x, factor = squares(wi)
        return positive(self.tail.density(*self.tail.cell(x), active) * factor)
