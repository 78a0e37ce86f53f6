"""Portals of rooms: from files, and found in the meshes of a scene."""

import math

import drjit as dr
import mitsuba as mi
import numpy as np

from headtail import HeadtailError, _native

from ._pilot import camera_rays

# The sampler of the light through portals that are found; those of a file are `FOUND:FILE`.
FOUND = "mis2:portals"
# Fraction of diffuse rays from the visible surfaces that reach the environment, above which a scene is no room.
OPEN = 0.4
# Fraction of the light that portals cover, below which they are not tried: few samples find the rest, whose noise a small
# pilot does not see.
LEAST_COVERAGE = 0.98
SEED = 0x726F_6F6D


def is_portals(spec):
    """Returns whether a specification names portals."""
    return spec == FOUND or spec.startswith(f"{FOUND}:")


def portals_of_file(spec):
    return _native.read_portals(spec[len(FOUND) + 1 :])


def find_portals(scene, sensor):
    """Returns the portals of the room that a sensor is in."""
    camera = camera_of(sensor)
    if camera is None:
        raise HeadtailError(f"{FOUND}: {sensor.class_name()} has no perspective; name a file of portals, as in {FOUND}:FILE")
    portals, _, _ = _native.find_portals(*triangles_of(scene), camera)
    return portals


def portals_for_auto(scene, sensor):
    """Returns the portals of a room that most of its light comes through, or None, and whether they need no pilot."""
    camera = camera_of(sensor)
    if camera is None or openness(scene, sensor) > OPEN:
        return None, False
    try:
        portals, coverage, need_no_pilot = _native.find_portals(*triangles_of(scene), camera)
    except HeadtailError:  # it is no room, or no light enters
        return None, False
    return (portals, need_no_pilot) if coverage >= LEAST_COVERAGE else (None, False)


def openness(scene, sensor):
    """Returns the fraction of diffuse rays from the visible surfaces that reach the environment; 1 without surfaces."""
    with dr.suspend_grad():
        sampler, ray = camera_rays(sensor, SEED)
        si = scene.ray_intersect(ray)
        wi = si.to_world(dr.mulsign(mi.warp.square_to_cosine_hemisphere(sampler.next_2d()), si.wi.z))
        hit = si.is_valid()
        hits = dr.count(hit)[0]
        return dr.count(hit & ~scene.ray_test(si.spawn_ray(wi), hit))[0] / hits if hits else 1.0


def camera_of(sensor):
    """Returns position, target and vertical field of view in degrees of a perspective sensor; None for others."""
    parameters = mi.traverse(sensor)
    if "x_fov" not in parameters:
        return None
    to_world = np.array(sensor.world_transform().matrix, np.float64).reshape(4, 4)
    width, height = sensor.film().size()
    half_width = math.tan(math.radians(0.5 * float(np.array(parameters["x_fov"]).ravel()[0])))
    fov = 2 * math.degrees(math.atan(half_width * float(height) / float(width)))
    position, forward = to_world[:3, 3], to_world[:3, 2]
    return position.tolist(), (position + forward).tolist(), min(fov, 170.0)


def triangles_of(scene):
    """Returns the vertices [count, 3] and triangles [count, 3] of the meshes of a scene; other shapes are left out."""
    vertices, triangles, count = [np.zeros((0, 3), np.float32)], [np.zeros((0, 3), np.uint32)], 0
    for shape in scene.shapes():
        if shape.is_mesh():
            own = np.array(dr.detach(shape.vertex_positions_buffer()), np.float32).reshape(-1, 3)
            faces = np.array(shape.faces_buffer(), np.uint32).reshape(-1, 3)
            vertices.append(own)
            triangles.append(faces + np.uint32(count))
            count += len(own)
    return np.ascontiguousarray(np.concatenate(vertices)), np.ascontiguousarray(np.concatenate(triangles))
