"""Mesh files that are damaged, absurd or made to exhaust memory, by name; each is written by its function."""

from __future__ import annotations

import gzip
import json
import os
import struct
import zipfile
import zlib
from io import BytesIO

import numpy as np
import trimesh

BALL = trimesh.creation.icosphere(subdivisions=3, radius=30.0)
SUFFIXES = ("glb", "obj", "ply", "stl")


def encoded(vertices, faces, kind):
    """A mesh, whatever is wrong with it, as a file; `kind` is a suffix, or "text ply" or "text stl"."""
    points, corners = np.asarray(vertices, float), np.asarray(faces, int)
    if kind == "glb":
        return glb(points, corners)
    rows = [" ".join(map(str, row)) for row in points.tolist()]
    if kind == "obj":
        lines = [f"v {row}" for row in rows] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in corners.tolist()]
        return "\n".join([*lines, ""]).encode()
    if kind == "text stl":
        facets = ["vertex " + "\nvertex ".join(rows[corner] for corner in face) for face in corners.tolist()]
        body = "".join(f"facet normal 0 0 0\nouter loop\n{one}\nendloop\nendfacet\n" for one in facets)
        return f"solid fruit\n{body}endsolid fruit\n".encode()
    if kind == "stl":
        triangles = np.pad(points[corners].reshape(-1, 9).astype("<f4"), ((0, 0), (3, 0)))
        rows = (row.tobytes() + b"\0\0" for row in triangles)
        return bytes(80) + struct.pack("<I", len(faces)) + b"".join(rows)
    header = f"element vertex {len(points)}", *XYZ, f"element face {len(corners)}", CORNERS
    if kind == "text ply":
        lines = rows + [f"3 {a} {b} {c}" for a, b, c in corners.tolist()]
        return ply_header(*header, form="ascii") + "\n".join([*lines, ""]).encode()
    triangles = b"".join(b"\3" + row.astype("<i4").tobytes() for row in corners)
    return ply_header(*header) + points.astype("<f4").tobytes() + triangles


def glb(vertices=None, faces=None, *, binary=b"", **changes):
    """A GLB of one mesh; `changes` replace entries of its structure, or make them of the whole."""
    vertices = BALL.vertices if vertices is None else vertices
    faces = BALL.faces if faces is None else faces
    points, corners = np.asarray(vertices, "<f4").tobytes(), np.asarray(faces, "<i8").astype("<u4").tobytes()
    tree = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(vertices), "type": "VEC3"},
            {"bufferView": 1, "componentType": 5125, "count": 3 * len(faces), "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": len(points)},
            {"buffer": 0, "byteOffset": len(points), "byteLength": len(corners)},
        ],
        "buffers": [{"byteLength": len(points) + len(corners) + len(binary)}],
    }  # fmt: skip
    for key, change in changes.items():
        tree[key] = change(tree.get(key)) if callable(change) else change
    return glb_file(json.dumps(tree).encode(), points + corners + binary)


def glb_file(text, binary):
    """The two chunks with their headers."""
    text, binary = text + b" " * (-len(text) % 4), binary + b"\0" * (-len(binary) % 4)
    chunks = ((b"JSON", text), (b"BIN\0", binary))
    body = b"".join(struct.pack("<I4s", len(content), kind) + content for kind, content in chunks)
    return b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body


def entry(number, **values):
    """A change of one entry of a list."""
    return lambda entries: [item | values if index == number else item for index, item in enumerate(entries)]


def textured(image, uv=None, **texture):
    """A GLB with a texture, whose surface coordinates default to x and y."""
    uv = np.asarray(BALL.vertices[:, :2] / 60.0 + 0.5 if uv is None else uv, "<f4").tobytes()
    start = BALL.vertices.size * 4 + BALL.faces.size * 4
    views = [
        {"buffer": 0, "byteOffset": start, "byteLength": len(uv)},
        {"buffer": 0, "byteOffset": start + len(uv), "byteLength": len(image)},
    ]
    coordinates = {"bufferView": 2, "componentType": 5126, "count": len(BALL.vertices), "type": "VEC2"}
    attributes = {"POSITION": 0, "TEXCOORD_0": 2}
    return glb(
        binary=uv + image,
        meshes=[{"primitives": [{"attributes": attributes, "indices": 1, "material": 0}]}],
        accessors=lambda items: [*items, coordinates],
        bufferViews=lambda items: [*items, *views],
        images=[{"bufferView": 3, "mimeType": "image/png"}],
        textures=[{"source": 0}],
        materials=[{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0, **texture}}}],
    )


