"""Charts of what learned visibility gains, from the CSV files of visibility.sh: python3 visibility_charts.py FOLDER OUT.svg (needs matplotlib).

One panel for each of rays.csv, cells.csv, levels.csv and memory.csv that is there: MSE without visibility over that with it, a line for each scene, the
geometric mean over its maps.
"""

import collections
import csv
import pathlib
import re
import sys

import matplotlib

matplotlib.use("svg")
from matplotlib import pyplot

from geometric_means import geometric_mean

# The place of a sampler along the axis: a number in its name, or a column of the file.
PANELS = {
    "rays": ("samples per pixel learned from", "patches", r"LEARNED(\d+)"),
    "cells": ("cells along a side of Y, of a table", "direct:TABLE", r"vis(\d*)@"),
    "levels": ("levels of cells", "patches", "levels"),
    "memory": ("megabytes", "patches", "megabytes"),
}
# A lesson before a picture of 16 samples is a quarter of a sample of each pixel; a table has 16 cells where nobody says otherwise.
UNNAMED = {"rays": 0.25, "cells": 16}


def place(panel, row):
    by = PANELS[panel][2]
    if by in row:
        return float(row[by])
    digits = re.search(by, row["sampler"])
    return float(digits.group(1)) if digits and digits.group(1) else UNNAMED[panel]


def gains(panel, path):
    """{scene: {place: geometric mean over maps}}"""
    base, errors = PANELS[panel][1], collections.defaultdict(dict)
    with open(path, newline="") as file:
        for row in csv.DictReader(file):
            key = row["scene"], row["map"], row.get(PANELS[panel][2])
            errors[key][row["sampler"]] = row
    found = collections.defaultdict(lambda: collections.defaultdict(list))
    for (scene, _, _), rows in errors.items():
        for name, row in rows.items():
            if name != base:
                found[scene][place(panel, row)].append(float(rows[base]["mse"]) / float(row["mse"]))
    return {scene: {x: geometric_mean(ratios) for x, ratios in sorted(by.items())} for scene, by in found.items()}


def main():
    folder, out = map(pathlib.Path, sys.argv[1:])
    panels = [panel for panel in PANELS if (folder / f"{panel}.csv").exists()]
    pyplot.rcParams.update({"svg.fonttype": "none", "svg.hashsalt": "headtail", "font.size": 9})
    figure, axes = pyplot.subplots(1, len(panels), figsize=(2.6 * len(panels), 2.9), sharey=True, squeeze=False)
    for panel, axis in zip(panels, axes[0]):
        for (scene, line), mark in zip(gains(panel, folder / f"{panel}.csv").items(), "osD^v"):
            axis.plot(list(line), list(line.values()), marker=mark, markersize=4, linewidth=1.2, label=scene.replace("_", " "))
        ticks = sorted({x for line in gains(panel, folder / f"{panel}.csv").values() for x in line})
        axis.set_xscale("log", base=2)
        axis.set_xticks(ticks, [f"{x:g}" for x in ticks])
        axis.tick_params(axis="x", labelsize=7)
        axis.minorticks_off()
        axis.set_xlabel(PANELS[panel][0])
        axis.axhline(1, color="0.6", linewidth=0.8)
        axis.set_yscale("log", base=2)
        steps = [1, 1.25, 1.5, 2, 2.5, 3, 4]
        axis.set_yticks(steps, [f"{y:g}" for y in steps])
        axis.grid(axis="y", linewidth=0.3)
        axis.spines[["top", "right"]].set_visible(False)
    axes[0][0].set_ylabel("times less error")
    axes[0][0].legend(frameon=False, fontsize=8)
    figure.tight_layout()
    figure.savefig(out, metadata={"Date": None})


if __name__ == "__main__":
    main()
