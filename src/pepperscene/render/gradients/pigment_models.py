"""How pigments make the body of a surface: the parameters, and the models that turn them into spectra."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.materials import Surface, cut_surface, leaf_body, rind_reflectance
from pepperscene.render.surface.tables import LEAST_ALPHA

if TYPE_CHECKING:
    from pepperscene.cultivar import Cultivar, PigmentPath


Array = NDArray[np.float64]
Values = Mapping[str, Array]

RANGES: Final[Mapping[str, tuple[float, float]]] = {
    "structure_n": (1.0, 4.0),
    "chlorophyll_ug_cm2": (0.0, np.inf),
    "carotenoid_ug_cm2": (0.0, np.inf),
    "capsanthin_ug_cm2": (0.0, np.inf),
    "anthocyanin_ug_cm2": (0.0, np.inf),
    "brown": (0.0, np.inf),
    "water_cm": (0.0, np.inf),
    "dry_matter_g_cm2": (0.0, np.inf),
    "flesh_reflectance": (0.0, 1.0 - 1e-9),
    "ior": (1.0, 2.5),
    "roughness": (LEAST_ALPHA, 1.0),
}
"""Smallest and largest value of a surface's parameters, as a cultivar's file allows them."""
CONTENTS: Final = tuple(RANGES)[:8]


@dataclass(frozen=True)
class GivenContents:
    """Stands for a pigment path whose contents are known at the very states that are asked for."""

    contents: Mapping[str, Array]
    flesh_reflectance: float | None
    ior: float
    roughness: tuple[float, float]

    def at(self, states: ArrayLike) -> dict[str, Array]:
        """The contents, whatever the states."""
        return dict(self.contents)


Model = Callable[["PigmentPath", Array, Array], tuple[Array, Array]]
"""(path, wavelengths `(n,)`, states `(s,)`) -> reflectance `(s, 2, n)` and transmittance `(s, n)`."""


@dataclass(frozen=True, eq=False)
class PigmentModel:
    """What a surface's spectra are made of.

    Attributes:
        path: name of the pigments, also that of the parameters.
        states: `(a,)` at which the model asks for contents.
        shares: `(a, k)` of each knot in the contents at each of these states.
        rows: `(s,)` which of these states a row of spectra depends on.
        model: makes the spectra.
    """

    path: str
    states: Array
    shares: Array
    rows: NDArray[np.intp]
    model: Model


def pigment_model(surface: Surface, cultivar: Cultivar | None) -> PigmentModel | None:
    """How the cultivar's pigments make the surface; None where they do not."""
    if cultivar is None:
        return None
    states = np.linspace(0.0, 1.0, len(surface.reflectance))
    if surface.name == "cut":
        # The rim of a scar is half of the stem's darkest rind: both rows follow from state 1.
        stem = cultivar.kinds[cultivar.stem.node].surface
        path, one = cultivar.pigments[stem], np.ones(1)
        return PigmentModel(stem, one, _shares(path, one), np.zeros(len(states), np.intp), _scar)
    if surface.name not in cultivar.pigments:
        return None
    path = cultivar.pigments[surface.name]
    forms = {kind.form for kind in cultivar.kinds.values() if kind.surface == surface.name}
    model = _leaf if forms & {"blade", "flower"} else _rind
    return PigmentModel(surface.name, states, _shares(path, states), np.arange(len(states)), model)


def _leaf(path: PigmentPath, nm: Array, states: Array) -> tuple[Array, Array]:
    above, below, through = leaf_body(path, nm, states)
    return np.stack([above, below], axis=1), through


def _rind(path: PigmentPath, nm: Array, states: Array) -> tuple[Array, Array]:
    rows = rind_reflectance(path, nm, states)
    return np.repeat(rows[:, None, :], 2, axis=1), np.zeros_like(rows)


def _scar(path: PigmentPath, nm: Array, states: Array) -> tuple[Array, Array]:
    # Its speckle is drawn with it, but is no part of the spectra.
    made = cut_surface(path, nm, np.random.default_rng(0))
    return made.reflectance, made.transmittance


def path_values(name: str, path: PigmentPath) -> dict[str, Array]:
    """A path's parameters: `(k,)` contents at its knots, its flesh if it has any, and its cuticle."""
    found = {
        f"{name}.{what}": np.array([getattr(pigments, what) for _, pigments in path.knots], float)
        for what in CONTENTS
    }
    if path.flesh_reflectance is not None:
        found[f"{name}.flesh_reflectance"] = np.array(float(path.flesh_reflectance))
    return found | {f"{name}.ior": np.array(float(path.ior)), f"{name}.roughness": np.array(path.roughness)}


def _shares(path: PigmentPath, states: Array) -> Array:
    """`(a, k)` of each knot in the contents at states: contents are linear between the knots."""
    knots = np.array([state for state, _ in path.knots])
    return np.stack([np.interp(states, knots, one) for one in np.eye(len(knots))], axis=1)


def contents_of(body: PigmentModel, values: Values) -> dict[str, Array]:
    """`(a,)` of each content at the states at which the body's model asks for it."""
    return {what: body.shares @ values[f"{body.path}.{what}"] for what in CONTENTS}
