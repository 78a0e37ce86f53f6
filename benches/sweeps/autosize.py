"""autosize against an exhaustive comparison of all its candidates: regret in MSE at equal time, and the time that each takes.

python benches/sweeps/autosize.py --headtail target/release/headtail --data ../shared/data --out out/regret

`autosize` chooses. `autosize --exhaustive` prepares and times every candidate, and `compare` measures all of them in several runs each, for equal times (--seconds). A candidate's score
is its MSE times the time of its run, over the time that is left of --render-seconds once it is prepared. Regret is what the choice's score is above the least one. The
exhaustive way takes the preparation of all candidates and the comparison.

On a machine that does other things, --spp takes the place of --seconds: MSE is then that of equal samples, and the time of a sample that which `autosize --exhaustive`
measures by the processor's clock, all candidates in turn in one process.
"""

import argparse
import csv
import json
import statistics
import subprocess
import time
from pathlib import Path

# Scene, map, material.
PAIRS = [
    ("temple", "lebombo_1k.hdr", "lambert"),
    ("dishes", "studio_small_03_1k.hdr", "ggx:alpha=0.1"),
    ("droid", "venice_sunset_1k.hdr", "ggx:alpha=0.4"),
    ("bedroom", "spiaggia_di_mondello_1k.hdr", "lambert"),
    ("scenes/spot.glb", "dancing_hall_1k.hdr", "ggx:alpha=0.1..0.6"),
    ("cloth", "forest_slope_1k.hdr", "lambert"),
    ("diorama", "st_peters_square_night_1k.hdr", "ggx:alpha=0.05"),
    ("scenes/japanese_temple.glb", "kloofendal_overcast_1k.hdr", "lambert"),
]


def run(arguments, command, out, name):
    """The seconds that a command takes, by the clock and by the processor; what was run before is not run again."""
    times = out / f"{name}.json"
    if not times.exists():
        start, used_file = time.monotonic(), out / f"{name}.used"
        with open(out / f"{name}.log", "w") as messages:
            whole = ["/usr/bin/time", "-f", "%U %S", "-o", str(used_file), arguments.headtail, *command]
            subprocess.run([*whole, "--out", str(out / name), "--force"], check=True, stdout=messages, stderr=subprocess.STDOUT)
        used = sum(float(number) for number in used_file.read_text().split())
        times.write_text(json.dumps([time.monotonic() - start, used]))
    return json.loads(times.read_text())


def prepared_alone(records):
    """Seconds to prepare all candidates, each file counted once: what is made of another candidate's file has that one's preparation in its own."""
    prepared = {record["name"]: record["prepared_seconds"] for record in records}
    return sum(record["prepared_seconds"] - prepared.get(record["base"], 0.0) for record in records)


def compared_scores(out, records, arguments):
    """By name of the candidate: MSE at equal time once it is prepared, up to a common factor."""
    runs = {}
    with open(out / "compare/results.csv") as file:
        for row in csv.DictReader(file):
            if row["run"].isdigit():
                error = float(row["mse"]) * float(row["spp"]) if arguments.spp else float(row["ttuv"])
                runs.setdefault(row["sampler"], []).append(error)
    time_of = lambda record: record["sample_seconds"] if arguments.spp else 1
    left = lambda record: arguments.render - record["prepared_seconds"]
    score = lambda record: statistics.mean(runs[record["sampler"]]) * time_of(record) / left(record)
    return {record["name"]: score(record) for record in records if left(record) > 0}


def missing_choices(records, choices):
    """What autosize chose and the exhaustive way had not: forms of the best table, where that was another one. Time of a sample as on the exhaustive way,
    by the median ratio over what both have measured: a process may be slower than another as a whole."""
    seconds = {record["name"]: record["sample_seconds"] for record in records}
    ratios = [seconds[r["name"]] / r["sample_seconds"] for r in choices if r["name"] in seconds]
    missing = [r for r in choices if (r["winner"] or r["cheapest"]) and r["name"] not in seconds]
    return [r | {"sample_seconds": r["sample_seconds"] * statistics.median(ratios)} for r in missing]


