"""The camera equation: from the light in front of the lens to the mean electrons of an image's photosites.

Stray light (the point spread of diffraction and scatter, veiling glare and ghosts) is linear and moves light
without adding or losing any: what would leave the image is spread evenly, and its surroundings are taken to
be its mirror image, as nothing else is known of them. With mirrored borders, a convolution with a symmetric
point spread is a multiplication in the cosine transform (Martucci 1994, IEEE Trans. Signal Process. 42:1038),
so that no padding is needed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera.camera import Camera
from pepperscene.camera.optics.lens import StrayLight
from pepperscene.camera.sensor.rows import is_whole, row_strips

Array = NDArray[np.float64]
_NEAR: Final = 8
"""Pixels from the centre within which the point spread is integrated over pixels. Chosen: beyond, the value
at a pixel's centre differs from its mean by less than two hundredths."""
_ANGLES: Final = 24  # nodes of the integral over the angle
_PLACES: Final = 16
"""Nodes of the mean over the places of a point in its pixel. Chosen, as the angles: twice as many of both
change no pixel's share by more than 2e-3, for pixels of 1 to 20 um."""
_V_STEP: Final = 0.02  # of the Bessel functions' argument; chosen: linear interpolation is then exact to 3e-5
_GHOST_COLUMNS: Final = 96
"""Chosen: columns of the coarse image of ghosts, whose cells are smaller than their blur on most sensors."""


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
    """`(h, w, c)` the `expected_electrons` of an image, with the lens' blur and stray light if switched on.

    Those of a large image are in single precision, and take the place of the signal.

    Args:
        signal: as of `expected_electrons`; that of a large image is overwritten.
        camera: that takes the image.

    Raises:
        ValueError: as `expected_electrons`.
    """
    strips = row_strips(camera.width, camera.height)
    electrons: NDArray[Any] = signal
    if len(strips) == 1:
        electrons = expected_electrons(signal, camera)
    else:
        for rows in strips:
            signal[rows] = expected_electrons(signal[rows], camera, rows)
    return spread_light(electrons, camera)


def spread_light(electrons: NDArray[Any], camera: Camera) -> NDArray[Any]:
    """Expected electrons `(h, w, c)` with the blur and the stray light that are switched on.

    With mirrored borders, both keep the sum over the image. The array may be overwritten.
    """
    developing = camera.developing
    if developing.blur_px:
        from scipy.ndimage import gaussian_filter

        gaussian_filter(electrons, (developing.blur_px, developing.blur_px, 0.0), output=electrons)
    return add_stray_light(electrons, camera) if developing.stray_light else electrons


def stray_light_factor(camera: Camera) -> float:
    """What stray light leaves of a deviation that is independent from pixel to pixel; 1 if switched off.

    The root mean square of the factors on the image's frequencies (Parseval's theorem).
    """
    if not camera.developing.stray_light:
        return 1.0
    dtype = "float64" if is_whole(camera.width, camera.height) else "float32"
    transfer = _transfer(_optics(camera), (camera.height, camera.width), dtype)
    return math.sqrt(np.vdot(transfer, transfer) / transfer.size)


def near_point_spread(camera: Camera, reach: int) -> NDArray[np.floating]:
    """`(2 reach + 1, 2 reach + 1)` fraction of a pixel's light that stray light brings to those around it.

    All of it stays where it is if stray light is switched off.
    """
    if not camera.developing.stray_light:
        return np.pad(np.ones((1, 1)), reach)
    return _near_spread(_optics(camera), reach)


@lru_cache(maxsize=2)
def _near_spread(optics: tuple[StrayLight, float, float, float], reach: int) -> NDArray[np.floating]:
    """As `near_point_spread`; read-only, and shared by all frames of a camera."""
    quarter = point_spread(*optics, (reach, reach))
    distance = np.abs(np.arange(-reach, reach + 1))
    spread = quarter[distance[:, None], distance]
    spread.setflags(write=False)
    return spread


def add_stray_light(electrons: ArrayLike, camera: Camera) -> NDArray[np.floating]:
    """`(h, w, c)` expected electrons with the lens' stray light, which `developing.stray_light` switches on.

    The sum over the image is kept for each colour, and only ghosts change a uniform image. Labels do not
    depend on it: scattered light belongs to no object.

    A large image in single precision is computed in single precision, which is exact to a millionth of its
    root mean square, and overwritten.

    Args:
        electrons: `(h, w, c)` expected electrons of a photosite of each colour without stray light; values
            below 0 count as 0.
        camera: lens and sensor.
    """
    from scipy.fft import dctn, idctn

    image, stray = np.asarray(electrons), camera.lens.stray_light
    size = image.shape[0], image.shape[1]
    is_single = image.dtype == np.float32 and not is_whole(size[1], size[0])
    image = image if is_single else np.asarray(image, dtype=float)
    transfer = _transfer(_optics(camera), size, image.dtype.name)
    result = image if is_single else np.empty_like(image)
    for channel in range(image.shape[-1]):
        plane = np.maximum(image[..., channel], image.dtype.type(0.0))
        # Diffraction and scatter, with the image mirrored at its borders.
        frequencies = dctn(plane, type=2)
        frequencies *= transfer
        spread: NDArray[Any] = idctn(frequencies, type=2, overwrite_x=True)
        np.maximum(spread, 0.0, out=spread)
        if stray.ghosts:
            _add_ghosts(spread, plane, camera)
        # All remaining light is spread evenly: the veil, and what leaves the image.
        remaining = plane.sum(dtype=float) - spread.sum(dtype=float)
        np.add(spread, image.dtype.type(remaining / plane.size), out=result[..., channel])
    return result


