"""The choice of `auto`: patches, or pairs of compensated MIS, by small pictures of both."""

import drjit as dr
import mitsuba as mi
import numpy as np

WIDTH, HEIGHT, SAMPLES = 48, 36, 16
SEEDS = 0x7069_6C31, 0x7069_6C32
# Fraction of pixels with the greatest differences that is left out, so that no single pixel decides.
TRIMMED = 0.01
# The exponent by which errors fall with the number of samples: of stratified points as of the program's own.
FALL, FALL_INDEPENDENT = 1.4, 1.0
# Fraction of the most light that a candidate saw, below which it has missed light: its error says nothing.
MISSED = 0.5


def camera_rays(sensor, seed):
    """Returns a sampler, and rays through WIDTH x HEIGHT pixels with SAMPLES in each, pixel by pixel."""
    sampler, count = sensor.sampler().clone(), WIDTH * HEIGHT * SAMPLES
    sampler.set_sample_count(SAMPLES)
    sampler.set_samples_per_wavefront(SAMPLES)
    sampler.seed(seed, count)
    pixel = dr.arange(mi.UInt32, count) // SAMPLES
    place = mi.Point2f(mi.Float(pixel % WIDTH), mi.Float(pixel // WIDTH)) + sampler.next_2d()
    lens = sampler.next_2d() if sensor.needs_aperture_sample() else mi.Point2f(0.5)
    ray, _ = sensor.sample_ray(0, sampler.next_1d(), place / mi.Point2f(WIDTH, HEIGHT), lens)
    return sampler, ray


def picture(light, scene, sensor, seed):
    """Returns the environment's light that each pixel's surfaces reflect."""
    sampler, ray = camera_rays(sensor, seed)
    si = scene.ray_intersect(ray)
    hit, bsdf = si.is_valid(), si.bsdf(ray)
    prepared = light.prepare(ray, si, bsdf, hit)
    reflected = light.reflected(scene, sampler, ray, si, bsdf, prepared, hit, mi.Bool(False))
    # Where nothing is hit, there is one number for all.
    return np.broadcast_to(np.array(dr.mean(reflected)), WIDTH * HEIGHT * SAMPLES).reshape(-1, SAMPLES).mean(1)


def error_and_light(light, scene, sensor):
    """Returns half the mean squared difference of two pictures, and their mean, without the worst pixels."""
    a, b = (picture(light, scene, sensor, seed) for seed in SEEDS)
    kept = np.argsort(np.square(a - b))[: len(a) - int(TRIMMED * len(a))]
    return np.square(a - b)[kept].mean() / 2, (a + b)[kept].mean() / 2


def choose(lights, costs, scene, sensor):
    """Returns the index of the light with the least error in a given time that missed no light."""
    fall = FALL_INDEPENDENT if sensor.sampler().class_name() == "IndependentSampler" else FALL
    with dr.suspend_grad():
        found = [error_and_light(light, scene, sensor) for light in lights]
    most = max(light for _, light in found)
    prices = [error * cost**fall if light >= MISSED * most else np.inf for (error, light), cost in zip(found, costs)]
    return int(np.argmin(prices))
