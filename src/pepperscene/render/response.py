"""What the sensor makes of light, and where in the spectrum it is worth looking."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera
from pepperscene.scene import Scene

STEP_NM: Final = 1.0
_NEGLIGIBLE: Final = 1e-5  # chosen: response below this share of its peak is left out; error below 1e-5

_STRONGEST: Final = 1e26
"""Electrons s-1 m-2 (sr-1) that a light may send: chosen, a million times a flash of 200 klx at 50 cm. Single
precision ends at 3e38; next to a flash there is 1e8 times more, and mirrors gather 1e4 times more of that."""
_FAINTEST: Final = 1e-10
"""Chosen: a flash with less than this share of the daylight is none. Even at a centimetre it adds one part in
a million."""


@dataclass(frozen=True, eq=False)
class Response:
    """The camera's spectral side on a grid, ready for the kernel.

    Attributes:
        grid_nm: `(n,)` equally spaced by `STEP_NM`.
        electrons: `(n, c)` photo-electrons per joule, by channel: quantum efficiency times lambda / (h c).
        flash: `(n,)` W sr-1 nm-1 on the flash's axis, averaged over the exposure; zeros without a flash.
        density: `(n,)` where to take wavelengths: response times expected light, for importance sampling.
    """

    grid_nm: NDArray[np.float64]
    electrons: NDArray[np.float64]
    flash: NDArray[np.float64]
    density: NDArray[np.float64]


def response(camera: Camera, scene: Scene) -> Response:
    """The response over the range that the sensor sees and a light shines in, no wider.

    Raises:
        ValueError: a light is too strong for single precision.
    """
    efficiency = camera.sensor.quantum_efficiency
    peak = efficiency.values.max()
    seen = efficiency.wavelength_nm[(efficiency.values > _NEGLIGIBLE * peak).any(axis=0)]
    grid = np.arange(np.floor(seen[0]), np.ceil(seen[-1]) + STEP_NM, STEP_NM)
    lit = np.flatnonzero(np.any([_flash(camera, grid), *_sky_spectra(scene, grid)], axis=0))
    if lit.size:
        grid = grid[max(lit[0] - 1, 0) : lit[-1] + 2]
    electrons = camera.sensor.electrons_per_joule(grid).T
    flash, daylight = _flash(camera, grid), _sky_spectra(scene, grid)
    strengths = [float((light @ electrons).max()) for light in (flash, *daylight)]
    if scene.sky is not None:
        # The sky's spectra come first, each with its map.
        for k, weights in enumerate(scene.sky.weights, start=1):
            strengths[k] *= float(weights.max())
    if not max(strengths) <= _STRONGEST:
        most = f"{_STRONGEST:g} are allowed"
        raise ValueError(f"a light is too strong: {max(strengths):.3g} electrons s-1 m-2 where {most}")
    if strengths[0] < _FAINTEST * max(strengths):
        flash = np.zeros(grid.size)

    # Half of the density follows all lights alike, half the response alone: no light is left out.
    lights = [light for light in (flash, *daylight) if light.any()]
    light = (
        np.mean([spectrum / spectrum.mean() for spectrum in lights], axis=0) if lights else np.ones(grid.size)
    )
    share = (electrons / electrons.max(axis=0)).sum(axis=1)
    density = share * light
    density = density / density.sum() + share / share.sum() + 1e-3 / grid.size
    return Response(grid, electrons, flash, density)


def _flash(camera: Camera, grid: NDArray[np.float64]) -> NDArray[np.float64]:
    if camera.flash is None:
        return np.zeros(grid.size)
    return camera.flash.radiant_intensity(grid) * camera.flash_duty


def _sky_spectra(scene: Scene, grid: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    if scene.sky is None:
        return []
    sun = [scene.sky.sun.irradiance.at(grid)] if scene.sky.sun is not None else []
    return [*scene.sky.radiance.at(grid), *sun]
