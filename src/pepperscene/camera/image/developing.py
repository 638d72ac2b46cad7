"""Developing electrons into an image: mosaic, demosaicing, white balance, colour matrix and tone curve."""

from __future__ import annotations

import dataclasses
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera.camera import Camera
from pepperscene.camera.image.colorimetry import (
    ColourCorrection,
    colour_correction,
    d65_spectrum,
    srgb_decode,
    srgb_encode,
    white_balance_gains,
)
from pepperscene.camera.image.electrons import relative_illumination
from pepperscene.camera.isp.processor import ImageProcessor, Points, ToneCurveName
from pepperscene.camera.isp.steps import apply_local_steps, correct_shading, displace_red_and_blue, saturate
from pepperscene.camera.sensor.developing_steps import LARGEST_PEDESTAL, Tone
from pepperscene.camera.sensor.readout import Floats, colour_strips, mosaic_strips
from pepperscene.camera.sensor.rows import row_strips
from pepperscene.spectra import Spectrum

Array = NDArray[np.float64]
AUTO_PEDESTAL: Final = 0.7
"""Standard deviations of the noisiest colour of black. Chosen: the smallest at which the mean codes of black
differ by less than one between colours, for all shipped sensors; more would only make it brighter. EMVA 1288
asks for 2.6 in raw frames, so that 0.5 % of the numbers are clipped."""
GAMMA: Final = 2.2  # chosen: that of most displays before sRGB
_LEVELS: Final = 1 << 16
"""Of light in a table of a curve. Near black, where sRGB is steepest, a step is 0.05 codes of 255."""
_FILMIC_EXPOSURE: Final = 0.6  # of Narkowicz (2015), so that his fit is that of the whole transform


def develop(
    electrons: ArrayLike, camera: Camera, rng: np.random.Generator | None = None
) -> NDArray[np.uint8]:
    """The developed image, `(h, w, 3)` uint8; grey from a monochrome sensor. Sensors with bands have none.

    It is made from the mosaic that `raw_frame` returns for a generator in the same state. With an image
    signal processor it is what that makes of it, before any JPEG.

    Args:
        electrons: `(h, w, c)` expected electrons of a photosite of each colour; values below 0 (undershoot of
            a denoiser) count as 0.
        camera: sensor, flash and developing steps.
        rng: draws the noise; None leaves it out.

    Raises:
        ValueError: the electrons have the wrong shape or are not finite, the white balance needs a flash
            that the camera does not have, or the sensor has bands.
        InputError: the sensor cannot distinguish colours under the reference light.
    """
    expected = _check_electrons(electrons, camera)
    _check_has_mosaic(camera)
    isp = camera.developing.isp
    if isp is not None and isp.changes_images:
        return _processed(expected, camera, isp, rng)
    image = np.empty((camera.height, camera.width, 3), np.uint8)
    for rows, rgb in colour_strips(expected, camera.sensor, rng, camera.developing):
        linear = add_pedestal(correct_colours(rgb, camera), camera)
        image[rows] = encode_tone(linear, camera.developing.tone)
    return image


def _processed(
    expected: NDArray[np.floating], camera: Camera, isp: ImageProcessor, rng: np.random.Generator | None
) -> NDArray[np.uint8]:
    """The image of `develop` by an image signal processor, whose filters need the whole image."""
    sensor, shape = camera.sensor, (camera.height, camera.width)
    codes = np.empty((*shape, sensor.channels), np.float32)
    for rows, rgb in colour_strips(expected, sensor, rng, camera.developing):
        codes[rows] = correct_shading(rgb, rows, shape, isp, relative_illumination(camera, rows))
    if sensor.channels == 3:
        displace_red_and_blue(codes, isp)
    for rows in row_strips(camera.width, camera.height):
        linear = correct_colours(codes[rows], camera)
        linear = saturate(linear, isp.saturation) if sensor.channels == 3 else linear
        codes[rows] = apply_tone(add_pedestal(linear, camera), isp, camera.developing.tone)
    codes = apply_local_steps(codes, isp)
    image = np.empty((*shape, 3), np.uint8)
    for rows in row_strips(camera.width, camera.height):
        image[rows] = encode_tone(codes[rows], "linear")
    return image