def png(width, height, pixels=b""):
    """A PNG image of 8-bit RGB whose header states a size, whatever it holds."""

    def chunk(kind, content):
        size, checksum = (struct.pack(">I", number) for number in (len(content), zlib.crc32(kind + content)))
        return size + kind + content + checksum

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    parts = chunk(b"IHDR", header), chunk(b"IDAT", zlib.compress(pixels, 9)), chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def ply_header(*lines, form="binary_little_endian"):
    return "\n".join(["ply", f"format {form} 1.0", *lines, "end_header", ""]).encode()


XYZ = ("property float x", "property float y", "property float z")
CORNERS, LONG = (f"property list {kind} int vertex_indices" for kind in ("uchar", "uint"))


def _changed_points(number, value):
    points = np.array(BALL.vertices)
    points[number] = value
    return points


def meshes():
    """Vertices and faces by name, and whether a fruit can be made of them."""
    points, faces = np.asarray(BALL.vertices), np.asarray(BALL.faces)
    line = np.linspace(0.0, 1.0, len(points))[:, None] * np.ones(3)
    upper = faces[BALL.triangles_center[:, 2] > 0.0]
    return {
        "one triangle": (points[:3], faces[:1] * 0 + [[0, 1, 2]], False),
        "no triangle": (points, faces[:0], False),
        "nan": (_changed_points(7, np.nan), faces, False),
        "inf": (_changed_points(7, np.inf), faces, False),
        "huge": (1e30 * points, faces, False),
        "tiny": (1e-30 * points, faces, True),
        "all in one place": (np.ones_like(points), faces, False),
        "on a line": (line, faces, False),
        "half": (points, upper, False),
        "small hole": (points, faces[:-2], True),
        "duplicates": (points, np.concatenate([faces, faces]), True),
        "inside out": (points, faces[:, ::-1], True),
        "needles": (points, np.concatenate([faces, faces[:, [0, 0, 1]]]), True),
        "three at an edge": (points, np.concatenate([faces, [[0, 1, 40]]]), None),
        "random triangles": (points, np.random.default_rng(1).integers(0, len(points), faces.shape), None),
    }


def contents():
    """Content by file name, and whether it can be read: True, False, or None for either."""
    files = {}
    for name, (points, faces, usable) in meshes().items():
        for kind in (*SUFFIXES, "text ply", "text stl"):
            files[f"{name} {kind}.{kind[-3:]}"] = encoded(points, faces, kind), usable
    files |= _headers() | _structures() | _texts()
    valid = {kind: encoded(BALL.vertices, BALL.faces, kind) for kind in (*SUFFIXES, "text ply", "text stl")}
    rng = np.random.default_rng(2)
    for kind, content in valid.items():
        suffix = kind[-3:]
        files[f"empty {kind}.{suffix}"] = b"", False
        files[f"päprika 果実 {kind}.{suffix}"] = content, True
        for other in SUFFIXES:
            if other != suffix:
                files[f"{kind} as.{other}"] = content, False
        for number in range(4):
            # The last bytes may be padding, or a line break.
            files[f"cut {number} {kind}.{suffix}"] = content[: rng.integers(len(content) - 8)], None
            changed, is_text = bytearray(content), kind == "obj" or "text" in kind
            for place in rng.integers(len(content), size=20):
                changed[place] = rng.choice(list(b"0123456789.-ef \n")) if is_text else rng.integers(256)
            files[f"changed {number} {kind}.{suffix}"] = bytes(changed), None
        files[f"noise {kind}.{suffix}"] = content[:30] + rng.bytes(5000), False
    return files


