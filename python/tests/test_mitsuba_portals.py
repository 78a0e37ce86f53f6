"""Portals in Mitsuba: directions and pdfs are those of the native sampler, and means those of Mitsuba's own integrators."""

import json

import numpy as np
import pytest

mi = pytest.importorskip("mitsuba")
dr = pytest.importorskip("drjit")

from conftest import directions, uniform  # noqa: E402
from pictures import agree, integrator, runs  # noqa: E402
from pictures import scene as outdoors  # noqa: E402

import headtail  # noqa: E402

COUNT = 20_000
# A window, one beside it, and a skylight that is turned.
OPENINGS = [
    {"center": [2, 1.5, -0.5], "normal": [-1, 0, 0], "up": [0, 1, 0], "width": 1, "height": 1.2},
    {"center": [2.3, 1.6, 0.2], "normal": [-1, 0, 0], "up": [0, 1, 0], "width": 0.8, "height": 1},
    {"center": [-0.5, 3, 0.8], "normal": [0, -1, 0], "up": [0.6, 0, 0.8], "width": 1, "height": 0.6},
]


def written(folder, portals):
    file = folder / "portals.json"
    file.write_text(json.dumps({"portals": portals}))
    return file


def arrays(file, map, to_map=np.eye(3)):
    return headtail._native.portal_arrays(headtail._native.read_portals(file), map._native, np.asarray(to_map).tolist())


def at(n, p):
    from headtail.mitsuba._patches import Point

    n, p = (mi.Vector3f(np.ascontiguousarray(rows.T)) for rows in (n, p))
    return Point(n, n, None, p)


def test_directions_and_pdfs_are_the_native_ones(variant, tmp_path):
    from headtail.mitsuba._portals import Portals

    map, file = headtail.Environment("sunset"), written(tmp_path, OPENINGS)
    native, own = headtail.Sampler.from_spec(f"portals:{file}", map), Portals(arrays(file, map))
    n, u = directions(COUNT, 1), uniform(COUNT, 2)
    # Inside, outside, and in the plane of a window.
    p = (directions(COUNT, 3) * [2.5, 1.5, 2.5] + [0.5, 1.5, 0]).astype(np.float32)
    p[:50, 0] = 2
    draws = native.sample(n, u=u, p=p)
    prepared = own.prepare(at(n, p))
    wi, pdf = own.sample(prepared, mi.Point2f(np.ascontiguousarray(u.T)))
    wi, pdf = np.array(wi).T, np.array(pdf)
    drawn = draws.pdf > 0
    assert drawn.mean() > 0.9 and (drawn != (pdf > 0)).mean() < 1e-3
    both = drawn & (pdf > 0)
    assert np.quantile(np.abs(wi - draws.wi)[both].max(1), 0.995) < 1e-4
    assert np.quantile(np.abs(pdf / draws.pdf - 1)[both], 0.995) < 1e-3
    # Directions of the sampler, and any.
    for given in (np.where(drawn[:, None], draws.wi, n), directions(COUNT, 4)):
        expected = native.pdf(given, n, p=p)
        found = np.array(own.pdf(prepared, mi.Vector3f(np.ascontiguousarray(given.T))))
        assert np.quantile(np.abs(found - expected) / np.maximum(expected, 1e-6), 0.995) < 1e-3


def test_directions_follow_their_pdfs(variant, tmp_path):
    from headtail.mitsuba._portals import Portals
    from mitsuba.chi2 import ChiSquareTest, SphericalDomain

    if variant.endswith("_mono"):
        pytest.skip("the arithmetic is that of colours")
    own = Portals(arrays(written(tmp_path, OPENINGS), headtail.Environment("overcast")))
    n, p, draws = np.array([[0.3, 0.9, 0.1]], np.float32) / np.sqrt(0.91), np.array([[0.3, 0.2, -0.1]], np.float32), 400_000

    def prepared(count):
        return own.prepare(at(np.repeat(n, count, 0), np.repeat(p, count, 0)))

    def sample(u):
        wi, pdf = own.sample(prepared(draws), mi.Point2f(u[0], u[1]))
        return wi, dr.select(pdf > 0, mi.Float(1), 0)

    # Cells at the sides of portals need a fine quadrature.
    test = ChiSquareTest(SphericalDomain(), sample, lambda wi: own.pdf(prepared(dr.width(wi)), wi), sample_count=draws, res=51, ires=48, seed=1)
    assert test.run(significance_level=0.01, test_count=2, quiet=True), test.messages


