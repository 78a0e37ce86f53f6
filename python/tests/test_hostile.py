"""Calls every function thousands of times with random arguments: each raises an exception of the right kind
or returns a result, and never crashes."""

import os
import pathlib

import numpy as np
import pytest
from conftest import directions, uniform

import headtail
from headtail import Environment, HeadtailError, Sampler, Scene

CALLS = int(os.environ.get("HEADTAIL_FUZZ_INPUTS", 1500))
RIGHT = (HeadtailError, TypeError, ValueError, OSError, OverflowError, MemoryError)

NUMBERS = [0, -1, 1, 2, 7, 0.5, float("nan"), float("inf"), 1e38, -1e-40, 2**31, 2**32, 2**63, 2**64, -(2**63), 1 << 100]
THINGS = [None, True, "", "overcast", "patches", "mis", "x\0y", "/", "\udcff", b"studio", [], [1, 2], (2, 3), {}, {"a": {"b": 1}}, object(), print]


class Calls:
    """Random arguments, and functions to call with them."""

    def __init__(self, files, samplers):
        self.random = np.random.default_rng(4)
        self.files, self.samplers = files, samplers
        self.map = Environment.from_array(self.random.random((8, 16, 3), dtype=np.float32))

    def one_of(self, list):
        return list[self.random.integers(len(list))]

    def array(self):
        shape = self.one_of([(), (0,), (1,), (3,), (6,), (6, 3), (3, 6), (0, 3), (6, 2), (1, 3), (6, 3, 1), (4, 8, 3), (2, 2, 3), (8, 1, 3), (1, 1, 3)])
        array = np.full(shape, self.one_of([0.0, 1.0, 0.5, np.nan, np.inf, -1.0, 1e38, 1e-40]))
        if len(shape) == 2 and shape[1] == 3 and self.random.random() < 0.7:
            array = directions(len(array), int(self.random.integers(99)))
        with np.errstate(all="ignore"):
            return array.astype(self.one_of(["f4", "f4", "f4", "f8", "f2", "O", "c8", "?", "i4"]))

    def thing(self):
        """Returns any value."""
        kind = self.random.integers(4)
        if kind == 0:
            return self.one_of(NUMBERS)
        if kind == 1:
            return self.one_of(THINGS)
        return self.array() if kind == 2 else self.one_of([*self.samplers, *self.files, self.map])

    def mostly(self, *list):
        """Returns an element of a list, or any value."""
        return self.one_of(list) if self.random.random() < 0.8 else self.thing()

    def times(self, *list):
        """Returns a count or size, without valid ones that would take hours or all memory."""
        wrong = [number for number in NUMBERS if not 7 < number < 2**63] + [thing for thing in THINGS if thing is not True]
        return self.one_of(list if self.random.random() < 0.8 else wrong)

    def some(self, **arguments):
        """Returns a subset of the arguments."""
        return {name: make() for name, make in arguments.items() if self.random.random() < 0.4}

    def call(self):
        env = lambda: self.mostly(self.map)
        sampler = self.one_of(self.samplers)
        small, count = (lambda: self.times(1, 2, 8)), (lambda: self.mostly((2, 3), (4, 4), (4, 6)))
        n = lambda: self.mostly(directions(6, 1), directions(1, 2))
        surface = {"wo": n, "alpha": lambda: self.mostly(0.3, 1.0), "f0": lambda: self.mostly(0.5)}
        functions = {
            "sample": lambda: sampler.sample(n(), **self.some(u=lambda: self.mostly(uniform(6, 1)), count=small, seed=small, radiance=small, out=self.thing, **surface)),
            "pdf": lambda: sampler.pdf(n(), n(), **self.some(out=self.thing, **surface)),
            "from_spec": lambda: Sampler.from_spec(self.mostly("patches", "mis", "ris:2", "direct:x", "mis2", "head:", f"head:{self.one_of(self.files)}"), env()),
            "open": lambda: Sampler.open(self.mostly(*self.files), **self.some(env=env)),
            "save": lambda: sampler.save(self.mostly(self.files[0].parent / "saved", "/", "/nowhere/x")),
            "environment": lambda: Environment(self.mostly(*self.files), **self.some(layout=lambda: self.mostly("cube", "angular"), layer=self.thing)),
            "from_array": lambda: Environment.from_array(self.array(), **self.some(name=self.thing, layout=lambda: self.mostly("cube", "cross", "latlong"))),
            "radiance": lambda: self.map.radiance(self.mostly(directions(6, 2)), **self.some(out=self.thing)),
            "bake": lambda: headtail.bake(self.mostly(self.map, sampler), **self.some(normals=count, cells=count, tail=lambda: self.mostly("row-column"))),
            "scene": lambda: Scene(self.mostly("plane", "sphere", *self.files), **self.some(material=lambda: self.mostly("lambert", "ggx:alpha=0.3"), ground=small, camera=self.thing)),
            "render": lambda: headtail.render(
                self.mostly("plane"), self.mostly("mis", sampler), width=self.times(8, 1), height=self.times(6, 3),
                **self.some(env=env, spp=small, seed=small, depth=small, fov=small, look_at=self.thing, points=lambda: self.mostly("sobol", "independent")),
            ),
            "compare": lambda: headtail.compare(
                self.mostly("plane"), env(), self.mostly(["mis"], ["mis", "patches"]), width=self.times(8), height=self.times(6),
                reference_spp=self.times(1, 2), runs=self.times(1), **self.some(spp=lambda: self.times((1,), (1, 2), (0,), (-1, 2)), seed=small),
            ),
        }
        if hasattr(headtail, "fit"):
            functions["fit"] = lambda: headtail.fit(
                env(), self.mostly("lambert", "ggx:alpha=0.3"), steps=self.one_of([0, 1, -1, "x", None]), conditions=self.one_of([2, 4, 0, -3]), validation_conditions=2,
                **self.some(head=lambda: self.mostly({"bins": 4}, {"hidden": 8}, {"bins": 1}), preset=self.thing, seed=small, tail=lambda: self.mostly("row-column")),
            )
            functions["settings"] = lambda: headtail.settings(self.thing(), **self.some(head=self.thing, steps=self.thing))
        name = self.one_of(["sample", "pdf"] * 6 + list(functions))
        return name, functions[name]


