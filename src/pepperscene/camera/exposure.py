"""From light before the lens to electrons in the photosites."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera.camera import Camera


def relative_illumination(camera: Camera) -> NDArray[np.float64]:
    """`(h, w)` fall-off of the image towards the corners, 1 on the axis; 1 everywhere if it is switched off.

    Natural times mechanical vignetting. Seen at the field angle theta, the pupil is smaller by cos(theta),
    and a pixel takes in a solid angle that is smaller by cos^3(theta), but larger where the distortion draws
    the picture together: cos^4(theta) over the distortion's scale of areas, so that all light that falls
    into the pupil arrives on the sensor (M. Reiss, "The cos^4 law of illumination", J. Opt. Soc. Am. 35
    (1945) 283). The lens' own table comes on top.
    """
    directions = camera.pixel_directions()
    if not camera.developing.falloff:
        return np.ones(directions.shape[:2])
    cosine = directions[..., 2]
    relative = cosine**4
    distortion = camera.lens.distortion
    if not distortion.is_none:
        relative = relative / distortion.area_scale(directions[..., :2] / cosine[..., None])
    if camera.lens.vignetting is not None:
        relative = relative * camera.lens.vignetting.at(np.arccos(np.minimum(cosine, 1.0)))
    return np.asarray(relative)


def expected_electrons(signal: ArrayLike, camera: Camera) -> NDArray[np.float64]:
    """`(h, w, c)` mean photo-electrons of a photosite of each colour, before noise and saturation.

    The camera equation: a lens of f-number N under the radiance L puts E = L pi / (4 N^2) T on the middle of
    the sensor (far from its focal length), and less towards the corners; a photosite gathers it over its area
    and the exposure.

    Args:
        signal: `(h, w, c)` integral of L(lambda) QE_c(lambda) lambda / (h c) over wavelength: photo-electrons
            per second, square metre and steradian; averaged over the exposure. As many channels as the
            sensor has.
        camera: gives aperture, transmittance, exposure, pitch and fall-off.

    Raises:
        ValueError: the signal does not have the picture's shape.
    """
    light = np.asarray(signal, dtype=float)
    lens, sensor = camera.lens, camera.sensor
    shape = (camera.height, camera.width, len(sensor.quantum_efficiency.values))
    if light.shape != shape:
        raise ValueError(f"a signal of {shape} is needed, not {light.shape}")
    solid_angle = math.pi / (4 * lens.f_number**2)
    on_axis = sensor.pitch_m**2 * camera.exposure_s * solid_angle * lens.transmittance
    return light * (on_axis * relative_illumination(camera))[..., None]
