"""Models from pigments to a surface's spectra, and their parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.materials import Surface, cut_surface, leaf_body, rind_reflectance
from pepperscene.render.surface.cuticle import MIN_ALPHA

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
    "roughness": (MIN_ALPHA, 1.0),
}
"""Smallest and largest value of a surface's parameters, as a cultivar file allows them."""
CONTENTS: Final = tuple(RANGES)[:8]


SpectralModel = Callable[["PigmentPath", Array, Array], tuple[Array, Array]]
"""(path, wavelengths `(n,)`, states `(s,)`) -> reflectance `(s, 2, n)` and transmittance `(s, n)`."""


@dataclass(frozen=True, eq=False)
class PigmentModel:
    """The model behind a surface's spectra."""

    path: str  # name of the pigment path, and prefix of the parameters
    states: Array  # `(a,)` at which the model needs contents
    knot_weights: Array  # `(a, k)` of the path's knots in the contents at each of these states
    rows: NDArray[np.intp]  # `(s,)` which of these states each row of spectra depends on
    model: SpectralModel  # from contents to spectra

    def contents(self, values: Values) -> dict[str, Array]:
        """`(a,)` of each content at the model's states."""
        return {name: self.knot_weights @ values[f"{self.path}.{name}"] for name in CONTENTS}


def pigment_model(surface: Surface, cultivar: Cultivar | None) -> PigmentModel | None:
    """Find the model that makes a surface out of a cultivar's pigments; None if there is none."""
    if cultivar is None:
        return None
    states = np.linspace(surface.first_state, 1.0, len(surface.reflectance))
    if surface.name == "cut":
        # Half of a scar's rim is the stem's darkest rind: both rows depend on state 1.
        stem = cultivar.kinds[cultivar.stem.node].surface
        path, last = cultivar.pigments[stem], np.ones(1)
        return PigmentModel(stem, last, _knot_weights(path, last), np.zeros(len(states), np.intp), _scar)
    if surface.name not in cultivar.pigments:
        return None
    path = cultivar.pigments[surface.name]
    forms = {kind.form for kind in cultivar.kinds.values() if kind.surface == surface.name}
    model = _leaf if forms & {"blade", "flower"} else _rind
    return PigmentModel(surface.name, states, _knot_weights(path, states), np.arange(len(states)), model)


def _leaf(path: PigmentPath, nm: Array, states: Array) -> tuple[Array, Array]:
    upper, lower, through = leaf_body(path, nm, states)
    return np.stack([upper, lower], axis=1), through


def _rind(path: PigmentPath, nm: Array, states: Array) -> tuple[Array, Array]:
    rows = rind_reflectance(path, nm, states)
    return np.repeat(rows[:, None, :], 2, axis=1), np.zeros_like(rows)


def _scar(path: PigmentPath, nm: Array, states: Array) -> tuple[Array, Array]:
    # The generator draws its speckle, which is not part of the spectra.
    surface = cut_surface(path, nm, np.random.default_rng(0))
    return surface.reflectance, surface.transmittance


def path_values(name: str, path: PigmentPath) -> dict[str, Array]:
    """Parameters of a path: `(k,)` contents at its knots, its flesh if it has any, and its cuticle."""
    values = {
        f"{name}.{content}": np.array([getattr(pigments, content) for _, pigments in path.knots], float)
        for content in CONTENTS
    }
    if path.flesh_reflectance is not None:
        values[f"{name}.flesh_reflectance"] = np.array(float(path.flesh_reflectance))
    return values | {f"{name}.ior": np.array(float(path.ior)), f"{name}.roughness": np.array(path.roughness)}


def _knot_weights(path: PigmentPath, states: Array) -> Array:
    """`(a, k)` weights of the knots in the contents at states, which are linear between knots."""
    knots = np.array([state for state, _ in path.knots])
    return np.stack([np.interp(states, knots, hat) for hat in np.eye(len(knots))], axis=1)
