"""Fixtures of all tests."""

import os
import pathlib

import numpy as np
import pytest

import headtail


@pytest.fixture(scope="session")
def studio():
    return headtail.Environment("studio")


@pytest.fixture(scope="session")
def patches(studio):
    return headtail.Sampler.from_spec("patches", studio)


@pytest.fixture(scope="session")
def table(studio):
    return headtail.bake(studio)


@pytest.fixture(scope="session")
def program():
    """The command line."""
    folder = os.environ.get("CARGO_TARGET_DIR", pathlib.Path.home() / ".cache" / "headtail-target")
    program = pathlib.Path(folder) / "release" / "headtail"
    if not program.exists():
        pytest.skip(f"{program} is not built")
    return program


def directions(count, seed):
    """Returns random unit directions [count, 3]."""
    d = np.random.default_rng(seed).normal(size=(count, 3))
    return (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)


def uniform(count, seed):
    """Returns random points of the square [count, 2]."""
    return np.random.default_rng(seed).random((count, 2), dtype=np.float32)


@pytest.fixture(scope="module", params=["llvm_ad_rgb", "llvm_ad_mono", "cuda_ad_rgb"])
def variant(request):
    """A Mitsuba variant with the integrators."""
    mi = pytest.importorskip("mitsuba")
    try:
        mi.set_variant(request.param)
        mi.Float(1) + mi.Float(2)
    except Exception as error:  # no device, or no LLVM
        pytest.skip(f"{request.param}: {error}")
    import headtail.mitsuba  # noqa: F401

    return request.param


@pytest.fixture(scope="session")
def heads(tmp_path_factory):
    """Files of heads by name, for studio; barely trained heads are unbiased, too."""
    if not hasattr(headtail, "fit"):
        pytest.skip("built without training")
    folder = tmp_path_factory.mktemp("heads")
    short = {"steps": 20, "conditions": 8, "validation_conditions": 8}
    forms = {
        "lambert": {"head": {"mode": "coupled"}},
        "of one width": {"material": "ggx:alpha=0.3", "head": {"mode": "autoregressive"}},
        "of any width": {"material": "ggx:alpha=0.1..0.9", "head": {"mode": "coupled", "encoder": {"hidden": 24, "output": 13}}},
        "over rows and columns": {"tail": "row-column"},
        "over a flow": {"tail": "flow", "flow": {"steps": 20, "cells": 64}},
        "over patches": {"over": "patches"},
        "over fine patches": {"material": "ggx:alpha=0.1..0.9", "over": "fine-patches"},
    }
    map = headtail.Environment("studio").array()
    for name, settings in forms.items():
        headtail.fit(map, **settings, **short).save(folder / f"{name}.safetensors")
    return {name: str(folder / f"{name}.safetensors") for name in forms}
