"""Ten thousand trials: the time of plan, status, collect and report, and the size of the page. No trial is run: a journal says that all are done.

python benches/sweeps/many.py --headtail target/release/headtail --out out/many [--map ../shared/data/envmaps/lebombo_1k.hdr]
"""

import argparse
import json
import math
import random
import subprocess
import time
from pathlib import Path

SPACE = """
objectives = ["relative_variance", "ns_per_sample", "weights"]
[run]
steps = 100
[axes]
env = {maps}
seed = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9]
head.bins = [4, 8, 16, 32]
head.hidden = {{ log_integer = [8, 96] }}
learning_rate = {{ log = [1e-3, 1e-1] }}
loss = ["log-chi-square", "forward-kl"]
[search]
method = "random"
n = 500
seed = 1
[aggregate]
over = ["env", "seed"]
"""


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--headtail", default="headtail")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--map", action="append", default=[], help="two maps; by default built-in ones")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    space = arguments.out / "space.toml"
    space.write_text(SPACE.format(maps=json.dumps(arguments.map or ["studio", "window"])))

    def run(*command):
        start = time.monotonic()
        output = subprocess.run([arguments.headtail, "sweep", command[0], str(space), *command[1:]], check=True, capture_output=True)
        return output.stdout, time.monotonic() - start

    trials = json.loads(run("plan", "--json")[0])
    random.seed(1)
    journal = arguments.out / "space.sweep/journal"
    journal.mkdir(parents=True, exist_ok=True)
    with open(journal / "0-script-0.jsonl", "w") as file:
        for number, trial in enumerate(trials):
            own = trial["assignment"]
            rate = math.log(own["learning_rate"] / 1e-2) ** 2
            figures = {
                "relative_variance": 0.1 * math.exp(0.1 * rate + 0.1 * random.gauss(0, 1)) * (1.2 if own["loss"] == "forward-kl" else 1),
                "ns_per_sample": 100 + 2 * own["head.hidden"] + own["head.bins"],
                "weights": own["head.hidden"] ** 2 * 6.0,
            }
            line = {"time": 1.0 + number, "event": "done", "trial": trial["id"], "measures": figures, "seconds": 1.0}
            file.write(json.dumps(line) + "\n")
    print("trials", len(trials))
    for command in ("plan", "status", "collect", "report"):
        print(command, f"{min(run(command)[1] for _ in range(3)):.2f} s")
    print("page", f"{(arguments.out / 'space.sweep/report.html').stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
