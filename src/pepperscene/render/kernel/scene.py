"""A scene inside Mitsuba: one merged mesh, surface optics, and tables of the daylight.

There is one mesh, not one per organ: instancing and many shapes were over 100 times slower to trace and load
in the JIT variants (mitsuba3 #1017, #1712), and per-face attributes survive merging exactly.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry import Mesh
from pepperscene.materials.tissue import choose_texture, texture_count
from pepperscene.render.arrays import WORLD, LocalCoordinates, device_array, local_coordinates
from pepperscene.render.kernel.cells import SurfaceCells, surface_cells
from pepperscene.render.surface.normals import shading_normals
from pepperscene.render.surface.optics import Optics
from pepperscene.render.variant import mitsuba_modules
from pepperscene.scene import Scene

_SHORTEST_CHORD: Final = 1e-4
"""Chosen: of the sun's disc. Single precision resolves directions to 1e-7, a thousandth of it."""


def mitsuba_mesh(
    mesh: Mesh,
    bsdf: Any | None = None,
    coordinates: LocalCoordinates = WORLD,
    face_organ: NDArray[np.integer] | None = None,
) -> Any:
    """Convert a mesh to a Mitsuba shape.

    Args:
        mesh: world coordinates, metres.
        bsdf: for Mitsuba's own integrators; it reads state, organ and scanned colours from mesh attributes.
            None for our integrator, which reads them from tables, and for geometry alone.
        coordinates: of the shape.
        face_organ: `(f,)` number of each triangle's organ, for the BSDF.

    Raises:
        ValueError: normals, surface coordinates, states or colours are not finite.
    """
    for name in ("normals", "uv", "state", "colour"):
        values = getattr(mesh, name)
        if values is not None and not np.isfinite(values).all():
            raise ValueError(f"the mesh's {name} must be finite numbers")
    mi, _ = mitsuba_modules()
    props = mi.Properties()
    if bsdf is not None:
        props["mesh_bsdf"] = bsdf
    sizes = len(mesh.vertices), len(mesh.faces)
    shape = mi.Mesh("plants", *sizes, props=props, has_vertex_normals=True, has_vertex_texcoords=True)
    params = mi.traverse(shape)
    params["vertex_positions"] = np.ascontiguousarray(coordinates.vertices(mesh), np.float32).ravel()
    params["vertex_normals"] = np.ascontiguousarray(mesh.normals, np.float32).ravel()
    # The kernel gathers this buffer in packets, so it must be aligned; the others share the mesh's memory.
    params["vertex_texcoords"] = device_array(mesh.uv)
    params["faces"] = np.ascontiguousarray(mesh.faces, np.uint32).ravel()
    params.update()
    if bsdf is not None and face_organ is not None:
        shape.add_attribute("vertex_state", 1, np.ascontiguousarray(mesh.state, np.float32))
        shape.add_attribute("face_organ", 1, np.ascontiguousarray(face_organ, np.float32))
        if mesh.colour is not None:
            shape.add_attribute("vertex_colour", 3, np.ascontiguousarray(mesh.colour, np.float32).ravel())
    return shape


def check_surfaces(scene: Scene) -> None:
    """Check that a scene has surfaces.

    Raises:
        ValueError: it has none.
    """
    if not scene.surfaces:
        raise ValueError("the scene has no surfaces: assemble it with them to render colour")


def organ_table(scene: Scene) -> tuple[NDArray[np.float64], NDArray[np.uint32]]:
    """Organs as `Optics` packs them, `(o, 4)`, and `(f,)` the number of each triangle's organ.

    One for each appearance and surface that occur together, with the texture of `choose_texture`.

    Raises:
        ValueError: there are no surfaces.
    """
    check_surfaces(scene)
    mesh, count = scene.mesh, len(scene.surfaces)
    pair = mesh.face_appearance.astype(np.int64) * count + mesh.face_surface
    is_used = np.zeros(len(mesh.appearances) * count, dtype=bool)
    is_used[pair] = True
    appearance, surface = np.divmod(np.flatnonzero(is_used), count)
    values = np.array([(item.variant, item.residue, item.ageing) for item in mesh.appearances])[appearance]
    counts = np.array([texture_count(surface) for surface in scene.surfaces])[surface]
    texture, mirrored = choose_texture(counts, values[:, 0].astype(np.int64))
    signed = np.where(mirrored, -1, 1) * (1 + texture)
    number = np.cumsum(is_used) - 1
    return np.column_stack([surface, signed, values[:, 1:]]), number[pair].astype(np.uint32)


def truth_scene(scene: Scene) -> Any:
    """Build a Mitsuba scene of the geometry alone, in its local coordinates.

    Raises:
        ValueError: see `local_coordinates` and `mitsuba_mesh`.
    """
    shape = mitsuba_mesh(scene.mesh, coordinates=local_coordinates(scene.mesh))
    return mitsuba_modules()[0].load_dict({"type": "scene", "plants": shape})