def raw_frame(
    electrons: ArrayLike, camera: Camera, rng: np.random.Generator | None = None
) -> NDArray[np.uint16]:
    """`(site rows, site columns)` digital numbers of the converter, black level included.

    Always quantised and limited to the converter's range, whatever `developing` leaves out for the image.
    Arguments and errors are those of `develop`.
    """
    _check_has_mosaic(camera)
    developing = dataclasses.replace(camera.developing, quantise=True, saturation=True)
    expected = _check_electrons(electrons, camera)
    image = np.empty(camera.sensor.site_shape, np.uint16)
    for rows, sites in mosaic_strips(expected, camera.sensor, rng, developing):
        image[rows] = sites
    return image


def measured_electrons(
    electrons: ArrayLike, camera: Camera, rng: np.random.Generator | None = None
) -> Floats:
    """`(h, w, c)` electrons as the sensor measures them: with its noise, full well, gain and converter.

    They are digital numbers without the black level, times `Sensor.gain_e_per_dn`, as means over the
    photosites of each pixel; noise can make them slightly negative. Arguments and errors are those of
    `camera_rgb`.
    """
    sensor, measured = camera.sensor, camera_rgb(electrons, camera, rng)
    measured *= np.float32(sensor.full_well_e / sensor.gain)
    return measured


def camera_rgb(electrons: ArrayLike, camera: Camera, rng: np.random.Generator | None = None) -> Floats:
    """`(h, w, c)` linear device colour of the image pixels: black is 0, full scale is 1.

    The bands of a sensor with bands are read out one after the other, each as a monochrome image.

    Noise can make values slightly negative, or, by demosaicing, above 1; without saturation far above 1.

    Raises:
        ValueError: as `develop`.
    """
    sensor, expected = camera.sensor, _check_electrons(electrons, camera)
    if sensor.pattern != "bands":
        strips = [rgb for _, rgb in colour_strips(expected, sensor, rng, camera.developing)]
        return strips[0] if len(strips) == 1 else np.concatenate(strips)
    pixels = np.empty(expected.shape, np.float32)
    for number in range(sensor.channels):
        band = slice(number, number + 1)
        for rows, values in colour_strips(expected[..., band], sensor, rng, camera.developing):
            pixels[rows, :, band] = values
    return pixels


def correct_colours(rgb: Floats, camera: Camera) -> Floats:
    """`(h, w, 3)` linear sRGB of camera_rgb by the steps in the camera's `developing`; can leave [0, 1].

    The numbers are those of `colour_transform`. All channels clip where the one of the smallest gain does: at
    the sensor's limit times that gain. So gains k times as large give an image k times as bright, clipped
    light included, and with a smallest gain below 1 overexposed white stays below 1.

    Monochrome camera_rgb `(h, w, 1)` passes through. Raises as `colour_transform`, also for bands.
    """
    sensor, developing = camera.sensor, camera.developing
    if sensor.pattern == "mono":
        return rgb
    gains, matrix = colour_transform(camera)
    if developing.white_balance is not None:
        rgb = rgb * gains.astype(np.float32)
        if developing.saturation:
            # After the gains, channels would clip at different light. Clipping all of them where the sensor
            # does, at full scale or, with a gain below 1, at the full well, keeps overexposed white neutral.
            rgb = np.minimum(rgb, np.float32(min(sensor.gain, 1.0) * gains.min()))
    return rgb if developing.colour_matrix is False else rgb @ matrix.T.astype(np.float32)


