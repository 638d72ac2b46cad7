"""The lamps of a frame: those of the scene and of the camera, sorted by spectrum, on a wavelength grid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera, Lamp
from pepperscene.scene import Scene
from pepperscene.spectra import Spectrum

MOST_SPECTRA: Final = 8
"""Different spectra of the lamps of a frame. Chosen: light that meets one surface is computed for each."""


@dataclass(frozen=True, eq=False)
class FrameLamps:
    """The lamps of a frame, sorted by spectrum.

    Attributes:
        lamps: k of them.
        at_camera: `(k,)` whether a lamp moves with the camera.
        flux_W: `(k,)` averaged over the exposure.
        group: `(k,)` number of the spectrum, ascending.
        spectra: `(g, n)` on a grid, nm-1: those of 1 W.
        pose: `(4, 4)` of the camera.
    """

    lamps: tuple[Lamp, ...]
    at_camera: NDArray[np.bool_]
    flux_W: NDArray[np.float64]  # noqa: N815 (the unit is written so)
    group: NDArray[np.int64]
    spectra: NDArray[np.float64]
    pose: NDArray[np.float64]

    @property
    def emitted(self) -> NDArray[np.float64]:
        """`(g, n)` all light of each spectrum, W nm-1."""
        return np.bincount(self.group, self.flux_W, len(self.spectra))[:, None] * self.spectra

    def irradiance(
        self, point_m: NDArray[np.float64], normal: NDArray[np.float64] | None = None
    ) -> NDArray[np.float64]:
        """`(n,)` irradiance of a plane by lamps without any shadow, W m-2 nm-1; None for facing each."""
        total = np.zeros(self.spectra.shape[1])
        turn, centre = self.pose[:3, :3], self.pose[:3, 3]
        for lamp, moves, flux, group in zip(self.lamps, self.at_camera, self.flux_W, self.group, strict=True):
            placed = lamp.moved(turn, centre) if moves else lamp
            ray = placed.position_m - point_m
            facing = ray / max(float(np.linalg.norm(ray)), 1e-9) if normal is None else normal
            total += flux * float(placed.irradiance_factor([point_m], [facing])[0]) * self.spectra[group]
        return total

    def irradiance_ahead(self, distance_m: float) -> NDArray[np.float64]:
        """`(n,)` irradiance of planes on the camera's axis that face each lamp, W m-2 nm-1."""
        return self.irradiance(self.pose[:3, 3] + distance_m * self.pose[:3, 2])


def frame_lamps(camera: Camera | None, scene: Scene, grid_nm: NDArray[np.float64]) -> FrameLamps | None:
    """The lamps of a camera in a scene; None if there are none.

    Without a camera they are those of the scene that shine all the time.

    Raises:
        ValueError: they have more than `MOST_SPECTRA` different spectra.
    """
    found: list[tuple[int, Lamp, bool]] = []
    spectra: list[Spectrum] = []
    placed = [(lamp, False) for lamp in scene.lamps if camera or lamp.pulse_s is None]
    for lamp, moves in (*placed, *((lamp, True) for lamp in (camera.lamps if camera else ()))):
        number = next((k for k, known in enumerate(spectra) if _is_same(known, lamp.spectrum)), None)
        if number is None:
            number = len(spectra)
            spectra.append(lamp.spectrum)
        found.append((number, lamp, moves))
    if len(spectra) > MOST_SPECTRA:
        raise ValueError(
            f"the lamps have {len(spectra)} different spectra, at most {MOST_SPECTRA} are allowed"
        )
    if not found:
        return None
    found.sort(key=lambda item: item[0])
    group, sorted_lamps, at_camera = zip(*found, strict=True)
    units = {number: lamp.unit_spectrum.at(grid_nm) for number, lamp, _ in found}
    table = np.stack([units[number] for number in range(len(spectra))])
    return FrameLamps(
        lamps=sorted_lamps,
        at_camera=np.array(at_camera),
        flux_W=np.array(
            [one.flux_W * (one.duty(camera.exposure_s) if camera else 1.0) for one in sorted_lamps]
        ),
        group=np.array(group),
        spectra=table,
        pose=camera.pose if camera else np.eye(4),
    )


def _is_same(first: Spectrum, second: Spectrum) -> bool:
    """Whether two relative spectra are the same object or have the same values."""
    return first is second or (
        np.array_equal(first.wavelength_nm, second.wavelength_nm)
        and np.array_equal(first.values, second.values)
    )
