"""Patches of sky in Dr.Jit: product sampling in closed form, like `sampling/src/patches` for SIMD lanes.

Multiply-adds are fused in the same places as there, so that masses agree to the last digits.
"""

import math

import drjit as dr
import mitsuba as mi

from ._warp import BELOW_ONE, Tail, directions, positive, remap, squares, upload

CLUSTERS, PARTS = 32, 16
LEAF_FLOOR, CLUSTER_FLOOR = 0.15, 0.045
LEAST_VISIBLE, LEAST_TOP, LEAST_VARIANCE = 0.02, 0.2, 3e-7
MOST_BRDF, LEAST_BRDF, LEAST_REFLECTED = 0.9, 0.03, 0.3
ODDS_AT_ONE, ODDS_BY_WIDTH, ODDS_BY_LIGHT = -4.35, 2.14, 1.92
LEAST_BRDF_SEEN, LEAST_BY_WIDTH, MOST_LEAST = 0.02, 3.0, 0.5
LEAST_UNEVENNESS, MOST_UNEVENNESS, TINY = 0.1, 1e6, 1.17549435e-38
ODDS_OF_SMALL, LEAST_SMALL, MOST_SMALL = 0.75, 0.05, 0.875
CUTS_COLUMNS, IS_SINGLE = 1 << 7, 1 << 24


class Patch:
    """The quantities that a patch's mass depends on, for one patch or one per lane."""

    def __init__(self, numbers):
        self.energy = numbers[0]
        self.centroid = mi.Vector3f(*numbers[1:4])
        self.squares = mi.Vector3f(*numbers[4:7])
        self.mixed = mi.Vector3f(*numbers[7:10])
        self.reach, self.mahalanobis, self.cell, self.variance, self.inverse_energy = numbers[10:15]

    def spread(self, t):
        """Returns three times the variance of t . w over the patch."""
        first = dr.fma(t.y, self.mixed.x, dr.fma(t.z, self.mixed.y, t.x * self.squares.x))
        second = dr.fma(t.z, self.mixed.z, t.y * self.squares.y)
        third = t.z * self.squares.z
        return dr.maximum(dr.fma(t.x, first, dr.fma(t.y, second, t.z * third)), 0)

    def cosines(self, n):
        """Returns mean, half-width and upper bound of the cosines over the patch, approximated as uniform on
        an interval."""
        mean = dot(n, self.centroid)
        half_width = dr.sqrt(self.spread(n) + LEAST_VARIANCE)
        return mean, half_width, mean + dr.minimum(dr.fma(self.mahalanobis, half_width, self.cell), self.reach)

    def mass(self, at, is_leaf):
        """Returns the light of the patch times its reflection at the surface."""
        cosines = self.cosines(at.n)
        diffuse = clamped(cosines, is_leaf)
        if at.is_diffuse:
            return self.energy * diffuse
        glossy = dr.select(cosines[2] > 0, self.glossy(at, cosines, is_leaf), 0)
        both = dr.fma(at.specular, glossy, at.diffuse * dr.inv_pi * diffuse)
        return self.energy * dr.select(at.specular > 0, both, diffuse)

    def glossy(self, at, cosines, is_leaf):
        """Returns the Trowbridge-Reitz lobe times cosine in the middle of the visible part, widened by the
        spread of half vectors."""
        mean, half_width, bound = cosines
        top = dr.maximum(dr.minimum(mean + half_width, bound), LEAST_TOP * bound)
        bottom = dr.maximum(mean - half_width, 0)
        visible = dr.maximum(dr.minimum((top - bottom) / (2 * half_width), 1), LEAST_VISIBLE)
        middle = 0.5 * (top + bottom)
        w = dr.fma(at.n, middle - mean, self.centroid)
        scale = 1 / dr.sqrt(dr.maximum(dot(w, w), 1e-6))
        w *= scale
        cos_i = dr.clip(middle * scale, 1e-4, 1)
        cos = dr.minimum(dot(at.wo, w), 1 - 1e-6)
        squared_half = dr.maximum(dr.fma(0.5, cos, 0.5), 1e-3)
        away = 1 - cos
        both = 1 / (squared_half * away)
        per_half, per_squared_sine = away * both, 0.5 * both
        squared_cos_h = dr.minimum((cos_i + at.cos_o) * (cos_i + at.cos_o) * (0.25 * per_half), 1)
        across = mi.Vector3f(
            dr.fma(at.wo.y, w.z, -(at.wo.z * w.y)),
            dr.fma(at.wo.z, w.x, -(at.wo.x * w.z)),
            dr.fma(at.wo.x, w.y, -(at.wo.y * w.x)),
        )
        variance_across = self.spread(across) * (1 / 3) * per_squared_sine
        variance_along = dr.maximum(self.variance - variance_across, 0)
        own = at.alpha * at.alpha
        along = dr.minimum(dr.fma(0.5, variance_along, own), 1)
        over = dr.minimum(dr.fma(0.5 * variance_across, per_half, own), 1)
        tilt_across = dr.square(dot(at.n, across)) * per_squared_sine
        tilt_along = dr.maximum(1 - squared_cos_h - tilt_across, 0)
        product = along * over
        scaled = dr.fma(squared_cos_h, product, dr.fma(tilt_along, over, tilt_across * along))
        smooth, rough = 2 * cos_i * at.cos_o, cos_i + at.cos_o
        shadowing = 2 * dr.fma(at.alpha, rough - smooth, smooth)
        x = 1 - squared_half
        fourth = dr.square(dr.square(x))
        fresnel = dr.fma(1 - at.f0, fourth * fourth * fourth, at.f0)
        fraction = dr.sqrt(visible) if is_leaf else visible
        lobe = dr.inv_pi * product * dr.sqrt(product) * cos_i / (scaled * scaled * shadowing)
        return fraction * fresnel * lobe


