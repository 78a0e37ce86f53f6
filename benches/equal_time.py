"""Tables at equal samples and at equal time from the CSV of `--bench visibility`: python3 equal_time.py FILE [BASE].

The first table has, for each sampler, the mean squared error of `mis` over its own (or that of BASE): geometric means over all views at equal samples
and after as much processor time as 16 and 64 samples of `mis` take, the least view in brackets, and the time of a sample over that of `mis`. The
second has the best form of MIS over the sampler at equal time, by map; forms of MIS are those of as many directions as the sampler has, or fewer. The
others have the best of each in every view, by map at equal time, and that of one direction at equal samples.

A sample's time is the mean over the budgets of a view; errors between budgets, or a little beyond them, follow the power with which they fall.
"""

import collections
import csv
import sys

from geometric_means import FORMS_OF_MIS, by_power, geometric_mean

SPLIT_FORMS_OF_MIS = ("split:2:mis-comp", "split:4:mis-comp")
BUDGETS_OF_MIS = (16, 64)


def read(path):
    """{(map, scene): {sampler: {samples: (error, seconds of a sample)}}}"""
    views = collections.defaultdict(lambda: collections.defaultdict(dict))
    with open(path, newline="") as file:
        for row in csv.DictReader(file):
            figures = float(row["mse"]), float(row["cpu_seconds_per_sample"])
            views[row["map"], row["scene"]][row["sampler"]][int(row["spp"])] = figures
    return views


def seconds_of_sample(budgets):
    """The mean time of a sample over budgets, as a logarithm's: short pictures are the noisier ones."""
    return geometric_mean([seconds for _, seconds in budgets.values()])


def error_after(budgets, seconds):
    """The error of a sampler after so much time."""
    errors = {samples: error for samples, (error, _) in budgets.items()}
    return by_power(errors, seconds / seconds_of_sample(budgets))


def errors_at_equal_time(view):
    """{(samples of mis, sampler): error}"""
    of_mis = seconds_of_sample(view["mis"])
    return {(n, name): error_after(budgets, n * of_mis) for n in BUDGETS_OF_MIS for name, budgets in view.items()}


def with_least(ratios):
    return f"{geometric_mean(ratios):.2f} ({min(ratios):.2f})"


def in_words(ratios):
    """Means of the ratios of all views after either time, the least, and how many views are below 1."""
    least, below = min(map(min, ratios)), sum(min(pair) < 1 for pair in zip(*ratios))
    means = " · ".join(f"{geometric_mean(own):.2f}" for own in ratios)
    return f"{means} ({least:.2f}; {below} below 1)"


def print_row(cells):
    print("| " + " | ".join(cells) + " |")


def print_head(cells):
    print_row(cells)
    print_row(["---"] * len(cells))


def print_samplers(views, base):
    samples = sorted(next(iter(views.values()))[base])
    at_time = [(view, errors_at_equal_time(view)) for view in views.values()]
    equal = [f"{n} samples" for n in samples]
    print_head(["sampler", *equal, "time of a sample", *(f"equal time, {n} of mis" for n in BUDGETS_OF_MIS)])
    for name in next(iter(views.values())):
        cells = [with_least([view[base][n][0] / view[name][n][0] for view in views.values()]) for n in samples]
        times = [seconds_of_sample(view[name]) / seconds_of_sample(view["mis"]) for view in views.values()]
        cells.append(f"{geometric_mean(times):.2f}")
        cells += [with_least([errors[n, base] / errors[n, name] for _, errors in at_time]) for n in BUDGETS_OF_MIS]
        print_row([name, *cells])


def by_map(views):
    """The errors at equal time of the views of each map, and of all: {title: [errors of a view]}"""
    chosen = collections.defaultdict(list)
    for (where, _), view in views.items():
        chosen[where].append(errors_at_equal_time(view))
    return {**chosen, f"all {len(views)}": [errors for own in chosen.values() for errors in own]}


def print_maps(views):
    names = [name for name in next(iter(views.values())) if name not in FORMS_OF_MIS]
    print_head(["map", *names])
    for title, chosen in by_map(views).items():
        cells = []
        for name in names:
            forms = FORMS_OF_MIS + (SPLIT_FORMS_OF_MIS if name.startswith("split:") else ())
            cells.append(in_words(at_equal_time(chosen, forms, [name])))
        print_row([title, *cells])


def at_equal_time(chosen, forms, own):
    """The least error of some forms over that of a sampler, or of the best of some, in each view after either time."""

    def least(errors, n, names):
        return min(errors[n, name] for name in names if (n, name) in errors)

    return [[least(errors, n, forms) / least(errors, n, own) for errors in chosen] for n in BUDGETS_OF_MIS]


def print_best(views):
    """The best form of MIS over the best of all other samplers but resampling, in each view the best."""
    names = next(iter(views.values()))
    others = [name for name in names if name not in FORMS_OF_MIS + SPLIT_FORMS_OF_MIS and not name.startswith("ris:")]
    with_one = [name for name in others if not name.startswith("split:")]
    rows = [
        ("one direction each", FORMS_OF_MIS, with_one),
        ("MIS with one", FORMS_OF_MIS, others),
        ("as many as each has", FORMS_OF_MIS + SPLIT_FORMS_OF_MIS, others),
    ]
    chosen = by_map(views)
    print_head(["best over best, equal time", *chosen])
    for title, forms, own in rows:
        print_row([title, *(in_words(at_equal_time(errors, forms, own)) for errors in chosen.values())])
    print()
    print_head(["best over best, equal samples", f"all {len(views)}"])
    for samples in sorted(names["mis"]):

        def least(view, chosen, samples=samples):
            return min(view[name][samples][0] for name in chosen if name in view)

        ratios = [least(view, FORMS_OF_MIS) / least(view, with_one) for view in views.values()]
        print_row([f"one direction each, {samples} samples of either", with_least(ratios)])


def main(path, base="mis"):
    views = read(path)
    print_samplers(views, base)
    print()
    print_maps(views)
    print()
    print_best(views)


if __name__ == "__main__":
    main(*sys.argv[1:])