def _headers():
    """Files that announce more than they hold."""
    many = 4_000_000_000
    stl = bytearray(encoded(BALL.vertices, BALL.faces, "stl"))
    stl[80:84] = struct.pack("<I", 2**32 - 1)
    start = glb()
    long_chunk = start[:12] + struct.pack("<I", 2**32 - 1) + start[16:]
    faces = ("element face 2", CORNERS)
    files = {
        "count.stl": bytes(stl),
        "length.glb": start[:8] + struct.pack("<I", 2**32 - 1) + start[12:],
        "chunk.glb": long_chunk,
        "version.glb": start[:4] + struct.pack("<I", 1) + start[8:],
        "points.ply": ply_header(f"element vertex {many}", *XYZ, *faces),
        "points text.ply": ply_header(f"element vertex {many}", *XYZ, *faces, form="ascii"),
        "faces.ply": ply_header("element vertex 3", *XYZ, f"element face {many}", CORNERS) + bytes(60),
        "digits.ply": ply_header("element vertex " + 30 * "9", *XYZ, *faces),
        "negative.ply": ply_header("element vertex -3", *XYZ, *faces),
        "unknown type.ply": ply_header("element vertex 3", "property real x", *faces) + bytes(99),
        "no type.ply": ply_header("element vertex 3", "property", *faces) + bytes(99),
        "equal corners.obj": b"v 0 0 0\nv 1e-9 0 0\nv 1 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n",
        "long list.ply": ply_header("element vertex 3", *XYZ, "element face 1", LONG)
        + bytes(36) + struct.pack("<I", 2**32 - 1) + bytes(12),
        "endless header.ply": b"ply\nformat ascii 1.0\n" + b"comment x\n" * 20_000,
        "accessor.glb": glb(accessors=entry(0, count=many)),
        "corners.glb": glb(accessors=entry(1, count=many)),
        "without content.glb": glb(accessors=entry(0, bufferView=None, count=many)),
        "no view.glb": glb(accessors=[{"componentType": 5126, "count": 10**9, "type": "VEC3"}] * 2),
        "sparse.glb": glb(accessors=entry(0, sparse={"count": many})),
        "view.glb": glb(bufferViews=entry(0, byteLength=many)),
        "negative view.glb": glb(bufferViews=entry(0, byteOffset=-8)),
        "stride.glb": glb(bufferViews=entry(0, byteStride=many)),
    }  # fmt: skip
    return {name: (content, False) for name, content in files.items()}


def _structures():
    """GLB files of a structure that glTF does not allow, or that grows beyond memory."""
    doubling = [{"children": [number + 1, number + 1]} for number in range(60)] + [{"mesh": 0}]
    copies = [{"children": list(range(1, 10_001))}, *[{"mesh": 0}] * 10_000]
    one = [{"attributes": {"POSITION": 0}, "indices": 1}]
    deep = 200_000
    files = {
        "doubling.glb": glb(nodes=doubling),
        "copies.glb": glb(nodes=copies),
        "primitives.glb": glb(meshes=[{"primitives": one * 20_000}]),
        "shared points.glb": glb(accessors=entry(1, count=3), meshes=[{"primitives": one * 10_000}]),
        "cycle.glb": glb(nodes=[{"children": [1]}, {"children": [0], "mesh": 0}]),
        "deep.glb": glb_file(b"[" * deep, b""),
        "not json.glb": glb_file(b"{,}", b""),
        "nothing.glb": glb_file(b"{}", b""),
        "no scene.glb": glb(scenes=[]),
        "negative child.glb": glb(nodes=[{"children": [-1], "mesh": 0}]),
        "matrix.glb": glb(nodes=[{"mesh": 0, "matrix": [1.0] * 15}]),
        "flattening.glb": glb(nodes=[{"mesh": 0, "scale": [1.0, 1.0, 0.0]}]),
        "rotation.glb": glb(nodes=[{"mesh": 0, "rotation": [0.0, 0.0, 0.0, 0.0]}]),
        "text for a number.glb": glb(accessors=entry(0, count="12")),
        "component.glb": glb(accessors=entry(0, componentType=7)),
        "strip.glb": glb(meshes=[{"primitives": [{**one[0], "mode": 5}]}]),
        "draco.glb": glb(extensionsRequired=["KHR_draco_mesh_compression"]),
        "other file.glb": glb(buffers=[{"byteLength": 9, "uri": "/dev/zero"}]),
        "big texture.glb": textured(png(60_000, 60_000)),
        "cut texture.glb": textured(png(64, 64)),
        "texture number.glb": textured(png(1, 1, bytes(4)), index=5),
        "moved texture.glb": textured(png(1, 1, bytes(4)), extensions={"KHR_texture_transform": {}}),
    }
    usable = {
        "textured.glb": textured(png(2, 2, bytes([0, *6 * [200], 0, *6 * [90]]))),
        "nan coordinates.glb": textured(png(1, 1, bytes(4)), np.full((len(BALL.vertices), 2), np.nan)),
        "turned.glb": glb(nodes=[{"mesh": 0, "rotation": [0.5, 0.5, 0.5, 0.5], "scale": [-2.0, 1.0, 1.0]}]),
    }
    read = {name: (content, False) for name, content in files.items()}
    return read | {name: (content, True) for name, content in usable.items()}