def dot(a, b):
    """Returns the dot product in the native sampler's order of operations."""
    return dr.fma(a.x, b.x, dr.fma(a.y, b.y, a.z * b.z))


def clamped(cosines, is_leaf):
    """Returns the clamped cosine: root mean square for a leaf, mean for a cluster; at least a fraction of its
    upper bound."""
    mean, half_width, bound = cosines
    above = dr.maximum(mean + half_width, 0)
    if is_leaf:
        part = above * above * above / (6 * half_width)
        value = dr.sqrt(dr.select(mean > half_width, mean * mean + half_width * half_width * (1 / 3), part))
    else:
        value = dr.select(mean > half_width, mean, above * above / (4 * half_width))
    return dr.select(bound > 0, dr.maximum(value, bound * (LEAF_FLOOR if is_leaf else CLUSTER_FLOOR)), 0)


class Point:
    """A shading point in the map's frame: unit normal and direction to the viewer, lobes (None if all
    surfaces are diffuse), and a position (None for samplers that ignore it)."""

    def __init__(self, n, wo, lobes, p=None):
        self.n, self.wo, self.p, self.is_diffuse = n, wo, p, lobes is None
        if lobes is not None:
            self.diffuse, self.specular, self.f0, self.alpha = lobes
            self.cos_o = dr.maximum(dot(n, wo), 1e-4)


class Prepared:
    """A shading point with the running sums of its clusters' masses, their total, and the mixture weight of the
    product beside BSDF sampling."""

    def __init__(self, at, sums, total, mixture_weight):
        self.at, self.sums, self.total, self.mixture_weight = at, sums, total, mixture_weight


def mixture_weight_by_width(lobes):
    """Returns the mixture weight of the product beside BSDF sampling, by the width of lobes alone."""
    diffuse, specular, f0, alpha = lobes
    return mixture_weight_beside_lobe(by_width(alpha), diffuse, specular, f0)


def by_width(alpha):
    """Returns the mixture weight of BSDF sampling for a lobe by its width alone."""
    return dr.clip(0.5 * dr.power(0.05 / alpha, 1.25), LEAST_BRDF, MOST_BRDF)