def _optics(camera: Camera) -> tuple[StrayLight, float, float, float]:
    """What the point spread depends on, the first arguments of `point_spread`; by value, for its cache."""
    efficiency = camera.sensor.quantum_efficiency
    nm, sensitivity = efficiency.wavelength_nm, efficiency.values.sum(axis=0)
    # The mean wavelength of the photo-electrons of light with the same photons at all wavelengths.
    wavelength_m = float(np.trapezoid(nm * sensitivity, nm) / np.trapezoid(sensitivity, nm)) * 1e-9
    return camera.lens.stray_light, camera.lens.f_number, camera.sensor.pixel_pitch_m, wavelength_m


@lru_cache(maxsize=2)
def _transfer(
    optics: tuple[StrayLight, float, float, float], shape: tuple[int, int], dtype: str
) -> NDArray[np.floating]:
    """`(h, w)` factors on the image's cosine transform; read-only, and shared by all frames of a camera."""
    from scipy.fft import dctn

    spread = point_spread(*optics, shape, dtype)
    factors = np.ascontiguousarray(dctn(spread, type=1, overwrite_x=True)[: shape[0], : shape[1]])
    factors.setflags(write=False)
    return factors


def point_spread(
    stray: StrayLight,
    f_number: float,
    pitch_m: float,
    wavelength_m: float,
    shape: tuple[int, int],
    dtype: str = "float64",
) -> NDArray[np.floating]:
    """`(h + 1, w + 1)` fraction of a pixel's light in the pixels at 0 to h rows and 0 to w columns from it.

    Diffraction and scatter, without veil and ghosts. The light is uniform within its pixel.
    """
    from scipy.special import j0, j1

    direct = 1.0 - stray.scatter - stray.veil - sum(ghost.fraction for ghost in stray.ghosts)
    cutoff = 1.0 / (f_number * wavelength_m)  # spatial frequency at which diffraction ends
    width, exponent = stray.scatter_width_m, stray.scatter_exponent

    # Far pixels: the density at their centres; of the Airy pattern without its rings, narrower than a pixel.
    spread = np.empty((shape[0] + 1, shape[1] + 1), dtype)
    for part in row_strips(shape[1] + 1, shape[0] + 1):
        row, column = np.ogrid[part, : shape[1] + 1]
        radius = np.maximum(np.hypot(row, column), 1.0) * pitch_m
        density = (exponent - 1.0) / (np.pi * width**2) * (1.0 + (radius / width) ** 2) ** -exponent
        spread[part] = (stray.scatter * density + direct / (np.pi**3 * cutoff * radius**3)) * pitch_m**2

    # Rayleigh's integral of the Airy pattern, tabulated because Bessel functions are slow.
    v = np.arange(0.0, np.pi * cutoff * 1.5 * (_NEAR + 2) * pitch_m + _V_STEP, _V_STEP)
    airy = 1.0 - j0(v) ** 2 - j1(v) ** 2

    def encircled(radius_m: Array) -> Array:
        """Fraction of a point's light within a radius."""
        scattered = 1.0 - (1.0 + (radius_m / width) ** 2) ** (1.0 - exponent)
        return np.asarray(direct * np.interp(np.pi * cutoff * radius_m, v, airy) + stray.scatter * scattered)

    # Near pixels: their light, averaged over the places of the point in its pixel.
    # The light in a pixel is a difference of four quadrants' light, signed by the side of the point.
    near = slice(min(_NEAR, shape[0]) + 1), slice(min(_NEAR, shape[1]) + 1)
    places, weights = np.polynomial.legendre.leggauss(_PLACES)
    rows, columns = ((np.arange(part.stop + 1) - 0.5 - places[:, None] / 2) * pitch_m for part in near)
    quadrants = _light_in_rectangles(encircled, np.abs(rows).ravel(), np.abs(columns).ravel())
    quadrants *= np.sign(rows).ravel()[:, None] * np.sign(columns).ravel()
    pixels = np.diff(np.diff(quadrants.reshape(*rows.shape, *columns.shape), axis=1), axis=3)
    spread[near] = np.einsum("i,j,injm->nm", weights / 2, weights / 2, pixels)
    return spread


def _light_in_rectangles(encircled: Callable[[Array], Array], down: Array, right: Array) -> Array:
    """`(n, m)` fraction of a point's light in rectangles from the point to `down` `(n,)`, `right` `(m,)`.

    `encircled` is the fraction within a radius.
    """
    nodes, weights = np.polynomial.legendre.leggauss(_ANGLES)
    height, width = down[:, None, None], right[None, :, None]
    corner = np.arctan2(height, width)
    total = np.zeros((len(down), len(right)))
    # Two triangles, each with an edge of the rectangle across its angles.
    for limit, length in ((corner, width), (np.pi / 2 - corner, height)):
        light = encircled(length / np.cos(limit * (1.0 + nodes) / 2.0))
        total += light @ weights * limit[..., 0] / 2.0
    return total / (2.0 * np.pi)