def colour_transform(camera: Camera) -> tuple[Array, Array]:
    """White balance gains `(3,)` and colour matrix `(3, 3)` in use: linear sRGB is `matrix @ (gains * rgb)`.

    Each is given by the camera's `developing`, or fitted to its reference light (see `reference_correction`);
    ones, or the identity, if the step is left out. Clipping is not included.

    Raises:
        ValueError: the sensor is monochrome or has bands, or the white balance needs a missing flash.
        InputError: the sensor cannot distinguish colours under the reference light.
    """
    _check_has_colours(camera)
    balance, choice = camera.developing.white_balance, camera.developing.colour_matrix
    if balance is None:
        gains = np.ones(3)
    elif isinstance(balance, str):
        # Not from the full correction, because light that shows no colours can be balanced too.
        gains = white_balance_gains(camera.sensor, reference_light(camera))
    else:
        gains = np.array(balance)
    gains = gains * np.array(camera.developing.white_balance_error)

    if isinstance(choice, bool):
        matrix = reference_correction(camera).matrix if choice else np.eye(3)
    else:
        matrix = np.array(choice)
    return gains, matrix.copy()


def add_pedestal(linear: Floats, camera: Camera) -> Floats:
    """`(h, w, c)` linear sRGB lifted by the camera's pedestal p: (linear + p) / (1 + p).

    Raises as `pedestal`.
    """
    offset = np.float32(pedestal(camera))
    return linear if offset == 0 else (linear + offset) / (np.float32(1) + offset)


def pedestal(camera: Camera) -> float:
    """The pedestal of the camera's `developing` as a number, a fraction of full scale.

    "auto" is `AUTO_PEDESTAL` times the largest standard deviation of red, green and blue of unlit pixels in
    linear sRGB, from read noise and the converter's rounding; at most `LARGEST_PEDESTAL`. It depends on the
    gain, but not on the light. Demosaiced pixels count as single photosites.

    Raises:
        ValueError, InputError: as `colour_transform`, if it is automatic and the sensor has colours.
    """
    sensor, developing = camera.sensor, camera.developing
    if developing.pedestal != "auto":
        return float(developing.pedestal)
    if sensor.pattern in ("mono", "bands"):
        return 0.0
    variance = sensor.read_noise_e**2 if developing.read_noise else 0.0
    variance += sensor.gain_e_per_dn**2 / 12.0 if developing.quantise else 0.0
    full_scale_e = sensor.gain_e_per_dn * (sensor.full_scale_dn - sensor.black_level_dn)
    gains, matrix = colour_transform(camera)
    of_pixels = np.square(matrix * gains) @ (variance / full_scale_e**2 / np.array(sensor.photosites))
    return min(AUTO_PEDESTAL * float(np.sqrt(of_pixels.max())), LARGEST_PEDESTAL)


def tone_curve(light: Array, curve: ToneCurveName | str | Points, gamma: float = GAMMA) -> Array:
    """Code in [0, 1] of linear light in [0, 1].

    "filmic" is the fit of Narkowicz (2015, "ACES filmic tone mapping curve", knarkowicz.wordpress.com) to the
    reference transform of the Academy Color Encoding System, scaled so that light 1 is white, and coded as
    sRGB: dark shade, bright lights, and a shoulder below white. A curve of points is linear between them.

    Raises:
        ValueError: the curve has another name.
    """
    if not isinstance(curve, str):
        x, y = np.array(curve).T
        return np.interp(light, x, y)
    if curve == "linear":
        return light
    if curve == "gamma":
        return np.asarray(light ** (1.0 / gamma))
    if curve == "filmic":
        return srgb_encode(_aces(_FILMIC_EXPOSURE * light) / _aces(np.array(_FILMIC_EXPOSURE)))
    if curve == "srgb":
        return srgb_encode(light)
    raise ValueError(f"there is no tone curve {curve!r}")


def _aces(x: Array) -> Array:
    return np.asarray(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14))


def s_curve(code: Array, strength: float) -> Array:
    """Codes in [0, 1], by a share `strength` of -1 to 1 on their way to 3x^2 - 2x^3; 0, 1/2 and 1 stay."""
    return np.asarray(code + strength * (code * code * (3.0 - 2.0 * code) - code))


