"""Small scenes whose results have a closed form, and electrons computed without the program."""

from __future__ import annotations

import csv
from dataclasses import replace
from functools import cache

import numpy as np
import trimesh

from pepperscene.camera import AngularProfile, Camera, Flash, Sensor, load_flash, load_lens, load_sensor
from pepperscene.classes import Appearance, Instance, OrganClass
from pepperscene.geometry import Mesh
from pepperscene.materials import Surface, lambertian_surface
from pepperscene.scene import Scene, assemble_scene, uniform_sky
from pepperscene.shipped import shipped_folder
from pepperscene.spectra import Spectrum

RANGE_NM = np.array([300.0, 1100.0])
EVEN_SKY = uniform_sky(Spectrum(RANGE_NM, np.ones(2)), 5500.0)
PLANCK, LIGHT_SPEED = 6.62607015e-34, 2.99792458e8  # J s, m/s (SI 2019, exact)
SENSORS = ("ueye_ui5250re", "onsemi_mt9v024")  # one binned, one demosaiced
PITCH_M = {"ueye_ui5250re": 4.5e-6, "onsemi_mt9v024": 6.0e-6}  # of a photosite, from the data sheets
CURVES = {  # files of quantum efficiency and of the infrared-cut filter in front
    "ueye_ui5250re": ("ev76c570_rgb_qe_MODEL", None),
    "onsemi_mt9v024": ("onsemi_mt9v024_rgb_qe", "ircut_schott_22022010"),
}


def body(solid: trimesh.Trimesh, surface: str, organ_class: OrganClass = OrganClass.LEAF) -> Mesh:
    """A trimesh body as a mesh of one instance; all vertices have the same uv and state."""
    vertices, faces = len(solid.vertices), len(solid.faces)
    return Mesh(
        vertices=solid.vertices.astype(np.float32),
        normals=np.asarray(solid.vertex_normals, np.float32),
        uv=np.full((vertices, 2), 0.5, np.float32),
        state=np.full(vertices, 0.5, np.float32),
        faces=solid.faces.astype(np.uint32),
        face_instance=np.zeros(faces, np.uint32),
        face_surface=np.zeros(faces, np.uint8),
        face_appearance=np.zeros(faces, np.uint32),
        surfaces=(surface,),
        instances=(Instance(organ_class, "test body"),),
        appearances=(Appearance(),),
    )


def sheet(width: float, height: float, z: float, surface: str) -> Mesh:
    """A rectangle across the z axis, facing -z."""
    return card(0.0, 0.0, width, height, surface, z)


def card(x: float, y: float, width: float, height: float, surface: str, z: float = 0.5) -> Mesh:
    """A rectangle with its centre at (x, y, z), facing -z."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * (width / 2, height / 2)
    flat = trimesh.Trimesh(np.pad(corners, ((0, 0), (0, 1))), [[0, 2, 1], [0, 3, 2]], process=False)
    return body(flat, surface).moved(np.eye(3), np.array([x, y, z]))


def knife_edge(z: float) -> Scene:
    """A black half-plane (x > 0) at distance z in front of a uniform sky."""
    blade = card(1.0, 0.0, 2.0, 4.0, "black", z)
    return assemble_scene(blade, {"black": lambertian_surface("black", 0.0)}, EVEN_SKY)


def sphere(centre: tuple[float, float, float], radius: float, surface: str, subdivisions: int = 5) -> Mesh:
    """A finely tessellated sphere of class PEPPER."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    ball.apply_translation(centre)
    return body(ball, surface, OrganClass.PEPPER)


def axis_camera(
    columns: int = 800,
    rows: int = 600,
    *,
    sensor: str = "ueye_ui5250re",
    flash: Flash | bool | None = True,
    **flash_changes: object,
) -> Camera:
    """A shipped sensor, cropped, behind the recipe's lens at the origin, looking along +z, for 50 us.

    `flash` is the recipe's with `flash_changes`, none, or another one.
    """
    if flash is True:
        flash = replace(_flash(), **flash_changes) if flash_changes else _flash()  # type: ignore[arg-type]
    cropped = _cropped(sensor, columns, rows)
    return Camera(load_lens("lensagon_cmfa0420nd"), cropped, np.eye(4), 50e-6, flash or None)


