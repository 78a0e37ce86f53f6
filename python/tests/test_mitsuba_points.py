"""Compares samplers in Dr.Jit point by point with the native ones, including the map's poles and seam."""

import numpy as np
import pytest

mi = pytest.importorskip("mitsuba")
dr = pytest.importorskip("drjit")

import headtail  # noqa: E402

COUNT = 4000
# Rounding moves a few points across borders, and changes pdfs more where the map is steep.
NEAR, FEW = 1e-4, 1e-2


class Points:
    """Shading points and directions, for numpy and for Mitsuba."""

    def __init__(self):
        random = np.random.default_rng(1)
        n, wo, given = (random.normal(size=(COUNT, 3)) for _ in range(3))
        for vectors in (n, given):
            vectors[:4] = [[0, 1, 0], [0, -1, 0], [0, 0, -1], [-1e-7, 0, -1]]
        self.n, wo, self.given = ((v / np.linalg.norm(v, axis=1, keepdims=True)).astype(np.float32) for v in (n, wo, given))
        self.wo = np.where((self.n * wo).sum(1, keepdims=True) < 0, -wo, wo)
        self.alpha = random.uniform(0.1, 0.9, COUNT).astype(np.float32)
        self.u = random.random((COUNT, 2), dtype=np.float32)

    def point(self, alpha):
        """Returns Mitsuba's shading points: GGX surfaces of a width, diffuse ones for None."""
        from headtail.mitsuba._patches import Point

        zero = mi.Float(np.zeros(COUNT, np.float32))
        lobes = None if alpha is None else (zero, zero + 1, zero + 1, zero + mi.Float(alpha))
        return Point(vectors(self.n), vectors(self.wo), lobes)


def vectors(rows):
    return mi.Vector3f(np.ascontiguousarray(rows.T))


def are_near(name, wi, native_wi, pdf, native_pdf):
    apart = np.abs(wi - native_wi).max(1)
    for differences in (apart, relative(pdf, native_pdf)):
        assert (differences > NEAR).mean() < FEW and np.quantile(differences, 0.99) < NEAR, name


def relative(pdf, native):
    return np.abs(np.array(pdf) - native) / np.maximum(native, 1e-20)


def map_texels(name):
    return headtail.Environment.from_array(headtail.Environment(name).array())


def compare(name, native, product, points, alpha):
    """Compares samples, their pdfs, and pdfs of given directions; the sampler is alone, or mixed with BRDF
    sampling with equal weights on both sides."""
    surface = {} if alpha is None else {"alpha": alpha}
    prepared = product.prepare(points.point(alpha))
    is_mixed = alpha is not None and product.has_mixture_weight and native.name != "head"
    mixture_weight = np.array(product.mixture_weight(prepared)) if is_mixed else np.ones(COUNT, np.float32)
    brdf = headtail.Sampler.from_spec("brdf", native.map)

    def mixed(pdf, wi):
        # Rejected samples have no direction.
        wi = np.where((wi == 0).all(1, keepdims=True), points.n, wi)
        return mixture_weight * np.array(pdf) + (1 - mixture_weight) * (brdf.pdf(wi, points.n, points.wo, **surface) if is_mixed else 0)

    # The first part of the unit interval selects the product.
    u = np.stack([np.minimum(points.u[:, 0] * mixture_weight, np.nextafter(mixture_weight, np.float32(0))), points.u[:, 1]], 1)
    draws = native.sampler.sample(points.n, points.wo, u=u, radiance=False, **surface)
    wi, pdf = product.sample(prepared, mi.Point2f(np.ascontiguousarray(points.u.T)))
    drawn = draws.pdf > 0
    are_near(name, np.array(wi).T[drawn], draws.wi[drawn], mixed(pdf, draws.wi)[drawn], draws.pdf[drawn])
    of_given = native.sampler.pdf(points.given, points.n, points.wo, **surface)
    differences = relative(mixed(product.pdf(prepared, vectors(points.given)), points.given), of_given)
    assert (differences > NEAR).mean() < FEW and np.quantile(differences, 0.99) < NEAR, name


class Native:
    """A sampler of the package from a SPEC, for a built-in map."""

    def __init__(self, map, spec):
        self.name, self.map = spec.split(":")[0], map_texels(map)
        self.sampler = headtail.Sampler.from_spec(spec, self.map)


@pytest.fixture(scope="module")
def points(variant):
    if variant.endswith("_mono"):
        pytest.skip("the arithmetic is that of colours")
    return Points()


@pytest.mark.parametrize("loops", [False, True])
def test_heads_match_the_native_ones(points, heads, loops):
    """Tests both ways to multiply matrices."""
    from headtail.mitsuba._light import product_of

    for name, file in heads.items():
        native = Native("studio", f"head+patches:{file}" if "patches" in name else f"head:{file}")
        alpha = points.alpha if name in ("of any width", "over fine patches") else 0.3 if name == "of one width" else None
        product = product_of(native.sampler._native.arrays(), loops)
        compare(name, native, product, points, alpha)


@pytest.mark.parametrize("map", ["studio", "sunset"])
def test_tables_match_the_native_ones(points, tmp_path, map):
    from headtail.mitsuba._table import Table

    file = tmp_path / "table.safetensors"
    headtail.bake(headtail.Environment(map).array()).save(file)
    native = Native(map, f"direct:{file}")
    compare(map, native, Table(native.sampler._native.arrays()), points, None)


@pytest.mark.parametrize("glossy", [False, True])
@pytest.mark.parametrize(("map", "fine"), [("studio", False), ("studio", True), ("sunset", False)])
def test_patches_match_the_native_ones(points, map, fine, glossy):
    from headtail.mitsuba._patches import Patches

    native = headtail.Sampler(headtail._native.Sampler.patches_alone(headtail.Environment(map)._native, fine))
    patches, surface = Patches(native._native.arrays()), {"alpha": points.alpha} if glossy else {}
    prepared = patches.prepare(points.point(points.alpha if glossy else None))
    draws = native.sample(points.n, points.wo, u=points.u, radiance=False, **surface)
    wi, pdf = patches.sample(prepared, mi.Point2f(np.ascontiguousarray(points.u.T)))
    drawn = draws.pdf > 0
    are_near("draws", np.array(wi).T[drawn], draws.wi[drawn], np.array(pdf)[drawn], draws.pdf[drawn])
    # One pass samples half of the points, and evaluates pdfs of given directions at the others.
    is_given = np.arange(COUNT) % 2 == 1
    wi, pdf = patches.sample_or_pdf(prepared, mi.Point2f(np.ascontiguousarray(points.u.T)), mi.Bool(is_given), vectors(points.given))
    expected = np.where(is_given, native.pdf(points.given, points.n, points.wo, **surface), draws.pdf)
    counts = is_given | drawn
    expected_wi = np.where(is_given[:, None], points.given, draws.wi)
    are_near("both", np.array(wi).T[counts], expected_wi[counts], np.array(pdf)[counts], expected[counts])
