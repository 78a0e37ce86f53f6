"""Cycles, Blender's renderer, by the Python module bpy."""

import math
import tempfile
import time
from pathlib import Path

import bpy
import mathutils

import exr
from views import ALBEDO, z_up


class Renderer:
    def __init__(self, picture, guiding=False, portals=False, points="AUTOMATIC"):
        self.version, self.note = bpy.app.version_string, ""
        self.folder = tempfile.TemporaryDirectory()
        self.out = Path(self.folder.name) / "picture.exr"
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self.scene = bpy.context.scene
        self.add_mesh(picture)
        self.add_map(picture)
        self.add_camera(picture)
        if portals:
            exec(picture.portals)
        self.set_options(picture, guiding, points)

    def add_mesh(self, picture):
        mesh = bpy.data.meshes.new("mesh")
        mesh.from_pydata([z_up(point) for point in picture.vertices.tolist()], [], picture.faces.tolist())
        mesh.materials.append(material(picture.alpha))
        self.scene.collection.objects.link(bpy.data.objects.new("mesh", mesh))

    def add_map(self, picture):
        world = bpy.data.worlds.new("map")
        self.scene.world = world
        nodes, link = empty_tree(world)
        coordinates, mapping = nodes.new("ShaderNodeTexCoord"), nodes.new("ShaderNodeMapping")
        # Blender places the middle column of a map at -Y, glTF viewers and headtail at what becomes +X.
        mapping.inputs["Rotation"].default_value = (0, 0, math.radians(90))
        texture, background = nodes.new("ShaderNodeTexEnvironment"), nodes.new("ShaderNodeBackground")
        texture.image = bpy.data.images.load(picture.map)
        link(coordinates.outputs["Generated"], mapping.inputs["Vector"])
        link(mapping.outputs["Vector"], texture.inputs["Vector"])
        link(texture.outputs["Color"], background.inputs["Color"])
        link(background.outputs[0], nodes.new("ShaderNodeOutputWorld").inputs["Surface"])

    def add_camera(self, picture):
        camera = bpy.data.cameras.new("camera")
        camera.sensor_fit, camera.angle = "VERTICAL", math.radians(picture.fov)
        camera.clip_start, camera.clip_end = 1e-4, 1e6
        placed = bpy.data.objects.new("camera", camera)
        placed.location = z_up(picture.look_from)
        direction = mathutils.Vector(z_up(picture.look_at)) - placed.location
        placed.rotation_euler = direction.to_track_quat("-Z", "Y").to_euler()
        self.scene.collection.objects.link(placed)
        self.scene.camera = placed

    def set_options(self, picture, guiding, points):
        render, cycles = self.scene.render, self.scene.cycles
        render.engine = "CYCLES"
        render.threads_mode, render.threads = "FIXED", picture.threads
        render.use_persistent_data = True
        render.resolution_x, render.resolution_y, render.resolution_percentage = picture.width, picture.height, 100
        render.image_settings.file_format, render.image_settings.color_depth = "OPEN_EXR", "32"
        cycles.device = "CPU"
        cycles.use_adaptive_sampling = cycles.use_denoising = False
        cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.blur_glossy = 0
        cycles.light_sampling_threshold = 0
        cycles.pixel_filter_type, cycles.filter_width = "BOX", 1.0
        bounces = picture.depth - 1
        cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = bounces
        cycles.use_guiding = guiding
        # Automatic points are blue noise in pictures of a known number of samples.
        cycles.sampling_pattern = points

    def possible(self, samples):
        """Any number of samples is possible."""
        return samples

    def render(self, samples, seed):
        """Returns (linear image, seconds, of which preparation seconds)."""
        self.scene.cycles.samples, self.scene.cycles.seed = samples, seed
        # Changes to the settings of Cycles alone do not update the scene.
        self.scene.render.filepath = str(self.out)
        start = time.perf_counter()
        bpy.ops.render.render(write_still=True)
        seconds = time.perf_counter() - start
        return exr.read(self.out), seconds, 0.0


def empty_tree(owner):
    owner.use_nodes = True
    owner.node_tree.nodes.clear()
    return owner.node_tree.nodes, owner.node_tree.links.new


def material(alpha):
    own = bpy.data.materials.new("material")
    nodes, link = empty_tree(own)
    if alpha is None:
        lobe = nodes.new("ShaderNodeBsdfDiffuse")
        lobe.inputs["Color"].default_value = (ALBEDO, ALBEDO, ALBEDO, 1)
        lobe.inputs["Roughness"].default_value = 0
    else:
        # Roughness is the square root of alpha. MULTI_GGX would add scattering between microfacets.
        lobe = nodes.new("ShaderNodeBsdfAnisotropic")
        lobe.distribution = "GGX"
        lobe.inputs["Color"].default_value = (1, 1, 1, 1)
        lobe.inputs["Roughness"].default_value = math.sqrt(alpha)
    link(lobe.outputs[0], nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    return own
