"""Variance at equal time inside Mitsuba 3: `headtail_direct` against `direct` in its best form, or `headtail_path`
against `path`.

    python benches/mitsuba/equal_time.py --data DATA
    python benches/mitsuba/equal_time.py --data DATA --paths

The views of `benches/peers/renderers/views.py`, diffuse and glossy, and the first of them with three area lights. Both
integrators take multijittered points, and one or four samples per hit; `direct` samples the map with MIS compensation.
The variance is that of RUNS pictures, so that none is another's reference, times the seconds of one. Ratios are those
of the best form of `direct` in the picture over each form. The rows `rays` have the ratio of a sampler
with the variance of `direct` that takes no time beside its rays, if variance falls as one over the number of samples.
With --paths, light meets up to three surfaces.
Needs mitsuba, numpy and headtail, and nothing else that runs. Prints a JSON list, and progress to the standard error.
"""

import argparse
import itertools
import json
import pathlib
import sys
import time

import drjit as dr
import mitsuba as mi
import numpy as np

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "benches" / "peers" / "renderers"))
mi.set_variant("llvm_ad_rgb")
# Warnings go to the standard output.
mi.set_log_level(mi.LogLevel.Error)
import headtail.mitsuba  # noqa: E402, F401
import views  # noqa: E402
from mitsuba_renderer import mesh_of  # noqa: E402

RUNS, SECONDS = 6, 1.0
WIDTH, HEIGHT = 256, 192
SAMPLES = (1, 4)


class Rays(mi.SamplingIntegrator):
    """A camera ray, and as many shadow rays as `direct` traces: one toward the map and one of the BSDF, here both of the
    cosine lobe."""

    def __init__(self, props):
        super().__init__(props)
        self.samples = int(props.get("shading_samples", 1))

    def sample(self, scene, sampler, ray, medium=None, active=True):
        si = scene.ray_intersect(ray, active)
        hit, seen = active & si.is_valid(), mi.Float(0)
        for _ in range(2 * self.samples):
            wi = si.to_world(mi.warp.square_to_cosine_hemisphere(sampler.next_2d(hit)))
            seen += dr.select(scene.ray_test(si.spawn_ray(wi), hit), 0.0, 1.0)
        return mi.Spectrum(seen), active, []

    def aov_names(self):
        return []


mi.register_integrator("rays", Rays)


def bsdf_of(alpha):
    if alpha is None:
        return {"type": "diffuse"}
    return {"type": "roughconductor", "material": "none", "distribution": "ggx", "alpha": alpha}


def lamps_above(look_from, look_at):
    """Returns three area lights around the middle of a view, above it and turned down."""
    middle, distance = np.array(look_at), np.linalg.norm(np.subtract(look_from, look_at))
    places = middle + distance * np.array([[-0.3, 0.4, 0.2], [0.3, 0.5, -0.1], [0.1, 0.4, 0.4]])
    down = [mi.ScalarTransform4f().translate(place.tolist()).rotate([1, 0, 0], 90).scale([0.06 * float(distance)] * 3) for place in places]
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": 4}}
    return {f"lamp {k}": {"type": "rectangle", "to_world": place, "emitter": emitter} for k, place in enumerate(down)}


def direct_of(integrator, samples):
    return {"type": integrator, "shading_samples": samples}


def path_of(integrator):
    # The camera, three surfaces and the map.
    return {"type": integrator, "max_depth": 4}


# What is compared; those of Mitsuba first.
DIRECT = [direct_of(*kind) for kind in itertools.product(("direct", "headtail_direct", "rays"), SAMPLES)]
PATHS = [path_of("path"), path_of("headtail_path")]


def name_of(kind):
    return f"{kind['type']}, {kind['shading_samples']} per hit" if "shading_samples" in kind else kind["type"]


def scene_of(opened, map, alpha, has_lamps, integrator):
    vertices, faces, look_from, look_at, fov = opened
    lamps = lamps_above(look_from, look_at) if has_lamps else {}
    return mi.load_dict({
        "type": "scene",
        "integrator": integrator,
        "sensor": {
            "type": "perspective", "fov": fov, "fov_axis": "y",
            "to_world": mi.ScalarTransform4f().look_at(list(look_from), list(look_at), [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT, "rfilter": {"type": "box"}},
            "sampler": {"type": "multijitter"},
        },
        "map": {"type": "envmap", "filename": str(map), "mis_compensation": integrator["type"] in ("direct", "path")},
        "mesh": mesh_of(vertices, faces, bsdf_of(alpha)), **lamps,
    })  # fmt: skip


def rendered(scene, spp, seed):
    start = time.perf_counter()
    picture = np.array(mi.render(scene, spp=spp, seed=seed))[..., :3]
    return picture, time.perf_counter() - start


def samples_of(scene):
    """Returns the samples per pixel of pictures of about SECONDS each."""
    # A number of samples has a kernel of its own, which the first picture compiles.
    rendered(scene, 16, 1)
    spp = max(1, round(16 * SECONDS / rendered(scene, 16, 2)[1]))
    rendered(scene, spp, 3)
    return spp


def measured(scenes):
    """Returns (samples per pixel, median seconds, variance, mean) of each scene, rendered in turn."""
    samples, pictures, times = [samples_of(scene) for scene in scenes], [[] for _ in scenes], [[] for _ in scenes]
    for run in range(RUNS):
        for k, scene in enumerate(scenes):
            picture, seconds = rendered(scene, samples[k], 10 + run)
            pictures[k].append(picture)
            times[k].append(seconds)
    for spp, own, seconds in zip(samples, pictures, times):
        values = np.stack(own).astype(np.float64)
        yield spp, float(np.median(seconds)), values.var(0, ddof=1).mean(), values.mean()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=pathlib.Path, required=True, help="the folder with scenes/ and envmaps/")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--paths", action="store_true", help="compare headtail_path with path")
    settings = parser.parse_args()
    kinds = PATHS if settings.paths else DIRECT
    dr.set_thread_count(settings.threads)
    rows = []
    for view, has_lamps in [(view, False) for view in views.VIEWS] + [(views.VIEWS[0], True)]:
        opened, map = views.opened(view, settings.data), settings.data / "envmaps" / f"{view.map}.hdr"
        for material in view.materials:
            picture = f"{view.name}, {material}{', three lamps' if has_lamps else ''}"
            scenes = [scene_of(opened, map, views.MATERIALS[material], has_lamps, kind) for kind in kinds]
            forms = []
            for kind, (spp, seconds, variance, mean) in zip(kinds, measured(scenes)):
                if kind["type"] == "rays":
                    form = forms[SAMPLES.index(kind["shading_samples"])]
                    variance, mean = form["variance"] * form["spp"] / spp, form["mean"]
                forms.append({
                    "picture": picture, "integrator": name_of(kind), "spp": spp, "seconds": seconds,
                    "variance": variance, "mean": mean, "version": mi.__version__, "threads": settings.threads,
                })  # fmt: skip
            of_mitsuba = [form for form in forms if form["integrator"].startswith(("direct", "path"))]
            best = min(form["variance"] * form["seconds"] for form in of_mitsuba)
            for form in forms:
                form["ratio"] = best / (form["variance"] * form["seconds"])
                print(picture, form["integrator"], f"{form['ratio']:.2f}", file=sys.stderr, flush=True)
            rows += forms
    print(json.dumps(rows, indent=1))


main()
