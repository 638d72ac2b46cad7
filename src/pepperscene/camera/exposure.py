"""From light before the lens to electrons in the photosites."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera.camera import Camera


def relative_illumination(camera: Camera) -> NDArray[np.float64]:
    """`(h, w)` fall-off of the image towards the corners: cos^4 of the field angle, 1 on the axis.

    The natural vignetting of a thin lens; mechanical vignetting is not modelled, as no figure for the lens
    is known.
    """
    return np.asarray(camera.pixel_directions()[..., 2] ** 4)


def expected_electrons(signal: ArrayLike, camera: Camera) -> NDArray[np.float64]:
    """`(h, w, 3)` mean photo-electrons of a photosite of each colour, before noise and saturation.

    The camera equation: a lens of f-number N under the radiance L puts E = L pi / (4 N^2) T cos^4 on the
    sensor (far from its focal length); a photosite gathers it over its area and the exposure.

    Args:
        signal: `(h, w, 3)` integral of L(lambda) QE_c(lambda) lambda / (h c) over wavelength: photo-electrons
            per second, square metre and steradian; averaged over the exposure.
        camera: gives aperture, transmittance, exposure, pitch and fall-off.

    Raises:
        ValueError: the signal does not have the picture's shape.
    """
    light = np.asarray(signal, dtype=float)
    if light.shape != (camera.height, camera.width, 3):
        raise ValueError(f"a signal of {(camera.height, camera.width, 3)} is needed, not {light.shape}")
    lens, sensor = camera.lens, camera.sensor
    solid_angle = math.pi / (4 * lens.f_number**2)
    on_axis = sensor.pitch_m**2 * camera.exposure_s * solid_angle * lens.transmittance
    return light * (on_axis * relative_illumination(camera))[..., None]