# Made once a process, as for a recipe: what is computed once for a sensor takes half of a small frame.
@cache
def _cropped(sensor: str, columns: int, rows: int) -> Sensor:
    return replace(load_sensor(sensor), columns=columns, rows=rows)


@cache
def _flash() -> Flash:
    return load_flash("led_matrix_200klx")


def point_flash_camera(columns: int = 16, rows: int = 12, **changes: object) -> Camera:
    """`axis_camera` with a point flash at the lens."""
    point = {"radius_m": 0.0, "emitters_m": np.zeros((1, 2)), "offset_m": (0.0, 0.0, 0.0)}
    return axis_camera(columns, rows, **{**point, **changes})


def matt(name: str, nm: np.ndarray, reflectance: np.ndarray) -> Surface:
    """An ideal matt, opaque surface of this spectral reflectance `(n,)`."""
    both = np.broadcast_to(reflectance, (1, 2, nm.size)).astype(float)
    return Surface(name, np.asarray(nm, float), both, np.zeros((1, nm.size)))


def even_lamp(spectrum: Spectrum, illuminance_lx: float = 200_000.0) -> Flash:
    """A point lamp at the lens whose beam makes a facing plane at 50 cm look evenly bright.

    A point of intensity I cos^-7 lights that plane with I cos^-7 cos^3 / z^2, and the lens takes cos^4 of it.
    """
    angle = np.radians(np.arange(0.0, 60.1, 0.25))
    profile = AngularProfile(angle, np.cos(angle) ** -7)
    return Flash("lamp", spectrum, illuminance_lx=illuminance_lx, at_m=0.5, profile=profile)


# --- by hand: NumPy and the numbers of the data files, no code of the program -------------------------------


def columns_of(file: str) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """(wavelengths, values) of all columns of a CSV file below `materials/`, by name."""
    with (shipped_folder("materials") / f"{file}.csv").open() as stream:
        header, *rows = [row for row in csv.reader(stream) if row and not row[0].startswith("#")]
    table = np.array(rows, float)
    return {name: (table[:, 0], table[:, i]) for i, name in enumerate(header) if i}


def response_by_hand(sensor: str, nm: np.ndarray) -> np.ndarray:
    """`(3, n)` electrons per nm of a photosite, for 1 W m-2 sr-1 nm-1: f/2, 90 % glass, 50 us."""
    efficiency, cut = CURVES[sensor]
    curves = columns_of(f"sensors/spectra/{efficiency}")
    quantum_efficiency = np.array([np.interp(nm, *curves[channel], 0, 0) for channel in "rgb"])
    if cut:
        quantum_efficiency *= np.interp(nm, *columns_of(f"sensors/spectra/{cut}")["transmittance"], 0, 0)
    photons = nm * 1e-9 / (PLANCK * LIGHT_SPEED)
    return quantum_efficiency * photons * PITCH_M[sensor] ** 2 * np.pi / (4 * 2.0**2) * 0.9 * 50e-6


def lux(nm: np.ndarray, irradiance: np.ndarray) -> float:
    """Illuminance of W m-2 nm-1 (CIE 1924, 683.002 lm/W)."""
    import colour

    v = colour.SDS_LEFS["CIE 1924 Photopic Standard Observer"]
    return 683.002 * np.trapezoid(irradiance * np.interp(nm, v.wavelengths, v.values, 0, 0), nm)


def irradiance_by_hand(spd: tuple[np.ndarray, np.ndarray], lx: float, nm: np.ndarray) -> np.ndarray:
    """`(n,)` W m-2 nm-1 of a light of this relative SPD that gives `lx`."""
    fine = np.arange(360.0, 830.0, 0.5)
    return np.interp(nm, *spd, 0, 0) * lx / lux(fine, np.interp(fine, *spd, 0, 0))
