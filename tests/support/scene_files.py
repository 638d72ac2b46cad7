"""Readers of scene files by other libraries: triangles and nodes of GLB by trimesh, of USD by usd-core."""

from __future__ import annotations

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh

Z_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])
"""From the axes of glTF to those of scenes."""


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


def cast_rays(nodes: dict[str, SceneNode], origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """`(n, 3)` first points that rays `(n, 3)` from an origin hit; nan for those that hit nothing."""
    triangles = np.concatenate([node.triangles for node in nodes.values() if node.triangles is not None])
    body = trimesh.Trimesh(
        triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3), process=False
    )
    caster = trimesh.ray.ray_triangle.RayMeshIntersector(body)
    points, rays, _ = caster.intersects_location(
        np.repeat(origin[None], len(directions), axis=0), directions, multiple_hits=True
    )
    found = np.full((len(directions), 3), np.nan)
    # The nearest of all hits is written last.
    order = np.argsort(-np.linalg.norm(points - origin, axis=1))
    found[rays[order]] = points[order]
    return found
