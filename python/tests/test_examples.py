"""The examples of the pages are short, run, and match the pages."""

import json
import pathlib
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("name, page", [("reflected_light", "python"), ("mitsuba_scene", "mitsuba")])
def test_an_example_runs_and_is_on_its_page(name, page):
    if page == "mitsuba":
        pytest.importorskip("mitsuba")
    file = ROOT / "python" / "examples" / f"{name}.py"
    assert len(file.read_text().splitlines()) < 40
    assert file.read_text() in (ROOT / "docs" / f"{page}.md").read_text()
    run = subprocess.run([sys.executable, file], capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stderr


def test_the_examples_of_other_languages_are_on_their_pages():
    for file, page in [("render/examples/exported_sampler.rs", "rust"), ("shaders/wgsl/example.wgsl", "shaders")]:
        assert (ROOT / file).read_text() in (ROOT / "docs" / f"{page}.md").read_text()


def test_the_notebook_runs():
    pyplot = pytest.importorskip("matplotlib.pyplot")
    pyplot.switch_backend("Agg")
    notebook = json.loads((ROOT / "python" / "examples" / "from_map_to_chart.ipynb").read_text())
    names = {}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), names)  # noqa: S102: a file of this repository
    # The quadrature of the notebook has no more than its map's texels, and lamps have sharp edges.
    assert abs((names["pdf"] * names["solid_angle"]).sum() - 1) < 0.01
    assert len(pyplot.get_fignums()) == 3
    errors = [names["table"]["mse"][names["table"]["sampler"] == name].mean() for name in ("mis", "patches")]
    assert errors[1] < errors[0]
    pyplot.close("all")
