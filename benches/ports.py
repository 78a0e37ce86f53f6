"""Time of a direction with its pdf by each implementation of a sampler, in turn in one process: the native one by the C library,
the Python package, Dr.Jit, and WGSL on the adapter that wgpu finds, which is a CPU where there is only Mesa's.

    pip install ./python -r benches/peers/renderers/requirements.txt
    HEADTAIL=target/release/headtail python benches/ports.py

The C library is beside the program. Times are those of all threads together, since C draws on the thread that calls; medians of
rounds, after one that compiles kernels. Points are random, and each is prepared for its one direction. Prints JSON: a row for each
sampler and implementation.
"""

import argparse
import ctypes
import json
import os
import pathlib
import subprocess
import tempfile
import time

import drjit as dr
import mitsuba as mi
import numpy as np

ENV = "studio"
CHECKPOINTS = pathlib.Path(__file__).parents[1] / "checkpoints"
# Two windows, in metres; normals point into the room.
PORTALS = [
    {"center": [2, 1.5, 0], "normal": [-1, 0, 0], "up": [0, 1, 0], "width": 1.6, "height": 1.2},
    {"center": [0, 3, 0], "normal": [0, -1, 0], "up": [0, 0, 1], "width": 1, "height": 1},
]
POINTER = ctypes.c_void_p


class Points(ctypes.Structure):
    """`HeadtailPoints` of capi/include/headtail.h."""

    _fields_ = [
        field
        for name in ("n", "wo", "alpha", "f0", "roughness", "metallic", "base_color", "p")
        for field in ((name, POINTER), (f"{name}_count", ctypes.c_size_t))
    ] + [("material", ctypes.c_uint64)]
    _fields_ += [
        field
        for name in ("uv", "tangent", "footprint")
        for field in ((name, POINTER), (f"{name}_count", ctypes.c_size_t))
    ]


def native(library, spec, inputs, count):
    """Returns the work of the C library, and the pdfs that it writes."""
    calls = ctypes.CDLL(library)
    calls.headtail_last_error.restype = ctypes.c_char_p
    environment, sampler = ctypes.c_uint64(), ctypes.c_uint64()

    def check(status):
        if status:
            raise RuntimeError(calls.headtail_last_error().decode())

    check(calls.headtail_environment_open(ENV.encode(), ctypes.byref(environment)))
    check(calls.headtail_sampler_from_spec(spec.encode(), environment, ctypes.byref(sampler)))
    at = Points(**{name: rows.ctypes.data for name, rows in inputs.items() if name != "u"})
    for name, rows in inputs.items():
        if name != "u":
            setattr(at, f"{name}_count", len(rows))
    wi, pdf = np.empty((count, 3), np.float32), np.empty(count, np.float32)
    size, seed, lists = ctypes.c_size_t(count), ctypes.c_uint64(0), (inputs["u"], wi, pdf)

    def work():
        u, to_wi, to_pdf = (POINTER(rows.ctypes.data) for rows in lists)
        check(calls.headtail_sampler_sample(sampler, ctypes.byref(at), size, u, seed, to_wi, to_pdf, None))

    return work, lambda: pdf


def python(sampler, inputs, count):
    """Returns the work of the Python package, and its pdfs."""
    wi, pdf = np.empty((count, 3), np.float32), np.empty(count, np.float32)
    return lambda: sampler.sample(**inputs, radiance=False, out=(wi, pdf, None)), lambda: pdf