def room(integrator, material, to_world):
    """A box with a window in its east wall, under a sun outside. Rectangles that Mitsuba merges have no bounding box, without
    which its own integrators sample the map through walls."""
    transform = mi.ScalarTransform4f
    glossy = {"type": "roughconductor", "alpha": 0.3}
    bsdf = {"type": "twosided", "bsdf": glossy if material == "glossy" else {"type": "diffuse"}}
    walls = {"floor": ([0, 0, 0], [1, 0, 0], -90, 2, 2), "ceiling": ([0, 3, 0], [1, 0, 0], 90, 2, 2), "south": ([0, 1.5, 2], [0, 1, 0], 180, 2, 1.5),
             "north": ([0, 1.5, -2], [0, 1, 0], 0, 2, 1.5), "west": ([-2, 1.5, 0], [0, 1, 0], 90, 2, 1.5),
             "below": ([2, 0.5, 0], [0, 1, 0], -90, 2, 0.5), "above": ([2, 2.5, 0], [0, 1, 0], -90, 2, 0.5),
             "left": ([2, 1.5, -1.25], [0, 1, 0], -90, 0.75, 0.5), "right": ([2, 1.5, 1.25], [0, 1, 0], -90, 0.75, 0.5)}
    shapes = {
        name: {"type": "rectangle", "to_world": transform().translate(place).rotate(axis, angle).scale([width, height, 1]), "bsdf": bsdf}
        for name, (place, axis, angle, width, height) in walls.items()
    }
    return mi.load_dict({
        "type": "scene",
        "integrator": integrator,
        "map": {"type": "envmap", "bitmap": mi.Bitmap(headtail.Environment("sunset").array()), "to_world": to_world},
        "sensor": {
            "type": "perspective",
            "fov": 60,
            "to_world": transform().look_at([-1.5, 1.5, 1.5], [0.5, 0.8, -0.5], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 64, "height": 48, "rfilter": {"type": "box"}},
        },
        **shapes,
    }, optimize=False)


@pytest.mark.parametrize(("material", "kind"), [("diffuse", "direct"), ("glossy", "path")])
def test_means_match_mitsubas_own_integrators_with_less_variance(variant, tmp_path, material, kind):
    if variant.endswith("_mono") and material == "glossy":
        pytest.skip("of one channel, one scene is enough")
    window = written(tmp_path, [{"center": [2, 1.5, 0], "normal": [-1, 0, 0], "up": [0, 1, 0], "width": 1, "height": 1}])
    turned = mi.ScalarTransform4f().rotate([0, 1, 0], 70)
    own = runs(room(integrator(f"headtail_{kind}", sampler=f"mis2:portals:{window}"), material, turned), 100)
    theirs = runs(room(integrator(kind), material, turned), 0)
    assert agree(own, theirs), f"{own.mean()} {theirs.mean()}"
    assert own.mean() > 0 and own.std(0).mean() < 0.7 * theirs.std(0).mean()


def test_auto_finds_the_portals_of_a_room(variant, tmp_path):
    """The window is found where it is, pictures are those of a file with it, and open scenes have none."""
    from headtail.mitsuba._rooms import portals_for_auto

    straight = mi.ScalarTransform4f()
    scene = room({"type": "headtail_path", "max_depth": 3}, "diffuse", straight)
    ((center, normal, _, size), *others), need_no_pilot = portals_for_auto(scene, scene.sensors()[0])
    assert not others and need_no_pilot and np.allclose(center, [2, 1.5, 0], atol=0.03) and np.allclose(normal, [-1, 0, 0], atol=1e-3)
    assert np.allclose(size, [1, 1], atol=0.06), size
    picture = np.array(mi.render(scene, spp=4, seed=1))
    assert scene.integrator().chosen == "mis2:portals"
    named = room({"type": "headtail_path", "max_depth": 3, "sampler": "mis2:portals"}, "diffuse", straight)
    assert np.array_equal(picture, np.array(mi.render(named, spp=4, seed=1)))
    outside = outdoors("diffuse", {"type": "headtail_direct", "sampler": "mis2:portals"})
    assert portals_for_auto(outside, outside.sensors()[0]) == (None, False)
    with pytest.raises(headtail.HeadtailError, match="portals are for rooms"):
        mi.render(outside, spp=1)


def test_faults_of_files_are_named(variant, tmp_path):
    none = tmp_path / "none.json"
    none.write_text('{"portals": []}')
    for name, words in (("missing.json", "missing.json"), (none, "portals")):
        scene = room({"type": "headtail_direct", "sampler": f"mis2:portals:{name}"}, "diffuse", mi.ScalarTransform4f())
        with pytest.raises((headtail.HeadtailError, OSError), match=words):
            mi.render(scene, spp=1)
