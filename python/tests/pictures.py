"""A scene under an environment map in Mitsuba, and the comparison of its pictures by means of tiles."""

import numpy as np
import pytest

mi = pytest.importorskip("mitsuba")
stats = pytest.importorskip("scipy.stats")

import headtail  # noqa: E402

MATERIALS = {
    "diffuse": {"type": "twosided", "nested": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.5, 0.3]}}},
    "glossy": {"type": "twosided", "nested": {"type": "roughconductor", "alpha": 0.3, "distribution": "ggx"}},
    "textured": {
        "type": "twosided",
        "nested": {
            "type": "principled",
            "base_color": {"type": "checkerboard"},
            "roughness": {"type": "checkerboard", "color0": 0.3, "color1": 0.7},
            "metallic": 0.5,
        },
    },
    "bumped": {
        "type": "twosided",
        "nested": {"type": "bumpmap", "arbitrary": {"type": "bitmap", "raw": True}, "nested": {"type": "diffuse"}, "scale": 0.2},
    },
    "plastic": {"type": "plastic"},
}

TILE, RUNS, SPP = 16, 8, 32
# Tests of means over variants, materials, samplers and kinds, for correcting the significance level.
TESTS = 100


def scene(material, integrator, **more):
    transform = mi.ScalarTransform4f
    waves = 0.5 + 0.5 * np.sin(np.linspace(0, 20 * np.pi, 256, dtype=np.float32))
    MATERIALS["bumped"]["nested"]["arbitrary"]["bitmap"] = mi.Bitmap(waves[:, None, None] * waves[None, :, None])
    bitmap = mi.Bitmap(headtail.Environment("studio").array())
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": integrator,
            "map": {"type": "envmap", "bitmap": bitmap, "to_world": transform().rotate([0.36, 0.8, 0.48], 40)},
            "sensor": {
                "type": "perspective",
                "fov": 40,
                "to_world": transform().look_at([0, 2, 6], [0, 0.7, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 64, "height": 48, "rfilter": {"type": "box"}},
            },
            "floor": {"type": "rectangle", "to_world": transform().rotate([1, 0, 0], -90).scale(5), "bsdf": MATERIALS[material]},
            "ball": {"type": "sphere", "center": [0, 1, 0], "bsdf": MATERIALS[material]},
            "box": {"type": "cube", "to_world": transform().translate([2, 0.5, 0.5]).rotate([0, 1, 0], 30).scale(0.5), "bsdf": MATERIALS[material]},
            **more,
        }
    )


def runs(scene, first_seed):
    """Returns luminance means of tiles, [runs, tiles]."""
    pictures = np.array([np.array(mi.render(scene, spp=SPP, seed=first_seed + run))[..., :3].mean(-1) for run in range(RUNS)])
    rows, columns = pictures.shape[1] // TILE, pictures.shape[2] // TILE
    return pictures.reshape(RUNS, rows, TILE, columns, TILE).mean((2, 4)).reshape(RUNS, -1)


def integrator(kind, **more):
    return {"type": kind, **({"max_depth": 4} if kind.endswith("path") else {}), **more}


def agree(a, b):
    """Returns whether no tile's means differ by Welch's test, at 0.1 % corrected for the number of tiles and
    of tests."""
    p = stats.ttest_ind(a, b, equal_var=False).pvalue
    return np.nanmin(p) > 1e-3 / (a.shape[1] * TESTS)