def _add_ghosts(spread: NDArray[np.floating], plane: NDArray[np.floating], camera: Camera) -> None:
    """Add the light of all ghosts, `(h, w)`: the image scaled about the optical axis and blurred.

    Light outside the image is lost. Ghosts are computed on a coarse grid, because they have no details.
    """
    cell = max(-(-plane.shape[1] // _GHOST_COLUMNS), 1)
    # The last cells can be smaller.
    rows, columns = (np.append(np.arange(0, size, cell), size) for size in plane.shape)
    coarse = np.add.reduceat(np.add.reduceat(plane, rows[:-1], axis=0, dtype=float), columns[:-1], axis=1)
    centre_column, centre_row = camera.intrinsics[:2, 2]
    total = np.zeros_like(coarse)
    for ghost in camera.lens.stray_light.ghosts:
        down = _scaled_cells(rows, centre_row, ghost.magnification)
        right = _scaled_cells(columns, centre_column, ghost.magnification)
        # A blur of twice the image's size is even already.
        radius = ghost.radius_m / (camera.sensor.pixel_pitch_m * cell)
        disc = _disc(min(radius, 2.0 * max(coarse.shape)))
        # Small matrices: with BLAS, starting its threads would take most of the time.
        scaled = np.einsum("ij,jk->ik", np.einsum("ij,jk->ik", down, coarse), right.T)
        # `scipy.ndimage.convolve` reads beyond an image that is smaller than the disc.
        reflected = np.pad(scaled, len(disc) // 2, mode="symmetric")
        total += ghost.fraction * np.maximum(convolve_inside(reflected, disc), 0.0)
    density = total / (np.diff(rows)[:, None] * np.diff(columns))

    def ghosts(part: slice) -> Array:
        return _interpolate(_interpolate(density, rows, 0, part), columns, 1)

    first, *others = row_strips(plane.shape[1], plane.shape[0])
    fine = ghosts(first)
    # Interpolation keeps the sum only approximately.
    interpolated = fine.sum() + sum(ghosts(part).sum() for part in others)
    scale = total.sum() / max(interpolated, np.finfo(float).tiny)
    spread[first] += fine * scale
    for part in others:
        spread[part] += ghosts(part) * scale


def convolve_inside(image: Array, weights: Array) -> Array:
    """The convolution of an image with square weights `(n, n)`, where these are inside it.

    The bits of `scipy.signal.fftconvolve(image, weights, mode="valid")`, whose import takes a second of the
    first frame.
    """
    from scipy.fft import irfftn, next_fast_len, rfftn

    if len(weights) == 1:
        return image * weights
    rows, columns = image.shape
    last = len(weights) - 1
    size = [next_fast_len(length + last, real=True) for length in (rows, columns)]
    result = irfftn(rfftn(image, size) * rfftn(weights, size), size)
    return np.asarray(result[last:rows, last:columns].copy())


def _scaled_cells(edges: NDArray[np.intp], centre: float, scale: float) -> Array:
    """`(n, n)` fraction of each cell's light (columns) in each cell (rows) after scaling about `centre`."""
    ends = centre + scale * (edges - centre)
    low, high = np.minimum(ends[:-1], ends[1:]), np.maximum(ends[:-1], ends[1:])
    overlap = np.minimum(high, edges[1:, None]) - np.maximum(low, edges[:-1, None])
    return np.asarray(np.maximum(overlap, 0.0) / (high - low))


def _interpolate(cells: Array, edges: NDArray[np.intp], axis: int, part: slice = slice(None)) -> Array:
    """Values at pixels along an axis, linear between the centres of cells and constant at the borders.

    `part` are some of the pixels.
    """
    centres = (edges[:-1] + edges[1:]) / 2.0
    place = np.interp(np.arange(edges[-1])[part] + 0.5, centres, np.arange(len(centres)))
    lower = np.minimum(place.astype(np.intp), max(len(centres) - 2, 0))
    weight = (place - lower)[:, None] if axis == 0 else place - lower
    values = np.diff(cells, axis=axis, append=cells.take([-1], axis)).take(lower, axis)
    values *= weight
    values += cells.take(lower, axis)
    return values


def _disc(radius: float) -> Array:
    """`(2 n + 1, 2 n + 1)` weights of a uniform disc of a radius in cells, their sum is 1."""
    reach = int(np.ceil(radius))
    offsets = (np.arange(-reach - 0.5, reach + 0.5, 0.25) + 0.125)[: 4 * (2 * reach + 1)]
    inside = (np.hypot(offsets[:, None], offsets) <= max(radius, 0.5)).astype(float)
    cells = inside.reshape(2 * reach + 1, 4, 2 * reach + 1, 4).sum(axis=(1, 3))
    return np.asarray(cells / cells.sum())
