"""Triangles and colours of the mesh file of a scanned fruit: GLB, OBJ, PLY or STL.

A file can declare more than it holds, so what it declares is compared with its length before anything is
allocated.
"""

from __future__ import annotations

import codecs
import io
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np

from pepperscene.camera.image.colorimetry import srgb_decode
from pepperscene.document import decode_text
from pepperscene.errors import InputError
from pepperscene.geometry.fruit.scan_glb import glb_bodies
from pepperscene.geometry.fruit.scan_triangles import (
    ALLOWED_SCAN,
    MAX_TRIANGLES_READ,
    ScanTriangles,
    check_count,
    checked_triangles,
    damaged_scan,
)
from pepperscene.geometry.mesh import FloatArray, join_colours
from pepperscene.user_files import MissingFileError, open_file

_MAX_BYTES: Final = {".glb": 200_000_000, ".obj": 100_000_000, ".ply": 100_000_000, ".stl": 100_000_000}
"""Chosen: a million triangles fit, with colours and textures, and are read with less than 2 GB of memory."""
_MAX_TEXT: Final = 100_000_000
_MAX_WORDS: Final = 16 * MAX_TRIANGLES_READ  # chosen: coordinates, texture coordinates and normals need 10
_MAX_MATERIALS: Final = 1_000  # chosen: the time that trimesh takes grows with the square

_STL_HEADER: Final = 84  # bytes: 80 of any content, and the number of triangles (StereoLithography 1989)
_UTF_16: Final = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_STL_TRIANGLE: Final = 50  # bytes: normal, three corners, two bytes of attributes
_PLY_HEADER: Final = 65_536  # bytes; chosen: a hundred times as long as any
_PLY_BYTES: Final[Mapping[str, int]] = {
    "char": 1, "uchar": 1, "short": 2, "ushort": 2, "int": 4, "uint": 4, "float": 4, "double": 8,
    "int8": 1, "uint8": 1, "int16": 2, "uint16": 2, "int32": 4, "uint32": 4, "float32": 4, "float64": 8,
}  # fmt: skip


def read_triangles(path: Path, *, colour: bool = False) -> ScanTriangles:
    """Read the triangles of all groups, nodes and materials of a file.

    Args:
        path: a name that ends in one of `SCAN_SUFFIXES`.
        colour: whether to read colours.

    Raises:
        InputError: the file cannot be read, is too large, is damaged, or has no triangles.
    """
    content, suffix = _read_content(path), path.suffix.lower()
    checks = {".obj": _obj_content, ".ply": _ply_content, ".stl": _stl_content}
    if suffix in checks:
        content = checks[suffix](content, path)
    with _errors_about(path):
        if suffix == ".glb":
            bodies = glb_bodies(content, path, colour=colour)
        else:
            bodies = _read_bodies(content, suffix[1:], colour=colour)
    bodies = [checked_triangles(body, path) for body in bodies if len(body.faces)]
    if not bodies:
        raise InputError(path, f"has no triangles; {ALLOWED_SCAN}")
    check_count(sum(len(body.faces) for body in bodies), path)
    first = np.cumsum([0, *(len(body.vertices) for body in bodies)])
    faces = np.concatenate([body.faces + start for body, start in zip(bodies, first, strict=False)])
    # Points of a body without colours are white.
    colours = join_colours([(body.colours, len(body.vertices)) for body in bodies], 1.0)
    return ScanTriangles(np.concatenate([body.vertices for body in bodies]), faces, colours)


def _read_content(path: Path) -> bytes:
    """The bytes of a file that is not too long for its format."""
    most = _MAX_BYTES[path.suffix.lower()]
    try:
        with open_file(path, "mesh") as file:
            content = file.read(most + 1)
    except MissingFileError:
        raise InputError(path, f"there is no such file; {ALLOWED_SCAN}") from None
    except InputError as error:
        raise InputError(error.where, f"{error.problem}; {ALLOWED_SCAN}") from None
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror or error}); {ALLOWED_SCAN}") from None
    if len(content) > most:
        limit = f"{most // 1_000_000} MB, the most that is read of {path.suffix[1:].upper()}"
        raise InputError(path, f"is longer than {limit}: simplify it before")
    return content


def _text(content: bytes, path: Path) -> str:
    """The text of a file that is not too long."""
    if len(content) > _MAX_TEXT:
        size = _MAX_TEXT // 1_000_000
        raise InputError(
            path, f"is longer than {size} MB, the most that is read of text: save it as binary PLY"
        )
    return decode_text(content, path)


def _obj_content(content: bytes, path: Path) -> bytes:
    """The content, if trimesh can read so many words and materials."""
    text = _text(content, path)
    words = sum(text.count(space) for space in " \t\n")
    if words > _MAX_WORDS:
        problem = f"has {words:,} words, and at most {_MAX_WORDS:,} are read: simplify it before"
        raise InputError(path, problem)
    if (materials := text.count("usemtl")) > _MAX_MATERIALS:
        problem = f"has {materials:,} changes of its material, and at most {_MAX_MATERIALS:,} are read"
        raise InputError(path, f"{problem}: export it without materials")
    return text.encode()