def by_drjit(arrays, inputs):
    """Returns the work of Dr.Jit, and its pdfs."""
    from headtail.mitsuba._light import product_of
    from headtail.mitsuba._patches import Point

    product, drawn = product_of(arrays), {}
    vector = lambda name: mi.Vector3f(np.ascontiguousarray(inputs[name].T))
    n, wo, u = vector("n"), vector("wo"), mi.Point2f(np.ascontiguousarray(inputs["u"].T))
    lobes = (mi.Float(0), mi.Float(1), mi.Float(1), mi.Float(inputs["alpha"])) if "alpha" in inputs else None
    at = Point(n, wo, lobes, mi.Point3f(vector("p"))) if "p" in inputs else Point(n, wo, lobes)

    def work():
        drawn["wi"], drawn["pdf"] = product.sample(product.prepare(at), u)
        dr.eval(drawn)
        dr.sync_thread()

    return work, lambda: np.array(drawn["pdf"])


# The example of an exported shader evaluates the pdf of another direction as well.
ENTRY = """
@group(0) @binding(2) var<storage, read> points: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> drawn: array<vec4<f32>>;
@compute @workgroup_size(64)
fn draw_all(@builtin(global_invocation_id) place: vec3<u32>) {
    let k = place.x + 65535u * 64u * place.y;
    if (k >= arrayLength(&drawn)) { return; }
    let a = points[3u * k];
    let b = points[3u * k + 1u];
    let c = points[3u * k + 2u];
    headtail_position = c.xyz;
    let lobes = select(vec4(0.0, 1.0, 1.0, c.w), vec4(1.0, 0.0, 1.0, 1.0), c.w == 0.0);
    drawn[k] = headtail_sample(a.xyz, b.xyz, lobes, vec2(a.w, b.w));
}
"""


