"""Trains heads for the same time from the paper's settings to the fast preset's, one change after the other.

    python benches/training_settings.py --program FILE --data FOLDER --out FOLDER [--seconds 60]

Prints the relative variance of the head on validation points, with the steps and the seconds of each training, as
JSON. Shorter trainings find the number of steps that fits."""

import argparse
import json
import os
import subprocess
from pathlib import Path

MAPS = ["lebombo", "studio_small_03"]
# Each row adds its settings to those above.
CHANGES = [
    ("the paper's settings, tabulated targets", {"points": "tabulated"}),
    ("points in strata of Y", {"points": "strata"}),
    ("batches of 128 x 32 points", {"conditions": 128, "strata": 5, "brdf_samples": 7}),
    ("K = 8 and a smaller encoder", {"head.bins": 8, "head.encoder.hidden": 32, "head.encoder.output": 32}),
    ("learning rate 0.016 after warm-up", {"learning_rate": 1.6e-2, "warmup": 0.05, "clip_norm": 10.0}),
    ("log-chi-square in place of KL and entropy", {"loss": "log-chi-square", "entropic": 0.0}),
]


def fit(options, name, settings, steps):
    """Trains a head for `steps` steps; returns the figures of the run."""
    changed = [f"--set={key}={value}" for key, value in ({"validate_every": 0} | settings | {"steps": steps}).items()]
    command = [options.program, "fit", "--env", options.data / f"envmaps/{name}_1k.hdr", "--preset", "paper-ggx",
               *changed, "--no-export", "--json", "--force", "--out", options.out / "fit"]  # fmt: skip
    return json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL).stdout)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", default=os.environ.get("HEADTAIL", "headtail"))
    parser.add_argument("--data", type=Path, required=True, help="folder of maps")
    parser.add_argument("--out", type=Path, required=True, help="working folder")
    parser.add_argument("--seconds", type=float, default=60.0)
    options = parser.parse_args()
    rows = []
    for name in MAPS:
        settings = {}
        for change, added in CHANGES:
            settings |= added
            steps, seconds = 4, 0.0
            while seconds < options.seconds / 12:
                steps *= 4
                seconds = fit(options, name, settings, steps)["training_seconds"]
            own = fit(options, name, settings, max(int(steps * options.seconds / seconds), 1))
            rows.append({"map": name, "change": change, "relative_variance": own["relative_variance"],
                         "steps": int(own["steps"]), "seconds": own["training_seconds"]})  # fmt: skip
    print(json.dumps(rows))


if __name__ == "__main__":
    main()
