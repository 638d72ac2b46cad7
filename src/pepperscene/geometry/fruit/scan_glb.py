"""Triangles and colours of a binary glTF file (Khronos 2021, "glTF 2.0 Specification").

Our own reader, because trimesh's rounds the linear colours of points to 8 bits, of which dark skin has four,
and allocates what a file declares, a million copies of one mesh or an array without content. It reads what a
scan consists of: triangles in a tree of nodes, colours of points, and the base colour of materials.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.image.colorimetry import srgb_decode
from pepperscene.document import parse_json
from pepperscene.errors import InputError
from pepperscene.geometry.fruit.scan_triangles import (
    MAX_TRIANGLES_READ,
    ScanTriangles,
    check_count,
    damaged_scan,
)
from pepperscene.geometry.mesh import FloatArray, IndexArray

_JSON, _BIN = b"JSON", b"BIN\0"
_MAX_JSON: Final = 16_000_000  # bytes; chosen: a scan's has a few kilobytes
_MAX_NODES: Final = 100_000  # chosen
_MAX_PIXELS: Final = 8192 * 8192  # of all textures; chosen: 200 MB as an image of 8 bits
_IMAGES: Final = ("PNG", "JPEG", "WEBP")
_TYPES: Final[Mapping[int, str]] = {
    5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4",
}  # fmt: skip
_WIDTHS: Final[Mapping[str, int]] = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_TRIANGLES: Final = 4  # mode of a primitive; those below are points and lines
# Towards each corner of a triangle, where no texel beyond an edge of the texture's charts is met.
_NEAR_CORNERS: Final = np.array([[4.0, 1.0, 1.0], [1.0, 4.0, 1.0], [1.0, 1.0, 4.0]]) / 6.0


def glb_bodies(content: bytes, path: Path, *, colour: bool) -> list[ScanTriangles]:
    """Read the triangles of all nodes of the file's scene.

    Colours are the product of the colours of the points, the material's base colour and its texture, which is
    averaged over the triangles around each point.

    Raises:
        InputError: the file is damaged, has too many triangles, or needs an extension that is not read.
        Exception: of many kinds, where the structure is not that of glTF.
    """
    try:
        return _scene_bodies(*_chunks(content, path), path, colour=colour)
    except (KeyError, IndexError) as error:
        raise damaged_scan(path, f"an entry of its structure is missing or unknown: {error}") from None


def _scene_bodies(
    tree: Mapping[str, Any], binary: memoryview, path: Path, *, colour: bool
) -> list[ScanTriangles]:
    """The triangles of all nodes."""
    for name in map(str, tree.get("extensionsRequired", [])):
        if name != "KHR_mesh_quantization" and not name.startswith("KHR_materials_"):
            raise InputError(path, f"needs {name}, which is not read: export it without that extension")
    file = _Accessors(tree, binary, path)
    bodies, triangles, most_points = [], 0, 3 * MAX_TRIANGLES_READ
    for transform, primitive in _primitives(tree, path):
        mode = primitive.get("mode", _TRIANGLES)
        if mode < _TRIANGLES:
            continue
        if mode != _TRIANGLES:
            raise InputError(path, "has strips or fans of triangles: export it with separate ones")
        triangles += file.corner_count(primitive) // 3
        check_count(triangles, path)
        points, faces = file.points(primitive), file.faces(primitive)
        # Primitives can share points, of which each gets its own.
        most_points -= len(points)
        if most_points < 0:
            raise damaged_scan(path, "its primitives have three times as many points as triangles are read")
        bodies.append(
            ScanTriangles(
                points @ transform[:3, :3].T + transform[:3, 3],
                faces,
                _colours(file, primitive, faces, len(points), path) if colour else None,
            )
        )
    return bodies


def _chunks(content: bytes, path: Path) -> tuple[dict[str, Any], memoryview]:
    """The structure and the binary content."""
    length = int.from_bytes(content[8:12], "little")
    if content[:4] != b"glTF" or len(content) < 20:
        raise damaged_scan(path, "it does not begin with `glTF`")
    if int.from_bytes(content[4:8], "little") != 2:
        raise damaged_scan(path, "it is not glTF of version 2")
    if length != len(content):
        raise damaged_scan(path, f"its header announces {length} bytes, but it has {len(content)}")
    chunks: dict[bytes, memoryview] = {}
    view, start = memoryview(content), 12
    while start + 8 <= len(content):
        size, kind = int.from_bytes(content[start : start + 4], "little"), content[start + 4 : start + 8]
        start += 8
        if start + size > len(content):
            raise damaged_scan(path, f"a chunk announces {size} bytes, but {len(content) - start} follow")
        chunks.setdefault(kind, view[start : start + size])
        start += size
    text = chunks.get(_JSON, b"")
    if len(text) > _MAX_JSON:
        raise damaged_scan(path, f"its structure has {len(text)} bytes, and at most {_MAX_JSON} are read")
    tree = parse_json(bytes(text))
    if not isinstance(tree, dict):
        raise damaged_scan(path, "its structure is not a table")
    return tree, chunks.get(_BIN, memoryview(b""))


def _primitives(tree: Mapping[str, Any], path: Path) -> Iterator[tuple[FloatArray, dict[str, Any]]]:
    """Each primitive of the scene with the transform of its node, `(4, 4)`."""
    nodes = tree.get("nodes", [])
    if len(nodes) > _MAX_NODES:
        raise damaged_scan(path, f"it has {len(nodes)} nodes, and at most {_MAX_NODES} are read")
    scene = tree["scenes"][_index(tree.get("scene", 0))]
    stack = [(_index(root), np.eye(4)) for root in reversed(scene.get("nodes", []))]
    visited: set[int] = set()
    while stack:
        number, above = stack.pop()
        if number in visited:
            raise damaged_scan(path, "its nodes do not form a tree")
        visited.add(number)
        node = nodes[number]
        transform = above @ _transform(node)
        if "mesh" in node:
            for primitive in tree["meshes"][_index(node["mesh"])]["primitives"]:
                yield transform, primitive
        stack += [(_index(child), transform) for child in reversed(node.get("children", []))]


def _transform(node: Mapping[str, Any]) -> FloatArray:
    """`(4, 4)` of a node, from its matrix or from scale, rotation and translation."""
    from scipy.spatial.transform import Rotation

    if "matrix" in node:
        return np.array(node["matrix"], dtype=float).reshape(4, 4).T
    result = np.eye(4)
    rotation = Rotation.from_quat(np.array(node.get("rotation", [0.0, 0.0, 0.0, 1.0]), dtype=float))
    result[:3, :3] = rotation.as_matrix() * np.array(node.get("scale", [1.0, 1.0, 1.0]), dtype=float)
    result[:3, 3] = node.get("translation", [0.0, 0.0, 0.0])
    return result


def _index(value: Any) -> int:
    """A number of an entry; Python would count negative ones from the end."""
    if type(value) is not int or value < 0:
        raise ValueError(f"{str(value)[:30]!r} is not a number of an entry")
    return value


class _Accessors:
    """The arrays of a file, each within its content."""

    def __init__(self, tree: Mapping[str, Any], binary: memoryview, path: Path) -> None:
        self.tree, self._binary, self._path = tree, binary, path
        self._images: dict[int, NDArray[np.uint8]] = {}
        self._pixels = 0

    def corner_count(self, primitive: Mapping[str, Any]) -> int:
        """Number of corners of the triangles, as declared."""
        number = primitive.get("indices", primitive["attributes"]["POSITION"])
        return _index(self.tree["accessors"][_index(number)]["count"])

    def points(self, primitive: Mapping[str, Any]) -> FloatArray:
        """`(v, 3)` points of a primitive."""
        return self._floats(primitive["attributes"]["POSITION"])

    def faces(self, primitive: Mapping[str, Any]) -> IndexArray:
        """`(f, 3)` triangles of a primitive, which need no indices if no point is shared."""
        if "indices" in primitive:
            corners = self._array(primitive["indices"])[:, 0].astype(np.intp)
        else:
            corners = np.arange(self.corner_count(primitive))
        return corners.reshape(-1, 3)

    def attribute(self, primitive: Mapping[str, Any], name: str) -> FloatArray | None:
        """`(v, k)` values of the points, or None if there are none of this name."""
        number = primitive["attributes"].get(name)
        return None if number is None else self._floats(number)

    def texture(self, number: Any) -> NDArray[np.uint8]:
        """`(h, w, 3)` image of a texture."""
        from PIL import Image, UnidentifiedImageError

        image_number = _index(self.tree["textures"][_index(number)]["source"])
        if image_number in self._images:
            return self._images[image_number]
        source = self.tree["images"][image_number]
        if "bufferView" not in source:
            raise InputError(self._path, "has its texture in another file: export it with embedded textures")
        try:
            with Image.open(io.BytesIO(self._view(source["bufferView"])), formats=_IMAGES) as image:
                self._pixels += image.width * image.height
                if self._pixels > _MAX_PIXELS:
                    raise Image.DecompressionBombError
                self._images[image_number] = np.asarray(image.convert("RGB"))
        except UnidentifiedImageError:
            raise damaged_scan(self._path, f"its texture is not a {', '.join(_IMAGES)} image") from None
        except Image.DecompressionBombError:
            problem = "has textures of more than 8192 x 8192 pixels together: make them smaller"
            raise InputError(self._path, problem) from None
        return self._images[image_number]

    def _floats(self, number: Any) -> FloatArray:
        """Values as numbers; integers that stand for fractions are divided by the largest."""
        values = self._array(number)
        result = values.astype(float)
        if self.tree["accessors"][number].get("normalized") and values.dtype.kind in "iu":
            result = np.maximum(result / np.iinfo(values.dtype).max, -1.0)
        return result

    def _array(self, number: Any) -> NDArray[Any]:
        """`(n, k)` values of an accessor."""
        accessor = self.tree["accessors"][_index(number)]
        if "sparse" in accessor or "bufferView" not in accessor:
            raise InputError(self._path, "has a sparse array, which is not read: export it without")
        dtype, width = np.dtype(_TYPES[accessor["componentType"]]), _WIDTHS[accessor["type"]]
        count, offset = _index(accessor["count"]), _index(accessor.get("byteOffset", 0))
        content = self._view(accessor["bufferView"])
        stride = self.tree["bufferViews"][accessor["bufferView"]].get("byteStride", dtype.itemsize * width)
        if count and offset + (count - 1) * _index(stride) + dtype.itemsize * width > len(content):
            raise damaged_scan(
                self._path, f"an array announces {count} entries, but {len(content)} bytes follow"
            )
        if count > 3 * MAX_TRIANGLES_READ:
            raise damaged_scan(self._path, f"an array has {count} entries, more than are read")
        return np.ndarray((count, width), dtype, content, offset, (stride, dtype.itemsize))

    def _view(self, number: Any) -> memoryview:
        """The content of a buffer view."""
        view = self.tree["bufferViews"][_index(number)]
        start, size = _index(view.get("byteOffset", 0)), _index(view["byteLength"])
        if view["buffer"] != 0 or "uri" in self.tree["buffers"][0]:
            raise InputError(self._path, "has its content in another file: export it as one GLB")
        if start + size > len(self._binary):
            raise damaged_scan(self._path, f"a view ends at byte {start + size} of {len(self._binary)}")
        return self._binary[start : start + size]


def _colours(
    file: _Accessors, primitive: Mapping[str, Any], faces: IndexArray, count: int, path: Path
) -> FloatArray | None:
    """`(v, 3)` linear sRGB of a primitive's points, or None if it has neither material nor colours."""
    colours = file.attribute(primitive, "COLOR_0")
    result = np.ones((count, 3)) if colours is None else colours[:, :3]
    if "material" not in primitive:
        return None if colours is None else result
    material = file.tree["materials"][_index(primitive["material"])].get("pbrMetallicRoughness", {})
    result = result * np.array(material.get("baseColorFactor", [1.0, 1.0, 1.0])[:3], dtype=float)
    texture = material.get("baseColorTexture")
    if texture is None:
        return result
    if "KHR_texture_transform" in texture.get("extensions", {}):
        raise InputError(path, "moves its texture by KHR_texture_transform: export it without")
    uv = file.attribute(primitive, f"TEXCOORD_{_index(texture.get('texCoord', 0))}")
    if uv is None:
        return result
    return result * _sampled(file.texture(texture["index"]), uv[faces], faces, count)


def _sampled(image: NDArray[np.uint8], corner_uv: FloatArray, faces: IndexArray, count: int) -> FloatArray:
    """`(v, 3)` linear sRGB of points: the mean of an image in the triangles around each, near it.

    Args:
        image: `(h, w, 3)` sRGB; it repeats beyond its edges.
        corner_uv: `(f, 3, 2)`; row 0 is v = 0.
        faces: `(f, 3)`.
        count: v.
    """
    uv = np.nan_to_num(_NEAR_CORNERS @ corner_uv)
    row = (np.mod(uv[..., 1], 1.0) * image.shape[0]).astype(np.intp) % image.shape[0]
    column = (np.mod(uv[..., 0], 1.0) * image.shape[1]).astype(np.intp) % image.shape[1]
    linear = srgb_decode(np.arange(256) / 255.0)[image[row, column]].reshape(-1, 3)
    corners = faces.ravel()
    total = [np.bincount(corners, channel, minlength=count) for channel in linear.T]
    return np.stack(total, axis=1) / np.maximum(np.bincount(corners, minlength=count), 1)[:, None]
