"""Inference of the head of the preset paper-ggx beside PyTorch, on one core.

    python benches/peers/inference.py [--rounds 3]

Every sample has its own condition; encoder and condition layers are included. headtail samples (through
`cargo bench --bench inference`), PyTorch evaluates densities, which takes the same arithmetic: the same
networks, and splines in the direction without root finding. Rounds alternate; medians are printed.
"""

import argparse
import re
import statistics
import subprocess
import time
from pathlib import Path

import torch

import problem
import pytorch

MODE = "coupled"


def headtail():
    """Returns millions of samples per second, the benchmark's median."""
    command = ["cargo", "bench", "--bench", "inference", "--", "sample", "--sample-count", "300"]
    root = Path(__file__).resolve().parents[2]
    lines = subprocess.run(command, check=True, capture_output=True, text=True, cwd=root).stdout.splitlines()
    inside = [index for index, line in enumerate(lines) if re.match(r"├─ sample\s", line)][0]
    row = next(i for i in range(inside, len(lines)) if "(PaperGgx, Coupled)" in lines[i])
    number, unit = re.findall(r"([\d.]+) ([KM])item/s", lines[row + 1])[2]
    return float(number) * (1.0 if unit == "M" else 1e-3)


def peer(function, samples, seconds=2.0):
    """Returns the same for a function that evaluates `samples` densities."""
    function()
    times, end = [], time.perf_counter() + seconds
    while time.perf_counter() < end:
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return samples / statistics.median(times) / 1e6


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    torch.set_num_threads(1)
    functions = {}
    with torch.inference_mode():
        for samples in (256, 4096):
            step = pytorch.Step(MODE, samples, 1, compiled=False)
            c, y, _ = step.batch
            for name, density in [("eager", step.log_density), ("compiled", torch.compile(step.log_density))]:
                functions[f"PyTorch {name}, batches of {samples}"] = (lambda f=density, c=c, y=y: f(c, y), samples)
        rates = {name: [] for name in ["headtail, batches of 256", *functions]}
        for _ in range(options.rounds):
            rates["headtail, batches of 256"].append(headtail())
            for name, (function, samples) in functions.items():
                rates[name].append(peer(function, samples))
    ours = statistics.median(rates["headtail, batches of 256"])
    print(f"K = {problem.BINS}, {MODE}, one core")
    for name, values in rates.items():
        rate = statistics.median(values)
        print(f"{name:<36} {rate:7.3f} M samples/s   headtail is {ours / rate:5.2f} x")


if __name__ == "__main__":
    main()
