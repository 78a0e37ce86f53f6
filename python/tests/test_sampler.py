"""Samplers over batches: their samples, and their input and output arrays."""

import pathlib
import threading
import time

import numpy as np
import pytest
from conftest import directions, uniform

import headtail
from headtail import HeadtailError, Sampler


@pytest.mark.parametrize("spec", ["patches", "mis", "emitter"])
def test_estimates_are_those_of_a_sum_over_the_map(studio, spec):
    """Reflected light of a white diffuse and a glossy surface: estimates match a sum over all texels."""
    sampler = Sampler.from_spec(spec, studio)
    n = np.array([0.3, 0.9, -0.3], np.float32)
    n /= np.linalg.norm(n)
    draws = sampler.sample(n, count=200_000, seed=3)
    lit = draws.pdf > 0
    values = np.zeros((len(lit), 3))
    values[lit] = draws.radiance[lit] * (np.maximum(draws.wi[lit] @ n, 0) / np.pi / draws.pdf[lit])[:, None]
    # The bilinear map by the midpoint rule, 4 x 4 points per texel.
    rows, columns = (4 * side for side in studio.shape)
    theta, phi = np.meshgrid((np.arange(rows) + 0.5) * np.pi / rows, (np.arange(columns) + 0.5) * 2 * np.pi / columns, indexing="ij")
    wi = np.stack([np.sin(phi) * np.sin(theta), np.cos(theta), -np.cos(phi) * np.sin(theta)], -1).reshape(-1, 3).astype(np.float32)
    weight = np.sin(theta).ravel() * (np.pi / rows) * (2 * np.pi / columns) * np.maximum(wi @ n, 0) / np.pi
    expected = (studio.radiance(wi) * weight[:, None]).sum(0)
    deviation = values.std(0) / np.sqrt(len(values))
    # Five standard errors, and 0.5 % for the midpoint rule at the edges of lamps.
    assert np.all(np.abs(values.mean(0) - expected) < 5 * deviation + 5e-3 * expected)


@pytest.mark.parametrize("surface", [{}, {"alpha": 0.3}, {"alpha": 0.1, "f0": 0.5}])
def test_the_pdf_of_a_draw_is_that_of_its_direction(patches, surface):
    n, u = directions(5000, 1), uniform(5000, 2)
    draws = patches.sample(n, u=u, **surface)
    drawn = draws.pdf > 0
    again = patches.pdf(draws.wi[drawn], n[drawn], **surface)
    # Directions are rounded to 32 bits, which moves some across the border of a patch.
    assert np.quantile(np.abs(again / draws.pdf[drawn] - 1), 0.999) < 1e-2


@pytest.mark.parametrize("surface", [{}, {"alpha": 0.2}, {"roughness": 0.4, "metallic": 0.5, "base_color": [0.9, 0.5, 0.1]}])
def test_prepared_points_give_the_same_draws(patches, surface):
    n, u = directions(3000, 1), uniform(3000, 2)
    prepared = patches.prepare(n, **surface)
    assert len(prepared) == 3000
    once, again = patches.sample(n, u=u, **surface), prepared.sample(u)
    assert all(np.array_equal(a, b) for a, b in zip(once, again))
    wi = directions(3000, 4)
    assert np.array_equal(patches.pdf(wi, n, **surface), prepared.pdf(wi))
    assert np.array_equal(patches.sample(n, seed=5, **surface).wi, prepared.sample(seed=5).wi)
    with pytest.raises(HeadtailError, match="wi: has 10 rows; 3000"):
        prepared.pdf(wi[:10])
    with pytest.raises(TypeError, match="use Sampler.prepare"):
        headtail.PreparedPoints(patches)


CHECKPOINTS = pathlib.Path(__file__).parents[2] / "checkpoints"


def test_neural_materials_are_sampled_and_evaluated(studio):
    """BRDF samples estimate the albedo that a sum over directions has, and lie where `tangent` says."""
    satin = headtail.Material(f"neural:{CHECKPOINTS / 'satin.safetensors'}")
    assert "satin" in repr(satin)
    n, wo = np.array([0, 1, 0], np.float32), np.array([0.6, 0.8, 0], np.float32)
    surface = {"material": satin, "uv": [0.3, 0.7], "tangent": [0, 0, 2, 1], "footprint": 0.02}
    draws = Sampler.from_spec("brdf", studio).sample(n, wo, count=100_000, seed=1, **surface)
    drawn = draws.pdf > 0
    values = headtail.brdf_cosine(np.where(drawn[:, None], draws.wi, n), n, wo, **surface)
    weights = np.where(drawn, values[:, 1] / np.where(drawn, draws.pdf, 1), 0)
    even = directions(200_000, 3)
    spread = 4 * np.pi * headtail.brdf_cosine(even, n, wo, **surface)[:, 1]
    error = np.hypot(weights.std() / np.sqrt(len(weights)), spread.std() / np.sqrt(len(spread)))
    assert weights.mean() > 0.01 and abs(weights.mean() - spread.mean()) < 5 * error
    turned = {**surface, "tangent": [1, 0, 0, 1]}
    assert not np.allclose(headtail.brdf_cosine(even, n, wo, **turned), headtail.brdf_cosine(even, n, wo, **surface), rtol=0.1)
    with pytest.raises(HeadtailError, match="tangent: has 0 rows"):
        headtail.brdf_cosine(even, n, wo, material=satin, uv=[0, 0])
    with pytest.raises(HeadtailError, match="uv: is of surfaces that have material"):
        headtail.brdf_cosine(even, n, wo, uv=[0, 0])
    with pytest.raises(HeadtailError, match="alpha and material: are of different"):
        headtail.brdf_cosine(even, n, wo, alpha=0.3, material=satin)
    with pytest.raises(HeadtailError, match="wo: is needed"):
        headtail.brdf_cosine(even, n, alpha=0.3)
    with pytest.raises(TypeError, match="neural:FILE"):
        headtail.brdf_cosine(even, n, wo, material="satin")
    with pytest.raises(HeadtailError, match="neither nbrdf"):
        headtail.Material("satin")


