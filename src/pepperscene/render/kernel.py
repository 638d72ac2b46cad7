"""A scene as Mitsuba holds it: one merged mesh, one BSDF, and tables for the lights.

One mesh rather than one per organ: instancing and many shapes were over 100 times slower to trace and load in
the JIT variants (mitsuba3 #1017, #1712), and per-face attributes survive merging exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pepperscene.geometry import Mesh
from pepperscene.render.bsdf import surface_bsdf
from pepperscene.render.optics import Optics
from pepperscene.render.tables import pack
from pepperscene.render.variant import kernel
from pepperscene.scene import Scene


def kernel_mesh(mesh: Mesh, bsdf: Any | None = None) -> Any:
    """The mesh as a Mitsuba shape.

    Args:
        mesh: world coordinates, metres.
        bsdf: None where rays only need to hit (ground truth); then no attributes are attached either.
    """
    mi, _ = kernel()
    props = mi.Properties()
    if bsdf is not None:
        props["mesh_bsdf"] = bsdf
    shape = mi.Mesh(
        "plants",
        len(mesh.vertices),
        len(mesh.faces),
        props=props,
        has_vertex_normals=True,
        has_vertex_texcoords=True,
    )
    params = mi.traverse(shape)
    params["vertex_positions"] = np.ascontiguousarray(mesh.vertices, np.float32).ravel()
    params["vertex_normals"] = np.ascontiguousarray(mesh.normals, np.float32).ravel()
    params["vertex_texcoords"] = np.ascontiguousarray(mesh.uv, np.float32).ravel()
    params["faces"] = np.ascontiguousarray(mesh.faces, np.uint32).ravel()
    params.update()
    if bsdf is not None:
        shape.add_attribute("vertex_state", 1, np.ascontiguousarray(mesh.state, np.float32))
        shape.add_attribute("face_surface", 1, np.ascontiguousarray(mesh.face_surface, np.float32))
    return shape


def truth_scene(scene: Scene) -> Any:
    """A Mitsuba scene that rays can hit, without materials or lights."""
    return kernel()[0].load_dict({"type": "scene", "plants": kernel_mesh(scene.mesh)})


@dataclass(frozen=True, eq=False)
class LightScene:
    """A scene with materials over a range of wavelengths; its lights are the integrator's own.

    Attributes:
        scene: of Mitsuba.
        optics: of its surfaces.
        corners: `(f * 4,)` states of each triangle's three corners, and the number of its surface: all that
            a hit needs of the mesh's attributes, in one fetch.
    """

    scene: Any
    optics: Optics
    corners: Any

    def point(self, si: Any, hit: Any, active: Any) -> Any:
        """The optical state at surface interactions `si` that the preliminary hits `hit` led to."""
        mi, dr = kernel()
        corner = dr.gather(mi.Vector4f, self.corners, hit.prim_index, active)
        u, v = hit.prim_uv.x, hit.prim_uv.y
        state = corner.x * (1.0 - u - v) + corner.y * u + corner.z * v
        return self.optics.at(si, mi.UInt32(corner.w), state, active)


def light_scene(scene: Scene, first_nm: float, last_nm: float) -> LightScene:
    """The scene with its materials.

    Raises:
        ValueError: the scene was assembled without surfaces.
    """
    if not scene.surfaces:
        raise ValueError("the scene has no surfaces: assemble it with them to render colour")
    mi, _ = kernel()
    mesh = scene.mesh
    optics = Optics(pack(scene.surfaces, first_nm, last_nm))
    corners = np.column_stack([mesh.state[mesh.faces], mesh.face_surface]).astype(np.float32)
    built = mi.load_dict({"type": "scene", "plants": kernel_mesh(mesh, surface_bsdf().of(optics))})
    return LightScene(built, optics, mi.Float(corners.ravel()))


@dataclass(frozen=True, eq=False)
class SkyTables:
    """The sky and the sun for the kernel.

    Attributes:
        weights: texture with one channel per spectrum.
        radiance: one `Float` table per spectrum on the response's grid.
        sun_frame, sun_cosine, sun_irradiance: towards the disc, cosine of its radius, W m-2 nm-1 on the
            response's grid; None without a sun.
    """

    weights: Any
    radiance: tuple[Any, ...]
    sun_frame: Any = None
    sun_cosine: Any = None
    sun_irradiance: Any = None


def sky_tables(scene: Scene, grid_nm: np.ndarray) -> SkyTables | None:
    """The scene's sky tabulated on a grid of wavelengths, or None where it has none."""
    mi, dr = kernel()
    sky = scene.sky
    if sky is None or (sky.sun is None and not sky.weights.any()):
        return None
    weights = mi.Texture2f(
        mi.TensorXf(np.ascontiguousarray(np.moveaxis(sky.weights, 0, -1))), wrap_mode=dr.WrapMode.Repeat
    )
    radiance = tuple(mi.Float(row) for row in sky.radiance.at(grid_nm))
    if sky.sun is None:
        return SkyTables(weights, radiance)
    towards = mi.Vector3f(*(float(x) for x in sky.sun.direction))
    cosine = mi.Float(float(np.cos(sky.sun.angular_radius)))
    dr.make_opaque(towards, cosine)
    return SkyTables(weights, radiance, mi.Frame3f(towards), cosine, mi.Float(sky.sun.irradiance.at(grid_nm)))