def apply_tone(linear: Floats, isp: ImageProcessor, tone: ToneCurveName) -> Floats:
    """Codes in [0, 1] of linear values of any shape, clipped to [0, 1]; `tone` without a curve of its own."""
    curve = isp.tone_curve or tone
    table = _tone_table(curve, GAMMA if isp.gamma is None else isp.gamma, isp.contrast or 0.0)
    levels = np.clip(linear, np.float32(0), np.float32(1))
    levels *= np.float32(_LEVELS - 1)
    levels += np.float32(0.5)
    return table.take(levels.astype(np.uint16))


@lru_cache(maxsize=4)
def _tone_table(curve: ToneCurveName | str | Points, gamma: float, contrast: float) -> Floats:
    """`(65536,)` codes by light: a fifth of the time of powers."""
    light = np.arange(_LEVELS) / (_LEVELS - 1)
    return s_curve(tone_curve(light, curve, gamma), contrast).astype(np.float32)


def encode_tone(linear: Floats, tone: Tone = "srgb") -> NDArray[np.uint8]:
    """8-bit codes of linear values, clipped to [0, 1], by the sRGB curve or without a curve."""
    value = np.clip(linear, np.float32(0), np.float32(1))
    return np.rint((srgb_encode(value) if tone == "srgb" else value) * np.float32(255)).astype(np.uint8)


def decode_tone(codes: ArrayLike, tone: Tone = "srgb") -> Array:
    """Linear values in [0, 1] of codes of any shape; the inverse of `encode_tone`.

    Args:
        codes: 8-bit codes, or numbers between them (means of codes); values outside 0 to 255 are clipped.
        tone: the curve of the codes.
    """
    value = np.asarray(codes)
    if value.dtype == np.uint8:
        return _decode_table(tone)[value]
    value = np.clip(value.astype(np.float64) / 255.0, 0.0, 1.0)
    return srgb_decode(value) if tone == "srgb" else value


@lru_cache(maxsize=2)
def _decode_table(tone: Tone) -> Array:
    """`(256,)` linear values by code: far faster than one power per pixel."""
    return decode_tone(np.arange(256.0), tone)


def reference_correction(camera: Camera) -> ColourCorrection:
    """Gains and colour matrix of the camera under its `reference_light`, computed once per sensor and light.

    Numbers given in `developing` are ignored. Raises as `colour_transform`.
    """
    _check_has_colours(camera)
    return colour_correction(camera.sensor, reference_light(camera))


def reference_light(camera: Camera) -> Spectrum:
    """The light whose white the camera shows as white: that of the white balance.

    If the white balance names none, and for a sensor that is monochrome or has bands, it is the flash, or
    daylight (CIE D65) without a flash.

    Raises:
        ValueError: the white balance needs a missing flash or missing lamps.
    """
    has_colours = camera.sensor.pattern not in ("mono", "bands")
    balance = camera.developing.white_balance if has_colours else None
    if balance == "flash" and camera.flash is None:
        raise ValueError('white balance "flash" needs a flash; choose "daylight"')
    if balance == "lamps":
        if camera.lamp_light is None:
            raise ValueError('white balance "lamps" needs the spectrum of lamps; choose "daylight"')
        return camera.lamp_light
    return d65_spectrum() if balance == "daylight" or camera.flash is None else camera.flash.spectrum


def _check_has_colours(camera: Camera) -> None:
    _check_has_mosaic(camera)
    if camera.sensor.pattern == "mono":
        raise ValueError(f"{camera.sensor.name} is monochrome: it has no colours to correct")


def _check_has_mosaic(camera: Camera) -> None:
    """Whether the photosites make one image, of colours or of grey."""
    if camera.sensor.pattern == "bands":
        raise ValueError(
            f"{camera.sensor.name} has bands: it makes no colour image, but electrons of each band"
        )


def _check_electrons(electrons: ArrayLike, camera: Camera) -> NDArray[np.floating]:
    """Finite electrons of the image's shape."""
    expected, shape = np.asarray(electrons), (camera.height, camera.width, camera.sensor.channels)
    if expected.shape != shape:
        raise ValueError(f"electrons must have the shape {shape}, not {expected.shape}")
    if not all(np.isfinite(expected[rows]).all() for rows in row_strips(camera.width, camera.height)):
        raise ValueError("electrons must be finite")
    return expected
