"""Compares docs/method/patches.py, which is written from its page, with the native sampler."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import headtail

PAGE = Path(__file__).parents[2] / "docs/method/patches.py"


def page():
    spec = importlib.util.spec_from_file_location("patches_page", PAGE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def sky(height, sun):
    """A bright upper half with a window below, and a lamp or a sun."""
    width = 2 * height
    v, u = np.meshgrid(np.arange(height) / (height - 1), (np.arange(width) + 0.5) / width, indexing="ij")
    noise = np.random.default_rng(1).random((height, width))
    light = 0.3 + 0.2 * np.cos(2 * np.pi * u) + (v < 0.5) * (0.4 + 0.2 * np.sin(6 * np.pi * u)) + 0.1 * noise
    light[height // 2, width // 3 : width // 3 + width // 16] = 30
    light[height // 4 : height // 4 + 2, width // 4 : width // 4 + 2] = sun
    return np.stack([light, 0.9 * light, 1.1 * light], -1).astype(np.float32)


def unit(random, count):
    vectors = random.normal(size=(count, 3))
    return (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)


# A sun of two texels of 256 is a small light, with parts of the window beside it; a lamp of two texels of 96
# is not.
@pytest.mark.parametrize(("height", "sun", "small"), [(48, 200, 0), (128, 20_000, 3)])
def test_densities_are_those_of_the_page(height, sun, small):
    radiance = sky(height, sun)
    own = page().Patches(radiance)
    assert own.small.sum() == small
    native = headtail.Sampler.from_spec("patches", headtail.Environment.from_array(radiance))
    random = np.random.default_rng(2)
    # Native masses have single precision. The narrower a lobe, the more their terms cancel (the tilt of half
    # vectors over the squared width).
    for alpha, tolerance in [(None, 1e-4), (0.4, 1e-4), (0.1, 3e-3)]:
        width = {} if alpha is None else {"alpha": alpha}
        for _ in range(4):
            n, wo = unit(random, 2)
            wo = wo if n @ wo > 0 else -wo
            drawn = native.sample(n, wo, count=40, seed=3, **width)
            wi = np.concatenate([unit(random, 60), drawn.wi[drawn.pdf > 0]])
            expected = native.pdf(wi, n, wo, **width)
            pdf = own.pdf(n.astype(float), wo.astype(float), wi.astype(float), alpha)
            np.testing.assert_allclose(pdf, expected, rtol=tolerance, atol=tolerance * 1e-2 * expected.max())
            assert (expected > 0).sum() > 40
