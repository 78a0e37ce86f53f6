"""Measures rays per second of Mitsuba's ray tracer (Embree) and of headtail's, without the rest of the
renderers."""

import re
import subprocess
import time

import drjit as dr
import mitsuba as mi

REPEATS = 6


def rate(work, rays):
    """Returns millions of rays per second, the best of several repeats."""
    best = float("inf")
    for _ in range(REPEATS):
        start = time.perf_counter()
        dr.eval(work())
        dr.sync_thread()
        best = min(best, time.perf_counter() - start)
    return rays / best / 1e6


def of_embree(scene, width, height, spp):
    """Returns (camera rays, shadow rays of cosine-distributed directions) in millions per second; for
    variants with arrays."""
    count = width * height * spp
    index, random = dr.arange(mi.UInt32, count) // spp, mi.PCG32(size=count)
    place = mi.Point2f(
        (mi.Float(index % width) + random.next_float32()) / width, (mi.Float(index // width) + random.next_float32()) / height
    )
    rays, _ = scene.sensors()[0].sample_ray(0.0, 0.5, place, mi.Point2f(0.5))
    dr.eval(rays)
    dr.sync_thread()
    camera = rate(lambda: scene.ray_intersect_preliminary(rays, coherent=True), count)
    hit = scene.ray_intersect(rays)
    side = dr.select(dr.dot(hit.n, -rays.d) > 0, mi.Float(1), mi.Float(-1))
    local = mi.warp.square_to_cosine_hemisphere(mi.Point2f(random.next_float32(), random.next_float32()))
    leaving = hit.spawn_ray(side * mi.Vector3f(mi.Frame3f(hit.n).to_world(local)))
    shadow = dr.gather(mi.Ray3f, leaving, dr.compress(hit.is_valid()))
    dr.eval(shadow)
    dr.sync_thread()
    occluded = rate(lambda: scene.ray_test(shadow), dr.width(shadow))
    return camera, occluded


def of_headtail(command, pixels, spp, coverage, threads):
    """Returns the same for `headtail render` with cosine sampling, from its timings; camera rays include the
    lookup of surface or background."""
    best = [0.0, 0.0]
    for _ in range(REPEATS):
        done = subprocess.run(command + ["--spp", str(spp), "--sampler", "cosine", "--points", "independent", "--timings"], capture_output=True, text=True, check=True)
        camera, shadow = (float(re.search(name + r" +([0-9.]+) s", done.stdout)[1]) for name in ("camera rays", "shadow rays"))
        per_hit = float(re.search(r"([0-9.]+) shadow rays", done.stdout)[1])
        rates = pixels * spp * threads / camera / 1e6, pixels * spp * coverage * per_hit * threads / shadow / 1e6
        best = [max(pair) for pair in zip(best, rates)]
    return best
