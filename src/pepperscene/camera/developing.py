"""From electrons to the photograph: mosaic, colours, white balance, colour matrix, tone curve."""

from __future__ import annotations

import dataclasses
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera.camera import Camera
from pepperscene.camera.colorimetry import (
    ColourCorrection,
    colour_correction,
    d65_spectrum,
    white_balance_gains,
)
from pepperscene.camera.readout import Floats, Tone, bin_photosites, demosaic_image, read_out
from pepperscene.spectra import Spectrum


def develop(
    electrons: ArrayLike, camera: Camera, rng: np.random.Generator | None = None
) -> NDArray[np.uint8]:
    """The photograph, `(h, w, 3)` uint8; three times the same grey from a monochrome sensor.

    It is made from the mosaic that `raw_frame` gives for a generator in the same state.

    Args:
        electrons: `(h, w, c)` expected electrons of a photosite of each colour; below 0 (a denoiser's
            undershoot) counts as 0.
        camera: its sensor, flash and `developing` say how.
        rng: draws the noise; None leaves it out.

    Raises:
        ValueError: the electrons have the wrong shape or are not finite, or the white balance asks for a
            flash that is not there.
        InputError: the reference light does not let the sensor tell colours apart.
    """
    linear = correct_colours(camera_rgb(electrons, camera, rng), camera)
    codes = encode_tone(linear, camera.developing.tone)
    return np.repeat(codes, 3, axis=-1) if camera.sensor.channels == 1 else codes


def raw_frame(
    electrons: ArrayLike, camera: Camera, rng: np.random.Generator | None = None
) -> NDArray[np.uint16]:
    """`(site rows, site columns)` digital numbers as the converter gives them, black level included.

    Always quantised and within the converter's range, whatever `developing` leaves out for the picture.

    Args, Raises: as `develop`.
    """
    choice = dataclasses.replace(camera.developing, quantise=True, saturation=True)
    return read_out(_checked(electrons, camera), camera.sensor, rng, choice).astype(np.uint16)


def camera_rgb(electrons: ArrayLike, camera: Camera, rng: np.random.Generator | None = None) -> Floats:
    """`(h, w, c)` linear device colour of the image pixels: black is 0, full scale 1.

    Noise leads slightly below 0, demosaicing also above 1, and far above leads a saturation that is left out.

    Raises:
        ValueError: as `develop`.
    """
    sensor, choice = camera.sensor, camera.developing
    sites = read_out(_checked(electrons, camera), sensor, rng, choice)
    sites -= np.float32(sensor.black_level_dn)
    sites /= np.float32(sensor.full_scale_dn - sensor.black_level_dn)
    if sensor.channels == 3 and sensor.binning == 1:
        return demosaic_image(sites, sensor.pattern, choice.demosaic)
    return bin_photosites(sites, sensor)


def correct_colours(rgb: Floats, camera: Camera) -> Floats:
    """`(h, w, 3)` linear sRGB of camera_rgb, as far as the camera's `developing` asks for; may leave [0, 1].

    The numbers are those of `colour_transform`. All channels clip where the one of the smallest gain does:
    at the sensor's limit times that gain. So gains of k times the size give a picture k times as bright,
    clipped light included, and below a smallest gain of 1 blown-out white stays below 1.

    Monochrome camera_rgb `(h, w, 1)` passes through.

    Raises:
        ValueError: the white balance asks for a flash that is not there.
        InputError: the reference light does not let the sensor tell colours apart.
    """
    sensor, choice = camera.sensor, camera.developing
    if sensor.channels == 1:
        return rgb
    gains, matrix = colour_transform(camera)
    if choice.white_balance is not None:
        rgb = rgb * gains.astype(np.float32)
        if choice.saturation:
            # Channels clip at different lights once gained; clipping all where the sensor does, at full scale
            # or, with a gain below 1, at the full well, keeps blown-out white white.
            rgb = np.minimum(rgb, np.float32(min(sensor.gain, 1.0) * gains.min()))
    return rgb if choice.colour_matrix is False else rgb @ matrix.T.astype(np.float32)


