"""The kit of `headtail conformance`: the package and its samplers in Dr.Jit pass, and a wrong one is found."""

import json
import subprocess

import numpy as np
import pytest

import headtail
from headtail import Environment, Sampler


class Kit:
    """A kit in a folder, with its map and table."""

    def __init__(self, program, folder):
        self.program, self.folder = program, folder
        subprocess.run([program, "conformance", "--out", folder], check=True, stdout=subprocess.DEVNULL)
        kit = json.loads((folder / "kit.json").read_text())
        self.cases = {case["name"]: case for case in kit["cases"]}
        self.columns, size = kit["inputs"] + kit["results"], kit["map"]
        texels = np.fromfile(folder / size["file"], "<f4").reshape(size["height"], size["width"], 3)
        self.map = Environment.from_array(texels)

    def rows(self, name):
        """Returns n, wo, u and given directions of a case, and its surface."""
        numbers = np.fromfile(self.folder / f"{name}.f32", "<f4").reshape(-1, len(self.columns))
        n, wo, u, given = (np.ascontiguousarray(part) for part in np.split(numbers[:, :11], [3, 6, 8], axis=1))
        alpha = self.cases[name]["alpha"]
        return n, wo, u, given, {} if alpha is None else {"alpha": np.full(len(n), alpha, np.float32)}

    def answer(self, name, wi, pdf, pdf_of_given):
        columns = [wi, np.reshape(pdf, (-1, 1)), np.reshape(pdf_of_given, (-1, 1))]
        np.concatenate(columns, 1).astype("<f4").tofile(self.folder / f"{name}.answers.f32")

    def check(self):
        run = subprocess.run([self.program, "conformance", "--check", self.folder, "--json"], capture_output=True, text=True)
        verdicts = {verdict["name"]: verdict for verdict in json.loads(run.stdout)}
        assert (run.returncode == 0) == all(not verdict["faults"] for verdict in verdicts.values()), run.stderr
        return verdicts


@pytest.fixture
def kit(program, tmp_path):
    return Kit(program, tmp_path / "kit")


def samplers(kit):
    def alone():
        return Sampler(headtail._native.Sampler.patches_alone(kit.map._native, False))

    return {
        "emitter": Sampler.from_spec("emitter", kit.map),
        "patches": alone(),
        "patches-glossy": alone(),
        "table": Sampler.open(kit.folder / "table.safetensors", kit.map),
        "mis-glossy": Sampler.from_spec("mis", kit.map),
    }


def test_the_package_passes(kit):
    for name, sampler in samplers(kit).items():
        n, wo, u, given, surface = kit.rows(name)
        draws = sampler.sample(n, wo, u=u, radiance=False, **surface)
        kit.answer(name, draws.wi, draws.pdf, sampler.pdf(given, n, wo, **surface))
    verdicts = kit.check()
    assert list(verdicts) == list(kit.cases)
    for verdict in verdicts.values():
        assert verdict["faults"] == [] and verdict["other_directions"] == verdict["wrong_pdfs"] == 0, verdict


def test_samplers_in_dr_jit_pass_and_mirrored_directions_are_found(kit, variant):
    import mitsuba as mi
    from headtail.mitsuba._patches import Patches, Point
    from headtail.mitsuba._table import Table

    def vectors(rows):
        return mi.Vector3f(np.ascontiguousarray(rows.T))

    def answer(name, product, mirrored=1):
        n, wo, u, given, surface = kit.rows(name)
        zero = mi.Float(np.zeros(len(n), np.float32))
        lobes = (zero, zero + 1, zero + 1, zero + mi.Float(surface["alpha"])) if surface else None
        prepared = product.prepare(Point(vectors(n), vectors(wo), lobes))
        wi, pdf = product.sample(prepared, mi.Point2f(np.ascontiguousarray(u.T)))
        of_given = product.pdf(prepared, vectors(given * np.array([mirrored, 1, 1], np.float32)))
        wi, pdf = np.array(wi).T, np.array(pdf)
        kit.answer(name, np.where(pdf[:, None] > 0, wi, 0), pdf, np.array(of_given))

    native = samplers(kit)
    for name in ("patches", "patches-glossy", "table"):
        product = (Table if name == "table" else Patches)(native[name]._native.arrays())
        answer(name, product)
        assert kit.check()[name]["faults"] == [], kit.check()[name]
    answer("table", product, mirrored=-1)
    assert kit.check()["table"]["faults"] != []
