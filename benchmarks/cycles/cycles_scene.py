"""Export a scene to Cycles: the same triangles, with three channels instead of spectra.

The channels are the sensor's own. The mean that the sensor takes of a spectrum R under the light L,

    R_c = integral of R L QE_c lambda / integral of L QE_c lambda,

represents the surface, and the integral of L QE_c lambda / (h c) the light, so that one scale per channel
converts Cycles' picture to electrons per second, square metre and steradian. This is exact for light that is
scattered once; light scattered twice carries a product of means instead of the mean of a product.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera, Distortion, expected_electrons
from pepperscene.materials import Surface
from pepperscene.materials.gloss import cuticle_transmittance, interpolate_table
from pepperscene.materials.tissue import choose_texture
from pepperscene.scene import Scene, Sky

Array = NDArray[np.float64]

_MIN_ALPHA: Final = 1e-3  # chosen, as in our renderer: a mirror for every lens here
_COSINES: Final = np.linspace(
    0.0, 1.0, 17
)  # chosen: of the cuticle's transmittance; a colour ramp holds at most 32
_STEP_NM: Final = 1.0  # chosen: finer than any shipped spectrum
_PROFILE_STOPS: Final = 32  # as many as a Blender colour ramp holds


@dataclass(frozen=True, eq=False)
class CyclesScene:
    """A scene for the Blender process.

    Attributes:
        arrays: `vertices` and `normals` `(v, 3)`; `faces` `(f, 3)`; `face_material` `(f,)`; `front`, `back`
            and `through` `(v, 3)`, reflectance of either side and transmittance; `sky` `(rows, columns, 3)`
            radiance, zenith first, counter-clockwise from +x, if there is a sky.
        facts: camera, materials and lights as JSON data.
        unit: `(3,)` electrons s-1 m-2 sr-1 of a value of 1 in Cycles' picture.
    """

    arrays: dict[str, NDArray[Any]]
    facts: dict[str, Any]
    unit: Array

    def electrons(self, picture: NDArray[np.floating], camera: Camera) -> Array:
        """`(h, w, 3)` expected electrons of a picture `(h, w, 3)` of Cycles."""
        return expected_electrons(np.asarray(picture, float) * self.unit, undistorted(camera))


def undistorted(camera: Camera) -> Camera:
    """The camera without lens distortion, which Cycles does not have."""
    return dataclasses.replace(camera, lens=dataclasses.replace(camera.lens, distortion=Distortion()))


def export_scene(scene: Scene, camera: Camera) -> CyclesScene:
    """Export a scene and a camera to Cycles.

    Raises:
        ValueError: the scene has no surfaces or no light, or the sensor does not have three channels.
    """
    if not scene.surfaces:
        raise ValueError("the scene has no surfaces")
    if camera.sensor.channels != 3:
        raise ValueError(f"{camera.sensor.name} has {camera.sensor.channels} channels; Cycles renders three")
    sensor = SensorChannels(camera, scene.sky)
    unit = _unit(sensor, camera)
    arrays, materials = _export_mesh(scene, sensor)
    facts: dict[str, Any] = {"camera": _export_camera(undistorted(camera)), "materials": materials}
    if camera.flash is not None:
        facts["flash"] = _export_flash(camera, sensor.flash / unit)
    if scene.sky is not None:
        arrays["sky"] = (sensor.sky_map(scene.sky) / unit).astype(np.float32)
        if scene.sky.sun is not None:
            sun = scene.sky.sun
            facts["sun"] = {
                "direction": sun.direction.tolist(),
                "angular_radius": float(sun.angular_radius),
                "irradiance": (sensor.light(sun.irradiance.at(sensor.nm)) / unit).tolist(),
            }
    return CyclesScene(arrays, facts, unit)


class SensorChannels:
    """Integrals over wavelength for the channels of the sensor.

    Attributes:
        nm: `(n,)` wavelengths of the sensor's range.
        flash: `(3,)` axial intensity of the flash in electrons s-1 m-2 sr-1 at a distance of 1 m, averaged
            over the exposure; zeros without a flash.
        white: `(3,)` signal of the reference light, the flash or else the sky.
    """

    def __init__(self, camera: Camera, sky: Sky | None) -> None:
        first, last = camera.sensor.quantum_efficiency.range_nm
        self.nm = np.arange(np.floor(first), np.ceil(last) + _STEP_NM, _STEP_NM)
        self._electrons = camera.sensor.electrons_per_joule(self.nm)
        flash = np.zeros(self.nm.size)
        if camera.flash is not None:
            flash = camera.flash.radiant_intensity(self.nm) * camera.flash_duty
        self.flash = self.light(flash)
        light = flash if self.flash.all() else _mean_sky(sky, self.nm)
        self.white = self.light(light)
        if not self.white.all():
            raise ValueError(
                "a scene for Cycles needs a flash or a sky that every channel of the sensor sees"
            )
        self._weights = self._electrons * light * _STEP_NM / self.white[:, None]

    def light(self, spectrum: NDArray[np.floating]) -> Array:
        """`(..., 3)` electrons per second of spectral values `(..., n)` at the wavelengths `nm`."""
        return np.asarray(spectrum @ self._electrons.T * _STEP_NM)

    def reflectance(self, surface: Surface, values: Array) -> Array:
        """`(..., 3)` channel means of a reflectance or transmittance `(..., n)` under the reference light."""
        grid = np.apply_along_axis(lambda row: np.interp(self.nm, surface.wavelength_nm, row), -1, values)
        return np.asarray(grid @ self._weights.T)

    def sky_map(self, sky: Sky) -> Array:
        """`(rows, columns, 3)` radiance by direction."""
        return np.moveaxis(np.tensordot(self.light(sky.radiance.at(self.nm)).T, sky.weights, 1), 0, -1)


def _mean_sky(sky: Sky | None, nm: Array) -> Array:
    """Relative spectrum of sky and sun together."""
    if sky is None:
        return np.zeros(nm.size)
    spectrum = sky.weights.mean(axis=(1, 2), dtype=float) @ sky.radiance.at(nm) * 4.0 * np.pi
    return spectrum + (sky.sun.irradiance.at(nm) if sky.sun is not None else 0.0)


def _unit(sensor: SensorChannels, camera: Camera) -> Array:
    """Signals of full scale after white balance, to which Cycles' clamps and thresholds are relative."""
    on_axis = expected_electrons(np.ones((camera.height, camera.width, 3)), camera).max()
    full = camera.sensor.full_well_e / camera.sensor.gain / on_axis
    return full * sensor.white / sensor.white.max()


