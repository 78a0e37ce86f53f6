"""Compares the masses of `patches` with those of two earlier methods, in the same sampler.

    python benches/masses/earlier.py --data FOLDER --work FOLDER

Three programs are built from the commit BASE, two of them with a patch: `point.patch` evaluates BRDF times cosine once,
in the mean direction of a patch (Conty Estevez and Lecocq 2018), `gaussian.patch` computes masses from one variance per
patch, as for a spherical Gaussian (after Tokuyoshi et al. 2024). All render the same shadowed views with the same samples.
Prints for each surface the geometric mean over maps of the mean squared error over that of the closed form, and of the same
times the ratio of the seconds, as JSON. Finished programs and measurements in the working folder are not repeated."""

import csv
import json
import math
import os
import shutil
import subprocess
from pathlib import Path

from run import BASE, HERE, ROOT, folders

FORMS = {"own": None, "point": "one evaluation", "gaussian": "spherical Gaussians"}
EXPERIMENT = HERE / "earlier.toml"


def measure(form, data, work):
    """Returns the rows of the measurements with a form of masses."""
    out = work / f"{form}.csv"
    if out.exists():
        return list(csv.DictReader(out.open()))
    tree = work / form
    run = lambda *command, cwd=ROOT, **more: subprocess.run(command, cwd=cwd, check=True, **more)
    if not tree.exists():
        run("git", "worktree", "add", "--quiet", "--force", "--detach", str(tree), BASE)
    try:
        if FORMS[form] and not subprocess.run(["git", "diff", "--quiet"], cwd=tree).returncode:
            run("git", "apply", str(HERE / f"{form}.patch"), cwd=tree)
        shutil.copy(EXPERIMENT, tree / "results")
        environment = os.environ | {"CARGO_TARGET_DIR": str(work / "target")}
        run("cargo", "build", "--release", "--locked", "--package", "headtail-eval", "--bin", "results", cwd=tree, env=environment)
        program = str(work / "target/release/results")
        # No file of a trained sampler is needed, hence no program that would train one.
        run(program, "--root", ".", "run", EXPERIMENT.stem, "--data", data, "--program", "/bin/false", cwd=tree, stdout=subprocess.DEVNULL)
        shutil.copy(tree / "results" / "earlier.csv", out)
    finally:
        run("git", "worktree", "remove", "--force", str(tree))
    return measure(form, data, work)


def means(rows):
    """Returns the mean squared error and the seconds of each view and sampler, [material, sampler, map]."""
    sums = {}
    for row in rows:
        sums.setdefault((row["material"], row["sampler"], row["map"]), []).append((float(row["mse"]), float(row["seconds"])))
    return {key: [sum(column) / len(column) for column in zip(*values)] for key, values in sums.items()}


def main():
    data, work = folders(__doc__)
    measured = {form: means(measure(form, data, work)) for form in FORMS}
    logarithms = {}
    for form, label in FORMS.items():
        for (material, sampler, name), (error, seconds) in measured[form].items() if label else []:
            own_error, own_seconds = measured["own"][material, sampler, name]
            ratios = {"samples": error / own_error, "time": error * seconds / (own_error * own_seconds)}
            for budget, ratio in ratios.items():
                logarithms.setdefault((f"{material}, {sampler}", f"{label}, equal {budget}"), []).append(math.log(ratio))
    mean = lambda values: math.exp(sum(values) / len(values))
    print(json.dumps([{"surface": surface, "form": form, "ratio": mean(own)} for (surface, form), own in logarithms.items()]))


if __name__ == "__main__":
    main()
