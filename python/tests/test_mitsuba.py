"""The integrators in Mitsuba 3: their means equal those of Mitsuba's own, and invalid inputs are rejected."""

import functools

import numpy as np
import pytest

mi = pytest.importorskip("mitsuba")
dr = pytest.importorskip("drjit")

from conftest import directions  # noqa: E402
from pictures import agree, integrator, runs, scene  # noqa: E402

import headtail  # noqa: E402


@functools.cache
def runs_of_mitsuba(variant, material, kind):
    """Returns `runs` of Mitsuba's own integrator, rendered once in a variant for all samplers."""
    return runs(scene(material, integrator(kind)), 0)


@pytest.mark.parametrize("kind", ["direct", "path"])
@pytest.mark.parametrize("sampler", ["table", "patches", "mis2-comp"])
@pytest.mark.parametrize("material", ["diffuse", "glossy", "textured", "bumped"])
def test_means_match_mitsubas_own_integrators(variant, material, sampler, kind):
    if is_grey(variant) and (sampler, kind) != ("table" if material == "diffuse" else "patches", "path"):
        pytest.skip("of one channel, a scene for each material is enough")
    own = runs(scene(material, integrator(f"headtail_{kind}", sampler=sampler)), 100)
    theirs = runs_of_mitsuba(variant, material, kind)
    assert agree(own, theirs), f"{own.mean()} {theirs.mean()}"


@pytest.mark.parametrize(
    "material, kind, head",
    [
        ("diffuse", "direct", "lambert"),
        ("diffuse", "path", "lambert"),
        ("bumped", "direct", "lambert"),
        ("glossy", "direct", "of one width"),
        ("glossy", "path", "of any width"),
        ("textured", "direct", "of any width"),
        ("textured", "path", "of one width"),
        ("diffuse", "direct", "over rows and columns"),
        ("glossy", "direct", "over a flow"),
        ("bumped", "path", "over patches"),
        ("glossy", "direct", "over fine patches"),
    ],
)
def test_means_with_a_head_match_mitsubas_own_integrators(variant, heads, material, kind, head):
    if is_grey(variant):
        pytest.skip("maps are grey there, and files of a map in colour refused")
    own = runs(scene(material, integrator(f"headtail_{kind}", file=heads[head])), 100)
    theirs = runs_of_mitsuba(variant, material, kind)
    assert agree(own, theirs), f"{own.mean()} {theirs.mean()}"


def is_grey(variant):
    return variant.endswith("_mono")


def test_six_per_cent_more_light_is_detected(variant):
    """The test above detects 6 % more light."""
    own = runs(scene("diffuse", {"type": "headtail_direct"}), 100)
    assert not agree(1.06 * own, runs_of_mitsuba(variant, "diffuse", "direct"))


def test_delta_lobes_reflect_correctly(variant):
    own, theirs = (np.array(mi.render(scene("plastic", {"type": kind}), spp=512)).mean() for kind in ("headtail_direct", "direct"))
    # Mirrors of small lamps: pictures of different seeds differ by 2 %.
    assert abs(own / theirs - 1) < 0.04


def test_the_sampler_follows_the_map(variant):
    own = scene("diffuse", {"type": "headtail_direct"})
    before = np.array(mi.render(own, spp=64)).mean()
    parameters = mi.traverse(own)
    parameters["map.scale"] = 2 * parameters["map.scale"]
    parameters.update()
    assert np.array(mi.render(own, spp=64)).mean() == pytest.approx(2 * before, rel=0.02)


def test_auto_chooses_by_a_pilot(variant):
    """Patches where small lamps are the light, pairs under a sky that is nearly uniform; the picture is that of the chosen sampler."""
    sky = np.broadcast_to(np.linspace(1.5, 0.5, 32, dtype=np.float32)[:, None, None], (32, 64, 3))
    found = {}
    for name, kind, more in (("lamps", "direct", {}), ("sky", "path", {"map": {"type": "envmap", "bitmap": mi.Bitmap(sky.copy())}})):
        own = scene("glossy", integrator(f"headtail_{kind}"), **more)
        picture = np.array(mi.render(own, spp=16, seed=3))
        found[name] = own.integrator().chosen
        same = scene("glossy", integrator(f"headtail_{kind}", sampler=found[name]), **more)
        np.testing.assert_array_equal(picture, np.array(mi.render(same, spp=16, seed=3)))
    assert found == {"lamps": "patches", "sky": "mis2-comp"}


def lamp(column, width=64):
    """A dim map with one lamp."""
    texels = np.full((32, width, 3), 0.05, np.float32)
    texels[10, column] = 100
    return texels


def padded(texels):
    """Pads texels like Mitsuba 3.9."""
    return mi.TensorXf(np.concatenate([texels[:, -1:], texels, texels[:, :1]], 1))


