"""The head of the preset paper-ggx: sizes, initial weights and a batch for all peers."""

import math

import numpy as np

CONDITION = 12
BINS = 32
LOGITS = 3 * BINS + 1
HIDDEN = 64
LEAKY = 0.01
MIN_BIN = 1e-4
MIN_SLOPE = 1e-4
SLOPE_OFFSET = math.log(math.expm1(1.0 - MIN_SLOPE))

LEARNING_RATE = 1e-3
BETAS = (0.9, 0.999)
EPSILON = 1e-8
WEIGHT_DECAY = 1e-2


def layer_sizes(mode):
    """Returns (inputs, outputs) by name: encoder, elevation network, azimuth network."""
    seen = CONDITION + HIDDEN
    features = 2 if mode == "coupled" else 0
    sizes = {}
    for part, chain in [
        ("encoder", [CONDITION, HIDDEN, HIDDEN]),
        ("elevation", [seen + features, HIDDEN, HIDDEN, LOGITS]),
        ("azimuth", [seen + 1, HIDDEN, HIDDEN, LOGITS]),
    ]:
        for index, pair in enumerate(zip(chain, chain[1:])):
            sizes[f"{part}{index}"] = pair
    return sizes


def initial_weights(mode, seed=0):
    """Returns weights [out, in], uniform in +-1/sqrt(inputs) as in PyTorch's Linear."""
    rng = np.random.default_rng(seed)
    weights = {}
    for name, (inputs, outputs) in layer_sizes(mode).items():
        bound = 1.0 / math.sqrt(inputs)
        weights[name + ".weight"] = rng.uniform(-bound, bound, (outputs, inputs)).astype(np.float32)
        weights[name + ".bias"] = rng.uniform(-bound, bound, outputs).astype(np.float32)
    return weights


def batch(conditions, samples, seed=1):
    """Returns conditions [C, 12], points [C, S, 2] of the unit square, and a target density [C, S]."""
    rng = np.random.default_rng(seed)
    c = rng.normal(size=(conditions, CONDITION)).astype(np.float32)
    y = rng.random((conditions, samples, 2), dtype=np.float32)
    angle = 2.0 * np.pi * (y[..., 0] - c[:, None, 0])
    target = np.exp(np.cos(angle)) * y[..., 1] * (1.0 - y[..., 1])
    return c, y, target.astype(np.float32)
