"""Parts of a recipe at values of a fit's parameters, as smooth functions of these values.

Moving organs along a pigment path changes the shape of the path between its knots. Paths are therefore given
more knots first, which do not change their contents. The knots stay the same for all values, since the
renderer differentiates with respect to the contents at the knots.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera import Camera, Flash, colour_transform
from pepperscene.cultivar import Cultivar, PigmentPath, Pigments
from pepperscene.spectra import Spectrum, illuminance
from pepperscene.tuning.pigment_paths import state_distribution, tuned_path

Array = NDArray[np.float64]
STEPS: Final = 20
"""Even intervals between knots. Chosen: organs of a kind differ by twice as much, a tenth of the path."""
_MIN_KNOT_DISTANCE: Final = 0.4 / STEPS  # from the path's own knots; a closer one would gain nothing
MIDDLE_NM, WARMTH_NM, GREEN_NM = 550.0, 150.0, 50.0
"""Chosen: a warmth of 1 multiplies 700 nm by e and divides 400 nm by e, relative to the middle; between black
bodies of 6500 K and 3000 K is a warmth of 1.4. The green is about as wide as a camera's green channel."""
OFF_DIAGONAL: Final = ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))
"""Entries of the colour matrix that are fitted."""
_DIGITS: Final = 12
"""Significant digits of numbers in files. Chosen: six more than any fit determines, and few enough that the
last one does not depend on rounding in sums."""


@dataclass(frozen=True, eq=False)
class TunedParts:
    """Parts of a recipe at parameter values.

    Exposure is a factor on the sensor gain; without a flash, on the exposure time.
    """

    pigments: Mapping[str, PigmentPath]  # of surfaces with parameters among the values, on dense knots
    flash_power: float  # factor on the power of the flash
    flash_nodes_nm: Array  # (m,)
    flash_factors: Array  # (m,) factors on the flash spectrum at the nodes, linear in between
    exposure: float
    gains: Array  # (3,) white balance in use
    matrix: Array  # (3, 3) colour matrix in use, applied after the gains


def tuned_parts(
    cultivar: Cultivar, camera: Camera, values: Mapping[str, ArrayLike], nodes_nm: ArrayLike = ()
) -> TunedParts:
    """Return the parts of a recipe at parameter values; parameters without a value keep the recipe's.

    Args:
        cultivar: Cultivar of the recipe, with its own knots or dense ones.
        camera: Camera of the recipe.
        values: Parameter values by name; wrong shapes raise a ValueError.
        nodes_nm: `(m,)` wavelengths of the renderer's factors on the flash spectrum.
    """
    pigments = {
        surface: tuned_path(surface, densify_path(path), state_distribution(cultivar, surface), values)
        for surface, path in cultivar.pigments.items()
        if any(name.startswith(f"{surface}.") for name in values)
    }
    gains, matrix = colour_steps(camera, values)
    return TunedParts(
        pigments=pigments,
        flash_power=_scalar(values, "flash.power"),
        flash_nodes_nm=np.array(nodes_nm, float),
        flash_factors=flash_factors(values, nodes_nm),
        exposure=_scalar(values, "exposure"),
        gains=gains,
        matrix=matrix,
    )


def _scalar(values: Mapping[str, ArrayLike], name: str) -> float:
    """A factor; 1 if it is not among the values."""
    (value,) = np.asarray(values.get(name, 1.0), dtype=float).ravel()
    return float(value)


def densify_cultivar(cultivar: Cultivar) -> Cultivar:
    """The same cultivar with more knots on its pigment paths; contents are unchanged everywhere."""
    paths = {name: densify_path(path) for name, path in cultivar.pigments.items()}
    return cultivar.model_copy(update={"pigments": paths})


def densify_path(path: PigmentPath) -> PigmentPath:
    """The same path with its own knots and evenly spaced ones, unless these are close to its own."""
    knots = dict(path.knots)
    known = np.array(list(knots))
    even = np.arange(1, STEPS) / STEPS
    added = [float(state) for state in even if np.abs(known - state).min() > _MIN_KNOT_DISTANCE]
    contents = path.at(added)
    knots |= {
        state: Pigments(**{field: float(contents[field][i]) for field in Pigments.model_fields})
        for i, state in enumerate(added)
    }
    between = tuple((state, knots[state]) for state in sorted(knots) if 0.0 < state < 1.0)
    return path.model_copy(update={"path": between})


