"""MSE at equal time inside Mitsuba 3: headtail's integrators against Mitsuba's own, with the same sampler plugin, on meshes under maps.

    python benches/mitsuba/equal_time.py --meshes temple spot.glb --maps room.hdr --materials diffuse glossy --out out/mitsuba

Each pair of integrators renders in turns, and the ratio of times is that of the medians (`--clock processor`: processor time of all threads, which others
on the machine disturb less; best with `--threads 1`, as waiting threads count too); MSE is against a reference by headtail's integrator at many
samples per pixel, over the pixels that surfaces cover. Prints a row for each pair: the ratio of MSE x time (above 1: headtail's is better).
Pictures have the samples per pixel that take the same time; `--montage` joins them, meshes below each other and maps side by side.
"""

import argparse
import json
import pathlib
import time

import drjit as dr
import mitsuba as mi
import numpy as np

MATERIALS = {
    "diffuse": {"type": "twosided", "nested": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.8}}},
    "glossy": {"type": "twosided", "nested": {"type": "roughconductor", "distribution": "ggx", "alpha": 0.3}},
    "principled": {
        "type": "twosided",
        "nested": {"type": "principled", "base_color": {"type": "rgb", "value": [0.8, 0.5, 0.3]}, "roughness": 0.5, "specular": 0.5},
    },
}