def _stl_content(content: bytes, path: Path) -> bytes:
    """The content of a binary file whose length is right, or a complete text."""
    count = int.from_bytes(content[80:_STL_HEADER], "little")
    expected = _STL_HEADER + _STL_TRIANGLE * count
    if len(content) >= _STL_HEADER and len(content) == expected:
        check_count(count, path)
        return content
    # Binary files can begin with "solid" too, but contain zeros.
    is_text = content.lstrip(b"\xef\xbb\xbf \t\r\n")[:5].lower() == b"solid"
    if b"\0" in content or not is_text:
        if content.startswith(_UTF_16):
            decode_text(content, path)  # raises
        if len(content) < _STL_HEADER:
            raise damaged_scan(
                path, "it is neither text that begins with `solid` nor long enough for a header"
            )
        announced = f"its header announces {count} triangles in {expected} bytes"
        raise damaged_scan(path, f"{announced}, but it has {len(content)}")
    text = _text(content, path)
    if "endsolid" not in text.lower():
        raise damaged_scan(path, "the text ends before `endsolid`")
    check_count(text.count("endloop"), path)
    return text.encode()


def _ply_content(content: bytes, path: Path) -> bytes:
    """The content, of which there is as much as the header announces; text is normalised."""
    content = content.removeprefix(b"\xef\xbb\xbf")
    lines = content[:100].splitlines()
    if not lines or lines[0].strip().lower() != b"ply":
        raise damaged_scan(path, "it does not begin with a line `ply`")
    end = content.find(b"end_header", 0, _PLY_HEADER)
    if end < 0:
        raise damaged_scan(path, "its header has no line `end_header`")
    sizes = _ply_elements(content[:end].decode("latin-1"), path)
    check_count(sum(count for name, count, _ in sizes if name == "face"), path)
    if (most := max((count for _, count, _ in sizes), default=0)) > 3 * MAX_TRIANGLES_READ:
        raise InputError(
            path, f"has {most:,} points, and at most {3 * MAX_TRIANGLES_READ:,} are read: simplify it before"
        )
    is_text = len(lines) > 1 and lines[1].split()[:2] == [b"format", b"ascii"]
    if not is_text:
        least, rest = sum(count * size for _, count, size in sizes), len(content) - end
        if least > rest:
            raise damaged_scan(path, f"its header announces {least} bytes or more, but {rest} follow")
        return content
    text = _text(content, path)
    announced = sum(count for _, count, _ in sizes)
    if (count := text.partition("end_header\n")[2].count("\n") + 1) < announced:
        raise damaged_scan(path, f"its header announces {announced} lines, but {count} follow")
    return text.encode()


def _ply_elements(header: str, path: Path) -> list[tuple[str, int, int]]:
    """Name, number and least bytes of each element that the header of a PLY file announces."""
    elements: list[tuple[str, int, int]] = []
    for line in header.splitlines():
        match line.split():
            case ["element", name, count]:
                if not (count.isascii() and count.isdecimal() and len(count) < 18):
                    raise damaged_scan(
                        path, f"its header announces {count[:30]!r} of the element {name[:30]!r}"
                    )
                elements.append((name, int(count), 0))
            case ["property", *types] if elements:
                # A list can be empty, but has a number of entries.
                size = _PLY_BYTES.get("".join(types[1:2] if types[:1] == ["list"] else types[:1]))
                if size is None:
                    raise damaged_scan(path, f"its header has the line {line[:60]!r}")
                name, number, sum_before = elements[-1]
                elements[-1] = name, number, sum_before + size
    for name, number, size in elements:
        if number and not size:
            raise damaged_scan(path, f"its header announces {number} of {name[:30]!r} without properties")
    return elements


def _read_bodies(content: bytes, file_type: str, *, colour: bool) -> list[ScanTriangles]:
    """The meshes of a file of one of the formats that trimesh reads."""
    import trimesh

    scene = trimesh.load(io.BytesIO(content), file_type=file_type, process=False, skip_materials=True)
    bodies = list(scene.geometry.values()) if isinstance(scene, trimesh.Scene) else [scene]
    return [
        ScanTriangles(body.vertices, body.faces, _point_colours(body) if colour else None)
        for body in bodies
        if hasattr(body, "faces")
    ]


def _point_colours(body: Any) -> FloatArray | None:
    """The colours of a mesh's points, or the means of the colours of the faces around them."""
    if body.visual.kind not in ("vertex", "face"):
        return None
    return srgb_decode(np.asarray(body.visual.vertex_colors)[:, :3] / 255.0)


@contextmanager
def _errors_about(path: Path) -> Iterator[None]:
    """Whatever a reader raises becomes an error about the file."""
    try:
        # NumPy warns of text that is no number, and uses what comes before it.
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            warnings.filterwarnings("error", "string or file could not be read", DeprecationWarning)
            yield
    except (MemoryError, InputError):
        raise  # the first becomes an error of the whole scan
    except Exception as error:  # the readers of these formats raise many kinds
        # A missing key or index alone, or a missing package, would not be understood.
        message = " ".join(str(error).split())[:200]
        raise damaged_scan(path, f"{type(error).__name__}: {message}") from error
