"""Measures `patches` with other masses than its own.

    python benches/masses/run.py --data FOLDER --work FOLDER exact
    python benches/masses/run.py --data FOLDER --work FOLDER earlier

Programs are built from the commit BASE with a patch, and render the same shadowed views with the same samples.
`exact` tabulates the mass of every twig (glossy surfaces) at every shading point from four evaluations of the BRDF,
more than 1000 times slower than the closed form: the most that a network could gain. `earlier` has the masses of
earlier methods on the same tree. Prints ratios of mean squared errors as JSON. Finished comparisons in the working
folder are not repeated."""

import argparse
import csv
import json
import math
import os
import shutil
import subprocess
import sys
from pathlib import Path

BASE = "8d78da6"
HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
MAPS = ["lebombo", "studio_small_03", "venice_sunset", "dancing_hall", "spiaggia_di_mondello", "kloofendal_overcast",
        "forest_slope", "st_peters_square_night"]
MATERIALS = {
    "GGX, alpha = 0.05": "ggx:alpha=0.05",
    "measured": "nbrdf:{data}/nbrdf/nbrdf_all.f32#merl/gold-metallic-paint,merl/aluminium",
}
# Masses, and the variable with which `earlier.patch` is compiled for them.
EARLIER = {"BRDF in the middle of a patch": "point", "spherical Gaussians": "spherical-gaussians"}
SAMPLERS = {"patches": "1 direction", "split:4:patches": "4 directions"}


def build(work, name, patch=None, package="headtail", masses=""):
    """Builds a program of BASE, with a patch if one is named; returns its path."""
    program = work / name
    if program.exists():
        return program
    tree, binary = work / "tree", {"headtail": "headtail", "headtail-eval": "results"}[package]
    run = lambda *command, cwd=ROOT: subprocess.run(command, cwd=cwd, check=True)
    run("git", "worktree", "add", "--force", "--detach", str(tree), BASE)
    try:
        if patch:
            run("git", "apply", str(HERE / patch), cwd=tree)
        environment = os.environ | {"CARGO_TARGET_DIR": str(work / "target")} | ({"HT_MASSES": masses} if masses else {})
        command = ["cargo", "build", "--release", "--package", package, "--bin", binary]
        subprocess.run(command, cwd=tree, check=True, env=environment)
        (work / "target/release" / binary).rename(program)
    finally:
        run("git", "worktree", "remove", "--force", str(tree))
    return program


def measured(program, options, out, material, name, size, runs, reference=()):
    """Returns the mean squared error of each sampler in one view, and its seconds."""
    if not (out / "results.csv").exists():
        material = material.replace("{data}", str(options.data))
        subprocess.run([
            program, "compare", "--scene", options.data / "scenes/terrarium_robots.glb", "--ground", "--material", material,
            "--env", options.data / f"envmaps/{name}_1k.hdr", *size, "--spp", "16", "--runs", str(runs),
            "--samplers", ",".join(SAMPLERS), "--out", out, "--force", *reference,
        ], check=True, env=os.environ | {"HT_TWIGS": "1"}, stdout=subprocess.DEVNULL)  # fmt: skip
    values = {}
    for row in csv.DictReader((out / "results.csv").open()):
        if row["sampler"] in SAMPLERS:
            values.setdefault(row["sampler"], []).append([float(row["mse"]), float(row["seconds"])])
    return {sampler: [sum(column) / len(column) for column in zip(*rows)] for sampler, rows in values.items()}


def exact(options):
    """Returns the MSE of `patches` over that with exact masses."""
    closed_form, tabulated = build(options.work, "closed-form"), build(options.work, "exact", "exact.patch")
    rows, logarithms, size = [], {}, ["--width", "48", "--height", "36"]
    for name in MAPS:
        for label, material in MATERIALS.items():
            view = f"{label.split(',')[0].lower()}-{name}"
            before = measured(closed_form, options, options.work / f"closed-form-{view}", material, name, size, 2)
            # Rendering the reference with exact masses would take hours.
            reference = ["--reference", options.work / f"closed-form-{view}" / "reference.exr"]
            after = measured(tabulated, options, options.work / f"exact-{view}", material, name, size, 2, reference)
            for sampler, directions in SAMPLERS.items():
                ratio, surface = before[sampler][0] / after[sampler][0], f"{label}, {directions}"
                rows.append({"surface": surface, "map": name, "ratio": ratio})
                logarithms.setdefault(surface, []).append(math.log(ratio))
    for surface, values in logarithms.items():
        rows.append({"surface": surface, "map": "geometric mean", "ratio": math.exp(sum(values) / len(values))})
    return rows


def earlier(options):
    """Returns geometric means over maps of the MSE with the masses of earlier methods over that of `patches`."""
    own = in_experiment(options, "own")
    rows = []
    for label, masses in EARLIER.items():
        logarithms = {}
        for key, error in in_experiment(options, masses, "earlier.patch").items():
            surface, _, sampler, budget = key
            ratio = math.log(error / own[key])
            logarithms.setdefault((f"{surface}, {SAMPLERS[sampler]}", budget), []).append(ratio)
        for (surface, budget), values in logarithms.items():
            rows.append({"surface": surface, "budget": budget, "masses": label, "ratio": math.exp(sum(values) / len(values))})
    return rows


def in_experiment(options, name, patch=None):
    """Returns the mean squared error of each (material, map, sampler, budget) of `earlier.toml`."""
    program = build(options.work, f"results-{name}", patch, "headtail-eval", name)
    root = options.work / name
    (root / "results").mkdir(parents=True, exist_ok=True)
    shutil.copy(HERE / "earlier.toml", root / "results")
    command = [program, "--root", root, "run", "earlier", "--data", options.data]
    subprocess.run(command, check=True, cwd=root, stdout=sys.stderr)
    values = {}
    for row in csv.DictReader((root / "results/earlier.csv").open()):
        values.setdefault((row["material"], row["map"], row["sampler"], row["budget"]), []).append(float(row["mse"]))
    return {key: sum(own) / len(own) for key, own in values.items()}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder of maps and scenes")
    parser.add_argument("--work", type=Path, required=True, help="folder of programs and comparisons")
    parser.add_argument("masses", choices=["exact", "earlier"])
    options = parser.parse_args()
    options.data, options.work = options.data.resolve(), options.work.resolve()
    options.work.mkdir(parents=True, exist_ok=True)
    print(json.dumps({"exact": exact, "earlier": earlier}[options.masses](options)))


if __name__ == "__main__":
    main()
