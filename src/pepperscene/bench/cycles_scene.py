"""Our scene as Cycles can hold it: the same triangles, with red, green and blue instead of spectra.

Its three channels are the sensor's own. What the sensor makes of a spectrum R under the light L,

    R_c = integral of R L QE_c lambda / integral of L QE_c lambda,

stands for the surface, and the integral of L QE_c lambda / (h c) for the light, so that one scale per channel
turns Cycles' picture into electrons per second, square metre and steradian. It is exact for light that is
scattered once; light scattered twice carries the product of two means for the mean of a product.
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
from pepperscene.scene import Scene, Sky

Array = NDArray[np.float64]

_LEAST_ALPHA: Final = 1e-3  # chosen, as the kernel's: a mirror for every lens here
_COSINES: Final = np.linspace(0.0, 1.0, 17)  # chosen: of the cuticle's openness; a ramp holds 32 at most
_STEP_NM: Final = 1.0  # chosen: finer than any curve that is shipped
_PROFILE_STOPS: Final = 32  # a Blender colour ramp holds no more


@dataclass(frozen=True, eq=False)
class CyclesScene:
    """What the child process builds.

    Attributes:
        arrays: `vertices` and `normals` `(v, 3)`; `faces` `(f, 3)`; `face_material` `(f,)`; `front`, `back`
            and `through` `(v, 3)`, what the body sends back on either side and lets through; `sky`
            `(rows, columns, 3)` radiance, zenith first, counter-clockwise from +x, where there is one.
        facts: JSON-ready camera, materials and lights.
        unit: `(3,)` electrons s-1 m-2 sr-1 of a value of 1 in Cycles' picture.
    """

    arrays: dict[str, NDArray[Any]]
    facts: dict[str, Any]
    unit: Array

    def electrons(self, picture: NDArray[np.floating], camera: Camera) -> Array:
        """`(h, w, 3)` expected electrons of a picture `(h, w, 3)` of Cycles."""
        return expected_electrons(np.asarray(picture, float) * self.unit, pinhole(camera))


def pinhole(camera: Camera) -> Camera:
    """The camera without its lens' distortion, which Cycles does not have: what both are compared on."""
    return dataclasses.replace(camera, lens=dataclasses.replace(camera.lens, distortion=Distortion()))


def exported(scene: Scene, camera: Camera) -> CyclesScene:
    """The scene and the camera for Cycles.

    Raises:
        ValueError: the scene has no surfaces, no light, or the sensor has not three channels.
    """
    if not scene.surfaces:
        raise ValueError("the scene has no surfaces: assemble it with them to render colour")
    if camera.sensor.channels != 3:
        raise ValueError(f"{camera.sensor.name} has {camera.sensor.channels} channels; Cycles renders three")
    sensed = Sensed(camera, scene.sky)
    unit = _unit(sensed, camera)
    arrays, materials = _bodies(scene, sensed)
    facts: dict[str, Any] = {"camera": _camera(pinhole(camera)), "materials": materials}
    if camera.flash is not None:
        facts["flash"] = _flash(camera, sensed.flash / unit)
    if scene.sky is not None:
        arrays["sky"] = (sensed.sky_map(scene.sky) / unit).astype(np.float32)
        if scene.sky.sun is not None:
            sun = scene.sky.sun
            facts["sun"] = {
                "direction": sun.direction.tolist(),
                "angular_radius": float(sun.angular_radius),
                "irradiance": (sensed.light(sun.irradiance.at(sensed.nm)) / unit).tolist(),
            }
    return CyclesScene(arrays, facts, unit)


