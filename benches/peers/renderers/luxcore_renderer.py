"""LuxCore's path tracer PATHCPU, with or without the visibility cache of its environment light."""

import math
import time

import numpy as np
import pyluxcore

from views import ALBEDO, z_up


class Renderer:
    def __init__(self, picture, cache=False):
        pyluxcore.Init(lambda *_: None)
        self.version, self.note = pyluxcore.Version(), ""
        self.picture = picture
        self.scene = pyluxcore.Scene()
        vertices = [tuple(z_up(point)) for point in picture.vertices.tolist()]
        self.scene.DefineMesh("mesh", vertices, [tuple(face) for face in picture.faces.tolist()], None, None, None, None)
        # The field of view applies to the longer side.
        aspect = max(1.0, picture.width / picture.height)
        fov = 2 * math.degrees(math.atan(math.tan(math.radians(picture.fov / 2)) * aspect))
        # LuxCore's picture is one row lower than the others', so its window is shifted by a row.
        row = 2 / picture.height
        # Matches headtail's columns of the map after the exchange of axes: swaps x and y.
        mirroring = [0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
        self.scene.Parse(properties({
            "scene.camera.type": "perspective",
            "scene.camera.lookat.orig": z_up(picture.look_from),
            "scene.camera.lookat.target": z_up(picture.look_at),
            "scene.camera.up": [0, 0, 1],
            "scene.camera.fieldofview": fov,
            "scene.camera.screenwindow": [-1.0, 1.0, (-1 - row) / aspect, (1 - row) / aspect],
            "scene.camera.autovolume.enable": 0,
            **material(picture.alpha),
            "scene.objects.object.shape": "mesh",
            "scene.objects.object.material": "material",
            "scene.lights.map.type": "infinite",
            "scene.lights.map.file": picture.map,
            "scene.lights.map.gamma": 1.0,
            "scene.lights.map.storage": "float",
            "scene.lights.map.transformation": mirroring,
            "scene.lights.map.visibilitymapcache.enable": int(cache),
        }))  # fmt: skip
        self.cache = cache

    def possible(self, samples):
        """Any number of samples is possible."""
        return samples

    def render(self, samples, seed):
        """Returns (linear image, seconds, of which preparation seconds)."""
        own = self.picture
        depth = own.depth + 1
        configuration = pyluxcore.RenderConfig(properties({
            "renderengine.type": "PATHCPU",
            "renderengine.seed": seed + 1,
            "native.threads.count": own.threads,
            "sampler.type": "SOBOL",
            "sampler.sobol.adaptive.strength": 0.0,
            "path.pathdepth.total": depth,
            "path.pathdepth.diffuse": depth,
            "path.pathdepth.glossy": depth,
            "path.pathdepth.specular": depth,
            "path.clamping.variance.maxvalue": 0.0,
            "film.width": own.width,
            "film.height": own.height,
            # Samples count only for their own pixel, which is a box filter.
            "film.filter.type": "NONE",
            "film.imagepipelines.0.0.type": "NOP",
            "film.outputs.0.type": "RGB",
            "film.outputs.0.filename": "unused.exr",
            "batch.haltspp": samples,
        }), self.scene)  # fmt: skip
        session = pyluxcore.RenderSession(configuration)
        start = time.perf_counter()
        session.Start()
        started = time.perf_counter()
        while not session.HasDone():
            time.sleep(0.002)
            session.UpdateStats()
        end = time.perf_counter()
        session.Stop()
        flat = np.zeros(own.width * own.height * 3, np.float32)
        session.GetFilm().GetOutputFloat(pyluxcore.FilmOutputType.RGB, flat, 0)
        image = flat.reshape(own.height, own.width, 3)[::-1].astype(np.float64)
        preparation = started - start if self.cache else 0.0
        return image, end - started + preparation, preparation


def material(alpha):
    if alpha is None:
        return {"scene.materials.material.type": "matte", "scene.materials.material.kd": [ALBEDO] * 3}
    return {
        "scene.textures.fresnel.type": "fresnelcolor",
        "scene.textures.fresnel.kr": [1.0, 1.0, 1.0],
        "scene.materials.material.type": "metal2",
        "scene.materials.material.fresnel": "fresnel",
        "scene.materials.material.uroughness": alpha,
        "scene.materials.material.vroughness": alpha,
    }


def properties(values):
    own = pyluxcore.Properties()
    for key, value in values.items():
        own.Set(pyluxcore.Property(key, value))
    return own
