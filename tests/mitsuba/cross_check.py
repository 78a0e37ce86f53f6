"""Renders one scene with Mitsuba 3 and with headtail, and tests whether the images have the same mean.

    python tests/mitsuba/cross_check.py --headtail target/release/headtail
    python tests/mitsuba/cross_check.py --headtail target/release/headtail --scene temple.glb --env room.hdr --benchmark

Same triangles, camera, map and material; direct light only; a box filter. Every tile of the image is compared by Welch's t-test over
the runs; equal renderers fail with a probability of 1 %. Exit status: 0 if the images agree, 3 if they differ, other values
if they cannot be compared. --benchmark adds the time to equal error, and rays per second of whole renderings and of
the ray tracers alone."""

import argparse
import os
import pathlib
import re
import subprocess
import sys
import tempfile
import time

import mitsuba as mi
import numpy as np
from scipy import stats

import rays
import scene

SIGNIFICANCE = 0.01
# Exit status of differing images; an uncaught exception is 1, invalid arguments are 2.
DIFFERENT = 3
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--headtail", required=True, type=pathlib.Path, help="the program")
    parser.add_argument("--scene", type=pathlib.Path, help=".glb file; default: a ball and two blocks")
    parser.add_argument("--env", type=pathlib.Path, help="map; default: a sky with a small lamp")
    parser.add_argument("--material", default="lambert:albedo=0.5", help="lambert:albedo=A or ggx:alpha=A")
    parser.add_argument("--wrong-material", help="give headtail this one instead: the images must then differ")
    parser.add_argument("--sampler", default="mis2", help="headtail's sampler; mis2 is what Mitsuba's direct integrator does")
    parser.add_argument("--width", type=int, default=96)
    parser.add_argument("--spp", type=int, default=64)
    parser.add_argument("--runs", type=int, default=12)
    parser.add_argument("--tile", type=int, default=12, help="edge of a tile in pixels")
    parser.add_argument("--variant", default="llvm_ad_rgb", choices=["llvm_ad_rgb", "scalar_rgb"])
    parser.add_argument("--benchmark", action="store_true")
    return parser.parse_args()


def sky(path):
    """Writes a smooth sky over darker ground, with a lamp 400x as bright."""
    height, width = 32, 64
    v, u = np.meshgrid(np.linspace(0, 1, height), (np.arange(width) + 0.5) / width, indexing="ij")
    base = np.where(v < 0.5, 1.0 - v, 0.25)[..., None] * [0.7, 0.85, 1.0] * (1 + 0.3 * np.sin(2 * np.pi * u))[..., None]
    base[9:11, 20:22] = [400, 360, 300]
    mi.Bitmap(base.astype(np.float32)).write(str(path))


def camera(vertices, faces):
    """Returns (from, at, vertical field of view) of a view from above on everything but the ground."""
    things = vertices[:-4]
    low, high = things.min(0), things.max(0)
    center, size = (low + high) / 2, np.linalg.norm(high - low)
    return center + size * np.array([0.75, 0.45, 1.15]) / 1.15, center, 38.0


def bsdf(material):
    kind, _, settings = material.partition(":")
    value = float(settings.partition("=")[2] or 1)
    if kind == "lambert":
        lobe = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [value] * 3}}
    else:
        import height_correlated  # noqa: F401  (registers the plugin for this variant)

        lobe = {"type": "height_correlated", "alpha": value}
    return {"type": "twosided", "nested": lobe}