def flash_factors(values: Mapping[str, ArrayLike], nodes_nm: ArrayLike) -> Array:
    """`(m,)` factors on the flash spectrum at the nodes: `flash.spectrum` times those of `flash.colour`.

    Without nodes (fits to reflectance spectra render no view) it is empty. Another number of factors than
    nodes raises a ValueError.
    """
    nm = np.asarray(nodes_nm, dtype=float)
    factors = np.ones(nm.size)
    if nm.size and "flash.spectrum" in values:
        factors = np.atleast_1d(np.asarray(values["flash.spectrum"], dtype=float))
        if factors.shape != nm.shape:
            raise ValueError(f"flash.spectrum has {factors.size} factors and the renderer {nm.size} nodes")
    if "flash.colour" in values:
        warmth, green = np.asarray(values["flash.colour"], dtype=float)
        offset = nm - MIDDLE_NM
        factors = factors * np.exp(warmth * offset / WARMTH_NM + green * np.exp(-((offset / GREEN_NM) ** 2)))
    return np.array(factors)


def tuned_spectrum(spectrum: Spectrum, nodes_nm: ArrayLike, factors: ArrayLike) -> Spectrum:
    """The spectrum times factors that are linear between nodes and constant beyond them.

    It is sampled at every whole nanometre, where the renderer reads it, and at the nodes of both.
    """
    low, high = spectrum.range_nm
    nodes = np.asarray(nodes_nm, float)
    whole_nm = np.arange(np.ceil(low), np.floor(high) + 1.0)
    nm = np.union1d(np.union1d(spectrum.wavelength_nm, whole_nm), nodes[(nodes >= low) & (nodes <= high)])
    # A wavelength that differs from a whole nanometre by rounding only would give a duplicate row.
    nm = np.unique(nm.round(6))
    factor = np.interp(nm, nodes, np.asarray(factors, float)) if nodes.size else np.ones(nm.size)
    extended = Spectrum(spectrum.wavelength_nm, spectrum.values, "hold")
    values = np.array([round_for_file(value) for value in extended.at(nm) * factor])
    return Spectrum(nm, values, spectrum.outside)


def tuned_flash(flash: Flash, parts: TunedParts) -> Flash:
    """The flash with its tuned spectrum and power; its illuminance or irradiance follows."""
    spectrum = tuned_spectrum(flash.spectrum, parts.flash_nodes_nm, parts.flash_factors)
    if flash.illuminance_lx is not None:
        factor = parts.flash_power * illuminance(spectrum) / illuminance(flash.spectrum)
        return replace(flash, spectrum=spectrum, illuminance_lx=flash.illuminance_lx * factor)
    assert flash.irradiance_W_m2 is not None  # exactly one is given
    factor = parts.flash_power * float(spectrum.integral()) / float(flash.spectrum.integral())
    return replace(flash, spectrum=spectrum, irradiance_W_m2=flash.irradiance_W_m2 * factor)


def colour_steps(camera: Camera, values: Mapping[str, ArrayLike] | None = None) -> tuple[Array, Array]:
    """White balance gains `(3,)` and colour matrix `(3, 3)`; ones and the identity for a monochrome sensor.

    The camera's own are those of its reference light. They do not change if the flash is tuned.
    """
    if camera.sensor.channels == 1:
        return np.ones(3), np.eye(3)
    given = {} if values is None else values
    gains, matrix = (np.array(array, float) for array in colour_transform(camera))
    if "white_balance" in given:
        red, blue = np.asarray(given["white_balance"], dtype=float)
        gains = gains * np.array([red, 1.0, blue])
    if "colour_matrix" in given:
        entries = np.asarray(given["colour_matrix"], dtype=float)
        for (row, column), entry in zip(OFF_DIAGONAL, entries, strict=True):
            # The row's sum, and so white, is kept; the recipe's own entries give its own matrix to rounding.
            matrix[row, row] += matrix[row, column] - entry
            matrix[row, column] = entry
    return gains, matrix


def tuned_camera(camera: Camera, parts: TunedParts) -> Camera:
    """The camera with tuned flash, exposure, white balance and colour matrix."""
    red, green, blue = parts.gains.tolist()
    red_row, green_row, blue_row = (tuple(row) for row in parts.matrix.tolist())
    developing = replace(
        camera.developing, white_balance=(red, green, blue), colour_matrix=(red_row, green_row, blue_row)
    )
    developed = replace(camera, developing=developing)
    if camera.flash is None:
        return replace(developed, exposure_s=camera.exposure_s * parts.exposure)
    sensor = camera.sensor.with_settings(gain=camera.sensor.gain * parts.exposure)
    return replace(developed, flash=tuned_flash(camera.flash, parts), sensor=sensor)


def round_for_file(value: float) -> float:
    """A number with the significant digits that files state."""
    return float(f"{float(value):.{_DIGITS}g}")