class Sensed:
    """The sensor's sums over wavelengths.

    Attributes:
        nm: `(n,)` grid over all that the sensor sees.
        flash: `(3,)` axial intensity of the flash in electrons s-1 m-2 (of a lit metre away) sr-1, averaged
            over the exposure; zeros without one.
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
        self._white = self.light(light)
        if not self._white.all():
            raise ValueError("a scene for Cycles needs a flash or a sky that each colour of the sensor sees")
        self._weights = self._electrons * light * _STEP_NM / self._white[:, None]

    @property
    def white(self) -> Array:
        """`(3,)` the reference light, the flash or else the sky, as the channels see it."""
        return self._white

    def light(self, spectrum: NDArray[np.floating]) -> Array:
        """`(..., 3)` electrons per second of spectral values `(..., n)` on the grid."""
        return np.asarray(spectrum @ self._electrons.T * _STEP_NM)

    def reflectance(self, surface: Surface, values: Array) -> Array:
        """`(..., 3)` of a surface's reflectance or transmittance `(..., n)` under the reference light."""
        grid = np.apply_along_axis(lambda row: np.interp(self.nm, surface.wavelength_nm, row), -1, values)
        return np.asarray(grid @ self._weights.T)

    def sky_map(self, sky: Sky) -> Array:
        """`(rows, columns, 3)` radiance by direction."""
        return np.moveaxis(np.tensordot(self.light(sky.radiance.at(self.nm)).T, sky.weights, 1), 0, -1)


def _mean_sky(sky: Sky | None, nm: Array) -> Array:
    """Spectrum of the whole sky and the sun together, relative."""
    if sky is None:
        return np.zeros(nm.size)
    spectrum = sky.weights.mean(axis=(1, 2), dtype=float) @ sky.radiance.at(nm) * 4.0 * np.pi
    return spectrum + (sky.sun.irradiance.at(nm) if sky.sun is not None else 0.0)


def _unit(sensed: Sensed, camera: Camera) -> Array:
    """Signals that make full scale once white is balanced: Cycles' clamps and thresholds count from there."""
    on_axis = expected_electrons(np.ones((camera.height, camera.width, 3)), camera).max()
    full = camera.sensor.full_well_e / camera.sensor.gain / on_axis
    return full * sensed.white / sensed.white.max()


# --- bodies -------------------------------------------------------------------------------------------------


def _bodies(scene: Scene, sensed: Sensed) -> tuple[dict[str, NDArray[Any]], list[dict[str, Any]]]:
    """The mesh with colours at its vertices, and as many materials as there are cuticles."""
    mesh = scene.mesh
    vertex, surface_of, faces = _split(mesh.faces, mesh.face_surface)
    colours = np.zeros((3, len(vertex), 3), np.float32)
    materials: list[dict[str, Any]] = []
    material_of = np.zeros(len(scene.surfaces), np.int32)
    for number, surface in enumerate(scene.surfaces):
        mine = np.flatnonzero(surface_of == number)
        state = _with_pattern(surface, mesh.state[vertex[mine]], mesh.uv[vertex[mine]])
        shares = _shares_let_out(surface)
        table = _table(surface, sensed, shares)
        colours[:, mine] = np.moveaxis(_at_state(table, state), 1, 0)
        material = _cuticle(surface, shares, table)
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


def _split(faces: NDArray[np.uint32], face_surface: NDArray[np.uint8]) -> tuple[NDArray[Any], ...]:
    """Vertices so that each has one surface: their old numbers, their surfaces, and the faces anew."""
    pairs = faces.astype(np.int64) * 256 + face_surface[:, None]
    found, renumbered = np.unique(pairs, return_inverse=True)
    return found // 256, found % 256, renumbered.reshape(faces.shape)


def _with_pattern(surface: Surface, state: NDArray[np.float32], uv: NDArray[np.float32]) -> Array:
    """Pigment state of vertices, `(m,)`: bilinear in the pattern's texels, which repeat in u and end in v."""
    if surface.pattern is None or not state.size:
        return np.clip(state.astype(float), 0.0, 1.0)
    height, width = surface.pattern.shape
    x, y = uv[:, 0] * float(width) - 0.5, uv[:, 1] * float(height) - 0.5
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = x - left, y - top

    def texel(dx: int, dy: int) -> NDArray[np.float32]:
        return np.asarray(surface.pattern)[np.clip(top + dy, 0, height - 1), (left + dx) % width]

    upper = texel(0, 0) * (1.0 - fx) + texel(1, 0) * fx
    lower = texel(0, 1) * (1.0 - fx) + texel(1, 1) * fx
    return np.clip(state + upper * (1.0 - fy) + lower * fy, 0.0, 1.0)


