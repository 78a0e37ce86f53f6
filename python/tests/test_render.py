"""Pictures, comparisons and training."""

import os
import signal
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
    # 256 samples in some 200 pixels, of relative variance below 10: half a per cent.
    assert np.ptp(means) < 0.03 * means[0]
    assert pictures[0].image.shape == (24, 32, 3) and pictures[0].spp == 256


def test_a_comparison_is_data(studio):
    rows, reference = headtail.compare("sphere", studio, ["patches", "mis"], spp=(1, 4), runs=2, reference_spp=256, **SIZE)
    assert rows.shape == (8,) and set(rows["sampler"]) == {"patches", "mis"}
    mse = {name: rows[(rows["sampler"] == name) & (rows["spp"] == 4)]["mse"].mean() for name in ("patches", "mis")}
    assert mse["patches"] < mse["mis"]
    assert reference.spp == 256


def test_a_callback_sees_progress_and_can_end_a_rendering(studio):
    seen = []
    headtail.render("sphere", "mis", studio, spp=64, progress=seen.append, **SIZE)
    assert len(seen) == 4 and seen[-1] == 1.0

    def stop(share):
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        headtail.render("sphere", "mis", studio, spp=1 << 20, progress=stop, **SIZE)


def test_ctrl_c_ends_a_rendering(studio):
    threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()
    start = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        headtail.render("sphere", "mis", studio, seconds=100, **SIZE)
    assert time.monotonic() - start < 30


def test_mistakes_raise_with_a_sentence(studio):
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
    with pytest.raises(headtail.HeadtailError, match="material 'wood'"):
        headtail.Scene("sphere", material="wood")
