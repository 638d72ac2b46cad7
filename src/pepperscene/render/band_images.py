"""What a sensor with bands measures: electrons with noise, radiance, and reflectance by a white reference."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera, electrons_per_light, measured_electrons
from pepperscene.camera.white_reference import WhiteReference, flash_on_panel
from pepperscene.render.kernel.camera import (
    SpectralResponse,
    detected_wavelengths,
    spectral_response,
)
from pepperscene.scene import Scene

Array = NDArray[np.float64]


def band_images(
    names: Collection[str],
    signal: NDArray[np.float32],
    electrons: Array,
    camera: Camera,
    scene: Scene,
    panel: WhiteReference,
    noise: np.random.SeedSequence,
) -> tuple[dict[str, NDArray[np.float32]], dict[str, Any]]:
    """The outputs of a sensor with bands that are requested, and the description of the white reference.

    Args:
        names: of outputs.
        signal: `(h, w, c)` light, as of `expected_electrons`.
        electrons: `(h, w, c)` expected electrons.
        camera: of the frame.
        scene: with the frame's sky.
        panel: the white reference.
        noise: seed of the sensor's noise.
    """
    images: dict[str, NDArray[np.float32]] = {}
    described: dict[str, Any] = {}
    if "radiance" in names:
        images["radiance"] = (signal / response_integrals(camera)).astype(np.float32)
    if {"bands", "reflectance"}.intersection(names):
        images["bands"] = measured_electrons(electrons, camera, np.random.default_rng(noise))
    if "reflectance" in names:
        light = white_light(camera, scene, panel)
        white = light[:, None] * electrons_per_light(camera)[..., None]
        images["reflectance"] = (panel.reflectance * images["bands"] / white).astype(np.float32)
        on_axis = light[camera.height // 2] / response_integrals(camera)
        described["white_reference"] = {**panel.metadata(), "radiance": on_axis.tolist()}
    return images, described


def response_integrals(camera: Camera) -> Array:
    """`(c,)` integral of each band's response in electrons per joule over wavelength, nm."""
    grid = detected_wavelengths(camera.sensor)
    return np.asarray(np.trapezoid(camera.sensor.electrons_per_joule(grid), grid, axis=-1))


def white_light(camera: Camera, scene: Scene, panel: WhiteReference) -> Array:
    """`(h, c)` light of the white reference in each row of an image, electrons s-1 m-2 sr-1.

    Its radiance is reflectance over pi times its irradiance by sky, sun and flash, without any shadow. Rows
    of a rolling shutter can see less of the flash.
    """
    response = spectral_response(camera, scene)
    weights = response.electrons_per_joule * response.trapezoid_nm[:, None]
    daylight, flash = (light @ weights for light in _irradiance(response, camera, scene, panel))
    share = np.ones(camera.height)
    if camera.flash is not None:
        share = camera.shutter.flash_share(camera.flash.pulse_s)
    return np.asarray(panel.reflectance / np.pi * (daylight + share[:, None] * flash))


def _irradiance(
    response: SpectralResponse, camera: Camera, scene: Scene, panel: WhiteReference
) -> tuple[Array, Array]:
    """`(n,)` irradiance of the panel by daylight and by the flash, W m-2 nm-1, averaged over the exposure."""
    grid, normal = response.grid_nm, panel.normal(camera.pose)
    daylight = np.zeros(grid.size)
    if scene.sky is not None:
        daylight += scene.sky.received_by(normal) @ scene.sky.radiance.at(grid)
        if scene.sky.sun is not None:
            sun = scene.sky.sun
            daylight += max(float(sun.direction @ normal), 0.0) * sun.irradiance.at(grid)
    flash = np.zeros(grid.size)
    if camera.flash is not None:
        flash += response.flash * flash_on_panel(camera.flash, panel, camera.pose)
    return daylight, flash