def mixture_weight_beside_lobe(of_lobe, diffuse, specular, f0):
    """Returns the mixture weight of the product from that of BSDF sampling for the glossy lobe alone."""
    reflected = specular * dr.maximum(f0, LEAST_REFLECTED)
    return dr.select(specular > 0, 1 - of_lobe * reflected / (reflected + diffuse), 1)


def mixture_weight_beside_bsdf(at, total, squared):
    """Returns the mixture weight of the product by the width of lobes and the unevenness of the light in them.

    `total` is the reflected light, `squared` the same weighted by the density of the light.
    """
    if at.is_diffuse:
        return mi.Float(1)
    grazing = 1 - dr.maximum(dot(at.n, at.wo), 0)
    fourth = dr.square(dr.square(grazing))
    albedo = at.diffuse + at.specular * (at.f0 + (1 - at.f0) * (fourth * grazing))
    total = dr.maximum(total, TINY)
    unevenness = dr.clip((albedo / total) * (squared / total), LEAST_UNEVENNESS, MOST_UNEVENNESS)
    width = dr.log(at.alpha)
    odds = dr.exp(ODDS_AT_ONE - ODDS_BY_WIDTH * width - ODDS_BY_LIGHT * dr.log(unevenness))
    least = LEAST_BRDF_SEEN * dr.exp(LEAST_BY_WIDTH * dr.maximum(math.log(0.1) - width, 0))
    of_lobe = dr.maximum(dr.minimum(odds / (1 + odds), by_width(at.alpha)), dr.minimum(least, MOST_LEAST))
    return mixture_weight_beside_lobe(of_lobe, at.diffuse, at.specular, at.f0)


def small_light_scales(own, total, mixture_weight):
    """Returns changes to running sums that give small lights a multiple of 1/4 of all samples: a factor for
    their sums, and an offset for the others."""
    rest = total - own
    odds = ODDS_OF_SMALL * dr.sqrt(own / rest)
    quarters = dr.maximum(dr.floor(4 * mixture_weight * odds / (1 + odds) + 0.5), 1)
    quarters = dr.select(0.25 * quarters > MOST_SMALL * mixture_weight, quarters - 1, quarters)
    counts = (own > LEAST_SMALL * total) & (rest > 0) & (quarters > 0)
    wanted = 0.25 * quarters / mixture_weight
    wanted = wanted / (1 - wanted) * rest
    return dr.select(counts, wanted / own, 1), dr.select(counts, wanted - own, 0)


@dr.syntax
def descend(forest, root, sums, total, z, given, own, left, right, top, bottom, active):
    """Descends one tree: (index, mass, the rectangle cut so far). Cuts are proportional to masses, whose running sums
    are in local memory.

    The patch contains z, or where `given` has the index `own`.
    """
    # One value per lane: Dr.Jit treats a loop variable with a single value as a constant.
    zero = z.x * 0
    left, right, top, bottom = left + zero, right + zero, top + zero, bottom + zero
    root = root + mi.UInt32(zero)
    node, before, after, active = mi.UInt32(root), mi.Float(zero), total + zero, active & (zero == 0)
    split = dr.gather(mi.UInt32, forest, node, active)
    going = active & ((split & IS_SINGLE) == 0)
    while going:
        middle = sums.read(dr.maximum(split & 0x7F, 1) - 1, going)
        columns = (split & CUTS_COLUMNS) != 0
        start, end = dr.select(columns, left, top), dr.select(columns, right, bottom)
        fraction = (middle - before) / dr.maximum(after - before, 1.17549435e-38)
        cut = start + (end - start) * fraction
        first = dr.select(given, own < (split & 0x7F), dr.select(columns, z.x, z.y) < cut)
        before, after = dr.select(first, before, middle), dr.select(first, middle, after)
        start, end = dr.select(first, start, cut), dr.select(first, cut, end)
        left, right = dr.select(columns, start, left), dr.select(columns, end, right)
        top, bottom = dr.select(columns, top, start), dr.select(columns, bottom, end)
        node = root + (dr.select(first, split >> 8, split >> 16) & 0xFF)
        split = dr.gather(mi.UInt32, forest, node, going)
        going &= (split & IS_SINGLE) == 0
    return split & 0x7F, after - before, left, right, top, bottom


