"""A Mitsuba scene with one changed word."""

import mitsuba as mi

mi.set_variant("llvm_ad_rgb")
import headtail  # noqa: E402
import headtail.mitsuba  # noqa: E402, F401: registers the integrators

transform = mi.ScalarTransform4f
scene = {
    "type": "scene",
    "integrator": {"type": "headtail_path", "max_depth": 4},  # was "path"
    "map": {
        "type": "envmap",
        "bitmap": mi.Bitmap(headtail.Environment("studio").array()),
        "to_world": transform().rotate([0, 1, 0], 30),
    },
    "sensor": {
        "type": "perspective",
        "to_world": transform().look_at([0, 2, 5], [0, 0.5, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 160, "height": 120},
        "sampler": {"type": "multijitter"},
    },
    "floor": {"type": "rectangle", "to_world": transform().rotate([1, 0, 0], -90).scale(4)},
    "ball": {"type": "sphere", "center": [0, 1, 0], "bsdf": {"type": "principled", "roughness": 0.3}},
}
picture = mi.render(mi.load_dict(scene), spp=16)
print("mean", mi.TensorXf(picture).array.numpy().mean())
