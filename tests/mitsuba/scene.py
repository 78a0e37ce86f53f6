"""Triangles for both renderers: a small generated scene, or those of a .glb file, written without normals.

Without normals both renderers shade flat; they treat interpolated normals at silhouettes differently."""

import json
import struct

import numpy as np

GROUND_WIDTH = 20.0


def small():
    """A ball and two blocks on the ground: vertices [n, 3] and faces [m, 3], counter-clockwise from outside."""
    rings, segments = 16, 32
    latitude, longitude = np.meshgrid(np.linspace(-np.pi / 2, np.pi / 2, rings + 1), np.linspace(0, 2 * np.pi, segments, endpoint=False), indexing="ij")
    ball = np.stack([np.cos(latitude) * np.sin(longitude), np.sin(latitude), np.cos(latitude) * np.cos(longitude)], -1).reshape(-1, 3)
    at = lambda ring, segment: ring * segments + segment % segments
    quads = [(at(r, s), at(r, s + 1), at(r + 1, s + 1), at(r + 1, s)) for r in range(rings) for s in range(segments)]
    parts = [(0.5 * ball + [0, 0.5, 0], split(quads)), block([-1.3, 0, -0.9], [-0.7, 1.4, -0.3]), block([0.6, 0, 0.2], [1.2, 0.5, 0.7])]
    return with_ground(*joined(parts))


def block(low, high):
    corners = np.array([[(low, high)[i >> axis & 1][axis] for axis in range(3)] for i in range(8)], float)
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    return corners, split(quads)


def split(quads):
    return np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def joined(parts):
    starts = np.cumsum([0] + [len(vertices) for vertices, _ in parts[:-1]])
    return np.concatenate([v for v, _ in parts]), np.concatenate([f + start for (_, f), start in zip(parts, starts)])


def with_ground(vertices, faces):
    low, high = vertices.min(0), vertices.max(0)
    center, half = (low + high) / 2, GROUND_WIDTH / 2 * (high - low).max()
    corners = [[center[0] + x * half, low[1], center[2] + z * half] for x, z in ((-1, 1), (1, 1), (1, -1), (-1, -1))]
    return joined([(vertices, faces), (np.array(corners), np.array([[0, 1, 2], [0, 2, 3]]))])


def read_glb(path):
    """All triangles of a .glb whose nodes have no transforms, on the ground."""
    with open(path, "rb") as file:
        data = file.read()
    length = struct.unpack_from("<I", data, 12)[0]
    document, binary = json.loads(data[20 : 20 + length]), data[28 + length :]
    if any(key in node for node in document["nodes"] for key in ("matrix", "translation", "rotation", "scale")):
        raise SystemExit(f"{path}: nodes with transforms are not read here")

    def accessor(index):
        item = document["accessors"][index]
        view = document["bufferViews"][item["bufferView"]]
        kind = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}[item["componentType"]]
        width = {"SCALAR": 1, "VEC3": 3}[item["type"]]
        start = view.get("byteOffset", 0) + item.get("byteOffset", 0)
        return np.frombuffer(binary, kind, item["count"] * width, start).reshape(-1, width)

    parts = []
    for mesh in document["meshes"]:
        for primitive in mesh["primitives"]:
            parts.append((accessor(primitive["attributes"]["POSITION"]).astype(float), accessor(primitive["indices"]).reshape(-1, 3).astype(int)))
    return with_ground(*joined(parts))


def write_glb(path, vertices, faces):
    """Writes one mesh of positions and indices, visible from both sides as in Mitsuba."""
    positions, indices = vertices.astype("<f4").tobytes(), faces.astype("<u4").tobytes()
    binary = positions + indices
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [{"doubleSided": True}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(vertices), "type": "VEC3"},
            {"bufferView": 1, "componentType": 5125, "count": faces.size, "type": "SCALAR"},
        ],
        "bufferViews": [{"buffer": 0, "byteLength": len(positions)}, {"buffer": 0, "byteOffset": len(positions), "byteLength": len(indices)}],
        "buffers": [{"byteLength": len(binary)}],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    with open(path, "wb") as file:
        file.write(struct.pack("<4sIIII", b"glTF", 2, 28 + len(text) + len(binary), len(text), 0x4E4F534A) + text)
        file.write(struct.pack("<II", len(binary), 0x004E4942) + binary)
