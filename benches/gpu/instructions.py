#!/usr/bin/env python3
"""Counts the instructions of shaders on an NVIDIA GPU without one: python3 benches/gpu/instructions.py FOLDER --out FILE.json

FOLDER has shaders in Metal's language: of training by `kernels.rs` (cargo build --release --workspace --example kernels), of samplers by
`headtail export --target msl --out FOLDER/NAME`. clang (16 or later, CLANG) compiles them as CUDA, and NVIDIA's assembler to the
instructions of ARCHITECTURE (sm_90: H100, H200). ptxas and nvdisasm are those of the Python package triton, or in PATH. A driver has a
compiler of its own before that assembler, so that the numbers say what bounds a shader, not how long it runs.
"""

import argparse
import collections
import importlib.util
import json
import os
import re
import shutil
import subprocess
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
ARCHITECTURE = os.environ.get("ARCHITECTURE", "sm_90")
PLACES = {
    "thread_position_in_grid": "__nvvm_read_ptx_sreg_ctaid_{0}() * __nvvm_read_ptx_sreg_ntid_{0}() + __nvvm_read_ptx_sreg_tid_{0}()",
    "thread_position_in_threadgroup": "__nvvm_read_ptx_sreg_tid_{0}()",
    "threadgroup_position_in_grid": "__nvvm_read_ptx_sreg_ctaid_{0}()",
    "threadgroups_per_grid": "__nvvm_read_ptx_sreg_nctaid_{0}()",
}
VECTOR = r"metal::(?:packed_)?((?:float|uint|int|bool)[234])"


def tool(name):
    """Returns the path of one of NVIDIA's tools."""
    found = importlib.util.find_spec("triton")
    inside = Path(found.origin).parent / "backends/nvidia/bin" / name if found else None
    return str(inside) if inside and inside.exists() else shutil.which(name) or name


def argument(text):
    """Returns an argument of a kernel in CUDA, if it is one there, and what stands at the beginning of the body instead."""
    attribute = re.search(r"\[\[(\w+)", text)
    text = re.sub(r"\s*\[\[.*?\]\]", "", text).strip()
    name = text.split()[-1]
    if attribute and attribute.group(1) in PLACES:
        place = PLACES[attribute.group(1)]
        return None, f"metal::uint3 {name} = metal::make_uint3({', '.join(place.format(axis) for axis in 'xyz')});"
    if attribute and attribute.group(1) == "thread_index_in_threadgroup":
        return None, f"uint {name} = __nvvm_read_ptx_sreg_tid_x() + __nvvm_read_ptx_sreg_ntid_x() * __nvvm_read_ptx_sreg_tid_y();"
    if text.startswith("threadgroup "):
        kind = text.split()[1].rstrip("&")
        return None, f"static __attribute__((__shared__)) {kind} {name};"
    if text.startswith("constant "):
        return text.replace("constant ", "").replace("&", ""), ""
    kind = text[: text.rindex("&")]
    return f"{kind}* __restrict {name}_at", f"{kind}& {name} = *{name}_at;"


def kernel(match):
    """Returns a kernel's beginning in CUDA."""
    name, text = match.groups()
    parts = [argument(part) for part in re.split(r"\n, ", text.strip()) if part.strip()]
    arguments = ", ".join(part for part, _ in parts if part)
    return f'extern "C" __attribute__((__global__)) void {name}({arguments}) {{\n' + "\n".join(part for _, part in parts)


def to_cuda(text):
    """Returns a shader in CUDA."""
    text = re.sub(r"#include.*|using metal::uint;", "", text)
    text = re.sub(r"kernel void (\w+)\((.*?)\n\) \{", kernel, text, flags=re.DOTALL)
    text = re.sub(r"\[\[.*?\]\]", "", text)
    text = re.sub(VECTOR + r"\(", r"metal::make_\1(", text).replace("bool", "int").replace("as_type<", "bits_as<")
    text = re.sub(r"static_cast<(metal::\w+[234])>\(", r"converted<\1>(", text)
    text = re.sub(r"^constant ([\w:]+ \w+ =)", r"static constexpr \1", text, flags=re.MULTILINE)
    text = re.sub(r"^([\w:]+ \w+\((?:[^;{}]*?)\) \{)$", r"INLINE \1", text, flags=re.MULTILINE)
    text = re.sub(r"(?<![\w.])(\d+\.\d+(?:e-?\d+)?)(?![\w.])", r"\1f", text)
    return f'#include "{HERE / "metal.h"}"\n{text}'