def test_samplers_with_positions_ask_for_them(studio, tmp_path):
    window = tmp_path / "window.json"
    window.write_text('{"portals": [{"center": [2, 1.5, 0], "normal": [-1, 0, 0], "up": [0, 1, 0], "width": 1.5, "height": 1}]}')
    sampler = Sampler.from_spec(f"portals+mis:{window}", studio)
    n = np.array([[0, 1, 0]], np.float32)
    with pytest.raises(HeadtailError, match="p: .* depends on positions"):
        sampler.sample(n)
    wi = np.array([[0.9, 0.436, 0]], np.float32)
    near, far = (sampler.pdf(wi, n, p=[[x, 1, 0]])[0] for x in (1.5, -2))
    assert near != far


def test_results_are_written_to_out(patches):
    n = directions(1000, 1)
    expected = patches.sample(n, seed=5)
    out = np.full((1000, 3), np.nan, np.float32), np.full(1000, np.nan, np.float32), None
    draws = patches.sample(n, seed=5, radiance=False, out=out)
    assert draws.wi is out[0] and draws.pdf is out[1] and draws.radiance is None
    assert np.array_equal(draws.wi, expected.wi) and np.array_equal(draws.pdf, expected.pdf)


class Foreign:
    """An array of another library that supports DLPack only."""

    def __init__(self, array):
        self.array = array

    def __dlpack__(self, **settings):
        return self.array.__dlpack__(**settings)

    def __dlpack_device__(self):
        return self.array.__dlpack_device__()


def test_arrays_of_other_libraries_are_taken_without_a_copy(patches):
    n, pdf = directions(100, 1), np.zeros(100, np.float32)
    draws = patches.sample(Foreign(n), seed=1, out=(None, Foreign(pdf), None))
    assert np.shares_memory(draws.pdf, pdf) and np.array_equal(pdf, patches.sample(n, seed=1).pdf)
    assert np.shares_memory(np.from_dlpack(draws.wi), draws.wi)


def test_torchs_tensors_are_taken_without_a_copy(patches):
    torch = pytest.importorskip("torch")
    n, pdf = torch.from_numpy(directions(100, 1)), torch.zeros(100)
    drawn = patches.sample(n, seed=1, out=(None, pdf, None))
    assert np.shares_memory(drawn.pdf, pdf.numpy()) and pdf.min() >= 0 and pdf.max() > 0
    assert torch.from_dlpack(drawn.wi).data_ptr() == drawn.wi.ctypes.data


def test_threads_draw_side_by_side(patches):
    n = directions(20_000, 1)
    expected = [patches.sample(n, seed=seed).wi for seed in range(4)]
    results = [None] * 4

    def draw(seed):
        results[seed] = patches.sample(n, seed=seed).wi

    threads = [threading.Thread(target=draw, args=(seed,)) for seed in range(4)]
    [thread.start() for thread in threads]
    [thread.join() for thread in threads]
    assert all(np.array_equal(a, b) for a, b in zip(results, expected))


def test_other_threads_go_on_while_one_draws(patches):
    """Sampling releases the interpreter lock; holding it would stop all other threads."""
    n, is_over, beats = directions(1, 1), threading.Event(), []

    def beat():
        while not is_over.wait(1e-3):
            beats.append(time.perf_counter())

    thread = threading.Thread(target=beat)
    thread.start()
    start = time.perf_counter()
    patches.sample(n, count=3_000_000, radiance=False)
    end = time.perf_counter()
    is_over.set()
    thread.join()
    # A thread that waited for the lock would run at the end; at the beginning it may run before the lock is
    # taken.
    tenth = (end - start) / 10
    assert sum(start + tenth < now < end - tenth for now in beats) > 2


