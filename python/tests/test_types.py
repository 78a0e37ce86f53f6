"""The stubs match the code."""

import pathlib
import subprocess
import sys

import pytest


def test_the_stubs_are_those_of_the_code():
    pytest.importorskip("mypy")
    settings = ["--mypy-config-file", pathlib.Path(__file__).parents[1] / "pyproject.toml", "--ignore-missing-stub", "--concise"]
    run = subprocess.run([sys.executable, "-m", "mypy.stubtest", "headtail", *settings], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
