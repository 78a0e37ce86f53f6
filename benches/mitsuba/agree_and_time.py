"""Agreement and time per sample of the forms of a sampler, in one process and in turns: the C library, the Python package, Dr.Jit.

    cargo build --release -p headtail-capi
    python benches/mitsuba/agree_and_time.py --library target/release/libheadtail_c.so --count 1000000

The C library is the native sampler behind one call, so its time is that of the native batch. Prints JSON lines.
"""

import argparse
import ctypes
import json
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

    def __init__(self, path, env):
        self.calls = ctypes.CDLL(path)
        self.calls.headtail_last_error.restype = ctypes.c_char_p
        map, self.sampler = ctypes.c_uint64(), ctypes.c_uint64()
        self.check(self.calls.headtail_environment_open(env.encode(), ctypes.byref(map)))
        self.check(self.calls.headtail_sampler_from_spec(b"patches", map, ctypes.byref(self.sampler)))

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
                self.sampler, ctypes.byref(at), ctypes.c_size_t(len(pdf_of(out))), u, ctypes.c_uint64(0), wi, pdf, None
            )
        )


def pdf_of(out):
    return out[1]


def directions(count, seed):
    d = np.random.default_rng(seed).normal(size=(count, 3))
    return (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)


def timed(work):
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--library", required=True)
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--env", default="studio")
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args()
    mi.set_variant(arguments.variant)
    import headtail
    from headtail.mitsuba._patches import Patches, Point
    from headtail.mitsuba._table import Table

    count, env = arguments.count, arguments.env
    n, wo = directions(count, 1), directions(count, 2)
    wo = np.where((n * wo).sum(1, keepdims=True) < 0, -wo, wo)
    u = np.random.default_rng(3).random((count, 2), dtype=np.float32)
    library, patches, table = Library(arguments.library, env), headtail.Sampler.from_spec("patches", env), headtail.bake(env)
    empty = lambda: (np.empty((count, 3), np.float32), np.empty(count, np.float32))
    vector = lambda rows: mi.Vector3f(np.ascontiguousarray(rows.T))
    on_device = vector(n), vector(wo), mi.Point2f(np.ascontiguousarray(u.T))
    for name, sampler, product in [("patches", patches, Patches(patches._native.arrays())), ("table", table, Table(table._native.arrays()))]:
        own, of_library, jit = empty(), empty(), {}

        def by_python():
            sampler.sample(n, wo, u=u, radiance=False, out=(*own, None))

        def by_library():
            library.sample(n, wo, None, u, of_library)

        def by_jit():
            n, wo, z = on_device
            if name == "table":
                jit["w"], jit["pdf"] = product.sample(product.prepare(n), z)
            else:
                jit["w"], jit["pdf"] = product.sample(Point(n, wo, None), z, None, None)
            dr.eval(jit)
            dr.sync_thread()

        forms = {"python": by_python, "drjit": by_jit}
        if name == "patches":
            forms["c"] = by_library
        times = {form: [] for form in forms}
        for _ in range(arguments.rounds + 1):
            for form, work in forms.items():
                times[form].append(timed(work))
        row = {"sampler": name, "env": env, "count": count}
        # The first round compiles kernels.
        row |= {f"{form} ns": 1e9 * np.median(list[1:]) / count for form, list in times.items()}
        drawn = own[1] > 0
        apart = np.abs(np.array(jit["w"]).T - own[0]).max(1)[drawn]
        row |= {"drjit beyond 1e-4": float((apart > 1e-4).mean()), "drjit 99.9 %": float(np.quantile(apart, 0.999))}
        density = np.abs(np.array(jit["pdf"])[drawn] / own[1][drawn] - 1)
        row |= {"drjit pdf beyond 1e-4": float((density > 1e-4).mean())}
        if name == "patches":
            row["c differs"] = int((own[0] != of_library[0]).sum() + (own[1] != of_library[1]).sum())
        print(json.dumps(row))


if __name__ == "__main__":
    main()
