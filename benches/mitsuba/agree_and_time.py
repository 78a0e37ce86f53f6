"""Agreement and time per sample of a sampler's implementations, interleaved in one process: C library, Python
package, Dr.Jit, WGSL.

    cargo build --release -p headtail -p headtail-capi
    python benches/mitsuba/agree_and_time.py --library target/release/libheadtail_c.so --count 1000000
    pip install wgpu
    python benches/mitsuba/agree_and_time.py --library target/release/libheadtail_c.so --headtail target/release/headtail

The C library is the native sampler behind one call, so its time is that of the native batch. Times are wall-clock (ns) and the sum over
all threads of the process (cpu ns), which is less sensitive to other load. With --headtail, the WGSL of
`headtail export` runs on the adapter that wgpu finds, a CPU if only Mesa's is available. Prints JSON lines.
"""

import argparse
import ctypes
import json
import pathlib
import subprocess
import tempfile
import time

import drjit as dr
import mitsuba as mi
import numpy as np


class Points(ctypes.Structure):
    _fields_ = [
        field
        for name in ("n", "wo", "alpha", "f0")
        for field in ((name, ctypes.c_void_p), (f"{name}_count", ctypes.c_size_t))
    ]


class Library:
    """A sampler from the C library."""

    def __init__(self, path, env, spec):
        self.calls = ctypes.CDLL(path)
        self.calls.headtail_last_error.restype = ctypes.c_char_p
        map, self.sampler = ctypes.c_uint64(), ctypes.c_uint64()
        self.check(self.calls.headtail_environment_open(env.encode(), ctypes.byref(map)))
        self.check(self.calls.headtail_sampler_from_spec(spec.encode(), map, ctypes.byref(self.sampler)))

    def check(self, status):
        if status:
            raise RuntimeError(self.calls.headtail_last_error().decode())

    def sample(self, n, wo, alpha, u, out):
        at = Points(n.ctypes.data, len(n), wo.ctypes.data, len(wo), None, 0, None, 0)
        if alpha is not None:
            at.alpha, at.alpha_count = alpha.ctypes.data, len(alpha)
        pointers = [ctypes.c_void_p(array.ctypes.data) for array in (u, *out)]
        u, wi, pdf = pointers
        self.check(
            self.calls.headtail_sampler_sample(
                self.sampler, ctypes.byref(at), ctypes.c_size_t(len(out[1])), u, ctypes.c_uint64(0), wi, pdf, None
            )
        )


