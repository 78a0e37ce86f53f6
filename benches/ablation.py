"""The paper's ablation on a neural material: what each part of the model is worth, unshadowed and in a picture.

python benches/ablation.py --headtail target/release/headtail --map MAP.hdr --out out/ablation

Five heads are trained alike, as the paper does it (forward KL, K = 32, no share beside BRDF sampling): the product without a tail, over the hierarchical tail, over a
fitted flow tail, with the encoder, with the entropic term; from the flow tail on, the rows add to each other. The MSE of `mis`, `mis2` and `patches` stands
beside them. The relative variance is that of an unshadowed estimate over the validation set of the training; the MSE is that of `compare` at equal samples.
"""

import argparse
import csv
import json
import statistics
import subprocess
from pathlib import Path

PLAIN = ["loss=forward-kl", "learning_rate=4e-3", "head.bins=32", "head.encoder=none", "head.share=false"]
ENCODED = [setting for setting in PLAIN if not setting.startswith("head.encoder")] + ["head.encoder.hidden=32", "head.encoder.output=32"]
VARIANTS = {
    "naive": (PLAIN, ["--naive"]),
    "hierarchical tail": (PLAIN, ["--tail", "hierarchical"]),
    "flow tail": (PLAIN, ["--tail", "flow"]),
    "+ encoder": (ENCODED, ["--tail", "flow"]),
    "+ entropic term": ([*ENCODED, "entropic=1e-4"], ["--tail", "flow"]),
}


def fitted(arguments, name, settings, options):
    """The summary of a training; what was trained before is not trained again."""
    folder = arguments.out / name.replace("+ ", "with-").replace(" ", "-")
    summary = folder / "summary.json"
    if not summary.exists():
        command = [arguments.headtail, "fit", "--preset", "fast-ggx", "--env", arguments.map, "--material", arguments.material]
        command += ["--conditions-from", arguments.scene, "--steps", str(arguments.steps), *options]
        for setting in [f"flow.steps={arguments.flow_steps}", *settings]:
            command += ["--set", setting]
        run = subprocess.run([*command, "--json", "--force", "--out", str(folder)], check=True, stdout=subprocess.PIPE, text=True)
        folder.mkdir(exist_ok=True)
        summary.write_text(run.stdout)
    return json.loads(summary.read_text()), folder / "sampler.safetensors"


def errors(arguments, specs):
    """Mean MSE by SPEC."""
    out = arguments.out / "compare"
    command = [arguments.headtail, "compare", "--scene", arguments.scene, "--env", arguments.map, "--material", arguments.material]
    command += ["--samplers", ",".join(specs), "--spp", str(arguments.spp), "--runs", str(arguments.runs), "--reference-spp", str(arguments.reference_spp)]
    command += ["--width", str(arguments.width), "--height", str(arguments.width * 3 // 4), "--force", "--out", str(out)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    found = {}
    with open(out / "results.csv") as file:
        for row in csv.DictReader(file):
            if row["run"].isdigit():
                found.setdefault(row["sampler"], []).append(float(row["mse"]))
    return {sampler: statistics.mean(of) for sampler, of in found.items()}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--headtail", default="headtail")
    parser.add_argument("--map", required=True)
    parser.add_argument("--scene", default="bedroom")
    parser.add_argument("--material", default="neural:checkpoints/welt.safetensors,repeat=24")
    parser.add_argument("--steps", type=int, default=2000)
    parser.add_argument("--flow-steps", type=int, default=1500)
    parser.add_argument("--spp", type=int, default=16)
    parser.add_argument("--runs", type=int, default=4)
    parser.add_argument("--reference-spp", type=int, default=1024)
    parser.add_argument("--width", type=int, default=128)
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    variances, files = {}, {}
    for name, (settings, options) in VARIANTS.items():
        summary, file = fitted(arguments, name, settings, options)
        variances[name] = summary["relative_variance"]
        files[name] = f"head:{file}"
    beside = ["mis", "mis2", "patches"]
    of = errors(arguments, [*beside, *files.values()])
    print("| | relative variance, unshadowed | MSE | MSE of the hierarchical tail over it |\n|---|---|---|---|")
    base = of[files["hierarchical tail"]]
    for name, variance in variances.items():
        error = of[files[name]]
        print(f"| {name} | {variance:.3g} | {error:.3g} | {base / error:.2f} |")
    for name in beside:
        print(f"| {name} | | {of[name]:.3g} | {base / of[name]:.2f} |")


if __name__ == "__main__":
    main()
