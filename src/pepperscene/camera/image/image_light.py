"""The camera equation: from the light in front of the lens to the mean electrons of an image's photosites."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera.camera import Camera
from pepperscene.camera.image.glare import add_stray_light
from pepperscene.camera.sensor.row_strips import row_strips


def relative_illumination(camera: Camera, rows: slice = slice(None)) -> NDArray[np.float64]:
    """`(h, w)` fall-off towards the image corners, 1 on the axis; 1 everywhere if it is switched off.

    Of some `rows` `(n, w)`, if they are given.

    Natural times mechanical vignetting. Seen at the field angle theta, the pupil is smaller by cos(theta),
    and a pixel receives light from a solid angle that is smaller by cos^3(theta), but larger where the
    distortion contracts the image: cos^4(theta) over the distortion's scale of areas, so that all light that
    enters the pupil reaches the sensor (M. Reiss, "The cos^4 law of illumination", J. Opt. Soc. Am. 35 (1945)
    283). The lens' own table is multiplied with it.
    """
    directions = camera.pixel_directions(rows)
    if not camera.developing.falloff:
        return np.ones(directions.shape[:2])
    cosine = directions[..., 2]
    relative = cosine**4
    distortion = camera.lens.distortion
    if not distortion.is_zero:
        relative = relative / distortion.area_scale(directions[..., :2] / cosine[..., None])
    if camera.lens.vignetting is not None:
        relative = relative * camera.lens.vignetting.at(np.arccos(np.minimum(cosine, 1.0)))
    return np.asarray(relative)


def expected_electrons(signal: ArrayLike, camera: Camera, rows: slice = slice(None)) -> NDArray[np.float64]:
    """`(h, w, c)` mean photo-electrons of a photosite of each colour, before noise and saturation.

    The camera equation: under the radiance L, a lens of f-number N gives the irradiance E = L pi / (4 N^2) T
    in the middle of the sensor (far from its focal length), and less towards the corners; a photosite
    integrates it over its area and the exposure. A lens that stretches the image, fy > fx, spreads the same
    light over a larger area.

    Args:
        signal: `(h, w, c)` integral of L(lambda) QE_c(lambda) lambda / (h c) over wavelength: photo-electrons
            per second, square metre and steradian, averaged over the exposure; by sensor channel.
        camera: aperture, transmittance, exposure, pitch and fall-off.
        rows: of the image, whose signal `(n, w, c)` is given; all by default.

    Raises:
        ValueError: the signal does not have the shape of the image, or of its rows.
    """
    light = np.asarray(signal, dtype=float)
    shape = (len(range(camera.height)[rows]), camera.width, camera.sensor.channels)
    if light.shape != shape:
        raise ValueError(f"a signal must have the shape {shape}, not {light.shape}")
    return light * electrons_per_light(camera, rows)[..., None]


def electrons_per_light(camera: Camera, rows: slice = slice(None)) -> NDArray[np.float64]:
    """`(h, w)` factor of each pixel from light to electrons; see `expected_electrons`.

    Of some `rows` `(n, w)`, if they are given.
    """
    lens, sensor = camera.lens, camera.sensor
    solid_angle = math.pi / (4 * lens.f_number**2) / lens.fy_over_fx
    on_axis = sensor.pitch_m**2 * camera.exposure_s * solid_angle * lens.transmittance
    return np.asarray(on_axis * relative_illumination(camera, rows))


def image_electrons(signal: NDArray[np.float32], camera: Camera) -> NDArray[Any]:
    """`(h, w, c)` the `expected_electrons` of an image, with the lens' stray light if that is switched on.

    Those of a large image are in single precision, and take the place of the signal.

    Args:
        signal: as of `expected_electrons`; that of a large image is overwritten.
        camera: that takes the image.

    Raises:
        ValueError: as `expected_electrons`.
    """
    strips = row_strips(camera.width, camera.height)
    if len(strips) == 1:
        electrons = expected_electrons(signal, camera)
        return add_stray_light(electrons, camera) if camera.developing.stray_light else electrons
    for rows in strips:
        signal[rows] = expected_electrons(signal[rows], camera, rows)
    return add_stray_light(signal, camera) if camera.developing.stray_light else signal
