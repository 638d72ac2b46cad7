"""A scene as Mitsuba holds it: one merged mesh, one BSDF, and tables for the lights.

One mesh rather than one per organ: instancing and many shapes were over 100 times slower to trace and load in
the JIT variants (mitsuba3 #1017, #1712), and per-face attributes survive merging exactly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry import Mesh
from pepperscene.render.kernel.arrays import WORLD, LocalCoordinates, device_table, local_coordinates
from pepperscene.render.surface.optics import Optics
from pepperscene.render.surface.tables import pack
from pepperscene.render.variant import mitsuba_modules
from pepperscene.scene import Scene

_LEAST_CHORD: Final = 1e-4
"""Chosen: of a sun's disc. Single precision tells directions apart to 1e-7, a thousandth of it."""


def kernel_mesh(mesh: Mesh, bsdf: Any | None = None, region: LocalCoordinates = WORLD) -> Any:
    """The mesh as a Mitsuba shape.

    Args:
        mesh: world coordinates, metres.
        bsdf: the plugin, for Mitsuba's own integrators; it finds state and surface in attributes. None where
            rays only need to hit: ours reads both from a table of its own.
        region: whose coordinates the shape is told in.

    Raises:
        ValueError: normals, surface coordinates or states are no finite numbers.
    """
    for name in ("normals", "uv", "state"):
        if not np.isfinite(getattr(mesh, name)).all():
            raise ValueError(f"the mesh's {name} must be finite numbers")
    mi, _ = mitsuba_modules()
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
    params["vertex_positions"] = np.ascontiguousarray(region.vertices(mesh), np.float32).ravel()
    params["vertex_normals"] = np.ascontiguousarray(mesh.normals, np.float32).ravel()
    # The one buffer that the kernel fetches in packets; the others it shares with the mesh itself.
    params["vertex_texcoords"] = device_table(mesh.uv)
    params["faces"] = np.ascontiguousarray(mesh.faces, np.uint32).ravel()
    params.update()
    if bsdf is not None:
        shape.add_attribute("vertex_state", 1, np.ascontiguousarray(mesh.state, np.float32))
        shape.add_attribute("face_surface", 1, np.ascontiguousarray(mesh.face_surface, np.float32))
    return shape


def truth_scene(scene: Scene) -> Any:
    """A Mitsuba scene that rays can hit, without materials or lights; in its region's coordinates.

    Raises:
        ValueError: as `local_coordinates`.
    """
    shape = kernel_mesh(scene.mesh, region=local_coordinates(scene.mesh))
    return mitsuba_modules()[0].load_dict({"type": "scene", "plants": shape})


@dataclass(frozen=True, eq=False)
class LightScene:
    """A scene with materials over a range of wavelengths; its lights are the integrator's own.

    Attributes:
        scene: of Mitsuba.
        shape: its only one.
        optics: of its surfaces.
        corners: `(f * 4,)` states of each triangle's three corners, and the number of its surface: all that
            a hit needs of the mesh's attributes, in one fetch.
    """

    scene: Any
    shape: Any
    optics: Optics
    corners: Any

    def interaction(self, ray: Any, hit: Any, active: Any) -> Any:
        """The surface interactions that the preliminary hits `hit` of rays lead to.

        What `hit.compute_surface_interaction(ray, RayFlags.All, active)` finds, but asked of the one shape
        there is instead of by a call through a pointer: the code is inlined, what nobody reads is left out,
        and it stays the same where another scene is still in memory.
        """
        mi, dr = mitsuba_modules()
        si = self.shape.compute_surface_interaction(ray, hit, mi.RayFlags.All, active)
        si.time, si.wavelengths = ray.time, ray.wavelengths
        si.initialize_sh_frame()
        si.wi = dr.select(active, si.to_local(-ray.d), -ray.d)
        return si

    def point(self, si: Any, hit: Any, active: Any, optics: Optics | None = None) -> Any:
        """The optical state at surface interactions `si` that the preliminary hits `hit` led to.

        Args:
            si: interactions.
            hit: preliminary ones that led there.
            active: mask.
            optics: another view of the scene's surfaces, or None for their spectra.
        """
        mi, dr = mitsuba_modules()
        corner = dr.gather(mi.Vector4f, self.corners, hit.prim_index, active)
        u, v = hit.prim_uv.x, hit.prim_uv.y
        state = corner.x * (1.0 - u - v) + corner.y * u + corner.z * v
        return (optics or self.optics).at(si, mi.UInt32(corner.w), state, active)


def light_scene(scene: Scene, first_nm: float, last_nm: float) -> LightScene:
    """The scene with its materials.

    Raises:
        ValueError: the scene was assembled without surfaces; or as `local_coordinates`.
    """
    if not scene.surfaces:
        raise ValueError("the scene has no surfaces: assemble it with them to render colour")
    mi, _ = mitsuba_modules()
    mesh = scene.mesh
    region = local_coordinates(mesh)
    optics = Optics(pack(scene.surfaces, first_nm, last_nm, region.unit))
    shape = kernel_mesh(mesh, region=region)
    built = mi.load_dict({"type": "scene", "plants": shape})
    return LightScene(built, shape, optics, device_table(_corners(mesh)))


def _corners(mesh: Mesh) -> NDArray[np.float32]:
    """`(f, 4)` states of each triangle's corners, and the number of its surface."""
    corners = np.empty((len(mesh.faces), 4), np.float32)
    corners[:, :3] = mesh.state[mesh.faces]
    corners[:, 3] = mesh.face_surface
    return corners


@dataclass(frozen=True, eq=False)
class SkyTables:
    """The sky and the sun for the kernel.

    Attributes:
        weights: texture with one channel per spectrum.
        radiance: one `Float` table per spectrum on the response's grid.
        sun_frame, sun_chord, sun_irradiance: towards the disc, chord from its centre to its rim, W m-2 nm-1
            on the response's grid; None without a sun. Single precision cannot tell the cosine of such a
            radius from 1. A cap of the chord s has the solid angle pi s^2 (Archimedes).
    """

    weights: Any
    radiance: tuple[Any, ...]
    sun_frame: Any = None
    sun_chord: Any = None
    sun_irradiance: Any = None


def sky_tables(scene: Scene, grid_nm: np.ndarray) -> SkyTables | None:
    """The scene's sky tabulated on a grid of wavelengths, or None where it has none."""
    mi, dr = mitsuba_modules()
    sky = scene.sky
    if sky is None or (sky.sun is None and not sky.weights.any()):
        return None
    texels = np.moveaxis(sky.weights, 0, -1)
    weights = mi.Texture2f(mi.TensorXf(device_table(texels), texels.shape), wrap_mode=dr.WrapMode.Repeat)
    radiance = tuple(device_table(row) for row in sky.radiance.at(grid_nm))
    if sky.sun is None:
        return SkyTables(weights, radiance)
    towards = mi.Vector3f(*(float(x) for x in sky.sun.direction))
    chord = mi.Float(max(2.0 * math.sin(sky.sun.angular_radius / 2.0), _LEAST_CHORD))
    dr.make_opaque(towards, chord)
    return SkyTables(
        weights, radiance, mi.Frame3f(towards), chord, device_table(sky.sun.irradiance.at(grid_nm))
    )
