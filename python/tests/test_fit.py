"""Training."""

import os
import signal
import threading

import numpy as np
import pytest
from conftest import directions, uniform

import headtail

SHORT = {"steps": 20, "conditions": 8, "validation_conditions": 8}


def test_a_fitted_head_is_saved_opened_and_baked(studio, tmp_path):
    seen = []
    head = headtail.fit(studio, "lambert", progress=seen.append, **SHORT)
    assert seen[-1]["step"] == 20 and seen[-1]["steps"] == 20 and np.isfinite(seen[-1]["kl"])
    head.save(tmp_path / "head.safetensors")
    opened = headtail.Sampler.open(tmp_path / "head.safetensors", studio)
    n, u = directions(100, 1), uniform(100, 2)
    assert np.array_equal(opened.sample(n, u=u).wi, head.sample(n, u=u).wi)
    assert headtail.bake(head, normals=(4, 8), cells=(8, 8)).info["intermediate"]["kind"] == "bake"


def test_a_head_over_patches_is_fitted_saved_and_opened(studio, tmp_path):
    # Long enough to improve on the initial weights, which are the identity.
    head = headtail.fit(studio, over="patches", steps=100, conditions=32, validation_conditions=32)
    # Settings of its preset: a smaller head than over the tail, and no mixture weight for BRDF sampling on
    # diffuse surfaces.
    assert headtail.settings(over="patches") == headtail.settings(preset="over-patches")
    head.save(tmp_path / "head.safetensors")
    opened = headtail.Sampler.open(tmp_path / "head.safetensors", studio)
    assert opened.info["patches"] == "leaves" and opened.info["intermediate"]["selection_layers"] == 0
    n, u = directions(2000, 1), uniform(2000, 2)
    draws = opened.sample(n, u=u)
    assert np.array_equal(draws.wi, head.sample(n, u=u).wi)
    # Differs from the patches alone and from the head over the tail.
    alone = headtail.Sampler.from_spec("patches", studio).sample(n, u=u)
    assert (np.abs(draws.wi - alone.wi).max(1) > 1e-3).mean() > 0.5
    drawn = draws.pdf > 0
    again = opened.pdf(draws.wi[drawn], n[drawn])
    assert np.quantile(np.abs(again / draws.pdf[drawn] - 1), 0.99) < 1e-2


def test_interrupted_runs_resume_to_the_same_weights(studio, tmp_path):
    whole = headtail.fit(studio, reproducible=True, **SHORT)

    def stop(now):
        if now["step"] == 7:
            raise KeyboardInterrupt

    resumable = {"checkpoint_dir": tmp_path / "checkpoints", "reproducible": True}
    with pytest.raises(KeyboardInterrupt):
        headtail.fit(studio, progress=stop, **resumable, **SHORT)
    resumed = headtail.fit(studio, resume=True, **resumable, **SHORT)
    for name, sampler in [("whole", whole), ("resumed", resumed)]:
        sampler.save(tmp_path / name)
    assert (tmp_path / "whole").read_bytes() == (tmp_path / "resumed").read_bytes()


def test_ctrl_c_ends_training(studio):
    # Processes started in the background ignore the signal unless it is reset.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGINT)).start()
    with pytest.raises(KeyboardInterrupt):
        headtail.fit(studio, steps=1_000_000)
    signal.signal(signal.SIGINT, before)


def test_settings_are_those_of_the_program(studio):
    text = headtail.settings("ggx:alpha=0.4", head={"bins": 16})
    assert "bins = 16" in text and 'material = "ggx:alpha=0.4"' in text
    for settings, words in [({"speed": 1}, "the key `speed` is unknown"), ({"head": {"bins": "x"}}, "bins"), ({"steps": -1}, "steps")]:
        with pytest.raises(headtail.HeadtailError, match=words):
            headtail.fit(studio, **settings)
    with pytest.raises(headtail.HeadtailError, match="resume: needs checkpoint_dir"):
        headtail.fit(studio, resume=True)
