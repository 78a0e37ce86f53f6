"""The views for all renderers: triangles, camera, map and materials."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "tests" / "mitsuba"))
import scene

WIDTH, HEIGHT = 320, 240
ALBEDO = 0.5
# The GGX width of each material; diffuse without one.
MATERIALS = {"diffuse": None, "glossy": 0.4}


@dataclass
class View:
    """A scene under a map. Without a camera, the scene stands on a ground and the camera looks down at it."""

    name: str
    scene: str
    map: str
    camera: tuple | None = None  # (look from, look at, vertical field of view in degrees)
    materials: tuple = ("diffuse",)


VIEWS = [
    View("temple, lebombo", "japanese_temple", "lebombo_1k", None, ("diffuse", "glossy")),
    View("robots, venice", "terrarium_robots", "venice_sunset_1k", None, ("diffuse", "glossy")),
    View("shaderball, st peters", "usd_shaderball", "st_peters_square_night_1k", None, ("diffuse", "glossy")),
    View(
        "grey room, lebombo", "rooms/grey_white_room", "lebombo_1k",
        ([5.105, 0.731, -2.318], [4.143, 0.805, -2.054], 59.0), ("diffuse", "glossy"),
    ),
    View(
        "breakfast room, kloofendal", "rooms/breakfast_room", "kloofendal_overcast_1k",
        ([-0.196, 0.92, 3.238], [-0.192, 0.90, 2.905], 45.0), ("diffuse", "glossy"),
    ),
    View(
        "staircase, venice", "rooms/wooden_staircase", "venice_sunset_1k",
        ([0.0, 1.6, 1.5], [-0.1, 2.1, -2.5], 65.0), ("diffuse", "glossy"),
    ),
]  # fmt: skip
# All scenes that stand on a ground.
MESHES = [
    *[replace(view, materials=("diffuse",)) for view in VIEWS if not view.camera],
    View("bridge garden, kloofendal", "japanese_bridge_garden", "kloofendal_overcast_1k"),
    View("spot, studio", "spot", "studio_small_03_1k"),
]


@dataclass
class Picture:
    """The input of a renderer, in the axes of glTF: Y is up."""

    vertices: np.ndarray  # [n, 3]
    faces: np.ndarray  # [m, 3]
    look_from: list
    look_at: list
    fov: float  # vertical, in degrees
    width: int
    height: int
    map: str
    alpha: float | None  # of GGX; a diffuse material if None
    depth: int  # surfaces that light visits; 1 is direct light
    threads: int
    glb: str  # a file of the same triangles
    portals: str | None  # of rooms: the script of `headtail inspect --portals` for Blender


def opened(view, data):
    """Returns (vertices, faces, look from, look at, field of view) of a view."""
    vertices, faces = scene.read_glb(data / "scenes" / f"{view.scene}.glb")
    if view.camera:
        # Rooms do not use the ground of two triangles that the reader adds.
        return vertices[:-4], faces[:-2], *view.camera
    low, high = vertices[:-4].min(0), vertices[:-4].max(0)
    center, size = (low + high) / 2, np.linalg.norm(high - low)
    look_from = center + size * np.array([0.75, 0.45, 1.15]) / 1.15
    return vertices, faces, look_from.tolist(), center.tolist(), 38.0


def map_file(view, data):
    return data / "envmaps" / f"{view.map}.hdr"


def z_up(point):
    """Converts to the axes of Blender and LuxCore, where Z is up."""
    return [point[0], -point[2], point[1]]
