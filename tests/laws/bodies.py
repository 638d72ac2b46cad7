"""Small scenes with closed forms, shared by the laws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh

from pepperscene.camera import Camera, load_flash, load_lens, load_sensor
from pepperscene.classes import Instance, OrganClass
from pepperscene.geometry import Mesh

RANGE_NM = np.array([300.0, 1100.0])


def body(solid: trimesh.Trimesh, surface: str, organ_class: OrganClass = OrganClass.LEAF) -> Mesh:
    """A trimesh body as a one-instance mesh; uv in the middle of everything."""
    vertices, faces = len(solid.vertices), len(solid.faces)
    return Mesh(
        vertices=solid.vertices.astype(np.float32),
        normals=np.asarray(solid.vertex_normals, np.float32),
        uv=np.full((vertices, 2), 0.5, np.float32),
        state=np.full(vertices, 0.5, np.float32),
        faces=solid.faces.astype(np.uint32),
        face_instance=np.zeros(faces, np.uint32),
        face_surface=np.zeros(faces, np.uint8),
        surfaces=(surface,),
        instances=(Instance(organ_class, "test body"),),
    )


def sheet(width: float, height: float, z: float, surface: str) -> Mesh:
    """A single rectangle across the z axis, facing -z."""
    x, y = width / 2, height / 2
    flat = trimesh.Trimesh(
        [[-x, -y, z], [x, -y, z], [x, y, z], [-x, y, z]], [[0, 2, 1], [0, 3, 2]], process=False
    )
    return body(flat, surface)


def sphere(centre: tuple[float, float, float], radius: float, surface: str, subdivisions: int = 5) -> Mesh:
    """A finely tessellated sphere of class PEPPER."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    ball.apply_translation(centre)
    return body(ball, surface, OrganClass.PEPPER)


def bench_camera(
    *, columns: int = 800, rows: int = 600, flash: bool = True, **flash_changes: object
) -> Camera:
    """The recipe's camera at the world's origin looking along +z; the image may be cut to a few pixels."""
    lamp = replace(load_flash("led_matrix_200klx"), **flash_changes) if flash else None  # type: ignore[arg-type]
    sensor = replace(load_sensor("ueye_ui5250re"), columns=columns, rows=rows)
    return Camera(load_lens("lensagon_cmfa0420nd"), sensor, np.eye(4), 50e-6, lamp)
