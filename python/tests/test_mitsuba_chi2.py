"""Mitsuba's own chi-square test: the pdfs of samplers in Dr.Jit are those that they sample with."""

import numpy as np
import pytest

mi = pytest.importorskip("mitsuba")
dr = pytest.importorskip("drjit")

import headtail  # noqa: E402

# Rows of cells, points in each along a side, and draws: a lat-long map of 64 rows has no details within a point's cell.
RES, IRES, DRAWS = 51, 16, 400_000
# Tests of this file.
TESTS = 12


def small_map():
    """A sky with a lamp and a dark half, without details that the quadrature would miss."""
    v, u = np.mgrid[0:64, 0:128]
    sky = 0.1 + np.exp(-((u - 90) ** 2 + (v - 20) ** 2) / 60.0) * 30 + 0.3 * (v < 32)
    return headtail.Environment.from_array(np.repeat(sky[..., None], 3, 2).astype(np.float32))


def at(normal, wo, alpha, count):
    from headtail.mitsuba._patches import Point

    def repeated(vector):
        vector = np.array(vector) / np.linalg.norm(vector)
        return mi.Vector3f(*(dr.full(mi.Float, float(number), count) for number in vector))

    zero = dr.zeros(mi.Float, count)
    lobes = None if alpha is None else (zero, zero + 1, zero + 1, zero + alpha)
    return Point(repeated(normal), repeated(wo), lobes)


def differences(product, normal, wo, alpha, factor=1.0, seed=0):
    """Returns Mitsuba's test of a sampler at a shading point, with pdfs multiplied by `factor` in one hemisphere."""
    from mitsuba.chi2 import ChiSquareTest, SphericalDomain

    def sample(u):
        wi, pdf = product.sample(product.prepare(at(normal, wo, alpha, DRAWS)), mi.Point2f(u[0], u[1]))
        return wi, dr.select(pdf > 0, mi.Float(1), 0)

    def density(wi):
        pdf = product.pdf(product.prepare(at(normal, wo, alpha, dr.width(wi))), wi)
        return dr.select(wi.x > 0, factor, 2 - factor) * pdf

    return ChiSquareTest(SphericalDomain(), sample, density, sample_count=DRAWS, res=RES, ires=IRES, seed=seed)


@pytest.fixture(scope="module")
def map(variant):
    if variant.endswith("_mono"):
        pytest.skip("the arithmetic is that of colours")
    return small_map()


def product(name, map, tmp_path):
    from headtail.mitsuba._light import product_of

    if name in ("patches", "mis-comp"):
        return product_of(headtail.Sampler.from_spec(name, map)._native.arrays())
    if name == "table":
        return product_of(headtail.bake(map)._native.arrays())
    settings = {"over patches": {"over": "patches"}, "over the tail": {"head": {"share": False}}}[name]
    file = tmp_path / "head.safetensors"
    headtail.fit(map, steps=20, conditions=8, validation_conditions=8, **settings).save(file)
    return product_of(headtail.Sampler.open(file, map)._native.arrays())


@pytest.mark.parametrize(
    ("name", "alpha"),
    [("patches", None), ("patches", 0.3), ("table", None), ("mis-comp", None), ("over the tail", None), ("over patches", None)],
)
@pytest.mark.parametrize("normal", [(0.2, 1, -0.3), (-0.7, -0.1, 0.6)])
def test_directions_follow_their_pdfs(map, tmp_path, name, alpha, normal):
    sampler = product(name, map, tmp_path)
    tangent = np.cross(normal, (0.3, 0.5, 0.8))
    test = differences(sampler, normal, np.array(normal) + 0.8 * tangent, alpha)
    assert test.run(significance_level=0.01, test_count=TESTS, quiet=True), test.messages


def test_wrong_pdfs_are_found(map, tmp_path):
    test = differences(product("patches", map, tmp_path), (0.2, 1, -0.3), (0.2, 1, -0.3), None, factor=1.03)
    assert not test.run(significance_level=0.01, test_count=1, quiet=True)