class Mitsuba:
    """Mitsuba's `direct` integrator: one emitter and one BSDF sample, power heuristic."""

    def __init__(self, options, vertices, faces, map_file, view, height):
        origin, target, fov = view
        mesh = mi.Mesh("mesh", len(vertices), len(faces), props=self.properties(options.material))
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = vertices.astype(np.float32).ravel()
        parameters["faces"] = faces.astype(np.uint32).ravel()
        parameters.update()
        self.scene = mi.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "direct"},
                "sensor": {
                    "type": "perspective",
                    "fov": fov,
                    "fov_axis": "y",
                    "to_world": mi.ScalarTransform4f().look_at(origin=list(origin), target=list(target), up=[0, 1, 0]),
                    "film": {"type": "hdrfilm", "width": options.width, "height": height, "rfilter": {"type": "box"}},
                },
                "light": {"type": "envmap", "filename": str(map_file)},
                "mesh": mesh,
            }
        )

    @staticmethod
    def properties(material):
        properties = mi.Properties()
        properties["mesh_bsdf"] = mi.load_dict(bsdf(material))
        properties["face_normals"] = True
        return properties

    def render(self, spp, seed):
        """(linear image [height, width, 3], seconds)"""
        start = time.perf_counter()
        image = np.array(mi.render(self.scene, spp=spp, seed=seed))
        return image[..., :3], time.perf_counter() - start

    def coverage(self, width, height):
        """Returns the fraction of pixel centres that see a surface."""
        sensor = self.scene.sensors()[0]
        y, x = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")

        def hits(place, aperture):
            ray, _ = sensor.sample_ray(0.0, 0.5, place, aperture)
            return np.mean(np.array(self.scene.ray_test(ray)))

        if "scalar" not in mi.variant():
            return float(hits(mi.Point2f(x.ravel(), y.ravel()), mi.Point2f(0.5)))
        return float(np.mean([hits(mi.Point2f(u, v), mi.Point2f(0.5)) for u, v in zip(x.ravel(), y.ravel())]))


class Headtail:
    """The program, with its files in a folder."""

    def __init__(self, options, folder, map_file, view, height):
        origin, target, fov = view
        triple = lambda point: ",".join(f"{x:.9g}" for x in point)
        self.out = folder / "ours.exr"
        self.command = [
            options.headtail.resolve(), "render", "--scene", folder / "scene.glb", "--env", map_file, "--material", options.wrong_material or options.material,
            f"--look-from={triple(origin)}", f"--look-at={triple(target)}", "--fov", fov,
            "--width", options.width, "--height", height, "--out", self.out, "--force",
        ]  # fmt: skip
        self.command = [str(part) for part in self.command]
        self.sampler = options.sampler

    def render(self, spp, seed):
        """(linear image, seconds, shadow rays per light estimate)"""
        command = self.command + ["--sampler", self.sampler, "--spp", str(spp), "--seed", str(seed), "--points", "independent"]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode != 0:
            sys.exit(f"headtail: {done.stderr.strip()}")
        said = re.search(r"in ([0-9.]+) s, ([0-9.]+) shadow rays", done.stdout)
        image = np.array(mi.Bitmap(str(self.out)).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False))
        return image, float(said[1]), float(said[2])


def tile_means(images, edge):
    """Returns [runs, tiles] mean luminance."""
    luminance = np.stack(images) @ LUMINANCE
    runs, height, width = luminance.shape
    rows, columns = height // edge, width // edge
    cut = luminance[:, : rows * edge, : columns * edge]
    return cut.reshape(runs, rows, edge, columns, edge).mean((2, 4)).reshape(runs, -1)


def judge(theirs, ours, edge):
    """Applies Welch's test to every tile, with the threshold corrected after Šidák; True if no tile
    differs."""
    a, b = tile_means(theirs, edge), tile_means(ours, edge)
    p = stats.ttest_ind(a, b, axis=0, equal_var=False).pvalue
    # Tiles without noise, which show only sky, must be equal to rounding.
    flat = (a.std(0) < 1e-6 * a.mean(0)) & (b.std(0) < 1e-6 * b.mean(0))
    p = np.where(flat, np.where(np.isclose(a.mean(0), b.mean(0), rtol=1e-4), 1.0, 0.0), p)
    threshold = 1 - (1 - SIGNIFICANCE) ** (1 / p.size)
    ratio = b.mean() / a.mean()
    noise = np.hypot(stats.sem(b.mean(1)), stats.sem(a.mean(1))) / a.mean()
    worst = int(np.argmin(p))
    deviation = b.mean(0)[worst] / a.mean(0)[worst] - 1
    print(f"mean luminance: headtail / Mitsuba = {ratio:.5f} +- {noise:.5f} (standard error)")
    print(f"tiles: {(p < threshold).sum()} of {p.size} differ; smallest p = {p.min():.2g} (threshold {threshold:.2g}), {100 * deviation:+.2f} % there")
    return bool((p >= threshold).all())


