"""Triangles of the mesh file of a scanned fruit: OBJ, PLY or STL."""

from __future__ import annotations

import codecs
import io
import re
import warnings
from pathlib import Path
from typing import Any, Final

import numpy as np

from pepperscene.document import decode_text
from pepperscene.errors import InputError
from pepperscene.geometry.mesh import FloatArray, IndexArray

FORMATS: Final = (".obj", ".ply", ".stl")
ALLOWED_SCAN: Final = (
    "a scanned fruit must be an OBJ, PLY or STL file with one closed surface, "
    "upright with its stalk end on top"
)

_LARGEST_COORDINATE: Final = 1e12
"""Chosen: a metre in picometres; products of three such numbers do not overflow."""
_STL_HEADER: Final = 84  # bytes: 80 of any content, and the number of triangles (StereoLithography 1989)
_UTF_16: Final = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_STL_TRIANGLE: Final = 50  # bytes: normal, three corners, two bytes of attributes


def read_triangles(path: Path) -> tuple[FloatArray, IndexArray]:
    """Vertices `(v, 3)` and faces `(f, 3)` of the file, of all its groups and materials.

    Raises:
        InputError: the file cannot be read, is damaged, or has no triangles.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror}); {ALLOWED_SCAN}") from None
    suffix = path.suffix.lower()
    check = {".obj": _obj_content, ".ply": _ply_content, ".stl": _stl_content}[suffix]
    bodies = [_body_triangles(body, path) for body in _read_bodies(check(content, path), suffix[1:], path)]
    bodies = [(vertices, faces) for vertices, faces in bodies if len(faces)]
    if not bodies:
        raise InputError(path, f"has no triangles; {ALLOWED_SCAN}")
    first = np.cumsum([0, *(len(vertices) for vertices, _ in bodies)])
    faces = [faces + start for (_, faces), start in zip(bodies, first, strict=False)]
    return np.concatenate([vertices for vertices, _ in bodies]), np.concatenate(faces)


def _obj_content(content: bytes, path: Path) -> bytes:
    return decode_text(content, path).encode()


def _stl_content(content: bytes, path: Path) -> bytes:
    """The content of a binary file whose length is right, or a complete text."""
    count = int.from_bytes(content[80:_STL_HEADER], "little")
    expected = _STL_HEADER + _STL_TRIANGLE * count
    if len(content) >= _STL_HEADER and len(content) == expected:
        return content
    # Binary files can begin with "solid" too, but contain zeros.
    is_text = content.lstrip(b"\xef\xbb\xbf \t\r\n")[:5].lower() == b"solid"
    if b"\0" in content or not is_text:
        if content.startswith(_UTF_16):
            decode_text(content, path)  # raises
        if len(content) < _STL_HEADER:
            raise _damaged(path, "it is neither text that begins with `solid` nor long enough for a header")
        announced = f"its header announces {count} triangles in {expected} bytes"
        raise _damaged(path, f"{announced}, but it has {len(content)}")
    text = decode_text(content, path)
    if "endsolid" not in text.lower():
        raise _damaged(path, "the text ends before `endsolid`")
    return text.encode()


def _ply_content(content: bytes, path: Path) -> bytes:
    """The content with a complete header; text is normalised."""
    content = content.removeprefix(b"\xef\xbb\xbf")
    lines = content[:100].splitlines()
    if not lines or lines[0].strip().lower() != b"ply":
        raise _damaged(path, "it does not begin with a line `ply`")
    if b"end_header" not in content:
        raise _damaged(path, "its header has no line `end_header`")
    is_text = len(lines) > 1 and lines[1].split()[:2] == [b"format", b"ascii"]
    if not is_text:
        return content
    text = decode_text(content, path)
    header, _, body = text.partition("end_header\n")
    announced = sum(int(count) for count in re.findall(r"(?m)^element\s+\S+\s+(\d{1,12})\s*$", header))
    if (count := len(body.splitlines())) < announced:
        raise _damaged(path, f"its header announces {announced} lines, but {count} follow")
    return text.encode()


def _read_bodies(content: bytes, file_type: str, path: Path) -> list[Any]:
    """The meshes of a file."""
    import trimesh

    try:
        # NumPy warns of text that is no number, and uses what comes before it.
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            warnings.filterwarnings("error", "string or file could not be read", DeprecationWarning)
            scene = trimesh.load(io.BytesIO(content), file_type=file_type, process=False, skip_materials=True)
            bodies = list(scene.geometry.values()) if isinstance(scene, trimesh.Scene) else [scene]
            return [(body.vertices, body.faces) for body in bodies if hasattr(body, "faces")]
    except MemoryError:
        raise
    except Exception as error:  # the readers of these formats raise many kinds
        # A missing key or index alone, or a missing package, would not be understood.
        raise _damaged(path, f"{type(error).__name__}: {error}") from error


def _body_triangles(body: tuple[Any, Any], path: Path) -> tuple[FloatArray, IndexArray]:
    """Vertices and faces of one mesh, if every face has three corners that exist."""
    vertices, faces = np.asarray(body[0]), np.asarray(body[1])
    if len(faces) == 0:
        return np.empty((0, 3)), np.empty((0, 3), dtype=np.intp)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or vertices.dtype.kind not in "fiu":
        raise _damaged(path, "its points do not have three coordinates each")
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "fiu":
        raise _damaged(path, "its faces cannot be divided into triangles")
    count = len(vertices)
    exists = (faces >= -count) & (faces < count) & (faces == np.floor(faces))
    if not exists.all():
        corner = faces[~exists][0]
        raise _damaged(path, f"a triangle has the corner {corner:g}, and there are {count} points")
    # Negative numbers count from the last point.
    faces = faces.astype(np.intp) % count
    points = vertices.astype(float)
    used = points[faces]
    if not np.isfinite(used).all():
        raise InputError(path, f"has points that are not finite numbers; {ALLOWED_SCAN}")
    if np.abs(used).max() > _LARGEST_COORDINATE:
        problem = f"has a coordinate beyond {_LARGEST_COORDINATE:g}; {ALLOWED_SCAN}"
        raise InputError(path, problem, value=float(np.abs(used).max()))
    return points, faces


def _damaged(path: Path, reason: str) -> InputError:
    return InputError(path, f"cannot be read as a mesh ({reason}); {ALLOWED_SCAN}")
