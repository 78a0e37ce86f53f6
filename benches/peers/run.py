"""Training throughput of headtail beside PyTorch and JAX, interleaved, on the same cores.

    python benches/peers/run.py [--mode coupled|autoregressive] [--conditions 256] [--samples 1024] [--steps 5] [--rounds 3]

A step is forward, backward and AdamW on a batch in memory. Peers take turns for a number of rounds, and the
medians of their samples per second are printed with the ratio of headtail to each. headtail is measured by
`headtail backends --json`, whose program must be built (`cargo build --release`) or named by HEADTAIL.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path


def measure(step, samples, steps):
    step()
    start = time.perf_counter()
    for _ in range(steps):
        step()
    return samples * steps / (time.perf_counter() - start)


def headtail(options):
    program = os.environ.get("HEADTAIL")
    if program is None:
        target = os.environ.get("CARGO_TARGET_DIR", Path(__file__).resolve().parents[2] / "target")
        program = str(Path(target) / "release" / "headtail")
    command = [
        program, "backends", "--preset", "paper-ggx", "--mode", options.mode, "--gradient", "fused", "--json",
        "--conditions", str(options.conditions), "--samples", str(options.samples), "--steps", str(options.steps),
    ]
    rows = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    return rows[0]["samples_per_second"]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mode", choices=["coupled", "autoregressive"], default="coupled")
    parser.add_argument("--conditions", type=int, default=256)
    parser.add_argument("--samples", type=int, default=1024)
    parser.add_argument("--steps", type=int, default=5)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    sys.path.insert(0, str(Path(__file__).parent))
    count = options.conditions * options.samples

    import jax_step
    import pytorch

    steps = {
        "PyTorch eager": pytorch.Step(options.mode, options.conditions, options.samples, compiled=False),
        "PyTorch compiled": pytorch.Step(options.mode, options.conditions, options.samples, compiled=True),
        "JAX": jax_step.Step(options.mode, options.conditions, options.samples),
    }
    losses = {name: step() for name, step in steps.items()}
    spread = max(losses.values()) - min(losses.values())
    if spread > 1e-3 * abs(next(iter(losses.values()))):
        sys.exit(f"the peers do not compute the same loss: {losses}")
    rates = {name: [] for name in ["headtail", *steps]}
    for _ in range(options.rounds):
        rates["headtail"].append(headtail(options))
        for name, step in steps.items():
            rates[name].append(measure(step, count, options.steps))
    ours = statistics.median(rates["headtail"])
    print(f"{options.mode}, {options.conditions} conditions x {options.samples} samples, {os.cpu_count()} cores")
    for name, values in rates.items():
        rate = statistics.median(values)
        print(f"{name:<18} {rate / 1e6:8.3f} M samples/s   headtail is {ours / rate:5.2f} x")


if __name__ == "__main__":
    main()