# --- surfaces -----------------------------------------------------------------------------------------------


def _export_mesh(
    scene: Scene, sensor: SensorChannels
) -> tuple[dict[str, NDArray[Any]], list[dict[str, Any]]]:
    """The mesh with colours at its vertices, and one material for each kind of cuticle."""
    mesh = scene.mesh
    vertex, surface_of, faces = _split_vertices(mesh.faces, mesh.face_surface)
    variant = np.zeros(len(mesh.vertices), int)
    variants = np.array([item.variant for item in mesh.appearances])
    variant[mesh.faces] = variants[mesh.face_appearance][:, None]
    colours = np.zeros((3, len(vertex), 3), np.float32)
    materials: list[dict[str, Any]] = []
    material_of = np.zeros(len(scene.surfaces), np.int32)
    for number, surface in enumerate(scene.surfaces):
        selected = np.flatnonzero(surface_of == number)
        of_surface = vertex[selected]
        state = _pigment_state(surface, mesh.state[of_surface], mesh.uv[of_surface], variant[of_surface])
        exits = _exit_fractions(surface)
        table = _colour_table(surface, sensor, exits)
        colours[:, selected] = np.moveaxis(_interpolate_rows(table, state), 1, 0)
        material = _material(surface, exits, table)
        if material not in materials:
            materials.append(material)
        material_of[number] = materials.index(material)
    arrays = {
        "vertices": mesh.vertices[vertex],
        "normals": mesh.normals[vertex],
        "faces": faces.astype(np.int32),
        "face_material": material_of[mesh.face_surface],
        "front": colours[0],
        "back": colours[1],
        "through": colours[2],
    }
    return arrays, materials


def _split_vertices(faces: NDArray[np.uint32], face_surface: NDArray[np.uint8]) -> tuple[NDArray[Any], ...]:
    """Duplicate vertices so that each has one surface: old vertex numbers, surfaces, and new faces."""
    pairs = faces.astype(np.int64) * 256 + face_surface[:, None]
    unique, inverse = np.unique(pairs, return_inverse=True)
    return unique // 256, unique % 256, inverse.reshape(faces.shape)


def _pigment_state(
    surface: Surface, state: NDArray[np.float32], uv: NDArray[np.float32], variant: NDArray[np.integer]
) -> Array:
    """Pigment state `(m,)` of vertices: bilinear in the pattern, which repeats in u and is clamped in v.

    `variant` is that of each vertex's organ. Residue and ageing have no counterpart in Cycles here.
    """
    if surface.pattern is None or not state.size:
        return np.clip(state.astype(float), 0.0, 1.0)
    pattern = surface.pattern
    count, height, width = pattern.shape
    texture, mirrored = choose_texture(count, variant)
    x, y = np.where(mirrored, 1.0 - uv[:, 0], uv[:, 0]) * float(width) - 0.5, uv[:, 1] * float(height) - 0.5
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = x - left, y - top

    def texel(dx: int, dy: int) -> NDArray[np.float32]:
        return np.asarray(pattern)[texture, np.clip(top + dy, 0, height - 1), (left + dx) % width]

    upper = texel(0, 0) * (1.0 - fx) + texel(1, 0) * fx
    lower = texel(0, 1) * (1.0 - fx) + texel(1, 1) * fx
    return np.clip(state + upper * (1.0 - fy) + lower * fy, 0.0, 1.0)


