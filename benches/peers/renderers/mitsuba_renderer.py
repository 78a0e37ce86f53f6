"""Mitsuba 3: its integrators `direct` and `path`, plain or BSDF-compensated sampling of the map, any kind of points."""

import math
import time

import mitsuba as mi
import numpy as np

from views import ALBEDO


def use_fastest_variant():
    """Selects llvm_ad_rgb if LLVM is found, else scalar_rgb."""
    try:
        mi.set_variant("llvm_ad_rgb")
        import drjit

        np.array(drjit.arange(mi.Float, 4) + 1)
    except Exception:
        mi.set_variant("scalar_rgb")


use_fastest_variant()


class Renderer:
    def __init__(self, picture, compensation=False, points="independent", pairs=1):
        self.version, self.note, self.points = mi.__version__, mi.variant(), points
        if "llvm" in mi.variant():
            import drjit

            drjit.set_thread_count(picture.threads)
        depth = picture.depth + 1
        direct = {"type": "direct", "shading_samples": pairs}
        integrator = direct if picture.depth == 1 else {"type": "path", "max_depth": depth}
        mesh = mesh_of(picture.vertices, picture.faces, material(picture.alpha))
        look = mi.ScalarTransform4f().look_at(origin=picture.look_from, target=picture.look_at, up=[0, 1, 0])
        film = {"type": "hdrfilm", "width": picture.width, "height": picture.height, "rfilter": {"type": "box"}}
        self.scene = mi.load_dict({
            "type": "scene",
            "integrator": integrator,
            "sensor": {
                "type": "perspective", "fov": picture.fov, "fov_axis": "y", "to_world": look, "film": film,
                "sampler": {"type": points},
            },
            "map": {"type": "envmap", "filename": picture.map, "mis_compensation": compensation},
            "mesh": mesh,
        })  # fmt: skip

    def possible(self, samples):
        """Returns the largest number of samples up to `samples` that the points have: multijitter rounds up to a grid."""
        rows = math.isqrt(samples)
        return samples // rows * rows if self.points == "multijitter" else samples

    def render(self, samples, seed):
        """Returns (linear image, seconds, of which preparation seconds)."""
        start = time.perf_counter()
        image = np.array(mi.render(self.scene, spp=samples, seed=seed))
        return image[..., :3].astype(np.float64), time.perf_counter() - start, 0.0


def mesh_of(vertices, faces, bsdf):
    """Returns a mesh of flat triangles with a two-sided BSDF."""
    properties = mi.Properties()
    properties["mesh_bsdf"] = mi.load_dict({"type": "twosided", "nested": bsdf})
    properties["face_normals"] = True
    mesh = mi.Mesh("mesh", len(vertices), len(faces), props=properties)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = vertices.astype(np.float32).ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    parameters.update()
    return mesh


def material(alpha):
    if alpha is None:
        return {"type": "diffuse", "reflectance": {"type": "rgb", "value": [ALBEDO] * 3}}
    import height_correlated  # noqa: F401  (registers the plugin for this variant)

    return {"type": "height_correlated", "alpha": alpha}
