#!/usr/bin/env python3
"""Checks the licence and the source of every dependency in the lock files, and that one version of burn is built.

    python3 .ci/licenses.py
"""

import json
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
# Permissive licences; MPL-2.0 binds only changes to the files of the dependency itself.
ALLOWED = """
    0BSD, Apache-2.0, Apache-2.0 WITH LLVM-exception, BSD-2-Clause, BSD-3-Clause, BSL-1.0, CC0-1.0, CDLA-Permissive-2.0,
    ISC, MIT, MIT-0, MPL-2.0, NCSA, Unicode-3.0, Unlicense, Zlib
"""
ALLOWED = {name.strip() for name in ALLOWED.split(",")}
# Packages without an SPDX expression, by the licence in their LICENSE file.
BY_FILE = {"cfg_block": "Apache-2.0"}
# A single version of each is required, since types of different versions differ.
SINGLE = re.compile(r"burn(-\w+)*|headtail(-\w+)*")


def is_allowed(expression):
    """Returns whether allowed licences satisfy an SPDX expression (with `/` as the old form of `OR`)."""
    terms = re.split(r"(\(|\)|/|\bAND\b|\bOR\b)", expression)
    words = {"AND": "and", "OR": "or", "/": "or", "(": "(", ")": ")", "": ""}
    return bool(eval(" ".join(words.get(term.strip(), str(term.strip() in ALLOWED)) for term in terms)))


def faults(manifest):
    """Yields a line for each forbidden package of a workspace."""
    command = "cargo metadata --locked --all-features --format-version 1 --manifest-path".split() + [ROOT / manifest]
    packages = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)["packages"]
    sources, versions = set(), {}
    for package in packages:
        name = f"{manifest}: {package['name']} {package['version']}"
        licence = package["license"] or BY_FILE.get(package["name"], "no licence")
        if not is_allowed(licence):
            yield f"{name}: licence {licence}"
        if package["source"] is None:
            if ROOT not in Path(package["manifest_path"]).parents:
                yield f"{name}: a path outside the repository, {package['manifest_path']}"
        elif not package["source"].startswith("registry+"):
            yield f"{name}: source {package['source']}"
        else:
            sources.add(package["source"])
        versions.setdefault(package["name"], []).append(package["version"])
    if len(sources) > 1:
        yield f"{manifest}: more than one registry: {', '.join(sorted(sources))}"
    for name, found in versions.items():
        if len(found) > 1 and SINGLE.fullmatch(name):
            yield f"{manifest}: {name} in {len(found)} versions: {', '.join(sorted(found))}"


def check_sample():
    """Checks expressions of all forms."""
    assert all(map(is_allowed, ["MIT", "GPL-3.0/MIT", "(MIT OR GPL-3.0) AND ISC", "Apache-2.0 WITH LLVM-exception"]))
    assert not any(map(is_allowed, ["GPL-3.0", "MIT AND GPL-3.0", "MIT WITH other-exception", "no licence"]))


if __name__ == "__main__":
    check_sample()
    found = [*faults("Cargo.toml"), *faults("python/Cargo.toml")]
    print(*found, sep="\n", file=sys.stderr if found else sys.stdout, end="\n" if found else "")
    sys.exit(1 if found else 0)
