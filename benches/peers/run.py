"""Training throughput of headtail beside PyTorch and JAX, interleaved, on the same cores or the same graphics card.

    python benches/peers/run.py [--device cpu|cuda] [--mode coupled|autoregressive] [--conditions 256] [--samples 1024]
        [--steps 5] [--rounds 3]

A step is forward, backward and AdamW on a batch in memory; losses are read after the last step. Peers take turns for a
number of rounds, and the medians of their samples per second are printed with the ratio of headtail to each. headtail is
measured by `headtail backends --json`, whose program must be built (`cargo build --release`, for cuda with
`--features gpu`) or named by HEADTAIL. On cuda, PyTorch and JAX may round products to TF32; headtail does not.
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
    float(step())
    start = time.perf_counter()
    for _ in range(steps):
        loss = step()
    float(loss)
    return samples * steps / (time.perf_counter() - start)


def headtail(options):
    program = os.environ.get("HEADTAIL")
    if program is None:
        target = os.environ.get("CARGO_TARGET_DIR", Path(__file__).resolve().parents[2] / "target")
        program = str(Path(target) / "release" / "headtail")
    command = [
        program, "backends", "--preset", "paper-ggx", "--mode", options.mode, "--json",
        "--gradient", {"cpu": "fused", "cuda": "device"}[options.device],
        "--conditions", str(options.conditions), "--samples", str(options.samples), "--steps", str(options.steps),
    ]
    rows = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    return rows[0]["samples_per_second"]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", choices=["cpu", "cuda"], default="cpu")
    parser.add_argument("--mode", choices=["coupled", "autoregressive"], default="coupled")
    parser.add_argument("--conditions", type=int, default=256)
    parser.add_argument("--samples", type=int, default=1024)
    parser.add_argument("--steps", type=int, default=5)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    sys.path.insert(0, str(Path(__file__).parent))
    count = options.conditions * options.samples
    # JAX would take most of a card's memory for itself.
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")

    import jax_step
    import pytorch

    sizes = options.mode, options.conditions, options.samples, options.device
    steps = {
        "PyTorch eager": pytorch.Step(*sizes, compiled=False),
        "PyTorch compiled": pytorch.Step(*sizes, compiled=True),
        "JAX": jax_step.Step(*sizes),
    }
    losses = {name: float(step()) for name, step in steps.items()}
    spread = max(losses.values()) - min(losses.values())
    if spread > 1e-3 * abs(next(iter(losses.values()))):
        sys.exit(f"the peers do not compute the same loss: {losses}")
    rates = {name: [] for name in ["headtail", *steps]}
    for _ in range(options.rounds):
        rates["headtail"].append(headtail(options))
        for name, step in steps.items():
            rates[name].append(measure(step, count, options.steps))
    ours = statistics.median(rates["headtail"])
    print(f"{options.mode}, {options.conditions} conditions x {options.samples} samples, {pytorch.name_of(options.device)}")
    for name, values in rates.items():
        rate = statistics.median(values)
        print(f"{name:<18} {rate / 1e6:8.3f} M samples/s   headtail is {ours / rate:5.2f} x")


if __name__ == "__main__":
    main()
