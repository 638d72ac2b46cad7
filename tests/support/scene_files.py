"""Readers of scene files by other libraries: triangles and nodes of GLB by trimesh, of USD by usd-core."""

from __future__ import annotations

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh

Z_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])
"""From the axes of glTF to those of scenes."""


NEAREST_M = 0.05
"""Triangles that are nearer to a camera are left out."""


class SceneNode(NamedTuple):
    """A node: its pose in the world, its triangles there or None, and what the file says of it."""

    pose: np.ndarray
    triangles: np.ndarray | None
    extras: dict


def glb_nodes(path: Path) -> dict[str, SceneNode]:
    """The nodes of a GLB by name."""
    scene = trimesh.load_scene(path)
    nodes = {}
    for name in scene.graph.nodes:
        matrix, geometry = scene.graph.get(name)
        corners = None
        if geometry is not None:
            corners = trimesh.transform_points(
                scene.geometry[geometry].triangles.reshape(-1, 3), Z_UP @ matrix
            )
            corners = corners.reshape(-1, 3, 3)
        extras = scene.graph.transforms.edge_data.get((scene.graph.transforms.parents.get(name), name), {})
        nodes[name] = SceneNode(Z_UP @ matrix, corners, extras.get("metadata") or {})
    return nodes


def glb_json(path: Path) -> dict:
    """The JSON part of a GLB."""
    content = path.read_bytes()
    return json.loads(content[20 : 20 + int.from_bytes(content[12:16], "little")])


def usd_nodes(path: Path) -> dict[str, SceneNode]:
    """The prims of a USD file that have a pose by name."""
    from pxr import Usd, UsdGeom

    stage, nodes = Usd.Stage.Open(str(path)), {}
    cache = UsdGeom.XformCache()
    for prim in stage.Traverse():
        if not prim.IsA(UsdGeom.Xformable):
            continue
        matrix = np.array(cache.GetLocalToWorldTransform(prim)).T
        corners = None
        if prim.IsA(UsdGeom.Mesh):
            mesh = UsdGeom.Mesh(prim)
            points = np.array(mesh.GetPointsAttr().Get(), dtype=float)
            corners = trimesh.transform_points(points, matrix)[mesh.GetFaceVertexIndicesAttr().Get()]
            corners = corners.reshape(-1, 3, 3)
        space = "userProperties:"
        extras = {
            one.GetName().removeprefix(space): one.Get()
            for one in prim.GetAttributes()
            if one.GetName().startswith(space)
        }
        nodes[prim.GetName()] = SceneNode(matrix, corners, extras)
    return nodes


def cast_rays(nodes: dict[str, SceneNode], pose: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """`(n,)` depth along the optical axis at which rays of a camera with slopes `(n, 2)` end; nan for none.

    In the coordinates x / z, y / z and -1 / z, which keep triangles flat, all rays are parallel to the third
    axis. So their bounding boxes are thin, and trimesh finds hits a hundred times as fast.
    """
    triangles = np.concatenate([node.triangles for node in nodes.values() if node.triangles is not None])
    corners = (triangles - pose[:3, 3]) @ pose[:3, :3]
    corners = corners[(corners[..., 2] > NEAREST_M).all(axis=1)].reshape(-1, 3)
    z = corners[:, 2:]
    body = trimesh.Trimesh(
        np.hstack([corners[:, :2] / z, -1.0 / z]), np.arange(len(corners)).reshape(-1, 3), process=False
    )
    origins = np.column_stack([slopes, np.full(len(slopes), -1.0 / NEAREST_M)])
    caster = trimesh.ray.ray_triangle.RayMeshIntersector(body)
    points, rays, _ = caster.intersects_location(
        origins, np.tile([0.0, 0.0, 1.0], (len(slopes), 1)), multiple_hits=True
    )
    depth = np.full(len(slopes), np.inf)
    np.minimum.at(depth, rays, -1.0 / points[:, 2])
    return np.where(np.isfinite(depth), depth, np.nan)
