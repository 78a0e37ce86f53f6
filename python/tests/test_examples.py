"""The examples of the pages are short, run, and match the pages."""

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