@dataclass(frozen=True, eq=False)
class LightScene:
    """Geometry and surface optics over a range of wavelengths; the integrator keeps the lights itself.

    Attributes:
        scene: Mitsuba's.
        shape: the only one in it.
        optics: of its surfaces.
        face_states: `(f * 4,)` pigment states at the three corners of each triangle, and the number of its
            organ: all that a hit needs of the mesh attributes, in one gather.
        mesh: of the shape, in world coordinates.
        colours: `(v * 4,)` scanned colours of the vertices, and 0; None if no organ has any.
    """

    scene: Any
    shape: Any
    optics: Optics
    face_states: Any
    mesh: Mesh
    colours: Any | None = None

    @functools.cached_property
    def cells(self) -> SurfaceCells:
        """Small places on the surfaces, made when light is first kept there."""
        return surface_cells(self.mesh)

    def interaction(self, ray: Any, hit: Any, active: Any) -> Any:
        """Compute what `hit.compute_surface_interaction(ray, RayFlags.All, active)` does.

        The only shape is called directly, not through a pointer: the code is inlined, unused results are left
        out, and it does not change while another scene is in memory.
        """
        mi, dr = mitsuba_modules()
        si = self.shape.compute_surface_interaction(ray, hit, mi.RayFlags.All, active)
        si.time, si.wavelengths = ray.time, ray.wavelengths
        si.initialize_sh_frame()
        si.wi = dr.select(active, si.to_local(-ray.d), -ray.d)
        return si

    def intersect(self, ray: Any, active: Any = True, *, coherent: bool = False) -> Any:
        """Whether rays hit a surface, their surface interactions, and the preliminary hits."""
        hit = self.scene.ray_intersect_preliminary(ray, coherent=coherent, active=active)
        is_hit = hit.is_valid()
        return is_hit, shading_normals(self.interaction(ray, hit, is_hit)), hit

    def surface_point(
        self, si: Any, hit: Any, active: Any, optics: Optics | None = None, footprint: Any | None = 0.0
    ) -> Any:
        """Look up the optical state at surface interactions of preliminary hits.

        With `optics`, the surfaces are as seen by a sensor's channels, else with their spectra; `footprint`
        as of `Optics.point`.
        """
        return (optics or self.optics).point(*self._at_hit(si, hit, active, footprint))

    def surface_place(self, si: Any, hit: Any, active: Any, footprint: Any | None = 0.0) -> Any:
        """What the optical state at surface interactions is at all wavelengths: see `Optics.locate`."""
        return self.optics.locate(*self._at_hit(si, hit, active, footprint))

    def _at_hit(self, si: Any, hit: Any, active: Any, footprint: Any | None) -> tuple[Any, ...]:
        """Arguments of `Optics.point`."""
        mi, dr = mitsuba_modules()
        corners = dr.gather(mi.Vector4f, self.face_states, hit.prim_index, active)
        u, v = hit.prim_uv.x, hit.prim_uv.y
        state = corners.x * (1.0 - u - v) + corners.y * u + corners.z * v
        at_hit = si, mi.UInt32(corners.w), state, active, footprint
        if self.colours is None:
            return at_hit
        vertices = self.shape.face_indices(hit.prim_index, active)
        a, b, c = (
            dr.gather(mi.Vector4f, self.colours, vertex, active)
            for vertex in (vertices.x, vertices.y, vertices.z)
        )
        return (*at_hit, a * (1.0 - u - v) + b * u + c * v)


def light_scene(scene: Scene, first_nm: float, last_nm: float) -> LightScene:
    """Build the geometry with its surface optics over [first_nm, last_nm].

    Raises:
        ValueError: see `organ_table`, `Optics.pack` and `local_coordinates`.
    """
    mi, _ = mitsuba_modules()
    mesh = scene.mesh
    coordinates = local_coordinates(mesh)
    organs, face_organ = organ_table(scene)
    has_colours = mesh.colour is not None
    optics = Optics.pack(
        scene.surfaces, first_nm, last_nm, coordinates.unit_m, organs, has_colours=has_colours
    )
    shape = mitsuba_mesh(mesh, coordinates=coordinates)
    face_states = np.empty((len(mesh.faces), 4), np.float32)
    face_states[:, :3] = mesh.state[mesh.faces]
    face_states[:, 3] = face_organ
    kernel_scene = mi.load_dict({"type": "scene", "plants": shape})
    colours = None if mesh.colour is None else device_array(np.pad(mesh.colour, ((0, 0), (0, 1))))
    return LightScene(kernel_scene, shape, optics, device_array(face_states), mesh, colours)


@dataclass(frozen=True, eq=False)
class SkyTables:
    """The sky and the sun on the device.

    Attributes:
        weights: texture with one channel per spectrum.
        radiance: one `Float` table per spectrum on the response's wavelength grid.
        sun_frame: coordinate frame whose normal points to the sun; None without a sun.
        sun_chord: from the centre of the disc to its rim on the unit sphere. Single precision cannot separate
            the cosine of so small a radius from 1; a cap of chord s has the solid angle pi s^2 (Archimedes).
        sun_irradiance: W m-2 nm-1 on the response's wavelength grid.
    """

    weights: Any
    radiance: tuple[Any, ...]
    sun_frame: Any = None
    sun_chord: Any = None
    sun_irradiance: Any = None


def sky_tables(scene: Scene, grid_nm: NDArray[np.float64]) -> SkyTables | None:
    """Tabulate a scene's sky on a wavelength grid; None if it has no sky or a black one."""
    mi, dr = mitsuba_modules()
    sky = scene.sky
    if sky is None or (sky.sun is None and not sky.weights.any()):
        return None
    texels = np.moveaxis(sky.weights, 0, -1)
    weights = mi.Texture2f(mi.TensorXf(device_array(texels), texels.shape), wrap_mode=dr.WrapMode.Repeat)
    radiance = tuple(device_array(row) for row in sky.radiance.at(grid_nm))
    if sky.sun is None:
        return SkyTables(weights, radiance)
    direction = mi.Vector3f(*(float(x) for x in sky.sun.direction))
    chord = mi.Float(max(2.0 * math.sin(sky.sun.angular_radius / 2.0), _SHORTEST_CHORD))
    dr.make_opaque(direction, chord)
    irradiance = device_array(sky.sun.irradiance.at(grid_nm))
    return SkyTables(weights, radiance, mi.Frame3f(direction), chord, irradiance)
