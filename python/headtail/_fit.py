"""Training."""

import json
import os

from . import _native
from ._environment import environment
from ._sampler import Sampler


def fit(
    env,
    material="lambert",
    *,
    preset=None,
    progress=None,
    checkpoint_dir=None,
    checkpoint_every=250,
    resume=False,
    reproducible=False,
    **settings,
):
    """Trains a head for a map and returns a `Sampler`, which `save` writes to a file.

    material: "lambert", "ggx:alpha=0.4", "ggx:alpha=0.2..0.8". settings: any key of
    `settings()`, tables as dictionaries: steps=3000, head={"bins": 16}, over="patches" (by default with the
    preset "over-patches"). progress: called after every step with a dictionary of step, steps, loss, kl,
    relative_variance, seconds.
    Ctrl-C raises KeyboardInterrupt after the current step; with checkpoint_dir, resume=True continues from there.
    """
    checkpoints = None
    if checkpoint_dir is not None:
        if int(checkpoint_every) < 1:
            raise _native.HeadtailError(f"checkpoint_every: {checkpoint_every} is not at least 1")
        checkpoints = (os.fspath(checkpoint_dir), int(checkpoint_every), bool(resume))
    elif resume:
        raise _native.HeadtailError("resume: needs checkpoint_dir")
    native = environment(env)._native
    return Sampler(_native.fit(native, material, _preset(preset, settings), _assignments(settings), checkpoints, reproducible, progress))


def settings(material=None, *, preset=None, **settings):
    """Returns all settings of a run as TOML text."""
    return _native.settings(material, _preset(preset, settings), _assignments(settings))


def _preset(preset, settings):
    """Returns the preset; heads over patches have one of their own."""
    return "over-patches" if preset is None and settings.get("over", "tail") != "tail" else preset


def _assignments(settings, path=""):
    """Returns `key.of.field = value` lines in TOML from nested dictionaries."""
    lines = []
    for key, value in settings.items():
        if isinstance(value, dict):
            lines += _assignments(value, f"{path}{key}.")
        else:
            # JSON's strings, numbers and booleans are valid TOML.
            lines.append(f"{path}{key}={json.dumps(value)}")
    return lines