def benchmark(options, theirs, ours, times, shadow_rays, coverage):
    """Prints rays per second and the time to equal error over all runs; errors are against the mean of all
    images of both."""
    pixels = theirs[0].shape[0] * theirs[0].shape[1]
    # Mitsuba traces a shadow ray and a BSDF ray at each hit (the integrator does not report how many it
    # skips).
    per_sample = {"Mitsuba": 1 + 2 * coverage, "headtail": 1 + shadow_rays * coverage}
    # Excluding a run from its own reference keeps the error unbiased up to the reference's error.
    everything = np.stack(theirs + ours).sum(0)
    count = len(theirs) + len(ours)
    ttuv = {}
    for name, images in (("Mitsuba", theirs), ("headtail", ours)):
        mse = np.mean([np.mean((image - (everything - image) / (count - 1)) ** 2) for image in images])
        seconds = float(np.median(times[name]))
        ttuv[name] = mse * seconds
        rate = per_sample[name] * pixels * options.spp / seconds / 1e6
        print(f"{name:9} {seconds:8.3f} s per image, {rate:7.2f} million rays per second, MSE {mse:.4g}, MSE x time {ttuv[name]:.4g}")
    print(f"headtail needs 1 / {ttuv['Mitsuba'] / ttuv['headtail']:.2f} of Mitsuba's time for the same error ({options.sampler})")


def main():
    options = arguments()
    mi.set_variant(options.variant)
    height = options.width * 3 // 4
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        vertices, faces = scene.read_glb(options.scene) if options.scene else scene.small()
        scene.write_glb(folder / "scene.glb", vertices, faces)
        map_file = options.env or folder / "sky.exr"
        if options.env is None:
            sky(map_file)
        view = camera(vertices, faces)
        mitsuba = Mitsuba(options, vertices, faces, map_file, view, height)
        headtail = Headtail(options, folder, map_file, view, height)
        mitsuba.render(options.spp, 10_000)  # compiles
        theirs, ours, shadow_rays = [], [], 0.0
        times = {"Mitsuba": [], "headtail": []}
        for run in range(options.runs):
            image, seconds = mitsuba.render(options.spp, run)
            theirs.append(image)
            times["Mitsuba"].append(seconds)
            image, seconds, shadow_rays = headtail.render(options.spp, run + 1)
            ours.append(image)
            times["headtail"].append(seconds)
        print(f"{options.scene or 'small scene'} ({len(faces)} triangles), {options.material}, {options.variant}, {options.runs} runs of {options.spp} spp")
        agree = judge(theirs, ours, options.tile)
        if options.benchmark:
            coverage = mitsuba.coverage(options.width, height)
            benchmark(options, theirs, ours, times, shadow_rays, coverage)
            if "llvm" in options.variant:
                alone = rays.of_embree(mitsuba.scene, options.width, height, 16)
                print(f"Embree alone:   camera rays {alone[0]:.1f}, shadow rays of cosine sampling {alone[1]:.1f} million per second")
                pixels = options.width * height
                alone = rays.of_headtail(headtail.command, pixels, options.spp, coverage, os.cpu_count())
                print(f"headtail alone: camera rays with surfaces {alone[0]:.1f}, shadow rays of cosine sampling {alone[1]:.1f} million per second")
    print("the images agree" if agree else "THE IMAGES DIFFER")
    sys.exit(0 if agree else DIFFERENT)


if __name__ == "__main__":
    main()