def colour_transform(camera: Camera) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """White balance gains `(3,)` and colour matrix `(3, 3)` in use: linear sRGB is `matrix @ (gains * rgb)`.

    Each is the one that the camera's `developing` tells, or that of its reference light (see
    `reference_correction`); ones, or the identity, where the step is left out. Clipping is not in them.

    Raises:
        ValueError: the sensor is monochrome, or the white balance asks for a flash that is not there.
        InputError: the reference light does not let the sensor tell colours apart.
    """
    _check_colours(camera)
    balance, choice = camera.developing.white_balance, camera.developing.colour_matrix
    if balance is None:
        gains = np.ones(3)
    elif isinstance(balance, str):
        # Not out of the whole correction: light without colours can be balanced all the same.
        gains = white_balance_gains(camera.sensor, _reference_light(camera))
    else:
        gains = np.array(balance)

    if isinstance(choice, bool):
        matrix = reference_correction(camera).matrix if choice else np.eye(3)
    else:
        matrix = np.array(choice)
    return gains, matrix.copy()


def encode_tone(linear: Floats, tone: Tone = "srgb") -> NDArray[np.uint8]:
    """8-bit codes of linear values, clipped to [0, 1]; the sRGB curve of IEC 61966-2-1, or none."""
    value = np.clip(linear, np.float32(0), np.float32(1))
    if tone == "srgb":
        toe = np.float32(12.92) * value
        value = np.where(
            value <= 0.0031308, toe, np.float32(1.055) * value ** np.float32(1 / 2.4) - np.float32(0.055)
        )
    return np.rint(value * np.float32(255)).astype(np.uint8)


def decode_tone(codes: ArrayLike, tone: Tone = "srgb") -> NDArray[np.float64]:
    """Linear values in [0, 1] of codes 0 to 255, of any shape: what `encode_tone` gives these codes for.

    Args:
        codes: 8-bit codes, or numbers between them (means of codes); what lies outside is clipped.
        tone: the curve that they have.
    """
    value = np.asarray(codes)
    if value.dtype == np.uint8:
        return _every_code(tone)[value]
    return _decoded(np.clip(np.asarray(value, dtype=np.float64) / 255.0, 0.0, 1.0), tone)


@lru_cache(maxsize=2)
def _every_code(tone: Tone) -> NDArray[np.float64]:
    """`(256,)` linear values by code: far faster than as many powers as a picture has pixels."""
    return _decoded(np.arange(256) / 255.0, tone)


def _decoded(value: NDArray[np.float64], tone: Tone) -> NDArray[np.float64]:
    """Linear values of encoded ones in [0, 1]; the inverse of the curve of IEC 61966-2-1, or none."""
    if tone != "srgb":
        return value
    # The standard rounds the knee to 0.04045; here it is where the curve of `encode_tone` has it.
    return np.where(value <= 12.92 * 0.0031308, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def reference_correction(camera: Camera) -> ColourCorrection:
    """Gains and colour matrix of the camera under its reference light, worked out once per sensor and light.

    That is the light of the white balance; where this names none, the flash, or daylight where there is no
    flash. What `developing` says in numbers plays no part.

    Raises:
        ValueError: the sensor is monochrome, or the white balance asks for a flash that is not there.
        InputError: the reference light does not let the sensor tell colours apart.
    """
    _check_colours(camera)
    return colour_correction(camera.sensor, _reference_light(camera))


def _check_colours(camera: Camera) -> None:
    if camera.sensor.channels == 1:
        raise ValueError(f"{camera.sensor.name} sees no colours that could be corrected")


def _reference_light(camera: Camera) -> Spectrum:
    choice = camera.developing.white_balance
    if choice == "flash" and camera.flash is None:
        raise ValueError('white balance "flash" needs a flash; choose "daylight"')
    return d65_spectrum() if choice == "daylight" or camera.flash is None else camera.flash.spectrum


def _checked(electrons: ArrayLike, camera: Camera) -> NDArray[np.floating]:
    """Finite electrons of the picture's shape, nowhere below 0."""
    expected, shape = np.asarray(electrons), (camera.height, camera.width, camera.sensor.channels)
    if expected.shape != shape:
        raise ValueError(f"electrons of {shape} are needed, not {expected.shape}")
    if not np.isfinite(expected).all():
        raise ValueError("electrons must be finite")
    return np.maximum(expected, 0.0)