def _alphas(surface: Surface) -> tuple[float, float]:
    front, back = (max(float(alpha), _LEAST_ALPHA) for alpha in surface.roughness)
    return front, back


def _shares_let_out(surface: Surface) -> tuple[float, float]:
    """Which share of the transmitted light the other side's cuticle lets out, from the front and the back."""
    means = [cuticle_transmittance(max(surface.ior, 1.0), alpha)[1] for alpha in _alphas(surface)]
    return min(means) / means[0], min(means) / means[1]


def _table(surface: Surface, sensed: Sensed, shares: tuple[float, float]) -> Array:
    """`(s, 3, 3)`: front and back reflectance and transmittance of the body by state and channel."""
    through = sensed.reflectance(surface, surface.transmittance)
    front, back = (
        sensed.reflectance(surface, surface.reflectance[:, side]) + through * (1.0 - shares[side])
        for side in (0, 1)
    )
    return np.stack([front, back, through], axis=1)


def _at_state(table: Array, state: Array) -> Array:
    """Rows of a table, linear in between, `(m, 3, 3)`."""
    place = state * (len(table) - 1)
    low = np.minimum(place.astype(int), max(len(table) - 2, 0))
    high = np.minimum(low + 1, len(table) - 1)
    part = (place - low)[:, None, None]
    return np.asarray(table[low] * (1.0 - part) + table[high] * part)


def _cuticle(surface: Surface, shares: tuple[float, float], table: Array) -> dict[str, Any]:
    """All of a surface that is not in its vertices' colours."""
    ior = max(float(surface.ior), 1.0)
    tables = [cuticle_transmittance(ior, alpha)[0] for alpha in _alphas(surface)]
    return {
        "ior": ior,
        "alpha": list(_alphas(surface)) if ior > 1.0 else [1.0, 1.0],
        "translucent": bool(table[:, 2].any()),
        "two_sided": bool(np.abs(table[:, 0] - table[:, 1]).max() > 0.0),
        "let_out": list(shares),
        "openness": interpolate_table(np.mean(tables, axis=0), _COSINES).tolist() if ior > 1.0 else [],
    }


# --- camera and flash ---------------------------------------------------------------------------------------


def _camera(camera: Camera) -> dict[str, Any]:
    """Blender's: axes are x right, y up, z backwards; lengths in millimetres, shifts in picture widths."""
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


def _flash(camera: Camera, intensity: Array) -> dict[str, Any]:
    """One rectangle for all discs, across the camera's axis, with the discs' variance of place."""
    flash = camera.flash
    assert flash is not None
    places = np.asarray(flash.emitters_m)
    # A disc's points vary by r^2 / 4 along each axis about its centre, a side's by s^2 / 12 about its middle.
    sides = np.sqrt(12.0 * (places.var(axis=0) + flash.radius_m**2 / 4.0))
    centre = np.asarray(flash.offset_m) + np.append(places.mean(axis=0), 0.0)
    pose = np.array(camera.pose)
    pose[:3, 3] += pose[:3, :3] @ centre
    return {
        "matrix_world": (pose @ np.diag([1.0, -1.0, -1.0, 1.0])).tolist(),
        "sides_m": np.maximum(sides, 1e-4).tolist(),  # a point is a tenth of a millimetre wide
        "intensity": intensity.tolist(),
        **_profile_stops(flash.profile.angle_rad, flash.profile.at),
    }


def _profile_stops(angles: Array, profile: Any) -> dict[str, list[float]]:
    """The beam at its own nodes where a ramp can hold them, else at even angles; 0 at a right angle."""
    if angles.size >= _PROFILE_STOPS:
        angles = np.linspace(0.0, float(angles[-1]), _PROFILE_STOPS - 1)
    return {"angle_rad": np.asarray(angles).tolist(), "relative_intensity": profile(angles).tolist()}