@pytest.mark.parametrize("width", [64, 48])
def test_the_sampler_follows_texels_that_are_replaced(variant, width):
    if is_grey(variant):
        pytest.skip("its maps have one channel")
    first, second = {"map": {"type": "envmap", "bitmap": mi.Bitmap(lamp(10))}}, lamp(width * 5 // 8, width)
    changed = scene("diffuse", {"type": "headtail_direct", "sampler": "patches"}, **first)
    mi.render(changed, spp=1)
    parameters = mi.traverse(changed)
    parameters["map.data"] = padded(second)
    parameters.update()
    new = scene("diffuse", {"type": "headtail_direct", "sampler": "patches"}, map={"type": "envmap", "bitmap": mi.Bitmap(second)})
    # The same sampler of the same map gives the same picture.
    pictures = [np.array(mi.render(each, spp=16, seed=3)) for each in (changed, new)]
    np.testing.assert_allclose(*pictures, rtol=1e-4, atol=1e-5)


def test_unknown_texel_columns_are_rejected():
    from headtail.mitsuba._light import unpadded

    texels = np.random.default_rng(1).random((4, 8, 3), np.float32)
    np.testing.assert_array_equal(unpadded(np.array(padded(texels))), texels)
    for data in (texels, np.concatenate([texels, texels[:, :1]], 1), texels[:, :3]):
        with pytest.raises(headtail.HeadtailError, match="do not repeat"):
            unpadded(data)


def test_black_maps_give_black_pictures(variant):
    black = {"map": {"type": "envmap", "bitmap": mi.Bitmap(np.zeros((4, 8, 3), np.float32))}}
    for kind in ("headtail_direct", "headtail_path"):
        assert not np.array(mi.render(scene("glossy", {"type": kind}, **black), spp=1)).any()


def test_unsupported_scenes_are_rejected(variant, tmp_path):
    unlit = {"map": {"type": "point", "position": [0, 5, 0]}}
    stretch = mi.ScalarTransform4f().scale([1, 2, 1])
    stretched = {"map": {"type": "envmap", "bitmap": mi.Bitmap(np.ones((4, 8, 3), np.float32)), "to_world": stretch}}
    headtail.bake("window").save(tmp_path / "window.safetensors")
    for integrator, more, words in [
        ({"type": "headtail_direct", "sampler": "magic"}, {}, "is not one of auto, table, patches"),
        ({"type": "headtail_path", "max_depth": -3}, {}, "max_depth must be"),
        ({"type": "headtail_direct"}, unlit, "has no environment map"),
        ({"type": "headtail_direct", "shading_samples": 0}, {}, "is not between 1 and 64"),
        ({"type": "headtail_direct", "file": str(tmp_path / "window.safetensors")}, {}, "made for the environment 'window'"),
        ({"type": "headtail_direct", "file": str(tmp_path / "none")}, {}, "No such file"),
        ({"type": "headtail_direct"}, stretched, "is not a rotation"),
    ]:
        with pytest.raises(Exception) as raised:
            mi.render(scene("diffuse", integrator, **more), spp=1)
        chain, error = [], raised.value
        while error is not None:
            chain.append(str(error))
            error = error.__cause__
        assert words in " ".join(chain)


@pytest.mark.parametrize("sampler", ["table", "patches"])
def test_a_picture_is_one_kernel(variant, sampler):
    """Sampling and pdfs are part of the rendering kernel: there are no kernels that Mitsuba's own integrator
    lacks."""
    counts = []
    for integrator in ({"type": "headtail_direct", "sampler": sampler}, {"type": "direct"}):
        own = scene("glossy", integrator)
        mi.render(own, spp=4).numpy()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            mi.render(own, spp=4, seed=1).numpy()
            counts.append(len(dr.kernel_history([dr.KernelType.JIT])))
    assert counts[0] == counts[1] > 0


def test_drjits_arrays_are_taken_without_a_copy(variant, patches):
    n = directions(100, 1)
    on_device, pdf = mi.TensorXf(n), mi.TensorXf(np.zeros(100, np.float32))
    dr.eval(on_device, pdf)
    drawn = patches.sample(on_device, seed=1, out=(None, pdf, None))
    expected = patches.sample(n, seed=1)
    assert np.array_equal(drawn.wi, expected.wi) and np.array_equal(pdf.numpy(), expected.pdf)
    assert np.shares_memory(headtail._arrays.rows(on_device, "n", 3), on_device.numpy())


def test_a_file_of_the_scenes_map_is_used(variant, tmp_path):
    map = headtail.Environment("studio").array()
    headtail.bake(map).save(tmp_path / "table.safetensors")
    own = scene("diffuse", {"type": "headtail_direct", "file": str(tmp_path / "table.safetensors")})
    if is_grey(variant):
        with pytest.raises(headtail.HeadtailError, match="texels differ"):
            mi.render(own, spp=4)
    else:
        assert np.isfinite(np.array(mi.render(own, spp=4))).all()


def test_scalar_variants_are_rejected():
    mi.set_variant("scalar_rgb")
    import headtail.mitsuba  # noqa: F401

    with pytest.raises(Exception, match="scalar_rgb has no arrays|failed to instantiate") as raised:
        mi.load_dict({"type": "headtail_direct"})
    text = f"{raised.value} {raised.value.__cause__}"
    assert "has no arrays" in text


def test_an_llvm_that_dr_jit_cannot_use_is_named(variant, monkeypatch):
    import types

    module = headtail.mitsuba
    for version, llvm, fault in (("1.5.0", (15, 0, 6), "LLVM 16"), ("1.5.0", (19, 1, 7), None), ("1.4.0", (15, 0, 6), None), ("1.5.0", (0, 0, 0), None)):
        detail = types.SimpleNamespace(llvm_version=lambda llvm=llvm: llvm)
        monkeypatch.setattr(module, "dr", types.SimpleNamespace(__version__=version, detail=detail))
        found = module._fault_of("llvm_ad_rgb")
        assert found is None if fault is None else fault in found
    assert "scalar_rgb" in module._fault_of("scalar_rgb")
