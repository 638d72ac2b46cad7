"""From electrons to the photograph: read-out, white balance, colour matrix, tone curve."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera.camera import Camera
from pepperscene.camera.correction import Correction, correction, daylight
from pepperscene.camera.readout import Floats, read_out
from pepperscene.camera.steps import Tone


def develop(
    electrons: ArrayLike, camera: Camera, rng: np.random.Generator | None = None
) -> NDArray[np.uint8]:
    """The photograph, `(h, w, 3)` uint8.

    Args:
        electrons: `(h, w, 3)` expected electrons of a photosite of each colour; below 0 (a denoiser's
            undershoot) counts as 0.
        camera: its sensor, flash and `developing` say how.
        rng: draws the noise; None leaves it out.

    Raises:
        ValueError: the electrons have the wrong shape or are not finite, or the white balance asks for a
            flash that is not there.
    """
    return encode(corrected(camera_rgb(electrons, camera, rng), camera), camera.developing.tone)


def camera_rgb(electrons: ArrayLike, camera: Camera, rng: np.random.Generator | None = None) -> Floats:
    """`(h, w, 3)` linear device colour after the read-out: black is 0, a full well 1.

    Raises:
        ValueError: as `develop`.
    """
    expected = np.asarray(electrons)
    if expected.shape != (camera.height, camera.width, 3):
        raise ValueError(f"electrons of {(camera.height, camera.width, 3)} are needed, not {expected.shape}")
    if not np.isfinite(expected).all():
        raise ValueError("electrons must be finite")
    sensor, choice = camera.sensor, camera.developing
    number = read_out(np.maximum(expected, 0.0), sensor, rng if choice.noise else None, choice.quantise)
    return (number - np.float32(sensor.black_level_dn)) / np.float32(
        sensor.full_scale_dn - sensor.black_level_dn
    )


def corrected(rgb: Floats, camera: Camera) -> Floats:
    """`(h, w, 3)` linear sRGB of camera_rgb, as far as the camera's `developing` asks for; may leave [0, 1].

    Raises:
        ValueError: the white balance asks for a flash that is not there.
    """
    choice = camera.developing
    if choice.white_balance is None and not choice.colour_matrix:
        return rgb
    wanted = reference_correction(camera)
    # Channels clip at different lights once gained; clipping all at the smallest keeps blown-out white white.
    balanced = rgb if choice.white_balance is None else np.minimum(rgb * wanted.gains.astype(np.float32), 1)
    return balanced @ wanted.matrix.T.astype(np.float32) if choice.colour_matrix else balanced


def encode(linear: Floats, tone: Tone = "srgb") -> NDArray[np.uint8]:
    """8-bit codes of linear values, clipped to [0, 1]; the sRGB curve of IEC 61966-2-1, or none."""
    value = np.clip(linear, np.float32(0), np.float32(1))
    if tone == "srgb":
        toe = np.float32(12.92) * value
        value = np.where(
            value <= 0.0031308, toe, np.float32(1.055) * value ** np.float32(1 / 2.4) - np.float32(0.055)
        )
    return np.rint(value * np.float32(255)).astype(np.uint8)


def reference_correction(camera: Camera) -> Correction:
    """Gains and colour matrix of the camera under its reference light, worked out once per sensor and light.

    Without white balance the matrix is that of the flash, or of daylight where there is no flash.

    Raises:
        ValueError: the white balance asks for a flash that is not there.
    """
    choice = camera.developing.white_balance
    if choice == "flash" and camera.flash is None:
        raise ValueError('white balance "flash" needs a flash; choose "daylight"')
    if choice == "daylight" or camera.flash is None:
        return correction(camera.sensor, daylight())
    return correction(camera.sensor, camera.flash.spectrum)