def run(*command):
    """Runs a command, and returns all that it printed."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{command[0]} failed:\n{(done.stdout + done.stderr)[:4000]}")
    return done.stdout + done.stderr


def innermost_loops(listing):
    """Returns for each innermost loop of a function the numbers of its instructions, products and loads of each kind."""
    labels, instructions = {}, []
    for line in listing.splitlines():
        if label := re.match(r"(\.L_x_\d+):", line):
            labels[label.group(1)] = len(instructions)
        elif found := re.match(r"\s+/\*[0-9a-f]+\*/\s+(.*?) ?;\s*$", line):
            instructions.append(re.sub(r"^@!?U?P\w+ ", "", found.group(1)))
    loops = set()
    for end, instruction in enumerate(instructions):
        label = re.search(r"BRA.*?(\.L_x_\d+)", instruction)
        if label and labels.get(label.group(1), len(instructions)) <= end:
            loops.add((labels[label.group(1)], end + 1))
    inner = [loop for loop in loops if not any(loop != other and loop[0] <= other[0] and other[1] <= loop[1] for other in loops)]
    counts = []
    for start, end in sorted(inner):
        kinds = collections.Counter(re.match(r"[A-Z0-9]+", instruction).group(0) for instruction in instructions[start:end])
        loads = {name: kinds[name] for name in ("LDG", "LDS", "LDL") if kinds[name]}
        if end - start > 4:
            counts.append({"instructions": end - start, "products": kinds["FFMA"], "loads": loads})
    return len(instructions), counts


def measure(path, folder):
    """Returns what the compilers say of the kernels of a shader."""
    source, assembly, binary = folder / "shader.cu", folder / "shader.ptx", folder / "shader.cubin"
    source.write_text(to_cuda(path.read_text()))
    device = ["-x", "cuda", "--cuda-device-only", f"--cuda-gpu-arch={ARCHITECTURE}", "-nocudainc", "-nocudalib"]
    # As for shaders: products and sums may be one instruction, small numbers be zero, and quotients be 2 ulp off.
    freedom = ["-ffp-contract=fast", "-fgpu-flush-denormals-to-zero", "-mllvm", "-nvptx-prec-divf32=1"]
    run(os.environ.get("CLANG", "clang"), *device, *freedom, "-O3", "-w", "-S", "-o", assembly, source)
    said = run(tool("ptxas"), "-v", "-O3", f"-arch={ARCHITECTURE}", assembly, "-o", binary)
    listing = run(tool("nvdisasm"), "-c", binary)
    rows = []
    for name, text in re.findall(r"Compiling entry function '(\w+)'(.*?)(?=Compiling entry|\Z)", said, re.DOTALL):
        of = lambda pattern, text=text: int((re.search(pattern, text) or [0, 0])[1])
        own = re.search(rf"\.text\.{name}:(.*?)(?=\n\s*\.section|\Z)", listing, re.DOTALL)
        length, loops = innermost_loops(own.group(1) if own else "")
        rows.append({
            "shader": path.parent.name if path.stem == "headtail" else path.stem if name in path.stem else name,
            "registers": of(r"Used (\d+) registers"),
            "private_bytes": of(r"(\d+) bytes stack frame"),
            "spilled_bytes": of(r"(\d+) bytes spill stores"),
            "workgroup_bytes": of(r"(\d+) bytes smem"),
            "instructions": length,
            "innermost_loops": loops,
        })
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rows = [row for path in sorted(given.folder.rglob("*.metal")) for row in measure(path, Path(folder))]
    for row in rows:
        print("{shader}: {registers} registers, {private_bytes} private bytes, {instructions} instructions".format(**row))
        for loop in row["innermost_loops"]:
            print("    a loop of {instructions}, {products} of them products".format(**loop), loop["loads"])
    if given.out:
        given.out.write_text(json.dumps({"architecture": ARCHITECTURE, "shaders": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