def _texts():
    """Text files with absurd lines, and other programs' files under the name of a mesh."""
    obj = encoded(BALL.vertices, BALL.faces, "obj")
    archive = BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as files:
        files.writestr("fruit.glb", bytes(2_000_000))
    packed = {"archive": archive.getvalue(), "packed": gzip.compress(bytes(2_000_000))}
    bombs = {f"{name}.{suffix}": content for name, content in packed.items() for suffix in SUFFIXES}
    refused = {
        "corner.obj": obj + b"f 1 2 99999999\n",
        "digits.obj": obj + b"f 1 2 " + 400 * b"9" + b"\n",
        "words.obj": obj + b"v one two three\n",
        "utf-16.obj": obj.decode().encode("utf-16"),
        "polygon.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\n" + b"f" + b" 1 2 3" * 30_000 + b"\n",
        "materials.obj": obj + b"".join(b"usemtl a%d\nf 1 2 3\n" % number for number in range(1001)),
        "one line.obj": b"v" + b" 1" * 200_000,
        "no end.stl": encoded(BALL.vertices, BALL.faces, "text stl")[:-60],
        "words.stl": encoded(BALL.vertices, BALL.faces, "text stl").replace(b"vertex", b"vertex x", 3),
    }
    usable = {
        "library.obj": b"mtllib /dev/zero\nusemtl skin\n" + obj,
        "comments.obj": b"# " + 100_000 * b"x" + b"\n" + obj,
    }
    files = {name: (content, False) for name, content in (refused | bombs).items()}
    return files | {name: (content, True) for name, content in usable.items()}


def large_scan():
    """A coloured sphere of seven tenths of the triangles that are read, with needles at its poles, as PLY."""
    sphere = trimesh.creation.uv_sphere(radius=1.0, count=[420, 420])
    sphere.visual.vertex_colors = [200, 50, 20, 255]
    return sphere.export(file_type="ply")


def special_files(folder):
    """Make what has the name of a file and is none; returns the paths."""
    paths = []
    for suffix in SUFFIXES:
        (directory := folder / f"directory.{suffix}").mkdir()
        (endless := folder / f"endless.{suffix}").symlink_to("/dev/zero")
        (dangling := folder / f"dangling.{suffix}").symlink_to(folder / "nowhere")
        (circle := folder / f"circle.{suffix}").symlink_to(folder / f"circle.{suffix}")
        os.mkfifo(pipe := folder / f"pipe.{suffix}")
        (holes := folder / f"a terabyte of zeros.{suffix}").touch()
        os.truncate(holes, 10**12)
        paths += [directory, endless, dangling, circle, pipe, holes, folder / f"{'long' * 80}.{suffix}"]
    return paths