def mesh_of(scene, material):
    """A headtail scene's triangles as one Mitsuba mesh with face normals."""
    corners = scene.triangles().reshape(-1, 3)
    mesh = mi.Mesh("mesh", len(corners), len(corners) // 3, props=properties(material))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = mi.Float(corners.ravel())
    parameters["faces"] = mi.UInt32(np.arange(len(corners), dtype=np.uint32))
    parameters.update()
    return mesh


def properties(material):
    props = mi.Properties()
    props["bsdf"] = mi.load_dict(material)
    props["face_normals"] = True
    return props


def scene_of(mesh, camera, texels, integrator, sampler, size):
    """The scene with an integrator."""
    look_from, look_at, fov = camera
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": integrator,
            "map": {"type": "envmap", "bitmap": mi.Bitmap(texels)},
            "mesh": mesh,
            "sensor": {
                "type": "perspective",
                "fov": fov,
                "fov_axis": "y",
                "to_world": mi.ScalarTransform4f().look_at(list(look_from), list(look_at), [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": size[0], "height": size[1], "rfilter": {"type": "box"}, "pixel_format": "rgb"},
                "sampler": {"type": sampler},
            },
        }
    )


CLOCKS = {"wall": time.perf_counter, "processor": time.process_time}


def render(scene, spp, seed, clock=time.perf_counter):
    """(picture, seconds)"""
    start = clock()
    picture = mi.render(scene, spp=spp, seed=seed)
    dr.eval(picture)
    dr.sync_thread()
    return np.array(picture), clock() - start


def compare(own, other, spp, runs, reference, covered, clock):
    """{name: (MSE, seconds)} of both scenes, rendered in turns."""
    results = {"headtail": [], "mitsuba": []}
    for name, scene in (("headtail", own), ("mitsuba", other)):
        render(scene, spp, 1)
    for run in range(runs):
        for name, scene in (("headtail", own), ("mitsuba", other)):
            picture, seconds = render(scene, spp, 100 + run, clock)
            results[name].append((np.mean((picture - reference)[covered] ** 2), seconds))
    return {name: (np.mean([mse for mse, _ in rows]), np.median([seconds for _, seconds in rows])) for name, rows in results.items()}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--meshes", nargs="+", default=["temple"])
    parser.add_argument("--maps", nargs="+", default=["studio"])
    parser.add_argument("--materials", nargs="+", default=["diffuse", "glossy"], choices=MATERIALS)
    parser.add_argument("--integrators", nargs="+", default=["direct"], choices=["direct", "path"])
    parser.add_argument("--samplers", nargs="+", default=["independent", "multijitter"])
    parser.add_argument("--product", default="table", help="the property `sampler` of headtail's integrators")
    parser.add_argument("--files", nargs="+", help="a file of a table or head for each map, instead")
    parser.add_argument("--spp", type=int, default=16)
    parser.add_argument("--runs", type=int, default=6)
    parser.add_argument("--reference-spp", type=int, default=4096)
    parser.add_argument("--size", type=int, nargs=2, default=[320, 240])
    parser.add_argument("--clock", default="wall", choices=CLOCKS)
    parser.add_argument("--threads", type=int)
    parser.add_argument("--out", type=pathlib.Path)
    parser.add_argument("--montage", type=pathlib.Path, help="a picture of all pairs of the first material")
    arguments = parser.parse_args()
    if arguments.files and len(arguments.files) != len(arguments.maps):
        parser.error("--files: name one for each map")
    mi.set_variant(arguments.variant)
    if arguments.threads:
        dr.set_thread_count(arguments.threads)
    import headtail
    import headtail.mitsuba

    rows, pairs = [], []
    for mesh_name in arguments.meshes:
        native = headtail.Scene(mesh_name)
        for map_name, file in zip(arguments.maps, arguments.files or [None] * len(arguments.maps)):
            texels = headtail.Environment(map_name).array()
            for material in arguments.materials:
                mesh = mesh_of(native, MATERIALS[material])
                for kind in arguments.integrators:
                    settings = {"max_depth": 4} if kind == "path" else {}
                    product = {"file": file} if file else {"sampler": arguments.product}
                    own = {"type": f"headtail_{kind}", **product, **settings}
                    scene = lambda integrator, sampler: scene_of(mesh, native.camera, texels, integrator, sampler, arguments.size)
                    long, count = scene(own, "independent"), max(arguments.reference_spp // 256, 1)
                    reference = sum(render(long, min(256, arguments.reference_spp), 10_000 + k)[0] for k in range(count)) / count
                    covered = coverage(long, arguments.size)
                    for sampler in arguments.samplers:
                        results = compare(scene(own, sampler), scene({"type": kind, **settings}, sampler), arguments.spp, arguments.runs, reference, covered, CLOCKS[arguments.clock])
                        (mse, seconds), (other_mse, other_seconds) = results["headtail"], results["mitsuba"]
                        row = {
                            "mesh": pathlib.Path(mesh_name).stem,
                            "map": pathlib.Path(map_name).stem,
                            "material": material,
                            "integrator": kind,
                            "sampler": sampler,
                            "spp": arguments.spp,
                            "mse_ratio": float(other_mse / mse),
                            "time_ratio": float(seconds / other_seconds),
                            "equal_time": float(other_mse * other_seconds / (mse * seconds)),
                        }
                        rows.append(row)
                        print(json.dumps({key: round(value, 3) if isinstance(value, float) else value for key, value in row.items()}), flush=True)
                    pictures = equal_time_pictures(rows[-1], scene, own, {"type": kind, **settings}, reference, covered)
                    if arguments.out:
                        name = "-".join(str(rows[-1][key]) for key in ("mesh", "map", "material", "integrator"))
                        write(arguments.out / f"{name}.png", np.concatenate(pictures, 1))
                    if material == arguments.materials[0]:
                        pairs.append(np.concatenate(pictures[:2], 1))
    if arguments.montage:
        count = len(arguments.maps) * len(arguments.integrators)
        write(arguments.montage, np.concatenate([np.concatenate(pairs[k : k + count], 1) for k in range(0, len(pairs), count)]))
    keys = sorted({(row["material"], row["integrator"], row["sampler"]) for row in rows})
    for key in keys:
        values = [row["equal_time"] for row in rows if (row["material"], row["integrator"], row["sampler"]) == key]
        print(*key, f"geometric mean {np.exp(np.mean(np.log(values))):.2f} of {len(values)}, least {min(values):.2f}")


def coverage(scene, size):
    """The pixels of which every one of 64 rays hits a surface."""
    sensor = scene.sensors()[0]
    sampler = mi.load_dict({"type": "independent", "sample_count": 64})
    count = size[0] * size[1]
    hits = np.ones(count, bool)
    for seed in range(64):
        sampler.seed(seed, count)
        index = dr.arange(mi.UInt32, count)
        pixel = mi.Point2f(mi.Float(index % size[0]), mi.Float(index // size[0]))
        ray, _ = sensor.sample_ray(0, 0, (pixel + sampler.next_2d()) / mi.Point2f(*size), 0)
        hits &= np.array(scene.ray_test(ray))
    return hits.reshape(size[1], size[0])


def equal_time_pictures(row, scene, own, other, reference, covered):
    """Mitsuba's picture, headtail's with as many samples per pixel as take the same time, and the reference, at one exposure."""
    counts = row["spp"], max(round(row["spp"] / row["time_ratio"]), 1)
    pictures = [render(scene(integrator, "independent"), spp, 1)[0] for integrator, spp in zip((other, own), counts)]
    exposure = 0.35 / max(reference[covered].mean(), 1e-9)
    return [picture * exposure for picture in (*pictures, reference)]


def write(file, picture):
    """A PNG."""
    file.parent.mkdir(parents=True, exist_ok=True)
    mi.Bitmap(picture.astype(np.float32)).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, True).write(str(file))


if __name__ == "__main__":
    main()
