"""Cameras with bands, and cards in front of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh
from bodies import axis_camera, body

from pepperscene.camera import Camera
from pepperscene.geometry import Mesh
from pepperscene.spectra import Spectrum


def gaussian_bands(centres_nm: np.ndarray, width_nm: float, peak: float = 0.6) -> Spectrum:
    """Bands of a full width at half maximum."""
    centres = np.asarray(centres_nm, float)
    nm = np.arange(centres.min() - 3 * width_nm, centres.max() + 3 * width_nm, 0.5)
    curves = peak * np.exp(-4.0 * np.log(2.0) * ((nm - centres[:, None]) / width_nm) ** 2)
    return Spectrum(nm, np.where(curves < 1e-4 * peak, 0.0, curves))


def with_bands(camera: Camera, efficiency: Spectrum | None = None) -> Camera:
    """The camera with a sensor of these bands; with those of its colours by default."""
    efficiency = efficiency or camera.sensor.quantum_efficiency
    sensor = replace(camera.sensor, pattern="bands", quantum_efficiency=efficiency)
    return replace(camera, sensor=sensor)


def small_camera(efficiency: Spectrum | None = None, columns: int = 16, rows: int = 12, **changes) -> Camera:
    """`axis_camera` with bands; its few pixels cover the middle of the image."""
    return with_bands(axis_camera(columns, rows, **changes), efficiency)


def wall(z: float, surface: str) -> Mesh:
    """A plane of 8 m across the z axis, facing -z."""
    corners = np.array([[x, y, z] for x, y in ((-4, -4), (-4, 4), (4, 4), (4, -4))], float)
    return body(trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False), surface)