class Patches:
    """The sampler `patches` from `arrays` (see `Patches::flat` in the crate headtail-sampling)."""

    def __init__(self, arrays):
        self.tail = Tail(arrays)
        self.clusters = [[float(number) for number in record] for record in arrays["patches.clusters"]]
        self.clusters = [record for record in self.clusters if record[0] > 0]
        self.records = {name: upload(arrays[f"patches.{name}"]) for name in ("leaves", "twigs")}
        self.rectangles = {name: upload(arrays[f"patches.{name}_rectangles"]) for name in ("leaf", "twig")}
        self.forest, self.roots = upload(arrays["patches.forest"]), upload(arrays["patches.roots"])
        self.twig_of_cell = upload(arrays["patches.twig_of_cell"])
        self.narrow = float(arrays["patches.narrow"][0])
        self.small = int(arrays["patches.small"][0])

    def prepare(self, at):
        """Returns the clusters' masses at a shading point, which serve any number of directions.

        Running sums for cutting the square are in local memory. Small lights come first and get multiples of 1/4
        of all samples.
        """
        sums, squared = self.cluster_masses(at)
        total = sums[-1]
        mixture_weight = mixture_weight_beside_bsdf(at, total, squared)
        if self.small > 0:
            factor, added = small_light_scales(sums[self.small - 1], total, mixture_weight)
            if not at.is_diffuse:
                at_leaves = at.alpha >= self.narrow
                factor, added = dr.select(at_leaves, factor, 1), dr.select(at_leaves, added, 0)
            sums = [sum * factor if k < self.small else sum + added for k, sum in enumerate(sums)]
            total = total + added
        local = dr.alloc_local(mi.Float, CLUSTERS)
        for k, sum in enumerate(sums):
            local[k] = sum
        return Prepared(at, local, total, mixture_weight)

    def sample(self, prepared, z, active=True):
        """Samples a direction from a uniform point z: (direction, solid-angle pdf)."""
        return self.sample_or_pdf(prepared, z, None, None, active)

    def pdf(self, prepared, wi, active=True):
        """Returns the solid-angle pdf of a direction under `sample`."""
        return self.invert(prepared, wi, active)[1]

    def sample_or_pdf(self, prepared, z, given, wi, active=True):
        """Samples directions for uniform points z, and evaluates pdfs of directions `wi` where `given`: (direction,
        solid-angle pdf).

        One pass for both, since sampling and pdf need the same masses. given may be None.
        """
        has_given = given is not None
        twig, inside_cell, factor = mi.UInt32(0), None, None
        if has_given:
            x, factor = squares(wi)
            cell, inside_cell = self.tail.cell(x)
            twig = dr.gather(mi.UInt32, self.twig_of_cell, cell, active & given)
        (left, right, top, bottom), cuts, q = self.walk(prepared, z, given, twig, active)
        inside = inside_of(cuts, z)
        y = mi.Point2f(within(left, right, inside.x), within(top, bottom, inside.y))
        draws = active & ~given if has_given else active
        x, density = self.tail.forward(y, draws)
        direction, own_factor = directions(x)
        pdf = density * own_factor
        if has_given:
            density = self.tail.density(cell, inside_cell, active & given)
            direction, pdf = dr.select(given, wi, direction), dr.select(given, density * factor, pdf)
        return direction, positive(pdf * q)

    def invert(self, prepared, wi, active=True):
        """Returns the uniform points that map to directions, and their solid-angle pdfs; points with pdf 0
        are invalid."""
        x, factor = squares(wi)
        y, density = self.tail.pull_back(x, active)
        twig = dr.gather(mi.UInt32, self.twig_of_cell, self.tail.cell(x)[0], active)
        rectangle, (left, right, top, bottom), q = self.walk(prepared, x, mi.Bool(True), twig, active)
        inside = inside_of(rectangle, y)
        z = mi.Point2f(left + (right - left) * inside.x, top + (bottom - top) * inside.y)
        return dr.minimum(z, BELOW_ONE), positive(q * density * factor)

    def walk(self, prepared, z, given, twig, active):
        """Returns (rectangle of Y, rectangle of uniform points, density over Y) of the patch that contains z,
        or where `given` of a twig's."""
        given = mi.Bool(False) if given is None else given
        at, sums, total = prepared.at, prepared.sums, prepared.total
        root = dr.gather(mi.UInt32, self.roots, mi.UInt32(0))
        square = mi.Float(0), mi.Float(1), mi.Float(0), mi.Float(1)
        place, mass, *cuts = descend(self.forest, root, sums, total, z, given, twig // (PARTS * PARTS), *square, active)
        probability = part_fraction(mass, total)
        number, probability, cuts, inverse_energy = self.level("leaves", 1, at, place, probability, z, cuts, twig // PARTS, given, active)
        rectangle = dr.gather(mi.Vector4f, self.rectangles["leaf"], number, active)
        if self.narrow > 1 or not at.is_diffuse:
            narrow = active & (mi.Float(1) < self.narrow if at.is_diffuse else at.alpha < self.narrow)
            number, probability, cuts, inverse_energy, rectangle = self.twig_level(
                at, number, probability, z, cuts, twig, given, narrow, inverse_energy, rectangle
            )
        return rectangle, cuts, probability * inverse_energy

    def cluster_masses(self, at):
        """Returns running sums of the clusters' masses, and the sum of masses weighted by the density of
        their light."""
        sums, squared = [], mi.Float(0)
        for record in self.clusters:
            mass = Patch([mi.Float(number) for number in record]).mass(at, False)
            sums.append(sums[-1] + mass if sums else mass)
            squared += mass * record[14]
        return sums, squared

    def level(self, name, first_root, at, parent, probability, z, cuts, own, given, active):
        """Descends one level: (index, probability, cuts, one over the part's energy)."""
        sums, total = dr.alloc_local(mi.Float, PARTS), mi.Float(0)
        for k in range(PARTS):
            total += self.patch(name, parent * PARTS + k, active).mass(at, True)
            sums[k] = total
        root = dr.gather(mi.UInt32, self.roots, parent + first_root, active)
        place, mass, *cuts = descend(self.forest, root, sums, total, z, given, own % PARTS, *cuts, active)
        number = parent * PARTS + place
        inverse_energy = dr.gather(mi.Vector4f, self.records[name], number * 4 + 3, active).z
        return number, probability * part_fraction(mass, total), cuts, inverse_energy

    @dr.syntax
    def twig_level(self, at, number, probability, z, cuts, twig, given, narrow, inverse_energy, rectangle):
        """Descends to the level below the leaves, for narrow lobes."""
        if narrow:
            first = 1 + CLUSTERS
            number, probability, cuts, inverse_energy = self.level(
                "twigs", first, at, number, probability, z, cuts, twig, given, narrow
            )
            rectangle = dr.gather(mi.Vector4f, self.rectangles["twig"], number, narrow)
        return number, probability, cuts, inverse_energy, rectangle

    def patch(self, name, number, active):
        parts = [dr.gather(mi.Vector4f, self.records[name], number * 4 + k, active) for k in range(4)]
        return Patch([number for part in parts for number in part])


def part_fraction(mass, total):
    """Returns the fraction of a mass; 0 if there is nothing to sample."""
    return dr.select((mass > 0) & (total > 0), mass / total, 0)


def inside_of(rectangle, point):
    """Returns the position of a point relative to a rectangle."""
    left, right, top, bottom = rectangle
    return mi.Point2f(remap(point.x, left, right), remap(point.y, top, bottom))


def within(start, end, inside):
    """Returns a position in an interval, excluding its end, which belongs to the next patch."""
    place = start + (end - start) * inside
    below = dr.reinterpret_array(mi.Float, dr.reinterpret_array(mi.UInt32, end) - 1)
    return dr.select(place < end, place, below)