def shader(program, source, inputs, count):
    """Returns the work of WGSL, its pdfs, and the name of the adapter."""
    import wgpu

    with tempfile.TemporaryDirectory() as folder:
        export = [program, "export", source, "--target", "wgsl", "--out", folder]
        of_map = [] if source.endswith(".safetensors") else ["--env", ENV]
        subprocess.run(export + of_map, check=True, capture_output=True)
        folder = pathlib.Path(folder)
        text = (folder / "headtail.wgsl").read_text()
        text = text[: text.index("// An example of use")] + ENTRY
        numbers = [(folder / name).read_bytes() for name in ("floats.bin", "integers.bin")]
    u, zeros = inputs["u"], np.zeros((count, 3), np.float32)
    alpha = inputs.get("alpha", zeros[:, 0])[:, None]
    points = np.concatenate([inputs["n"], u[:, :1], inputs["wo"], u[:, 1:], inputs.get("p", zeros), alpha], 1, dtype=np.float32)
    adapter = wgpu.gpu.request_adapter_sync(power_preference="high-performance")
    wished = "max-storage-buffer-binding-size", "max-buffer-size"
    device = adapter.request_device_sync(required_limits={name: adapter.limits[name] for name in wished})
    usage = wgpu.BufferUsage
    buffers = [device.create_buffer_with_data(data=data, usage=usage.STORAGE) for data in (*numbers, points.tobytes())]
    drawn = device.create_buffer(size=16 * count, usage=usage.STORAGE | usage.COPY_SRC)
    module = device.create_shader_module(code=text)
    pipeline = device.create_compute_pipeline(layout="auto", compute={"module": module, "entry_point": "draw_all"})
    entries = [{"binding": k, "resource": {"buffer": buffer}} for k, buffer in enumerate((*buffers, drawn))]
    group = device.create_bind_group(layout=pipeline.get_bind_group_layout(0), entries=entries)

    def work():
        encoder = device.create_command_encoder()
        commands = encoder.begin_compute_pass()
        commands.set_pipeline(pipeline)
        commands.set_bind_group(0, group)
        groups = -(-count // 64)
        commands.dispatch_workgroups(min(groups, 65535), -(-groups // 65535))
        commands.end()
        device.queue.submit([encoder.finish()])
        # Waits for the device.
        device.queue.read_buffer(drawn, 0, 16)

    pdfs = lambda: np.frombuffer(device.queue.read_buffer(drawn), np.float32).reshape(-1, 4)[:, 3]
    return work, pdfs, adapter.info["device"]


def directions(count, seed):
    d = np.random.default_rng(seed).normal(size=(count, 3))
    return (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)


def implementations(source, spec, inputs, count):
    """Returns the implementations of a sampler, as functions for a draw and for the pdfs of the latest; and the name of the
    shader's adapter. `source` is what `headtail export` calls the sampler."""
    import headtail

    program = os.environ["HEADTAIL"]
    library = pathlib.Path(program).with_name("libheadtail_c.so")
    environment = headtail.Environment(ENV)
    *wgsl, adapter = shader(program, source, inputs, count)
    if "alpha" in inputs:
        # Without the BRDF, which `spec` mixes in, and other implementations leave to the renderer.
        alone = headtail.Sampler(headtail._native.Sampler.patches_alone(environment._native, False))
        forms = {"native": python(alone, inputs, count)}
        arrays = alone._native.arrays()
    else:
        sampler = headtail.Sampler.from_spec(spec, environment)
        forms = {"native": native(library, spec, inputs, count), "Python": python(sampler, inputs, count)}
        if "p" in inputs:
            rectangles = headtail._native.read_portals(source.partition(":")[2])
            arrays = headtail._native.portal_arrays(rectangles, environment._native, np.eye(3).tolist())
        else:
            arrays = sampler._native.arrays()
    return forms | {"Dr.Jit": by_drjit(arrays, inputs), "WGSL": wgsl}, adapter


def rows_of(sampler, source, spec, inputs, arguments):
    """Measures the implementations of a sampler, in turn."""
    forms, adapter = implementations(source, spec, inputs, arguments.count)
    times = {form: [] for form in forms}
    for _ in range(arguments.rounds + 1):
        for form, (work, _) in forms.items():
            start = time.process_time()
            work()
            times[form].append((time.process_time() - start) * 1e9 / arguments.count)
    own = forms["native"][1]()
    for form, (_, pdfs) in forms.items():
        # Tests bind directions and pdfs; this finds a shader or kernel of something else.
        median = np.median(np.abs(pdfs() / np.maximum(own, 1e-20) - 1)[own > 0])
        if median > 1e-4:
            raise SystemExit(f"{sampler}: pdfs of {form} are those of another sampler: a median difference of {median}")
        ns, of_native = (float(np.median(times[name][1:])) for name in (form, "native"))
        row = {"sampler": sampler, "implementation": form, "ns": ns, "ratio": ns / of_native}
        yield row | ({"adapter": adapter} if form == "WGSL" else {})


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition(",")[0])
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args()
    mi.set_variant(arguments.variant)
    count = arguments.count
    n, wo = directions(count, 1), directions(count, 2)
    wo = np.where((n * wo).sum(1, keepdims=True) < 0, -wo, wo)
    random = np.random.default_rng(3)
    diffuse = {"n": n, "wo": wo, "u": random.random((count, 2), dtype=np.float32)}
    alpha = random.uniform(0.1, 1, count).astype(np.float32)
    p = (directions(count, 4) * 0.8 + [0.5, 1.5, 0]).astype(np.float32)
    head, table = (CHECKPOINTS / f"studio-{kind}.safetensors" for kind in ("head", "direct"))
    with tempfile.TemporaryDirectory() as folder:
        portals = pathlib.Path(folder) / "portals.json"
        portals.write_text(json.dumps({"portals": PORTALS}))
        cases = [
            ("patches, diffuse", "patches", "patches", diffuse),
            ("patches, glossy", "patches", "patches", diffuse | {"alpha": alpha}),
            ("table", table, f"direct:{table}", diffuse),
            ("head", head, f"head:{head}", diffuse),
            ("portals", f"portals:{portals}", f"portals:{portals}", diffuse | {"p": p}),
        ]
        rows = [row for sampler, source, *case in cases for row in rows_of(sampler, str(source), *case, arguments)]
    print(json.dumps(rows))


if __name__ == "__main__":
    main()
