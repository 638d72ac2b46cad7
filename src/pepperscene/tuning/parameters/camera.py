"""The parameters of light and camera: what a recipe has of them, and what values make of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.render.gradients.renderer import FLASH_WEIGHTS
from pepperscene.tuning.parameters.tunables import Tunables

if TYPE_CHECKING:
    from pepperscene.camera import Camera


Array = NDArray[np.float64]

MIDDLE_NM: Final = 550.0
WARMTH_NM: Final = 150.0
GREEN_NM: Final = 50.0
"""Chosen: a warmth of 1 makes 700 nm e times as strong as the middle and 400 nm as weak; between black bodies
of 6500 K and 3000 K lies a warmth of 1.4. The green is about as wide as a camera's green channel."""

OFF_DIAGONAL: Final = ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))
_COLOURS: Final = ("red", "green", "blue")
_ENTRIES: Final = tuple(f"{_COLOURS[row]}_from_{_COLOURS[column]}" for row, column in OFF_DIAGONAL)
_FACTORS: Final = (0.01, 100.0)  # chosen: seven stops to either side, as gains of a recipe may reach


def camera_side(camera: Camera) -> dict[str, Tunables]:
    """What can be fitted of the light and the camera: no flash's without one, no colours of a grey sensor."""
    found = []
    if camera.flash is not None:
        nodes = tuple(str(i + 1) for i in range(FLASH_WEIGHTS))
        found = [
            Tunables("flash.power", "", "factor on the flash's light", "light", np.ones(1), *_FACTORS),
            Tunables(
                "flash.colour", "", "exponents of the flash's spectrum", "light", np.zeros(2), -5.0, 5.0,
                labels=("warmth", "green"),
            ),
            Tunables(
                "flash.spectrum", "", "factors on the flash's spectrum at even wavelengths", "light",
                np.ones(FLASH_WEIGHTS), *_FACTORS, labels=nodes,
            ),
        ]  # fmt: skip
    found.append(
        Tunables(
            "exposure",
            "",
            "factor on the sensor's gain; without a flash, on the exposure time",
            "exposure",
            np.ones(1),
            *_FACTORS,
        )
    )
    if camera.sensor.channels > 1:
        _, matrix = _colour_steps(camera)
        own = np.array([matrix[at] for at in OFF_DIAGONAL])
        found += [
            Tunables(
                "white_balance", "", "factors on the gains of red and blue", "camera", np.ones(2), *_FACTORS,
                labels=("red", "blue"),
            ),
            Tunables(
                "colour_matrix", "", "off-diagonal entries; the rows' sums stay", "camera", own, -20.0, 20.0,
                labels=_ENTRIES,
            ),
        ]  # fmt: skip
    return {one.name: one for one in found}


def flash_factors(values: Mapping[str, ArrayLike], nodes_nm: ArrayLike) -> Array:
    """`(m,)` factors on the flash's spectrum at the nodes: those of `flash.spectrum` times `flash.colour`'s.

    Without nodes, as of measured spectra that no flash has lit, there are none.

    Raises:
        ValueError: `flash.spectrum` has another number of factors than there are nodes.
    """
    nm = np.asarray(nodes_nm, dtype=float)
    factors = np.ones(nm.size)
    if nm.size and "flash.spectrum" in values:
        factors = np.atleast_1d(np.asarray(values["flash.spectrum"], dtype=float))
        if factors.shape != nm.shape:
            raise ValueError(f"flash.spectrum has {factors.size} factors and the renderer {nm.size} nodes")
    if "flash.colour" in values:
        warmth, green = np.asarray(values["flash.colour"], dtype=float)
        off = nm - MIDDLE_NM
        factors = factors * np.exp(warmth * off / WARMTH_NM + green * np.exp(-((off / GREEN_NM) ** 2)))
    return np.array(factors)


def colour_steps_at(camera: Camera, values: Mapping[str, ArrayLike]) -> tuple[Array, Array]:
    """White balance gains `(3,)` and colour matrix `(3, 3)`; ones and the identity for a grey sensor.

    The recipe's own are those of its reference light, and stay so if the flash is tuned: what a fit finds is
    told in numbers.
    """
    if camera.sensor.channels == 1:
        return np.ones(3), np.eye(3)
    gains, matrix = _colour_steps(camera)
    if "white_balance" in values:
        red, blue = np.asarray(values["white_balance"], dtype=float)
        gains = gains * np.array([red, 1.0, blue])
    if "colour_matrix" in values:
        sums = matrix.sum(axis=1)
        asked = np.asarray(values["colour_matrix"], dtype=float)
        for at, entry in zip(OFF_DIAGONAL, asked, strict=True):
            matrix[at[0], at[0]] += matrix[at] - entry
            matrix[at] = entry
        # Written so, the recipe's own entries give its own matrix back, to rounding; white stays white.
        assert np.allclose(matrix.sum(axis=1), sums)
    return gains, matrix


def _colour_steps(camera: Camera) -> tuple[Array, Array]:
    from pepperscene.camera import colour_transform

    gains, matrix = colour_transform(camera)
    return np.array(gains, float), np.array(matrix, float)
