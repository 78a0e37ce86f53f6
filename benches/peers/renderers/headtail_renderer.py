"""headtail by its command line. Render times include the sampler's preparation."""

import json
import os
import subprocess
import tempfile
from pathlib import Path

import exr
from views import ALBEDO


def program():
    target = os.environ.get("CARGO_TARGET_DIR", Path(__file__).resolve().parents[3] / "target")
    return os.environ.get("HEADTAIL", str(Path(target) / "release" / "headtail"))


class Renderer:
    def __init__(self, picture, sampler="auto", points="lattice"):
        self.folder = tempfile.TemporaryDirectory()
        self.out = Path(self.folder.name) / "picture.exr"
        self.version = run([program(), "--version"]).split()[1]
        self.note = ""
        triple = lambda point: ",".join(f"{x:.9g}" for x in point)
        material = f"lambert:albedo={ALBEDO}" if picture.alpha is None else f"ggx:alpha={picture.alpha}"
        self.view = [
            "--scene", picture.glb, f"--look-from={triple(picture.look_from)}", f"--look-at={triple(picture.look_at)}",
            f"--fov={picture.fov}", f"--width={picture.width}", f"--height={picture.height}", "--json",
        ]  # fmt: skip
        self.command = [
            program(), "render", *self.view, "--env", picture.map, "--material", material, f"--depth={picture.depth}",
            f"--threads={picture.threads}", f"--sampler={sampler}", f"--points={points}", "--force", "--out", str(self.out),
        ]  # fmt: skip

    def possible(self, samples):
        """Any number of samples is possible."""
        return samples

    def render(self, samples, seed):
        """Returns (linear image, seconds, of which preparation seconds)."""
        report = json.loads(run([*self.command, f"--spp={samples}", f"--seed={seed}"]))
        if report["auto"]:
            self.note = report["sampler"]
        preparation = report["preparation_seconds"]
        return exr.read(self.out), preparation + report["seconds"], preparation

    def coverage(self):
        """Returns whether the centre of each pixel sees a surface."""
        run([*self.command, "--spp=1", "--aovs"])
        return exr.read(self.out.with_suffix(".aovs.exr"), "albedo").max(-1) > 0

    def portals(self):
        """Returns the room's portals as a script for Blender."""
        file = Path(self.folder.name) / "portals.py"
        run([program(), "inspect", "--portals", *self.view, "--out", str(file)])
        return file.read_text()


def run(command):
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}\n{done.stderr}")
    return done.stdout
