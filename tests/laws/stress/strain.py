"""Checks that every frame must pass; scenes that are moved, scaled and made of single triangles."""

from dataclasses import replace

import numpy as np
from bodies import RANGE_NM

from pepperscene.camera import Camera
from pepperscene.classes import Appearance, Instance, OrganClass
from pepperscene.frame import Frame
from pepperscene.geometry import Mesh
from pepperscene.materials import Surface, lambertian_surface
from pepperscene.render import QUALITIES, Quality, Renderer
from pepperscene.scene import Scene, Sky, assemble_scene

OUTPUTS = ("electrons", "class", "instance", "distance", "normal")
FIXED = replace(QUALITIES["standard"], target=None)
"""The standard quality with the same samples for any light: frames differ by the light alone."""


def render(
    scene: Scene, camera: Camera, quality: str | Quality = "draft", outputs=OUTPUTS, seed: int = 0
) -> Frame:
    """Render a frame and check it."""
    frame = Renderer(scene).render(camera, outputs, quality, seed)
    assert_sound(frame)
    return frame


def assert_sound(frame: Frame) -> None:
    """Values are finite, light is not negative, and all labels agree about the hits."""
    if "electrons" in frame.images:
        assert np.isfinite(frame["electrons"]).all()
        assert frame["electrons"].min() >= 0.0
    if "distance" in frame.images:
        hit = np.isfinite(frame["distance"])
        assert (frame["distance"][hit] >= 0.0).all()
        assert not np.isnan(frame["distance"]).any()
        assert np.array_equal(frame["class"] > 0, hit)
        assert np.array_equal(frame["instance"] > 0, hit)
        length = np.linalg.norm(frame["normal"], axis=-1)
        assert np.isfinite(length).all()
        assert (length[~hit] == 0.0).all()


def surface(
    name: str, reflectance: float, transmittance: float = 0.0, ior: float = 1.0, roughness: float = 0.3
) -> Surface:
    """A grey surface, the same on both sides."""
    both = np.full((1, 2, 2), float(reflectance))
    return Surface(name, RANGE_NM, both, np.full((1, 2), float(transmittance)), ior, (roughness, roughness))


def grey(mesh: Mesh, reflectance: float = 0.5, sky: Sky | None = None) -> Scene:
    """A scene with the same matt grey on all surfaces."""
    return assemble_scene(mesh, {name: lambertian_surface(name, reflectance) for name in mesh.surfaces}, sky)


def triangles(corners: np.ndarray, uv: np.ndarray | None = None, name: str = "leaf") -> Mesh:
    """`(f, 3, 3)` corners as a mesh of one instance with flat normals."""
    vertices = np.asarray(corners, np.float32).reshape(-1, 3)
    count = len(vertices) // 3
    a, b, c = np.moveaxis(np.asarray(corners, float), 1, 0)
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.where(length > 0, normal / np.maximum(length, 1e-300), [0.0, 0.0, 1.0])
    return Mesh(
        vertices=vertices,
        normals=np.repeat(normal, 3, axis=0).astype(np.float32),
        uv=np.asarray(np.tile([[0, 0], [1, 0], [0, 1]], (count, 1)) if uv is None else uv, np.float32),
        state=np.full(3 * count, 0.5, np.float32),
        faces=np.arange(3 * count, dtype=np.uint32).reshape(-1, 3),
        face_instance=np.zeros(count, np.uint32),
        face_surface=np.zeros(count, np.uint8),
        face_appearance=np.zeros(count, np.uint32),
        surfaces=(name,),
        instances=(Instance(OrganClass.LEAF, "test body"),),
        appearances=(Appearance(),),
    )


def with_faces(mesh: Mesh, faces: np.ndarray) -> Mesh:
    """The mesh with more faces, of its first instance and surface, appended."""
    return replace(
        mesh,
        faces=np.concatenate([mesh.faces, faces.astype(np.uint32)]),
        face_instance=np.concatenate([mesh.face_instance, np.zeros(len(faces), np.uint32)]),
        face_surface=np.concatenate([mesh.face_surface, np.zeros(len(faces), np.uint8)]),
        face_appearance=np.concatenate([mesh.face_appearance, np.zeros(len(faces), np.uint32)]),
    )


def moved(scene: Scene, camera: Camera, by: np.ndarray) -> tuple[Scene, Camera]:
    """Scene and camera moved by `(3,)` metres."""
    pose = camera.pose.copy()
    pose[:3, 3] += by
    return replace(scene, mesh=scene.mesh.moved(np.eye(3), by)), camera.at_pose(pose)


def scaled(scene: Scene, camera: Camera, factor: float) -> tuple[Scene, Camera]:
    """Scene, reliefs, camera position and flash scaled about the origin."""
    pose = camera.pose.copy()
    pose[:3, 3] *= factor
    flash = camera.flash
    if flash is not None:
        flash = replace(
            flash,
            at_m=flash.at_m * factor,
            radius_m=flash.radius_m * factor,
            emitters_m=flash.emitters_m * factor,
            offset_m=tuple(x * factor for x in flash.offset_m),
        )
    mesh = replace(scene.mesh, vertices=(scene.mesh.vertices * factor).astype(np.float32))
    surfaces = tuple(
        s if s.relief_mm is None else replace(s, relief_mm=s.relief_mm * np.float32(factor))
        for s in scene.surfaces
    )
    return replace(scene, mesh=mesh, surfaces=surfaces), replace(camera, pose=pose, flash=flash)
