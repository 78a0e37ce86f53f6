"""The stubs say what the code is."""

import subprocess
import sys

import pytest


def test_the_stubs_are_those_of_the_code():
    pytest.importorskip("mypy")
    # What begins with an underscore is the package's own; the integrators have no stubs, and no functions that are called.
    own = ["--ignore-missing-stub", "--concise"]
    run = subprocess.run([sys.executable, "-m", "mypy.stubtest", "headtail", *own], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
