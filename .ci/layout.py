#!/usr/bin/env python3
"""Checks the layout of the sources: no import cycles between folders or files of a crate, and wrapped prose.

    python3 .ci/layout.py
"""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
# A binary of several files is a crate of its own.
CRATES = ["sampling/src", "render/src", "model/src", "train/src", "shaders/src", "gpu/src", "capi/src", "eval/src", "eval/src/bin/results", "src", "python/src"]
WIDTH = 120

# Comments, raw strings, strings and characters: their braces and paths are not code.
LITERAL = re.compile(
    r"""//.*|/\*[\s\S]*?\*/|\bb?r(?P<marks>#*)"[\s\S]*?"(?P=marks)|"(?:\\[\s\S]|[^"\\])*"|'(?:\\.[^']*|[^'\\])'"""
)
TEST_MODULE = re.compile(
    r"#\[cfg\((?:test|all\(test\b[^\]]*)\)\]\s*(?:#\[[^\]]*\]\s*)*(?:pub(?:\([^)]*\))?\s+)?mod\s+\w+\s*(?P<end>[;{])"
)


def parts_of(body):
    """Returns the items of a use list `a::b, c::{d, e}`, split at its outermost commas."""
    depth, start, out = 0, 0, []
    for at, letter in enumerate(body + ","):
        depth += (letter == "{") - (letter == "}")
        if letter == "," and depth == 0:
            out.append(body[start:at].strip())
            start = at + 1
    return [part for part in out if part]


def end_of_braces(text, start):
    """Returns the position after the brace that closes the one before `start`."""
    depth = 1
    while depth:
        depth += (text[start] == "{") - (text[start] == "}")
        start += 1
    return start


def code_of(text):
    """Returns a file's code without comments, literals and test modules."""
    text = LITERAL.sub(" ", text)
    while match := TEST_MODULE.search(text):
        end = match.end() if match["end"] == ";" else end_of_braces(text, match.end())
        text = text[: match.start()] + text[end:]
    return text


def paths_of(text, module):
    """Yields the paths in a module's code outside test modules, from the crate's root."""
    text = re.sub(r"\bpub\([^)]*\)", "pub", code_of(text))
    for match in re.finditer(r"\b(crate|super)((?:::\w+)*)(::\{)?", text):
        path = match[2].split("::")[1:]
        base = []
        if match[1] == "super":
            base = list(module[:-1])
            while path and path[0] == "super":
                path, base = path[1:], base[:-1]
        if not match[3]:
            yield base + path
            continue
        end = end_of_braces(text, match.end())
        for part in parts_of(text[match.end() : end - 1]):
            yield base + path + re.split(r"\{| as ", part)[0].strip(":").split("::")


def children_of(text, names):
    """Returns the child modules of these names that a module's code uses, other than to make their items public."""
    text = re.sub(r"\bpub(\([^)]*\))? use [^;]*;", "", code_of(text))
    return [name for name in names if re.search(rf"(?<![:\w]){name}::|\buse (?:self::)?\{{[^;]*\b{name}::", text)]


def graph_of(crate):
    """Returns the modules that each module of a crate uses; modules are tuples of names."""
    modules = {}
    for file in (ROOT / crate).rglob("*.rs"):
        name = file.relative_to(ROOT / crate).with_suffix("").parts
        if name[0] == "bin":
            continue
        modules[name[:-1] if name[-1] == "mod" else name] = file
    graph = {}
    for module, file in modules.items():
        if "tests" in module or module in (("lib",), ("main",)):
            continue
        found = graph.setdefault(module, set())
        for path in paths_of(file.read_text(), module):
            known = next((tuple(path[:k]) for k in range(len(path), 0, -1) if tuple(path[:k]) in modules), None)
            if known and known != module:
                found.add(known)
        children = [other[-1] for other in modules if other[:-1] == module]
        found.update((*module, name) for name in children_of(file.read_text(), children))
    return graph


def cycle_in(graph):
    """Returns nodes of a cycle, the first repeated at the end; None if there is no cycle."""
    done, way = set(), []

    def visit(node):
        if node in way:
            return way[way.index(node) :] + [node]
        if node in done:
            return None
        way.append(node)
        found = next(filter(None, map(visit, sorted(graph.get(node, ())))), None)
        way.pop()
        done.add(node)
        return found

    return next(filter(None, map(visit, sorted(graph))), None)


def cycles():
    """Yields a message for each crate with a cycle of files or folders."""
    for crate in CRATES:
        files = graph_of(crate)
        folders = {}
        for module, taken in files.items():
            folders.setdefault(module[:1], set()).update(other[:1] for other in taken if other[0] != module[0])
        for kind, graph in [("files", files), ("folders", folders)]:
            if way := cycle_in(graph):
                yield f"{crate}: {kind} take from each other: " + " -> ".join("::".join(node) for node in way)


def long_lines():
    """Yields prose lines that are too long; tables, code, headings and lines without a space to break at are
    exempt."""
    tracked = subprocess.run(["git", "ls-files", "*.md"], cwd=ROOT, capture_output=True, text=True, check=True)
    for name in tracked.stdout.split():
        is_code = is_generated = False
        for number, line in enumerate((ROOT / name).read_text().splitlines(), 1):
            if line.lstrip().startswith("```"):
                is_code = not is_code
            is_generated = (is_generated or line.startswith("<!-- results: ")) and line != "<!-- end of results -->"
            is_free = is_code or is_generated or re.match(r"\s*(\||#|!\[|<!--)", line) or " " not in line.strip()[:WIDTH].lstrip("-* ")
            if len(line) > WIDTH and not is_free:
                yield f"{name}:{number}: {len(line)} characters"


SAMPLE = r"""
//! [`crate::comment`]
#[cfg(test)]
mod declared;

use super::sibling::{One, Two};

#[cfg(all(test, unix))]
#[path = "inline.rs"]
pub(crate) mod inline {
    use crate::test_support;
    const BRACES: (&str, &str, char) = ("{", r#"}"{"#, '{');
}

fn name<'a>(_: &'a str) -> crate::last::Name {
    Name("crate::string", '\'')
}
"""


def check_sample():
    """Checks on a sample that paths are found before and after its test modules but not inside them."""
    found = list(paths_of(SAMPLE, ("folder", "file")))
    assert found == [["folder", "sibling", "One"], ["folder", "sibling", "Two"], ["last", "Name"]], found


if __name__ == "__main__":
    check_sample()
    found = [*cycles(), *long_lines()]
    print(*found, sep="\n", file=sys.stderr if found else sys.stdout, end="\n" if found else "")
    sys.exit(1 if found else 0)