class Shader:
    """A sampler as WGSL on a device."""

    # Only sampling is timed; the example of the exported shader also evaluates a pdf.
    ENTRY = """
        @group(0) @binding(2) var<storage, read> points: array<vec4<f32>>;
        @group(0) @binding(3) var<storage, read_write> drawn: array<vec4<f32>>;
        @compute @workgroup_size(64)
        fn draw_all(@builtin(global_invocation_id) place: vec3<u32>) {
            let k = place.x + 65535u * 64u * place.y;
            if (k >= arrayLength(&drawn)) { return; }
            let a = points[2u * k];
            let b = points[2u * k + 1u];
            drawn[k] = headtail_sample(a.xyz, b.xyz, vec4(1.0, 0.0, 1.0, 1.0), vec2(a.w, b.w));
        }
    """

    def __init__(self, program, env, source, n, wo, u):
        import wgpu

        self.wgpu, self.count = wgpu, len(n)
        with tempfile.TemporaryDirectory() as folder:
            own = [program, "export", source, "--target", "wgsl", "--out", folder]
            subprocess.run(own + (["--env", env] if source == "patches" else []), check=True, capture_output=True)
            folder = pathlib.Path(folder)
            text = (folder / "headtail.wgsl").read_text()
            text = text[: text.index("// An example of use")] + self.ENTRY
            numbers = [(folder / name).read_bytes() for name in ("floats.bin", "integers.bin")]
        points = np.concatenate([n, u[:, :1], wo, u[:, 1:]], 1, dtype=np.float32)
        adapter = wgpu.gpu.request_adapter_sync(power_preference="high-performance")
        self.name = adapter.info["device"]
        limits = {"max-storage-buffer-binding-size": adapter.limits["max-storage-buffer-binding-size"],
                  "max-buffer-size": adapter.limits["max-buffer-size"]}
        self.device = adapter.request_device_sync(required_limits=limits)
        usage = wgpu.BufferUsage
        buffers = [self.device.create_buffer_with_data(data=data, usage=usage.STORAGE) for data in (*numbers, points.tobytes())]
        self.drawn = self.device.create_buffer(size=16 * self.count, usage=usage.STORAGE | usage.COPY_SRC)
        module = self.device.create_shader_module(code=text)
        self.pipeline = self.device.create_compute_pipeline(layout="auto", compute={"module": module, "entry_point": "draw_all"})
        entries = [{"binding": k, "resource": {"buffer": buffer}} for k, buffer in enumerate((*buffers, self.drawn))]
        self.group = self.device.create_bind_group(layout=self.pipeline.get_bind_group_layout(0), entries=entries)

    def sample(self):
        encoder = self.device.create_command_encoder()
        work = encoder.begin_compute_pass()
        work.set_pipeline(self.pipeline)
        work.set_bind_group(0, self.group)
        groups = -(-self.count // 64)
        work.dispatch_workgroups(min(groups, 65535), -(-groups // 65535))
        work.end()
        self.device.queue.submit([encoder.finish()])
        # Waits for the device by reading 16 bytes.
        self.device.queue.read_buffer(self.drawn, 0, 16)

    def results(self):
        rows = np.frombuffer(self.device.queue.read_buffer(self.drawn), np.float32).reshape(-1, 4)
        return rows[:, :3], rows[:, 3]


# Maximum number of directions whose pdfs are evaluated.
MOST_GIVEN = 100_000


def directions(count, seed):
    d = np.random.default_rng(seed).normal(size=(count, 3))
    return (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)


def timed(work):
    """Returns (wall-clock seconds, seconds of all threads)."""
    start, used = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - start, time.process_time() - used


def form_of(sampler, alpha):
    """Returns Dr.Jit's form of a sampler: functions of normals, views, and uniform points or given
    directions."""
    from headtail.mitsuba._light import product_of
    from headtail.mitsuba._patches import Point

    product = product_of(sampler._native.arrays())
    lobes = None if alpha is None else (mi.Float(0), mi.Float(1), mi.Float(1), mi.Float(alpha))
    return (
        lambda n, wo, z: product.sample(product.prepare(Point(n, wo, lobes)), z),
        lambda n, wo, wi: product.pdf(product.prepare(Point(n, wo, lobes)), wi),
    )


def apart(row, form, wi, pdf, own):
    """Adds the differences of a form's directions and pdfs from the package's."""
    drawn = own[1] > 0
    distance = np.abs(wi - own[0]).max(1)[drawn]
    row |= {f"{form} beyond 1e-4": float((distance > 1e-4).mean()), f"{form} 99.9 %": float(np.quantile(distance, 0.999))}
    density = np.abs(pdf[drawn] / own[1][drawn] - 1)
    row |= {f"{form} pdf beyond 1e-4": float((density > 1e-4).mean()), f"{form} pdf 99.9 %": float(np.quantile(density, 0.999))}


def compare(name, env, sampler, of_library, shader_of, count, rounds, alpha=None):
    """Returns a row of the tables, for diffuse surfaces or glossy ones of widths `alpha`; forms that are not
    given have no column."""
    n, wo = directions(count, 1), directions(count, 2)
    wo = np.where((n * wo).sum(1, keepdims=True) < 0, -wo, wo)
    u = np.random.default_rng(3).random((count, 2), dtype=np.float32)
    surface = {} if alpha is None else {"alpha": alpha}
    by_device, _ = form_of(sampler, alpha)
    empty = lambda: (np.empty((count, 3), np.float32), np.empty(count, np.float32))
    vector = lambda rows: mi.Vector3f(np.ascontiguousarray(rows.T))
    on_device = vector(n), vector(wo), mi.Point2f(np.ascontiguousarray(u.T))
    own, from_c, jit = empty(), empty(), {}

    def by_jit():
        jit["w"], jit["pdf"] = by_device(*on_device)
        dr.eval(jit)
        dr.sync_thread()

    forms = {"python": lambda: sampler.sample(n, wo, u=u, radiance=False, out=(*own, None), **surface), "drjit": by_jit}
    if of_library:
        forms["c"] = lambda: of_library.sample(n, wo, None, u, from_c)
    shader = shader_of and shader_of(n, wo, u)
    if shader:
        forms["wgsl"] = shader.sample
    times = {form: [] for form in forms}
    for _ in range(rounds + 1):
        for form, work in forms.items():
            times[form].append(timed(work))
    row = {"sampler": name, "env": pathlib.Path(env).stem, "count": count}
    for form, list in times.items():
        # The first round compiles kernels.
        clock, used = np.median(np.array(list[1:]), 0) * 1e9 / count
        row |= {f"{form} ns": clock, f"{form} cpu ns": used}
    apart(row, "drjit", np.array(jit["w"]).T, np.array(jit["pdf"]), own)
    given = directions(min(count, MOST_GIVEN), 4)
    of_given = sampler.pdf(given, *(rows[: len(given)] for rows in (n, wo)), **{key: value[: len(given)] for key, value in surface.items()})
    few = (vector(rows[: len(given)]) for rows in (n, wo, given))
    _, pdf_by_device = form_of(sampler, None if alpha is None else alpha[: len(given)])
    differences = np.abs(np.array(pdf_by_device(*few)) - of_given) / np.maximum(of_given, 1e-20)
    row["drjit given beyond 1e-4"] = float((differences > 1e-4).mean())
    if shader:
        row["adapter"] = shader.name
        apart(row, "wgsl", *shader.results(), own)
    if of_library:
        row["c differs"] = int((own[0] != from_c[0]).sum() + (own[1] != from_c[1]).sum())
    return row


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--library", required=True)
    parser.add_argument("--headtail", help="the program, to export shaders with")
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--env", default="studio")
    parser.add_argument("--head", help="a head for diffuse surfaces and this map")
    parser.add_argument("--over-patches", help="one over patches")
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args()
    mi.set_variant(arguments.variant)
    import headtail

    with tempfile.TemporaryDirectory() as folder:
        table = pathlib.Path(folder) / "table.safetensors"
        headtail.bake(arguments.env).save(table)
        specs = {"patches": "patches", "table": f"direct:{table}"}
        if arguments.head:
            specs["head"] = f"head:{arguments.head}"
        if arguments.over_patches:
            specs["head over patches"] = f"head+patches:{arguments.over_patches}"
        row = lambda *columns, **alpha: print(json.dumps(compare(*columns, arguments.count, arguments.rounds, **alpha)), flush=True)
        for name, spec in specs.items():
            source, env = spec.partition(":")[2] or spec, arguments.env
            shader = arguments.headtail and (lambda *points: Shader(arguments.headtail, env, source, *points))
            row(name, env, headtail.Sampler.from_spec(spec, env), Library(arguments.library, env, spec), shader)
        alpha = np.random.default_rng(5).uniform(0.1, 1, arguments.count).astype(np.float32)
        alone = headtail._native.Sampler.patches_alone(headtail.Environment(arguments.env)._native, False)
        row("patches, glossy", arguments.env, headtail.Sampler(alone), None, None, alpha=alpha)


if __name__ == "__main__":
    main()
