"""Measures how much lower the error of `patches` would be with exact masses: the most that a network could gain.

    python benches/masses/run.py --data FOLDER --work FOLDER

A second program is built from the commit BASE with `exact.patch`, which tabulates the mass of every twig (glossy
surfaces) at every shading point from four evaluations of the BRDF, more than 1000 times slower than the closed form.
Both render the same shadowed views with the same samples. Prints the ratio of their mean squared errors for each map
as JSON. Finished comparisons in the working folder are not repeated."""

import argparse
import csv
import json
import math
import os
import subprocess
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
SAMPLERS = {"patches": "1 direction", "split:4:patches": "4 directions"}


def build(work, patched):
    """Builds the program of BASE, patched or not; returns its path."""
    program = work / ("exact" if patched else "closed-form")
    if program.exists():
        return program
    tree = work / "tree"
    run = lambda *command, cwd=ROOT: subprocess.run(command, cwd=cwd, check=True)
    run("git", "worktree", "add", "--quiet", "--force", "--detach", str(tree), BASE)
    try:
        if patched:
            run("git", "apply", str(HERE / "exact.patch"), cwd=tree)
        environment = os.environ | {"CARGO_TARGET_DIR": str(work / "target")}
        subprocess.run(["cargo", "build", "--release", "--bin", "headtail"], cwd=tree, check=True, env=environment)
        (work / "target/release/headtail").rename(program)
    finally:
        run("git", "worktree", "remove", "--force", str(tree))
    return program


def errors(program, data, out, material, name, reference):
    """Returns the mean squared error of each sampler in one view."""
    if not (out / "results.csv").exists():
        subprocess.run([
            program, "compare", "--scene", data / "scenes/terrarium_robots.glb", "--ground", "--material", material,
            "--env", data / f"envmaps/{name}_1k.hdr", "--width", "48", "--height", "36", "--spp", "16", "--runs", "2",
            "--samplers", ",".join(SAMPLERS), "--out", out, "--force", *reference,
        ], check=True, env=os.environ | {"HT_TWIGS": "1"}, stdout=subprocess.DEVNULL)  # fmt: skip
    sums = {}
    for row in csv.DictReader((out / "results.csv").open()):
        if row["sampler"] in SAMPLERS:
            sums.setdefault(row["sampler"], []).append(float(row["mse"]))
    return {sampler: sum(values) / len(values) for sampler, values in sums.items()}


def folders(description):
    """Returns the folders of the command line: data, and work, which is made."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder of maps and scenes")
    parser.add_argument("--work", type=Path, required=True, help="folder of programs and results")
    options = parser.parse_args()
    data, work = options.data.resolve(), options.work.resolve()
    work.mkdir(parents=True, exist_ok=True)
    return data, work


def main():
    data, work = folders(__doc__)
    closed_form, exact = (build(work, patched) for patched in (False, True))
    rows, logarithms = [], {}
    for name in MAPS:
        for label, material in MATERIALS.items():
            view = f"{label.split(',')[0].lower()}-{name}"
            material = material.replace("{data}", str(data))
            before = errors(closed_form, data, work / f"closed-form-{view}", material, name, [])
            # Rendering the reference with exact masses would take hours.
            reference = ["--reference", work / f"closed-form-{view}" / "reference.exr"]
            after = errors(exact, data, work / f"exact-{view}", material, name, reference)
            for sampler, directions in SAMPLERS.items():
                ratio, surface = before[sampler] / after[sampler], f"{label}, {directions}"
                rows.append({"surface": surface, "map": name, "ratio": ratio})
                logarithms.setdefault(surface, []).append(math.log(ratio))
    for surface, values in logarithms.items():
        rows.append({"surface": surface, "map": "geometric mean", "ratio": math.exp(sum(values) / len(values))})
    print(json.dumps(rows))


if __name__ == "__main__":
    main()
