"""A recipe's parts at some values of a fit's parameters: smooth functions of them.

A path's shape between its knots is what a change of state makes anew, so paths are given more knots first, at
which it says nothing else than before. They stay the same whatever the values, as the renderer's derivatives
are those by contents at the knots.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.cultivar import PigmentPath, Pigments
from pepperscene.tuning.parameters.camera import colour_steps_at, flash_factors
from pepperscene.tuning.parameters.surface import path_at, state_law

if TYPE_CHECKING:
    from pepperscene.camera import Camera
    from pepperscene.cultivar import Cultivar


Array = NDArray[np.float64]

STEPS: Final = 20
"""Even steps between knots. Chosen: a twentieth of the path is half of what organs of a kind differ by."""
NEAREST: Final = 0.4 / STEPS
"""No knot is put closer to one of the path's own: nothing would be gained."""


@dataclass(frozen=True, eq=False)
class TunedParts:
    """A recipe's parts at some values.

    Attributes:
        pigments: of the surfaces that have parameters among the values, on dense knots.
        flash_power: factor on the flash's light.
        flash_nodes_nm: `(m,)` wavelengths.
        flash_spectrum: `(m,)` factors on its spectrum there, linear in between.
        exposure: factor on the sensor's gain; without a flash, on the exposure time.
        gains: `(3,)` white balance in use.
        matrix: `(3, 3)` colour matrix in use, behind the gains.
    """

    pigments: Mapping[str, PigmentPath]
    flash_power: float
    flash_nodes_nm: Array
    flash_spectrum: Array
    exposure: float
    gains: Array
    matrix: Array


def tuned_parts(
    cultivar: Cultivar, camera: Camera, values: Mapping[str, ArrayLike], nodes_nm: ArrayLike = ()
) -> TunedParts:
    """The parts at these values; what has none among them is the recipe's own.

    Args:
        cultivar: the recipe's, with its own knots or dense ones.
        camera: the recipe's.
        values: of parameters by their names, as `select_parameters` gives them.
        nodes_nm: `(m,)` where the renderer takes factors of the flash's spectrum.

    Raises:
        ValueError: a value has the wrong shape or lies where there are no such plants.
    """
    pigments = {
        surface: path_at(surface, dense_path(path), state_law(cultivar, surface), values)
        for surface, path in cultivar.pigments.items()
        if any(name.startswith(f"{surface}.") for name in values)
    }
    gains, matrix = colour_steps_at(camera, values)
    return TunedParts(
        pigments=pigments,
        flash_power=_single(values, "flash.power"),
        flash_nodes_nm=np.array(nodes_nm, float),
        flash_spectrum=flash_factors(values, nodes_nm),
        exposure=_single(values, "exposure"),
        gains=gains,
        matrix=matrix,
    )


def dense(cultivar: Cultivar, surfaces: Iterable[str]) -> Cultivar:
    """The same cultivar with more knots on the paths of some surfaces, and the same contents everywhere."""
    paths = {name: dense_path(cultivar.pigments[name]) for name in surfaces}
    return cultivar.model_copy(update={"pigments": {**cultivar.pigments, **paths}})


def dense_path(path: PigmentPath) -> PigmentPath:
    """The same path with its own knots and further ones in between, at most `NEAREST` from even steps."""
    own = dict(path.knots)
    known = np.array(list(own))
    even = np.arange(1, STEPS) / STEPS
    further = [float(state) for state in even if np.abs(known - state).min() > NEAREST]
    contents = path.at(further)
    fields = Pigments.model_fields
    more = {
        state: Pigments(**{what: float(contents[what][i]) for what in fields})
        for i, state in enumerate(further)
    }
    every = own | more
    between = tuple((state, every[state]) for state in sorted(every) if 0.0 < state < 1.0)
    return path.model_copy(update={"path": between})


def _single(values: Mapping[str, ArrayLike], name: str) -> float:
    """A factor; 1 where it is not among the values."""
    (value,) = np.asarray(values.get(name, 1.0), dtype=float).ravel()
    return float(value)
