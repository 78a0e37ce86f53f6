"""Pictures, comparisons and training."""

import json
import os
import signal
import subprocess
import threading
import time

import numpy as np
import pytest

import headtail

SIZE = {"width": 32, "height": 24}


def test_pictures_of_different_samplers_have_the_same_mean(studio):
    scene = headtail.Scene("sphere")
    pictures = [headtail.render(scene, spec, studio, spp=256, **SIZE) for spec in ("patches", "mis", "ris:4")]
    means = [picture.image[picture.coverage == 1].mean() for picture in pictures]
    # 256 samples in about 200 pixels of relative variance below 10: 0.5 %.
    assert np.ptp(means) < 0.03 * means[0]
    assert pictures[0].image.shape == (24, 32, 3) and pictures[0].spp == 256


def test_better_samplers_have_smaller_errors(studio):
    rows, reference = headtail.compare("sphere", studio, ["patches", "mis"], spp=(1, 4), runs=2, reference_spp=256, **SIZE)
    assert rows.shape == (8,) and set(rows["sampler"]) == {"patches", "mis"} and set(rows["budget"]) == {"1spp", "4spp"}
    mse = {name: rows["mse"][(rows["sampler"] == name) & (rows["spp"] == 4)].mean() for name in ("patches", "mis")}
    assert mse["patches"] < mse["mis"]
    # More samples are taken while its noise is too large.
    assert 256 <= reference.spp <= 1024 and 0 < reference.mse < mse["patches"]
    assert reference.image.shape == (24, 32, 3) and 0 < reference.covered.sum() < 24 * 32


def test_references_can_be_given(studio, table):
    settings = {"spp": (4,), "runs": 2, **SIZE}
    rows, reference = headtail.compare("sphere", studio, ["mis", table], reference_spp=64, **settings)
    again, same = headtail.compare("sphere", studio, ["mis", table], reference=reference, **settings)
    for name in ("mse", "relmse", "relmse_trimmed", "reference_mse", "tile_p"):
        # Tiles are tested from 64 samples per pixel on; below, their probability is NaN.
        assert np.array_equal(rows[name], again[name], equal_nan=True), name
    assert same.spp == 0 and (same.image == reference.image).all()
    picture, _ = headtail.compare("sphere", studio, ["mis"], reference=reference.image, **settings)
    assert np.isnan(picture["reference_mse"]).all() and (picture["mse"] > rows["mse"][rows["sampler"] == "mis"]).all()
    with pytest.raises(headtail.HeadtailError, match="reference"):
        headtail.compare("sphere", studio, ["mis"], reference=reference, width=8, height=6)


def test_budgets_of_time_are_met(studio):
    rows, _ = headtail.compare("sphere", studio, ["mis"], spp=(), seconds=(0.02,), runs=2, reference_spp=16, **SIZE)
    assert list(rows["budget"]) == ["0.02s"] * 2 and (rows["spp"] >= 1).all() and (rows["preparation"] > 0).all()


def test_numbers_are_those_of_the_command_line(studio, program, tmp_path):
    view = "--scene sphere --env studio --width 32 --height 24"
    arguments = f"compare {view} --samplers patches,mis --spp 1,4 --runs 2 --seed 1 --reference-spp 64 --json --out".split()
    run = subprocess.run([program, *arguments, tmp_path / "out"], check=True, stdout=subprocess.PIPE)
    expected = json.loads(run.stdout)
    rows, _ = headtail.compare("sphere", studio, ["patches", "mis"], spp=(1, 4), runs=2, seed=1, reference_spp=64, **SIZE)
    assert len(rows) == len(expected) == 8
    for row, other in zip(rows, expected):
        for name in ("sampler", "budget", "run", "seed", "mse", "relmse", "mean_luminance", "max_weight"):
            assert row[name] == other[name], name


def test_precomputed_visibility_is_used_in_its_scene(studio, program, tmp_path):
    file = tmp_path / "visibility.safetensors"
    bake = "bake --visibility --scene sphere --env studio --width 32 --height 24 --spp 16 --out".split()
    subprocess.run([program, *bake, file], check=True)
    spec = f"patches+vis:{file}"
    picture = headtail.render("sphere", spec, studio, spp=4, **SIZE)
    same = headtail.render("sphere", headtail.Sampler.from_spec(spec, studio), spp=4, **SIZE)
    assert (picture.image == same.image).all()
    rows, _ = headtail.compare("sphere", studio, [spec], spp=(4,), runs=1, reference_spp=16, **SIZE)
    assert list(rows["sampler"]) == [spec]
    with pytest.raises(headtail.HeadtailError, match="scene"):
        headtail.render("plane", spec, studio, spp=4, **SIZE)


def test_a_callback_sees_progress_and_can_end_a_rendering(studio):
    seen = []
    headtail.render("sphere", "mis", studio, spp=64, progress=seen.append, **SIZE)
    assert len(seen) == 4 and seen[-1] == 1.0

    def stop(fraction):
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        headtail.render("sphere", "mis", studio, spp=1 << 20, progress=stop, **SIZE)


@pytest.mark.parametrize(
    "work",
    [
        lambda env: headtail.render("sphere", "mis", env, seconds=100, **SIZE),
        lambda env: headtail.compare("sphere", env, ["mis"], reference_spp=1 << 21, **SIZE),
        lambda env: headtail.compare("sphere", env, ["mis"], runs=1 << 16, reference_spp=16, **SIZE),
    ],
)
def test_ctrl_c_ends_work(studio, work):
    # Python keeps SIGINT ignored if it was at start, as in a background job.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()
        start = time.monotonic()
        with pytest.raises(KeyboardInterrupt):
            work(studio)
        assert time.monotonic() - start < 30
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_callback_sees_the_progress_of_a_comparison_and_can_end_it(studio):
    seen = []
    headtail.compare("sphere", studio, ["mis"], runs=2, reference_spp=16, progress=seen.append, **SIZE)
    assert seen == sorted(seen) and seen[-1] == pytest.approx(1)

    def stop(fraction):
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        headtail.compare("sphere", studio, ["mis"], runs=1 << 24, reference_spp=16, progress=stop, **SIZE)


def test_errors_name_the_argument(studio):
    for settings, words in [
        ({"spp": 0}, "budget"),
        ({"spp": 1, "seconds": 1}, "budget"),
        ({"width": 0}, "width"),
        ({"points": "x"}, "points 'x'"),
        ({"look_from": [1, 2]}, "look_from: has the shape"),
        ({"fov": float("nan")}, "fov|field of view"),
        ({"seed": -1}, "seed"),
    ]:
        with pytest.raises(headtail.HeadtailError, match=words):
            headtail.render("sphere", "mis", studio, **{**SIZE, **settings})
    for settings, words in [({"spp": ()}, "budget"), ({"runs": 0}, "run"), ({"seconds": (-1,)}, "budget"), ({"points": "x"}, "points 'x'")]:
        with pytest.raises(headtail.HeadtailError, match=words):
            headtail.compare("sphere", studio, ["mis"], **{**SIZE, **settings})
    sampler = headtail.Sampler.from_spec("mis", "overcast")
    with pytest.raises(headtail.HeadtailError, match="another map than studio"):
        headtail.compare("sphere", studio, [sampler], **SIZE)
    with pytest.raises(headtail.HeadtailError, match="material 'wood'"):
        headtail.Scene("sphere", material="wood")
