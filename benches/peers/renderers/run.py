"""Compares headtail with Cycles, LuxCore and Mitsuba: variance at equal wall-clock time, on the same pictures.

    python benches/peers/renderers/run.py --data FOLDER [--store FILE] [--views NAME,...] [--renderers NAME,...]

Same triangles, camera, map, material and box filter; no clamping, denoising or adaptive sampling. The time is that of the
rendering call, after another one has built the scene and compiled kernels; the preparation of samplers (headtail)
and the visibility cache (LuxCore) are included. The samples of a run take about the budget without preparation, and
the variance is multiplied by seconds over budget.
Renderers that cannot be imported are skipped, and those whose pictures differ from those of the baseline have no
ratio; standard error reports both, with the progress. The rows are printed as JSON. Rows in the file of --store are
not measured again.
--comparison same-technique compares the speed of headtail and Mitsuba where they sample alike.

headtail is the program of this checkout (`cargo build --release`), or the one named by HEADTAIL."""

import argparse
import itertools
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "2")
HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import numpy as np

import headtail_renderer
import measure
import views

# Module and options of each renderer, and the measured depths.
COMPENSATED = {"compensation": True, "points": "multijitter"}
RENDERERS = {
    "Cycles": ("cycles_renderer", {}, (1, 4)),
    "Cycles, Sobol": ("cycles_renderer", {"points": "TABULATED_SOBOL"}, (1, 4)),
    "Cycles, portals": ("cycles_renderer", {"portals": True}, (1, 4)),
    "Cycles, path guiding": ("cycles_renderer", {"guiding": True}, (4,)),
    "LuxCore": ("luxcore_renderer", {}, (1, 4)),
    "LuxCore, visibility cache": ("luxcore_renderer", {"cache": True}, (1, 4)),
    "Mitsuba": ("mitsuba_renderer", {}, (1, 4)),
    "Mitsuba, multijitter": ("mitsuba_renderer", {"points": "multijitter"}, (1, 4)),
    "Mitsuba, compensation": ("mitsuba_renderer", {"compensation": True}, (1, 4)),
    "Mitsuba, compensation, multijitter": ("mitsuba_renderer", COMPENSATED, (1, 4)),
    "Mitsuba, compensation, multijitter, 3 pairs": ("mitsuba_renderer", {**COMPENSATED, "pairs": 3}, (1,)),
    "headtail mis2": ("headtail_renderer", {"sampler": "mis2"}, (1, 4)),
    "headtail mis2-comp": ("headtail_renderer", {"sampler": "mis2-comp"}, (1, 4)),
    "headtail split:3:mis2-comp": ("headtail_renderer", {"sampler": "split:3:mis2-comp"}, (1,)),
    "headtail patches+vis": ("headtail_renderer", {"sampler": "patches+vis"}, (1, 4)),
    "headtail auto": ("headtail_renderer", {"sampler": "auto"}, (1, 4)),
}
# The same technique: one direction of the emitter and one of the BRDF, from independent points.
SAME_TECHNIQUE = {
    "Mitsuba": ("mitsuba_renderer", {}, (1,)),
    "headtail": ("headtail_renderer", {"sampler": "mis2", "points": "independent"}, (1,)),
}


@dataclass
class Comparison:
    """Views and renderers, and the renderer that all others are compared with."""

    views: list
    renderers: dict
    baseline: str


COMPARISONS = {
    "renderers": Comparison(views.VIEWS, RENDERERS, "Cycles"),
    "same-technique": Comparison(views.MESHES, SAME_TECHNIQUE, "Mitsuba"),
}