@pytest.fixture
def changed_files(tmp_path, table):
    """Returns a table's file, and copies that are truncated or have a changed byte."""
    table.save(tmp_path / "whole.safetensors")
    bytes = np.fromfile(tmp_path / "whole.safetensors", np.uint8)
    random, files = np.random.default_rng(8), [tmp_path / "whole.safetensors", tmp_path]
    for k in range(40):
        changed = bytes.copy()
        changed[random.integers(1500 if k % 2 else len(bytes))] ^= 1 << random.integers(8)
        files.append(tmp_path / f"changed{k}")
        (changed[: random.integers(len(bytes))] if k % 4 == 0 else changed).tofile(files[-1])
    return [pathlib.Path(file) for file in files]


def test_random_calls_raise_or_return_numbers(changed_files, patches, table):
    calls = Calls(changed_files, [patches, table, Sampler.from_spec("mis", "overcast")])
    raised, done = {}, {}
    for _ in range(CALLS):
        name, call = calls.call()
        try:
            result = call()
        except RIGHT as error:
            raised[name] = raised.get(name, 0) + 1
            assert str(error) or isinstance(error, MemoryError), name
        else:
            done[name] = done.get(name, 0) + 1
            if name in ("sample", "pdf"):
                arrays = result if name == "sample" else [result]
                assert all(np.isfinite(np.asarray(array)).all() for array in arrays if array is not None), name
    print(raised, done)
    assert len(raised) > 8 and len(done) > 8
