"""Bias of the paper's estimator of the shadow catcher's mask, beside the control variate.

    python benches/mask_bias.py --program FILE --out FOLDER [--spp 1024] [--seeds 8]

Composites a ball into a view of the built-in studio with both forms of the mask and the same samples. Prints as JSON
the difference of the paper's form from the control variate, which is unbiased, in the whole shadow (the mean of
1 - mask), in percent of the shadow, with 95 % intervals over seeds."""

import argparse
import json
import math
import os
import subprocess
from pathlib import Path

SAMPLERS = {
    "head": "head:checkpoints/studio-head.safetensors",
    "table": "direct:checkpoints/studio-direct.safetensors",
    "patches": "patches",
    "mis": "mis",
}
# Quantile 0.975 of Student's t distribution by degrees of freedom.
STUDENT = {3: 3.182, 7: 2.365, 15: 2.131}


def interval(values):
    """Returns the mean and the half-width of its 95 % interval."""
    mean = sum(values) / len(values)
    variance = sum((value - mean) ** 2 for value in values) / (len(values) - 1)
    return mean, STUDENT[len(values) - 1] * math.sqrt(variance / len(values))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", default=os.environ.get("HEADTAIL", "headtail"))
    parser.add_argument("--out", type=Path, required=True, help="working folder")
    parser.add_argument("--spp", type=int, default=1024)
    parser.add_argument("--seeds", type=int, default=8, choices=[count + 1 for count in STUDENT])
    options = parser.parse_args()

    def run(*arguments):
        command = [options.program, *map(str, arguments), "--quiet", "--force"]
        return subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout

    options.out.mkdir(parents=True, exist_ok=True)
    photo = options.out / "photo.exr"
    run("view", "--env", "studio", "--width", 120, "--height", 80, "--out", photo)

    def shadow(sampler, form, seed):
        said = run("composite", "--photo", photo, "--camera", photo.with_suffix(".fspy"), "--env", "studio", "--scene",
                   "sphere", "--size", 0.8, "--sampler", sampler, "--mask", form, "--depth", 1, "--spp", options.spp,
                   "--seed", seed, "--json", "--out", options.out / "composite")  # fmt: skip
        return 1.0 - json.loads(said)["mean_mask"]

    rows = []
    for name, sampler in SAMPLERS.items():
        pairs = [[shadow(sampler, form, seed) for form in ("paper", "control-variate")] for seed in range(options.seeds)]
        mean, half_width = interval([100.0 * (paper / exact - 1.0) for paper, exact in pairs])
        rows.append({"sampler": name, "the paper's form, % of the shadow": f"{mean:+.2f} ± {half_width:.2f}"})
    print(json.dumps({"name": "mask", "rows": rows}))


if __name__ == "__main__":
    main()
