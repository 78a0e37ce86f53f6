"""Successive halving against plain random search at equal core-seconds, several seeds: who finds the better head.

python benches/sweeps/halving.py --headtail target/release/headtail --out out/halving --env studio

Both search the same ranges, one worker and one thread each. Halving works off its 27 configurations; random search then gets as many core-seconds: of its
trials, in their order, those count that fit into them.
"""

import argparse
import csv
import subprocess
from pathlib import Path

SPACE = """
objectives = ["relative_variance"]
[run]
env = "{env}"
steps = {last}
conditions = 32
validate_every = {first}
[axes]
head.bins = [2, 4, 8, 16, 32]
head.hidden = {{ log_integer = [8, 96] }}
head.mode = ["coupled", "autoregressive"]
learning_rate = {{ log = [1e-4, 1e-1] }}
beta_2 = [0.9, 0.99, 0.999]
loss = ["log-chi-square", "forward-kl", "chi-square"]
[search]
method = "random"
n = {n}
seed = {seed}
"""
HALVING = """
[halving]
rungs = {rungs}
keep = 3
"""


def sweep(arguments, name, text):
    space = arguments.out / f"{name}.toml"
    space.write_text(text)
    for action in (["run", "--jobs", "1", "--threads", "1"], ["collect"]):
        command = [arguments.headtail, "sweep", action[0], str(space), *action[1:]]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    with open(space.with_suffix(".sweep") / "trials.csv") as file:
        return list(csv.DictReader(file))


def best(rows):
    """The least variance of whole runs."""
    return min((float(row["relative_variance"]) for row in rows if row["state"] == "done"), default=float("inf"))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--headtail", default="headtail")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--env", default="studio")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--rungs", type=int, nargs=3, default=[100, 300, 900])
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    print("seed,core_seconds,halving,halving_whole_runs,random,random_whole_runs")
    for seed in range(arguments.seeds):
        values = dict(env=arguments.env, seed=seed, first=arguments.rungs[0], last=arguments.rungs[2])
        text = SPACE.format(n=27, **values) + HALVING.format(rungs=arguments.rungs)
        halving = sweep(arguments, f"halving-{seed}", text)
        budget = sum(float(row["work_seconds"]) for row in halving)
        drawn = sweep(arguments, f"random-{seed}", SPACE.format(n=24, **values))
        spent, within = 0.0, []
        for row in drawn:
            spent += float(row["work_seconds"])
            if spent <= budget:
                within.append(row)
        whole = sum(row["state"] == "done" for row in halving)
        print(f"{seed},{budget:.1f},{best(halving):.4f},{whole},{best(within):.4f},{len(within)}", flush=True)


if __name__ == "__main__":
    main()
