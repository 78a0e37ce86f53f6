"""Geometric means over the comparisons in a folder, by material and budget: python3 geometric_means.py OUT [TIMES].

Each folder is called MATERIAL-SCENE-MAP and holds the results.csv of `headtail compare`. Prints a Markdown table: the mean squared error of
`mis`, of the best form of MIS (of mis, mis2, mis-comp those that are there) and of `patches`, over that of the sampler, its least value, and the time over that of `mis`.

Budgets in seconds are met to some percent only, and other work on a machine disturbs a run. So a sample's time is the median over all such runs of a
sampler in a view, and its error is the one at as many samples as fit into the budget, between (or a little beyond) the budgets that were run: errors
fall as a power of the number of samples.

TIMES is another such folder of the same views, of runs on an idle machine. Rows "N of mis" then compare what the samplers of OUT, whose budgets are samples,
have after as much time as N samples of `mis` take, with the times of a sample from there.
"""

import collections
import csv
import math
import pathlib
import statistics
import sys

FORMS_OF_MIS = ("mis", "mis2", "mis-comp")


def mean(values):
    return sum(values) / len(values)


def geometric_mean(values):
    return math.exp(mean([math.log(value) for value in values]))


def runs_of(path):
    """{sampler: {budget: [(samples, seconds, mse)]}} of a results.csv."""
    runs = collections.defaultdict(lambda: collections.defaultdict(list))
    with open(path, newline="") as file:
        for row in csv.DictReader(file):
            if row["run"].isdigit():
                # Files of samplers have other names under other maps.
                kind, colon, file_name = row["sampler"].partition(":")
                sampler = kind + colon + "FILE" if file_name.endswith(".safetensors") else row["sampler"]
                runs[sampler][row["budget"]].append(tuple(float(row[name]) for name in ("spp", "seconds", "mse")))
    return runs


def seconds_of_samples(folder):
    """{(material and view, sampler): seconds of a sample}, medians over runs."""
    seconds = {}
    for path in pathlib.Path(folder).glob("*/results.csv"):
        for sampler, budgets in runs_of(path).items():
            each = [seconds / samples for runs in budgets.values() for samples, seconds, _ in runs]
            seconds[path.parent.name, sampler] = statistics.median(each)
    return seconds


def at_samples(budgets, samples):
    """The error of one sampler at a number of samples, between or a little beyond those that were run."""
    return by_power({runs[0][0]: mean([mse for _, _, mse in runs]) for runs in budgets.values()}, samples)


def by_power(errors, samples):
    """The error at a number of samples of {samples: error}, by the power with which it falls from one to the next."""
    points = sorted((math.log(samples), math.log(error)) for samples, error in errors.items())
    (x0, y0), (x1, y1) = nearest_pair(points, math.log(samples))
    slope = (y1 - y0) / (x1 - x0) if x1 > x0 else -1.0
    return math.exp(y0 + slope * (math.log(samples) - x0))


def at_equal_time(budgets):
    """{budget: (mse, seconds of a sample)} for the budgets of one sampler that are seconds."""
    timed = {budget: runs for budget, runs in budgets.items() if budget.endswith("s")}
    if not timed:
        return {}
    seconds = statistics.median(seconds / samples for runs in timed.values() for samples, seconds, _ in runs)
    return {budget: (at_samples(timed, float(budget[:-1]) / seconds), seconds) for budget in timed}


def nearest_pair(points, x):
    """The neighbours of a list between which a value lies, or the outermost ones."""
    after = next((k for k, point in enumerate(points) if point[0] >= x), len(points) - 1)
    after = max(after, min(1, len(points) - 1))
    return points[max(after - 1, 0)], points[after]


def read(folder, times=None):
    """{(material, budget): {view: {sampler: (mse, seconds)}}} with means over runs."""
    seconds_of = seconds_of_samples(times) if times else {}
    figures = collections.defaultdict(lambda: collections.defaultdict(dict))
    for path in sorted(pathlib.Path(folder).glob("*/results.csv")):
        material, view = path.parent.name.split("-", 1)
        of_view = runs_of(path)
        for sampler, budgets in of_view.items():
            own, of_mis = (seconds_of.get((path.parent.name, name)) for name in (sampler, "mis"))
            for budget in of_view["mis"] if own and of_mis else ():
                samples = of_view["mis"][budget][0][0]
                label = f"{samples:.0f} of mis"
                figures[material, label][view][sampler] = (at_samples(budgets, samples * of_mis / own), own)
            at_time = at_equal_time(budgets)
            for budget, runs in budgets.items():
                _, seconds, mse = (mean(column) for column in zip(*runs))
                figures[material, budget][view][sampler] = at_time.get(budget, (mse, seconds))
    return figures


def main(*folders):
    print("| material | budget | views | sampler | over mis | least | over the best MIS | least | below 1 | over patches | least | time over mis |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    for (material, budget), views in sorted(read(*folders).items()):
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
    main(*sys.argv[1:])
