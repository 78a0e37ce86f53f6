"""Scenes with emitters beside the environment, media, AOVs and derivatives: the integrators agree with Mitsuba's own."""

import numpy as np
import pytest

mi = pytest.importorskip("mitsuba")
dr = pytest.importorskip("drjit")

from pictures import agree, integrator, runs, scene  # noqa: E402


def area(position, radiance, size=0.4):
    down = mi.ScalarTransform4f().translate(position).rotate([1, 0, 0], 90).scale(size)
    return {"type": "rectangle", "to_world": down, "emitter": {"type": "area", "radiance": {"type": "rgb", "value": radiance}}}


def lamps():
    """Three area lights, one of them favoured, a bulb in view, and two lights without area."""
    favoured = area([-2, 2, 1], [30, 20, 10])
    favoured["emitter"]["sampling_weight"] = 3
    return {
        "first": favoured,
        "second": area([2, 2.5, 0], [5, 10, 30]),
        "third": area([0, 0.6, 1.6], [8, 8, 8], 0.1),
        "bulb": {"type": "sphere", "center": [1, 1.6, 1], "radius": 0.2, "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 15}}},
        "point": {"type": "point", "position": [0, 3, 2], "intensity": {"type": "rgb", "value": 8}},
        "spot": {"type": "spot", "to_world": mi.ScalarTransform4f().look_at([3, 3, 3], [0, 0, 0], [0, 1, 0]), "intensity": {"type": "rgb", "value": 40}},
    }


@pytest.fixture
def colours(variant):
    if variant.endswith("_mono"):
        pytest.skip("the same code as for grey")


@pytest.mark.parametrize("kind", ["direct", "path"])
@pytest.mark.parametrize("material", ["diffuse", "glossy", "textured"])
def test_means_match_with_other_emitters(variant, material, kind):
    if variant.endswith("_mono") and (material, kind) != ("glossy", "path"):
        pytest.skip("of one channel, one scene is enough")
    own = runs(scene(material, integrator(f"headtail_{kind}"), **lamps()), 100)
    theirs = runs(scene(material, integrator(kind), **lamps()), 0)
    assert agree(own, theirs), f"{own.mean()} {theirs.mean()}"


@pytest.mark.parametrize("max_depth", [0, 1, 2, 3])
def test_each_depth_has_the_light_of_mitsubas_path(colours, max_depth):
    own, theirs = (runs(scene("diffuse", {"type": kind, "max_depth": max_depth}, **lamps()), 10) for kind in ("headtail_path", "path"))
    assert agree(own, theirs) or not (own.any() or theirs.any())


@pytest.mark.parametrize("kind", ["direct", "path"])
def test_hidden_emitters_are_passed_and_still_light(colours, kind):
    own = runs(scene("diffuse", integrator(f"headtail_{kind}", hide_emitters=True), **lamps()), 100)
    theirs = runs(scene("diffuse", integrator(kind, hide_emitters=True), **lamps()), 0)
    seen = runs(scene("diffuse", integrator(kind), **lamps()), 0)
    assert agree(own, theirs) and not agree(own, seen)


def test_lamps_without_area_and_mirrors_match(colours):
    point = {"point": lamps()["point"]}
    for material, more in (("glossy", point), ("plastic", {"bulb": lamps()["bulb"]})):
        own = runs(scene(material, integrator("headtail_path"), **more), 100)
        theirs = runs(scene(material, integrator("path"), **more), 0)
        # Mirrors of small lamps are seen by few samples, which a test of means does not fit.
        ratio = own.mean() / theirs.mean()
        assert agree(own, theirs) if material == "glossy" else abs(ratio - 1) < 0.04, f"{material} {ratio}"


def test_sampling_weights_can_change_and_vanish(colours):
    theirs = runs(scene("diffuse", integrator("path"), bulb=lamps()["bulb"], first=lamps()["first"]), 0)
    own = scene("diffuse", integrator("headtail_path"), bulb=lamps()["bulb"], first=lamps()["first"])
    mi.render(own, spp=1)
    parameters = mi.traverse(own)
    keys = [key for key in parameters.keys() if key.endswith("emitter.sampling_weight")]
    assert len(keys) == 2
    for weights in ((0.2, 2.0), (0.0, 0.0)):
        for key, weight in zip(keys, weights):
            parameters[key] = weight
        parameters.update()
        again = runs(own, 100)
        # By the BSDF alone, lamps are noisy.
        assert agree(again, theirs) if any(weights) else abs(again.mean() / theirs.mean() - 1) < 0.02


def test_a_missing_lamp_is_detected(colours):
    own = runs(scene("diffuse", integrator("headtail_direct"), **{**lamps(), "first": lamps()["third"]}), 100)
    assert not agree(own, runs(scene("diffuse", integrator("direct"), **lamps()), 0))


def test_several_samples_per_hit_have_the_mean_and_less_noise(colours):
    one, four, theirs = (
        runs(scene("glossy", {"type": kind, "shading_samples": samples}, **lamps()), 10)
        # Mitsuba's `direct` counts a light without area once for each sample, so it takes one.
        for kind, samples in (("headtail_direct", 1), ("headtail_direct", 4), ("direct", 1))
    )
    assert agree(four, theirs)
    # A quarter of the variance of light; the noise of edges within a pixel stays.
    tiles = one.var(0) > 1e-9
    assert np.median(four.var(0)[tiles] / one.var(0)[tiles]) < 0.6


def test_media_are_rendered_by_volpath(colours, capfd):
    medium = {"type": "homogeneous", "albedo": 0.8, "sigma_t": 0.6}
    fog = {"fog": {"type": "cube", "to_world": mi.ScalarTransform4f().translate([0, 1, 0]), "bsdf": {"type": "null"}, "interior": medium}}
    mi.render(scene("diffuse", integrator("headtail_path")), spp=1)
    assert "volpath" not in "".join(capfd.readouterr())
    own = runs(scene("diffuse", integrator("headtail_path"), **fog), 100)
    assert "rendered by Mitsuba's volpath" in "".join(capfd.readouterr())
    assert agree(own, runs(scene("diffuse", integrator("volpath", max_depth=4), **fog), 0))


def test_aovs_are_made_around_the_integrators(colours):
    layers = {"type": "aov", "aovs": "depth:depth,normal:sh_normal"}
    own, theirs = (np.array(mi.render(scene("diffuse", {**layers, "image": integrator(kind)}), spp=16)) for kind in ("headtail_path", "path"))
    assert own.shape == theirs.shape
    np.testing.assert_allclose(own[..., -4:], theirs[..., -4:], rtol=1e-3, atol=1e-3)
    assert np.isfinite(own).all() and own[..., 0].mean() == pytest.approx(theirs[..., 0].mean(), rel=0.03)


SEEDS = 6
# By name: the material, the end of the parameter's key, and integrators with the mode of derivatives.
DERIVATIVES = [
    ("diffuse", "reflectance.value", "direct", "backward"),
    ("diffuse", "reflectance.value", "path", "backward"),
    ("glossy", "alpha.value", "direct", "forward"),
    ("diffuse", "map.scale", "direct", "backward"),
]


def signs(material, end):
    """Returns 1 where a picture by Mitsuba's `direct` grows with a parameter and -1 where it falls, so that derivatives add up:
    by a width, those of all pixels nearly cancel."""
    own = scene(material, integrator("direct"), **lamps())
    parameters = mi.traverse(own)
    key = next(key for key in parameters.keys() if key.endswith(end))
    value = type(parameters[key])(parameters[key])
    pictures = []
    for factor in (0.8, 1.25):
        parameters[key] = value * factor
        parameters.update()
        pictures.append(mi.TensorXf(mi.render(own, spp=256, seed=1000)))
    return dr.select(pictures[1] > pictures[0], 1, -1)


def derivatives(own, end, mode, weights):
    """Returns derivatives of a picture's weighted mean by a parameter, [SEEDS]."""
    parameters = mi.traverse(own)
    key = next(key for key in parameters.keys() if key.endswith(end))
    value = type(parameters[key])(parameters[key])
    values = []
    for seed in range(SEEDS):
        step = mi.Float(1)
        dr.enable_grad(step)
        parameters[key] = value * step
        parameters.update()
        # Numbers that Dr.Jit does not know are no reason to compile a kernel again.
        seeds = {"seed": dr.opaque(mi.UInt32, seed), "seed_grad": dr.opaque(mi.UInt32, 100 + seed)}
        mean = dr.mean(mi.render(own, parameters, spp=64, **seeds) * weights, axis=None)
        if mode == "backward":
            dr.backward(mean)
            values.append(dr.grad(step).numpy()[0])
        else:
            dr.forward(step)
            values.append(np.array(dr.grad(mean)).ravel()[0])
    return np.array(values)


@pytest.mark.parametrize(("material", "end", "kind", "mode"), DERIVATIVES)
def test_derivatives_match_mitsubas_own(colours, material, end, kind, mode):
    weights = signs(material, end)
    own = derivatives(scene(material, integrator(f"headtail_{kind}"), **lamps()), end, mode, weights)
    # Of Mitsuba's own, `path` has forward mode alone and the least noise: `direct` differentiates drawn directions too.
    depth = {"direct": 2, "path": 4}[kind]
    theirs = derivatives(scene(material, integrator("path", max_depth=depth), **lamps()), end, "forward", weights)
    noise = np.hypot(own.std(ddof=1), theirs.std(ddof=1)) / np.sqrt(SEEDS)
    # Student's t with 10 degrees of freedom exceeds 5 once in 2000 comparisons; there are 4.
    assert abs(own.mean() - theirs.mean()) < 5 * noise, f"{own} {theirs}"
    assert abs(theirs.mean()) > 5 * noise, f"the noise hides the derivative: {own} {theirs}"


@pytest.mark.parametrize("kind", ["headtail_direct", "headtail_path"])
def test_derivatives_by_a_shape_are_those_of_differences(colours, kind):
    # A slab that fills the view, so that nothing is hidden: edges have no derivatives.
    slab = {"type": "cube", "face_normals": True, "to_world": mi.ScalarTransform4f().scale([20, 0.1, 20]), "bsdf": {"type": "diffuse"}}
    nowhere = {"type": "sphere", "center": [0, -50, 0], "radius": 0.1}
    sensor = {
        "type": "perspective",
        "to_world": mi.ScalarTransform4f().look_at([0, 4, 1], [0, 0, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 16, "height": 12, "rfilter": {"type": "box"}},
    }
    more = {name: lamps()[name] for name in ("first", "point")}
    own = scene("diffuse", integrator(kind), floor=slab, ball=nowhere, box=nowhere, sensor=sensor, **more)
    parameters = mi.traverse(own)
    key = next(key for key in parameters.keys() if key.endswith("vertex_positions"))
    points = dr.unravel(mi.Point3f, mi.Float(parameters[key]))

    def mean(tilt):
        parameters[key] = dr.ravel(mi.Point3f(points.x, points.y + tilt * points.x, points.z))
        parameters.update()
        return dr.mean(mi.render(own, parameters, spp=1024, seed=1, seed_grad=2), axis=None)

    tilt = mi.Float(0)
    dr.enable_grad(tilt)
    dr.backward(mean(tilt))
    difference = (np.array(mean(mi.Float(0.1))) - np.array(mean(mi.Float(-0.1)))).ravel()[0] / 0.2
    assert dr.grad(tilt).numpy()[0] == pytest.approx(difference, rel=0.05)