def _alphas(surface: Surface) -> tuple[float, float]:
    front, back = (max(float(alpha), _MIN_ALPHA) for alpha in surface.roughness)
    return front, back


def _exit_fractions(surface: Surface) -> tuple[float, float]:
    """Fraction of transmitted light that leaves through the other side's cuticle, by the side of entry."""
    means = [cuticle_transmittance(max(surface.ior, 1.0), alpha)[1] for alpha in _alphas(surface)]
    return min(means) / means[0], min(means) / means[1]


def _colour_table(surface: Surface, sensor: SensorChannels, exits: tuple[float, float]) -> Array:
    """`(s, 3, 3)`: front and back reflectance and transmittance by state and channel."""
    through = sensor.reflectance(surface, surface.transmittance)
    front, back = (
        sensor.reflectance(surface, surface.reflectance[:, side]) + through * (1.0 - exits[side])
        for side in (0, 1)
    )
    return np.stack([front, back, through], axis=1)


def _interpolate_rows(table: Array, state: Array) -> Array:
    """Rows of a table at states in [0, 1], linearly interpolated, `(m, 3, 3)`."""
    position = state * (len(table) - 1)
    low = np.minimum(position.astype(int), max(len(table) - 2, 0))
    high = np.minimum(low + 1, len(table) - 1)
    fraction = (position - low)[:, None, None]
    return np.asarray(table[low] * (1.0 - fraction) + table[high] * fraction)


def _material(surface: Surface, exits: tuple[float, float], table: Array) -> dict[str, Any]:
    """The properties of a surface besides its colours at the vertices."""
    ior = max(float(surface.ior), 1.0)
    tables = [cuticle_transmittance(ior, alpha)[0] for alpha in _alphas(surface)]
    return {
        "ior": ior,
        "alpha": list(_alphas(surface)) if ior > 1.0 else [1.0, 1.0],
        "translucent": bool(table[:, 2].any()),
        "two_sided": bool(np.abs(table[:, 0] - table[:, 1]).max() > 0.0),
        "exit_fraction": list(exits),
        "transmittance": interpolate_table(np.mean(tables, axis=0), _COSINES).tolist() if ior > 1.0 else [],
    }


# --- camera and flash ---------------------------------------------------------------------------------------


def _export_camera(camera: Camera) -> dict[str, Any]:
    """Camera in Blender's convention: x right, y up, z backwards; lengths in mm, shifts in picture widths."""
    matrix, width, height = camera.intrinsics, camera.width, camera.height
    return {
        "matrix_world": (camera.pose @ np.diag([1.0, -1.0, -1.0, 1.0])).tolist(),
        "width": width,
        "height": height,
        "lens_mm": 1e3 * camera.lens.focal_length_m,
        "sensor_width_mm": 1e3 * camera.sensor.pixel_pitch_m * width,
        "shift_x": float(width / 2.0 - matrix[0, 2]) / width,
        "shift_y": float(matrix[1, 2] - height / 2.0) / width,
        "focus_m": camera.focus_m,
        "f_number": float(camera.lens.f_number),
    }


def _export_flash(camera: Camera, intensity: Array) -> dict[str, Any]:
    """One rectangle for all discs of the flash, with the same variance of position."""
    flash = camera.flash
    assert flash is not None
    centres = np.asarray(flash.emitters_m)
    # Variance along each axis: r^2 / 4 for points on a disc, s^2 / 12 for points on a side.
    sides = np.sqrt(12.0 * (centres.var(axis=0) + flash.radius_m**2 / 4.0))
    centre = np.asarray(flash.offset_m) + np.append(centres.mean(axis=0), 0.0)
    pose = np.array(camera.pose)
    pose[:3, 3] += pose[:3, :3] @ centre
    return {
        "matrix_world": (pose @ np.diag([1.0, -1.0, -1.0, 1.0])).tolist(),
        "sides_m": np.maximum(sides, 1e-4).tolist(),  # a point source is 0.1 mm wide
        "intensity": intensity.tolist(),
        **_profile_stops(flash.profile.angle_rad, flash.profile.at),
    }


def _profile_stops(angles: Array, profile: Any) -> dict[str, list[float]]:
    """The beam profile at its own nodes, or at equally spaced angles if a colour ramp cannot hold them."""
    if angles.size >= _PROFILE_STOPS:
        angles = np.linspace(0.0, float(angles[-1]), _PROFILE_STOPS - 1)
    return {"angle_rad": np.asarray(angles).tolist(), "relative_intensity": profile(angles).tolist()}
