"""How long paths are, and which frames need many scattering events: of bright leaves, and by daylight.

With two bounces after the first hit, a frame of `barth2018` by the flash has 99.9 % of its light. By daylight
inside the rows of `greenhouse`, where most light has been scattered on its way down, it has 92, 89 and 94 %
(red, green, blue) of it, and at 850 nm, where leaves absorb a tenth, 30 %.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.render.kernel.camera import SpectralResponse
from pepperscene.scene import Scene, Sky

ROULETTE: Final = (2.0, 0.25)
"""Chosen: a path survives with twice the fraction of light that it still carries, so that pale surfaces end
no path, and at least with this probability, which bounds the weight of a survivor. Half of the former takes a
quarter less time and has a fifth more noise: no gain."""
LONG_ROULETTE: Final = (0.5, 0.1)
"""The same beyond `Sampling.bounces`. Chosen: a visible frame of `greenhouse` by daylight then takes 3 % more
time than without these paths, with `ROULETTE` 6 %; the noise of its soft samples rises from 1.20 to 1.31 of
their mean."""

_BRIGHT: Final = 0.5
"""Mean reflectance plus transmittance. Chosen: leaves cross it at 705 nm, between dark red and bright near
infrared; a light scattered twice after the first hit has lost all but an eighth below it."""
_BRIGHT_SHARE: Final = 0.1
"""Chosen: share of the detected light at wavelengths at which surfaces are bright. By the flash, two bounces
then lose 3 % of a tenth of the light."""
_DAYLIGHT_SHARE: Final = 0.2
"""Chosen: daylight over flash light on a white body half a metre from the flash. Below, two bounces lose a
tenth of a fifth of the light."""
_FLASH_DISTANCE_M: Final = 0.5


def needs_long_paths(
    scene: Scene, response: SpectralResponse, triangles: NDArray[np.int64] | None = None
) -> bool:
    """Whether much of a frame's light is scattered more often than twice after the first hit.

    Args:
        scene: with surfaces and sky.
        response: of the camera in this scene; its flash is averaged over the exposure.
        triangles: `surface_triangles(scene)`, where they are kept between frames.
    """
    grid = response.grid_nm
    flash, daylight = _detected_light(scene, response)
    if daylight.sum() > _DAYLIGHT_SHARE * flash.sum():
        return True
    light = flash + daylight
    is_bright = mean_albedo(scene, grid, triangles) > _BRIGHT
    return bool(light[is_bright].sum() > _BRIGHT_SHARE * light.sum())


def has_mainly_daylight(scene: Scene, response: SpectralResponse) -> bool:
    """Whether there is no flash, or one that is weaker than all other light half a metre from it."""
    flash, daylight = _detected_light(scene, response)
    return bool(flash.sum() <= daylight.sum())


def has_mainly_sun(scene: Scene, response: SpectralResponse) -> bool:
    """Whether a level plane has more detected light from the sun than from the sky."""
    if scene.sky is None or scene.sky.sun is None:
        return False
    detected = response.electrons_per_joule.sum(axis=1) * response.trapezoid_nm
    without_sun = replace(scene.sky, sun=None)
    sky, both = (detected @ _irradiance(light, response.grid_nm) for light in (without_sun, scene.sky))
    return bool(both > 2.0 * sky)


def surface_triangles(scene: Scene) -> NDArray[np.int64]:
    """`(k,)` number of triangles of each surface; it takes 3 ms per million triangles."""
    return np.bincount(scene.mesh.face_surface, minlength=len(scene.surfaces))


def mean_albedo(
    scene: Scene, grid_nm: NDArray[np.float64], triangles: NDArray[np.int64] | None = None
) -> NDArray[np.float64]:
    """`(n,)` reflectance plus transmittance of a scene's surfaces, the mean over its triangles.

    Not over areas: the floor's two triangles have a larger area than all leaves together. Pigment states and
    both sides count alike. `triangles` as of `needs_long_paths`.
    """
    counts = surface_triangles(scene) if triangles is None else triangles
    total = np.zeros(grid_nm.size)
    for surface, count in zip(scene.surfaces, counts, strict=True):
        albedo = surface.reflectance.mean(axis=(0, 1)) + surface.transmittance.mean(axis=0)
        total += count * np.interp(grid_nm, surface.wavelength_nm, albedo)
    return total / max(counts.sum(), 1)


def _detected_light(
    scene: Scene, response: SpectralResponse
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """`(n,)` light of the flash at `_FLASH_DISTANCE_M`, and of sky and lamps, that is detected."""
    grid = response.grid_nm
    detected = response.electrons_per_joule.sum(axis=1) * response.trapezoid_nm
    flash = detected * response.flash / _FLASH_DISTANCE_M**2
    daylight = np.zeros(grid.size) if scene.sky is None else detected * _irradiance(scene.sky, grid)
    if response.lamps is not None:
        daylight = daylight + detected * response.lamps.irradiance_ahead(_FLASH_DISTANCE_M)
    return flash, daylight


def _irradiance(sky: Sky, grid_nm: NDArray[np.float64]) -> NDArray[np.float64]:
    """`(n,)` irradiance of a level plane by sky and sun, W m-2 nm-1."""
    total = sky.received() @ sky.radiance.at(grid_nm)
    if sky.sun is not None:
        total += max(0.0, float(sky.sun.direction[2])) * sky.sun.irradiance.at(grid_nm)
    return np.asarray(total)
