"""What tests share."""

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


def directions(count, seed):
    """Random unit directions [count, 3]."""
    d = np.random.default_rng(seed).normal(size=(count, 3))
    return (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)


def uniform(count, seed):
    """Random points of the square [count, 2]."""
    return np.random.default_rng(seed).random((count, 2), dtype=np.float32)
