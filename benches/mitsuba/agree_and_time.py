"""Agreement and time per sample of the forms of a sampler, in one process and in turns: the C library, the Python package, Dr.Jit.

    cargo build --release -p headtail-capi
    python benches/mitsuba/agree_and_time.py --library target/release/libheadtail_c.so --count 1000000

The C library is the native sampler behind one call, so its time is that of the native batch. Times are those of the clock (ns) and of all
threads of the process together (cpu ns), which other work on the machine disturbs less. Prints JSON lines.
"""

import argparse
import ctypes
import json
import pathlib
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
    """A sampler of the C library."""

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


def directions(count, seed):
    d = np.random.default_rng(seed).normal(size=(count, 3))
    return (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)


def timed(work):
    """(seconds of the clock, seconds of all threads)"""
    start, used = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - start, time.process_time() - used


def form_of(name, sampler):
    """Dr.Jit's form of a sampler: a function of normals, views and uniform points."""
    from headtail.mitsuba._head import Head
    from headtail.mitsuba._patches import Patches, Point
    from headtail.mitsuba._table import Table

    product = {"patches": Patches, "table": Table, "head": Head}[name](sampler._native.arrays())
    if name == "patches":
        return lambda n, wo, z: product.sample(Point(n, wo, None), z, None, None)
    return lambda n, wo, z: product.sample(product.prepare(Point(n, wo, None)), z)


def compare(name, env, spec, library, count, rounds):
    """A row of the tables, for diffuse surfaces."""
    import headtail

    n, wo = directions(count, 1), directions(count, 2)
    wo = np.where((n * wo).sum(1, keepdims=True) < 0, -wo, wo)
    u = np.random.default_rng(3).random((count, 2), dtype=np.float32)
    sampler, of_library = headtail.Sampler.from_spec(spec, env), Library(library, env, spec)
    by_device = form_of(name, sampler)
    empty = lambda: (np.empty((count, 3), np.float32), np.empty(count, np.float32))
    vector = lambda rows: mi.Vector3f(np.ascontiguousarray(rows.T))
    on_device = vector(n), vector(wo), mi.Point2f(np.ascontiguousarray(u.T))
    own, from_c, jit = empty(), empty(), {}

    def by_jit():
        jit["w"], jit["pdf"] = by_device(*on_device)
        dr.eval(jit)
        dr.sync_thread()

    forms = {
        "c": lambda: of_library.sample(n, wo, None, u, from_c),
        "python": lambda: sampler.sample(n, wo, u=u, radiance=False, out=(*own, None)),
        "drjit": by_jit,
    }
    times = {form: [] for form in forms}
    for _ in range(rounds + 1):
        for form, work in forms.items():
            times[form].append(timed(work))
    row = {"sampler": name, "env": pathlib.Path(env).stem, "count": count}
    for form, list in times.items():
        # The first round compiles kernels.
        clock, used = np.median(np.array(list[1:]), 0) * 1e9 / count
        row |= {f"{form} ns": clock, f"{form} cpu ns": used}
    drawn = own[1] > 0
    apart = np.abs(np.array(jit["w"]).T - own[0]).max(1)[drawn]
    row |= {"drjit beyond 1e-4": float((apart > 1e-4).mean()), "drjit 99.9 %": float(np.quantile(apart, 0.999))}
    density = np.abs(np.array(jit["pdf"])[drawn] / own[1][drawn] - 1)
    row |= {"drjit pdf beyond 1e-4": float((density > 1e-4).mean()), "drjit pdf 99.9 %": float(np.quantile(density, 0.999))}
    row["c differs"] = int((own[0] != from_c[0]).sum() + (own[1] != from_c[1]).sum())
    return row


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--library", required=True)
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--env", default="studio")
    parser.add_argument("--head", help="a head for diffuse surfaces and this map")
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
        for name, spec in specs.items():
            row = compare(name, arguments.env, spec, arguments.library, arguments.count, arguments.rounds)
            print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