def log(text):
    print(text, file=sys.stderr, flush=True)


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    names = lambda text: text.split(",")
    numbers = lambda kind: lambda text: [kind(part) for part in text.split(",")]
    parser.add_argument("--data", type=Path, help="folder of maps and scenes")
    parser.add_argument("--store", type=Path, help="file of rows that are measured already, and to which new ones are added")
    parser.add_argument("--comparison", choices=COMPARISONS, default="renderers")
    parser.add_argument("--views", type=lambda text: text.split(";"), help="beginnings of names, separated by semicolons")
    parser.add_argument("--renderers", type=lambda text: text.split(";"), help="names separated by semicolons")
    parser.add_argument("--materials", type=names, default=list(views.MATERIALS))
    parser.add_argument("--depths", type=numbers(int), default=[1, 4])
    parser.add_argument("--budgets", type=numbers(float), default=[1.0, 4.0], help="seconds of a picture")
    parser.add_argument("--runs", type=int, default=4, help="pictures with different seeds")
    parser.add_argument("--rounds", type=int, default=1, help="measurements of a picture, alternately by all renderers")
    parser.add_argument("--width", type=int, default=views.WIDTH)
    parser.add_argument("--height", type=int, default=views.HEIGHT)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--timeout", type=float, default=900, help="seconds after which a renderer of one picture is given up")
    parser.add_argument("--worker", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if not options.worker and not options.data:
        parser.error("--data is required")
    return options


def main():
    options = arguments()
    if options.worker:
        return work(json.loads(options.worker.read_text()))
    rows, comparison = stored(options.store), COMPARISONS[options.comparison]
    wanted = {name: own for name, own in comparison.renderers.items() if not options.renderers or name in options.renderers}
    available = importable(wanted)
    with tempfile.TemporaryDirectory() as folder:
        for view in comparison.views:
            if not options.views or view.name.startswith(tuple(options.views)):
                measure_view(view, options, available, rows, Path(folder))
    settings = [getattr(options, name) for name in ("runs", "width", "height", "threads")]
    print(json.dumps(report([row for row in rows if list(key(row)[6:]) == settings], comparison)))


def importable(renderers):
    """Returns renderers whose modules can be imported, and reports the others."""
    found, known = {}, {}
    for name, renderer in renderers.items():
        module = renderer[0]
        if module not in known:
            command = [sys.executable, "-c", f"import {module}"]
            environment = {**os.environ, "PYTHONPATH": str(HERE)}
            known[module] = subprocess.run(command, env=environment, capture_output=True, text=True)
        if known[module].returncode == 0:
            found[name] = renderer
        else:
            reason = known[module].stderr.strip().splitlines() or ["it ended without a message"]
            log(f"SKIPPED: {name}: {reason[-1]}")
    return found


def key(row):
    names = ("view", "material", "depth", "renderer", "round", "budget", "runs", "width", "height", "threads")
    return tuple(row[name] for name in names)


def stored(path):
    """Returns the rows of a file, whose last one may be incomplete after an interruption."""
    rows = []
    for line in path.read_text().splitlines() if path and path.exists() else []:
        try:
            rows.append({"round": 0, **json.loads(line)})
        except json.JSONDecodeError:
            log(f"{path}: an incomplete row is left out")
    return rows


def measure_view(view, options, available, rows, folder):
    files = [options.data / "scenes" / f"{view.scene}.glb", views.map_file(view, options.data)]
    missing = [str(file) for file in files if not file.exists()]
    if missing:
        return log(f"SKIPPED: {view.name}: there is no {', '.join(missing)}")
    vertices, faces, look_from, look_at, fov = views.opened(view, options.data)
    glb, geometry = folder / "scene.glb", folder / "geometry.npz"
    views.scene.write_glb(glb, vertices, faces)
    frame = dict(
        look_from=look_from, look_at=look_at, fov=fov, width=options.width, height=options.height,
        map=str(files[1].resolve()), threads=options.threads, glb=str(glb),
    )  # fmt: skip
    own = headtail_renderer.Renderer(views.Picture(vertices, faces, alpha=None, depth=1, portals=None, **frame))
    coverage = own.coverage()
    frame["portals"] = own.portals() if view.camera else None
    # Rounded like the file that other renderers read.
    np.savez(geometry, vertices=vertices.astype(np.float32).astype(float), faces=faces, coverage=coverage)
    known = {key(row) for row in rows}
    for depth in options.depths:
        for material in view.materials:
            for turn, (name, (module, settings, depths)) in itertools.product(range(options.rounds), available.items()):
                common = dict(view=view.name, material=material, depth=depth, renderer=name, round=turn)
                common.update({field: getattr(options, field) for field in ("runs", "width", "height", "threads")})
                budgets = [budget for budget in sorted(options.budgets) if key({**common, "budget": budget}) not in known]
                if material not in options.materials or depth not in depths or not budgets:
                    continue
                # Portals, and a cache of where light is visible, are for rooms.
                fits_scene = frame["portals"] or not {"portals", "cache"} & settings.keys()
                # LuxCore's metal is a different surface.
                has_material = module != "luxcore_renderer" or material == "diffuse"
                if not (fits_scene and has_material):
                    continue
                log(f"{view.name}, {material}, depth {depth}: {name}")
                picture = dict(alpha=views.MATERIALS[material], depth=depth, **frame)
                renderer = dict(module=module, settings=settings)
                task = dict(common=common, budgets=budgets, picture=picture, geometry=str(geometry), out=str(folder / "rows.json"), **renderer)
                for row in by_worker(task, folder, options.timeout):
                    rows.append(row)
                    if options.store:
                        options.store.parent.mkdir(parents=True, exist_ok=True)
                        with options.store.open("a") as file:
                            file.write(json.dumps(row) + "\n")


def by_worker(task, folder, timeout):
    """Returns rows that a separate process measures, since renderers load conflicting libraries and print to
    standard output."""
    file, out = folder / "task.json", Path(task["out"])
    file.write_text(json.dumps(task))
    out.unlink(missing_ok=True)
    with open(folder / "output.txt", "w+") as output:
        command = [sys.executable, __file__, "--worker", str(file)]
        try:
            subprocess.run(command, stdout=output, stderr=None if "DEBUG" in os.environ else output, timeout=timeout)
        except subprocess.TimeoutExpired:
            log(f"  given up after {timeout:.0f} s")
        if out.exists():
            return json.loads(out.read_text())
        output.seek(0)
        log("FAILED: " + task["common"]["renderer"] + "\n    " + "\n    ".join(output.read().splitlines()[-12:]))
    return []


def work(task):
    """Measures one picture by one renderer at all budgets."""
    geometry = np.load(task["geometry"])
    picture = views.Picture(vertices=geometry["vertices"], faces=geometry["faces"], **task["picture"])
    renderer = __import__(task["module"]).Renderer(picture, **task["settings"])
    mask = measure.interior(geometry["coverage"])
    rows, samples = [], 1
    renderer.render(1, 0)
    for budget in task["budgets"]:
        samples = renderer.possible(measure.samples_for(renderer, budget, samples, print))
        runs = [renderer.render(samples, 100 + seed) for seed in range(task["common"]["runs"])]
        rows.append({
            **task["common"],
            "version": renderer.version,
            "note": renderer.note,
            "budget": budget,
            "samples": samples,
            "seconds": float(np.mean([seconds for _, seconds, _ in runs])),
            "preparation": float(np.mean([preparation for *_, preparation in runs])),
            **measure.summary([image for image, *_ in runs], mask),
        })  # fmt: skip
    Path(task["out"]).write_text(json.dumps(rows))


def report(rows, comparison):
    """Returns the rows with their ratios to the baseline, and geometric means over pictures."""
    views_in_order, renderers = [view.name for view in comparison.views], list(comparison.renderers)
    place = lambda row: (row["depth"], row["budget"], views_in_order.index(row["view"]), row["material"], renderers.index(row["renderer"]))
    pictures = {}
    for row in sorted(rows, key=lambda row: row["round"]):
        pictures.setdefault(place(row), []).append(row)
    shown, ratios = [], {}
    for own_place in sorted(pictures):
        rounds = pictures[own_place]
        row, baselines = rounds[0], pictures.get((*own_place[:4], renderers.index(comparison.baseline)), [])
        own = {name: value for name, value in row.items() if name not in ("blocks", "round")}
        own["picture"] = f"{row['view']}, {row['material']}"
        own["ms_per_sample"] = float(np.mean([1000 * (row["seconds"] - row["preparation"]) / row["samples"] for row in rounds]))
        own.update(combined([compared(*pair) for pair in zip(rounds, baselines)]))
        shown.append(own)
        if "ratio" in own:
            group = ratios.setdefault((row["depth"], row["budget"], row["renderer"]), [])
            group.append([own["ratio"], own["ratio_per_sample"]])
    for (depth, budget, renderer), values in ratios.items():
        in_time, per_sample = np.exp(np.log(values).mean(0))
        shown.append({
            "picture": "geometric mean (pictures)", "depth": depth, "budget": budget, "renderer": renderer,
            "ratio_at_equal_time": f"{digits(in_time)} ({len(values)})",
            "ratio_at_equal_samples": f"{digits(per_sample)} ({len(values)})",
        })  # fmt: skip
    return shown


def compared(row, baseline):
    """Compares a row with the baseline; without a ratio if their pictures differ."""
    relative, error, blocks = measure.difference(row, baseline)
    own = {"mean_difference": relative, "mean_difference_error": error, "block_difference": blocks}
    if not measure.agree(row, baseline):
        log(
            f"LEFT OUT: {row['view']}, {row['material']}, depth {row['depth']}, {row['budget']:g} s: {row['renderer']}: its picture differs from that "
            f"of {baseline['renderer']}: the mean by {100 * relative:+.2f} % (standard error {100 * error:.2f} %), blocks by {100 * blocks:.2f} %"
        )
        return own
    ratio, low, high = measure.ratio(baseline, row)
    per_sample = baseline["variance"] * baseline["samples"] / (row["variance"] * row["samples"])
    return own | {"ratio": ratio, "ratio_low": low, "ratio_high": high, "ratio_per_sample": per_sample}


def combined(rounds):
    """Returns the comparison of all rounds: geometric means of ratios; their range instead of an interval if there is
    more than one."""
    if not rounds:
        return {}
    own = dict(rounds[0])
    without_ratio = [one for one in rounds if "ratio" not in one]
    if without_ratio:
        return without_ratio[0]
    for name in ("ratio", "ratio_per_sample"):
        own[name] = float(np.exp(np.mean(np.log([one[name] for one in rounds]))))
    if len(rounds) > 1:
        own["ratio_low"], own["ratio_high"] = (pick(one["ratio"] for one in rounds) for pick in (min, max))
    low, high = own["ratio_low"], own["ratio_high"]
    return own | {
        "ratio_at_equal_time": "1" if low == high == 1 else f"{digits(own['ratio'])} [{digits(low)}, {digits(high)}]",
        "ratio_at_equal_samples": digits(own["ratio_per_sample"]),
    }  # fmt: skip


def digits(value):
    """Formats three significant digits."""
    return f"{value:.{max(0, 2 - int(np.floor(np.log10(value))))}f}"


if __name__ == "__main__":
    main()
