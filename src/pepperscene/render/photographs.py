"""What a sensor makes of light: electrons, raw frame, photograph; of bands also radiance and reflectance."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import (
    Camera,
    develop,
    electrons_per_light,
    image_electrons,
    measured_electrons,
    raw_frame,
)
from pepperscene.camera.image.photo import photo_description
from pepperscene.camera.optics.white_reference import UNLIT_BANDS, WhiteReference, flash_on_panel
from pepperscene.camera.sensor.rows import row_strips
from pepperscene.render.kernel.camera import (
    SpectralResponse,
    detected_wavelengths,
    spectral_response,
)
from pepperscene.scene import Scene

Array = NDArray[np.float64]

LEAST_SIGNAL: Final = 3.0
"""Of the white reference over the noise of a pixel that sees it: the limit of detection, three standard
deviations (Currie 1968, Anal. Chem. 40:586). With less light, quotients are noise."""


def photographs(
    requested: Collection[str],
    signal: NDArray[np.float32],
    camera: Camera,
    scene: Scene,
    panel: WhiteReference,
    noise: np.random.SeedSequence,
) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """The requested outputs of a sensor, and descriptions of the white reference and of JPEG files.

    Args:
        requested: names of outputs; others are ignored.
        signal: `(h, w, c)` light, as of `expected_electrons`; that of a large image is overwritten.
        camera: of the frame.
        scene: with the frame's sky.
        panel: the white reference.
        noise: seed of the sensor's noise.
    """
    images: dict[str, NDArray[Any]] = {}
    described: dict[str, Any] = {}
    if "radiance" in requested:
        images["radiance"] = _radiance(signal, camera)
    electrons = image_electrons(signal, camera)
    # All start from the same generator state: the image is developed from exactly this raw frame.
    if "raw" in requested:
        images["raw"] = raw_frame(electrons, camera, np.random.default_rng(noise))
    if {"colour", "photo"}.intersection(requested):
        # The JPEG is made where files are written.
        images["colour"] = images["photo"] = develop(electrons, camera, np.random.default_rng(noise))
    if "photo" in requested:
        described["photo"] = photo_description(camera)
    if {"electrons", "bands", "reflectance"}.intersection(requested):
        images["electrons"] = electrons.astype(np.float32, copy=False)
    if {"bands", "reflectance"}.intersection(requested):
        images["bands"] = measured_electrons(images["electrons"], camera, np.random.default_rng(noise))
    if "reflectance" in requested:
        images["reflectance"], described["white_reference"] = _reflectance(
            images["bands"], camera, scene, panel
        )
    return {name: image for name, image in images.items() if name in requested}, described


def _radiance(signal: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    """`(h, w, c)` radiance of each band from its light, as of `expected_electrons`."""
    integrals = response_integrals(camera)
    radiance = np.empty(signal.shape, np.float32)
    for rows in row_strips(camera.width, camera.height):
        radiance[rows] = signal[rows] / integrals
    return radiance


def _reflectance(
    measured: NDArray[np.float32], camera: Camera, scene: Scene, panel: WhiteReference
) -> tuple[NDArray[np.float32], dict[str, Any]]:
    """`(h, w, c)` measured electrons over those of a white reference, nan where that has too little light."""
    light = white_light(camera, scene, panel)
    reflectance = np.empty(measured.shape, np.float32)
    for rows in row_strips(camera.width, camera.height):
        white = light[rows, None] * electrons_per_light(camera, rows)[..., None]
        lit = is_detected(white, camera)
        signal = panel.reflectance * measured[rows]
        reflectance[rows] = np.divide(signal, white, out=np.full(white.shape, np.nan), where=lit)
    on_axis = light[camera.height // 2] / response_integrals(camera)
    described = {**panel.to_metadata(), "radiance": on_axis.tolist()}
    unlit = np.flatnonzero(np.isnan(reflectance).any(axis=(0, 1)))
    if unlit.size:
        described[UNLIT_BANDS] = unlit.tolist()
    return reflectance, described


def is_detected(electrons: Array, camera: Camera) -> NDArray[np.bool_]:
    """Whether expected electrons of a photosite are `LEAST_SIGNAL` times their noise or more.

    The noise is that of photons, of reading, and of rounding to digital numbers, if the camera has them.
    """
    sensor, steps = camera.sensor, camera.developing
    variance = steps.shot_noise * electrons + steps.read_noise * sensor.read_noise_e**2
    variance = variance + steps.quantise * sensor.gain_e_per_dn**2 / 12.0
    return np.asarray((electrons > 0.0) & (electrons >= LEAST_SIGNAL * np.sqrt(variance)))


def response_integrals(camera: Camera) -> Array:
    """`(c,)` integral of each band's response in electrons per joule over wavelength, nm."""
    grid = detected_wavelengths(camera.sensor)
    return np.asarray(np.trapezoid(camera.sensor.electrons_per_joule(grid), grid, axis=-1))


def white_light(camera: Camera, scene: Scene, panel: WhiteReference) -> Array:
    """`(h, c)` light of the white reference in each row of an image, electrons s-1 m-2 sr-1.

    Its radiance is reflectance over pi times its irradiance by sky, sun, lamps and flash, without any shadow.
    Rows of a rolling shutter can see less of the flash.
    """
    response = spectral_response(camera, scene)
    weights = response.electrons_per_joule * response.trapezoid_nm[:, None]
    daylight, flash = (light @ weights for light in _irradiance(response, camera, scene, panel))
    share = np.ones(camera.height)
    if camera.flash is not None:
        share = camera.shutter.flash_fraction(camera.flash.pulse_s)
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
    if response.lamps is not None:
        daylight += response.lamps.irradiance(panel.centre(camera.pose), normal)
    flash = np.zeros(grid.size)
    if camera.flash is not None:
        flash += response.flash * flash_on_panel(camera.flash, panel, camera.pose)
    return daylight, flash