def measure(arguments, scene, env, material):
    view = ["--env", str(arguments.data / "envmaps" / env), "--material", material]
    view += ["--scene", str(arguments.data / scene), "--ground"] if "/" in scene else ["--scene", scene]
    view += ["--width", str(arguments.width), "--height", str(arguments.height)]
    budget = ["--prepare-seconds", str(arguments.prepare), "--render-seconds", str(arguments.render)]
    out = arguments.out / f"{Path(scene).stem}-{Path(env).stem}"
    out.mkdir(parents=True, exist_ok=True)
    whole, whole_cpu = run(arguments, ["autosize", *view, *budget, "--exhaustive"], out, "all")
    records = json.loads((out / "all/autosize.json").read_text())
    within = [r for r in records if r["prepared_seconds"] <= arguments.prepare or r["bytes"] == 0]
    choices = []
    if not arguments.exhaustive_only:
        short, short_cpu = run(arguments, ["autosize", *view, *budget], out, "short")
        choices = json.loads((out / "short/autosize.json").read_text())
    within += missing_choices(within, choices)
    samplers = ",".join(record["sampler"] for record in within)
    runs = ["--spp", str(arguments.spp)] if arguments.spp else ["--seconds", str(arguments.seconds)]
    runs += ["--runs", str(arguments.runs)]
    compared, compared_cpu = run(arguments, ["compare", *view, *runs, "--samplers", samplers], out, "compare")
    if arguments.exhaustive_only:
        return None
    chosen, cheapest = (next(r["name"] for r in choices if r[role]) for role in ("winner", "cheapest"))
    scores = compared_scores(out, within, arguments)
    best = min(scores, key=scores.get)
    behind = lambda name: f"{100 * (scores[name] / scores[best] - 1):.1f}"
    # With --seconds, autosize's own pictures of all candidates are no part of the exhaustive way.
    exhaustive = (whole if arguments.spp else prepared_alone(records)) + compared
    return dict(
        scene=Path(scene).stem, env=Path(env).stem, material=material, choice=chosen, cheapest=cheapest, best=best,
        regret=behind(chosen), regret_of_cheapest=behind(cheapest), candidates=len(records), compared=len(within),
        seconds=f"{short:.0f}", exhaustive_seconds=f"{exhaustive:.0f}", share=f"{short / exhaustive:.3f}",
        cpu_seconds=f"{short_cpu:.0f}", exhaustive_cpu_seconds=f"{whole_cpu + compared_cpu:.0f}",
        share_of_cpu=f"{short_cpu / (whole_cpu + compared_cpu):.3f}",
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--headtail", default="headtail")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--width", type=int, default=96)
    parser.add_argument("--height", type=int, default=72)
    parser.add_argument("--prepare", type=float, default=30, help="seconds of preparation, at most")
    parser.add_argument("--render", type=float, default=60, help="seconds of preparation and rendering")
    parser.add_argument("--seconds", type=float, default=1, help="the equal time of the comparison")
    parser.add_argument("--spp", type=int, help="samples in the place of --seconds")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--exhaustive-only", action="store_true", help="leave autosize itself for another call")
    parser.add_argument("--only", type=int, nargs="*", help="numbers of pairs, from 0")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    writer = None
    with open(arguments.out / "regret.csv", "w") as file:
        for number, pair in enumerate(PAIRS):
            if arguments.only is not None and number not in arguments.only:
                continue
            row = measure(arguments, *pair)
            if row is None:
                continue
            if writer is None:
                writer = csv.DictWriter(file, list(row))
                writer.writeheader()
            writer.writerow(row)
            file.flush()
            print(row, flush=True)


if __name__ == "__main__":
    main()
