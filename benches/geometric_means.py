"""Geometric means over the comparisons in a folder, by material and budget: python3 geometric_means.py OUT.

Each folder is called MATERIAL-SCENE-MAP and holds the results.csv of `headtail compare`. Prints a Markdown table: the mean squared error of
`mis`, of the best form of MIS (of mis, mis2, mis-comp those that are there) and of `patches`, over that of the sampler, its least value, and the time over that of `mis`.
"""

import collections
import csv
import math
import pathlib
import sys

FORMS_OF_MIS = ("mis", "mis2", "mis-comp")


def mean(values):
    return sum(values) / len(values)


def geometric_mean(values):
    return math.exp(mean([math.log(value) for value in values]))


def read(folder):
    """{(material, budget): {view: {sampler: (mse, seconds)}}} with means over runs."""
    figures = collections.defaultdict(lambda: collections.defaultdict(dict))
    for path in sorted(pathlib.Path(folder).glob("*/results.csv")):
        material, view = path.parent.name.split("-", 1)
        runs = collections.defaultdict(list)
        with open(path, newline="") as file:
            for row in csv.DictReader(file):
                if row["run"].isdigit():
                    # Files of samplers have other names under other maps.
                    kind, colon, file = row["sampler"].partition(":")
                    sampler = kind + colon + "FILE" if file.endswith(".safetensors") else row["sampler"]
                    runs[row["budget"], sampler].append((float(row["mse"]), float(row["seconds"])))
        for (budget, sampler), values in runs.items():
            figures[material, budget][view][sampler] = tuple(mean(column) for column in zip(*values))
    return figures


def main(folder):
    print("| material | budget | views | sampler | over mis | least | over the best MIS | least | below 1 | over patches | least | time over mis |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    for (material, budget), views in sorted(read(folder).items()):
        for sampler in next(iter(views.values())):
            if sampler == "mis" or not all(sampler in view for view in views.values()):
                continue
            over_mis = [view["mis"][0] / view[sampler][0] for view in views.values()]
            forms = [form for form in FORMS_OF_MIS if all(form in view for view in views.values())]
            over_best = [min(view[form][0] for form in forms) / view[sampler][0] for view in views.values()]
            over_patches = [view["patches"][0] / view[sampler][0] for view in views.values()]
            time = geometric_mean([view[sampler][1] / view["mis"][1] for view in views.values()])
            figures = [geometric_mean(over_mis), min(over_mis), geometric_mean(over_best), min(over_best)]
            cells = [material, budget, str(len(views)), sampler, *(f"{figure:.2f}" for figure in figures)]
            cells += [str(sum(ratio < 1 for ratio in over_best)), f"{geometric_mean(over_patches):.2f}", f"{min(over_patches):.2f}"]
            print("| " + " | ".join([*cells, f"{time:.2f}"]) + " |")


if __name__ == "__main__":
    main(sys.argv[1])