def test_opened_files_sample_like_the_written_sampler(table, studio, tmp_path):
    table.save(tmp_path / "table.safetensors")
    n, u = directions(1000, 1), uniform(1000, 2)
    expected = table.sample(n, u=u)
    opened = Sampler.open(tmp_path / "table.safetensors", studio)
    assert opened.info["intermediate"]["kind"] == "direct-bake"
    assert np.array_equal(opened.sample(n, u=u).wi, expected.wi)
    # Without the map there is no radiance, but the same directions.
    alone = Sampler.open(tmp_path / "table.safetensors").sample(n, u=u)
    assert alone.radiance is None
    assert np.allclose(alone.wi, expected.wi, atol=1e-4) and np.allclose(alone.pdf, expected.pdf, rtol=1e-3)
    with pytest.raises(HeadtailError, match="was made for the environment 'studio', not for 'window'"):
        Sampler.open(tmp_path / "table.safetensors", "window")


def test_invalid_arguments_raise_with_a_message(patches, studio, tmp_path):
    n = directions(10, 1)
    for call, words in [
        (lambda: patches.sample(n[:, :2]), "n: has the shape"),
        (lambda: patches.sample(n * 2), "n: row 0 is .* not of unit length"),
        (lambda: patches.sample(n * np.nan), "not of unit length"),
        (lambda: patches.sample(n, wo=n[:4]), "wo: has 4 rows; 10, or 1 for all"),
        (lambda: patches.sample(n, alpha=0), "alpha: row 0 is 0"),
        (lambda: patches.sample(n, f0=0.5), "f0: is of surfaces that have alpha"),
        (lambda: patches.sample(n, metallic=0.5), "metallic: is of surfaces that have roughness"),
        (lambda: patches.sample(n, alpha=0.5, roughness=0.5), "alpha and roughness: are of different surfaces"),
        (lambda: patches.sample(n, roughness=2), "roughness: row 0 is 2"),
        (lambda: patches.sample(n, p=n[:4]), "p: has 4 rows"),
        (lambda: patches.sample(n, p=n * np.inf), "p: row 0 is .* not finite"),
        (lambda: patches.sample(n, u=np.ones((10, 2))), "u: row 0"),
        (lambda: patches.sample(n, u=np.zeros((10, 2), complex)), "u: holds complex128"),
        (lambda: patches.sample(["a"] * 3), "n: holds"),
        (lambda: patches.sample(n, count=-1), "count: -1"),
        (lambda: patches.sample(n, count=7), "n: has 10 rows"),
        (lambda: patches.sample(n, seed=-1), "seed: -1"),
        (lambda: patches.sample(n, out=(np.zeros((10, 3)), None, None)), "out: wi must be a writable"),
        (lambda: patches.pdf(n * 0, n), "wi: row 0"),
        (lambda: Sampler.from_spec("nonsense", studio), "is not one of auto"),
        (lambda: Sampler.from_spec("ris:4", studio).sample(n), "has no pdf of its own"),
        (lambda: patches.save(tmp_path / "x"), "bake or fit one"),
        (lambda: headtail.Environment.from_array(np.zeros((4, 8, 3))), "black"),
        (lambda: headtail.Environment.from_array(np.zeros((4, 8))), "texels: has the shape"),
    ]:
        with pytest.raises(HeadtailError, match=words):
            call()
    with pytest.raises(OSError, match="No such file"):
        Sampler.open(tmp_path / "missing")
    with pytest.raises(TypeError, match="use Sampler.from_spec"):
        Sampler("patches")


def test_hostile_arguments_raise_and_never_crash(patches):
    """Arrays of any shape, type, layout and value: an exception of the right kind, or finite results."""
    random = np.random.default_rng(9)
    good = {"n": directions(6, 1), "wo": directions(6, 2), "alpha": np.float32(0.3), "u": uniform(6, 3)}
    shapes = [(), (0,), (1,), (3,), (6,), (6, 3), (3, 6), (0, 3), (6, 2), (1, 3), (6, 3, 1), (7, 3)]
    values = [np.nan, np.inf, -np.inf, 0.0, 1.0, -1.0, 1e38, 1e-40]
    raised = 0
    for _ in range(3000):
        arguments = dict(good)
        name = random.choice(list(arguments) + ["f0", "out"])
        array = random.choice(values) * np.ones(shapes[random.integers(len(shapes))])
        kind = random.integers(5)
        if kind == 1:
            with np.errstate(all="ignore"):
                array = array.astype(random.choice(["f4", "f4", "f4", "f2", "O", "U3", "c8", "?", "i4"]))
        elif kind == 2:
            array = np.asfortranarray(array.astype("f4"))
        elif kind == 3:
            array = None if name != "n" else "n"
        elif kind == 4:
            array = good["n"].copy()
            array[random.integers(6), random.integers(3)] = random.choice(values)
        arguments[name] = array if name != "out" else (array, None, None)
        try:
            draws = patches.sample(**arguments)
        except (HeadtailError, TypeError, ValueError):
            raised += 1
        else:
            assert np.isfinite(draws.wi).all() and np.isfinite(draws.pdf).all() and (draws.pdf >= 0).all()
    assert raised > 1000
