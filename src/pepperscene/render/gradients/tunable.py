"""Surface tables as functions of the tunable parameters, with their derivatives.

Between the parameters and the numbers that the kernel reads are PROSPECT, the openness of the cuticles, and
integrals over wavelength of light that meets one surface. All of that is smooth NumPy code in double
precision on few numbers, so its derivatives are taken by finite differences, with errors far below single
precision, and the kernel's own derivatives (`gradients.renderer`) are chained to them. Rows of spectra depend
on the pigments at their own state alone, so two more spectra of each row give the derivatives by all knots of
a pigment at once; the flash and the channel integrals are bilinear.

`PigmentModel` is the model from pigments to a surface's spectra.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Final, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.materials import Surface, cut_surface, leaf_body, rind_reflectance
from pepperscene.render.surface.tables import MIN_ALPHA, cuticle_tables, narrowest_alpha, spectra_rows

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
    if surface.name not in cultivar.pigments or surface.name in cultivar.spectra:
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


Parameters = Mapping[str, ArrayLike]
SurfaceTables = tuple[Array, Array, Array]
"""Of one surface: `(s, n, 4)` rows of spectra, and sides and openness as of `cuticle_tables`."""

_SCALES: Final[Mapping[str, float]] = {
    "water_cm": 1e-2,
    "dry_matter_g_cm2": 1e-2,
    "brown": 1e-1,
    "flesh_reflectance": 1e-1,
}
"""Amounts at which a content has an effect, 1 for others: difference steps are 1e-5 of that, or of a larger
content. Truncation and rounding errors are then both near 1e-10 of a spectrum."""
_STEP, _ROUGHNESS_STEP = 1e-5, 1e-3
"""Relative difference steps. The openness of a cuticle is a quadrature with kinks where the mirror direction
of a node reaches the horizon: over a thousandth of the roughness they average out."""
_TOLERANCE: Final = 1e-6  # largest difference to the scene's spectra; both come from the same functions


class Tunable:
    """The parameters of a scene's surfaces, and the surfaces' tables as functions of them.

    Args:
        surfaces: of the scene, in its order.
        cultivar: whose pigments made them; None offers cuticles alone.
        grid_nm: `(n,)` of the packed spectra.

    Attributes:
        defaults: every parameter at the value that the surfaces have.

    Raises:
        ValueError: a surface differs from what the cultivar's pigments make.
    """

    def __init__(self, surfaces: tuple[Surface, ...], cultivar: Cultivar | None, grid_nm: Array) -> None:
        self.surfaces, self.grid_nm = surfaces, grid_nm
        self.defaults: dict[str, Array] = {}
        self._models = [pigment_model(surface, cultivar) for surface in surfaces]
        self._cache: list[dict[tuple[tuple[str, bytes], ...], SurfaceTables]] = [{} for _ in surfaces]
        for model in self._models:
            if model is not None and cultivar is not None:
                self.defaults |= path_values(model.path, cultivar.pigments[model.path])
        for surface, model in zip(surfaces, self._models, strict=True):
            if surface.ior > 1.0 and (model is None or model.path != surface.name):
                self.defaults[f"{surface.name}.ior"] = np.array(float(surface.ior))
                self.defaults[f"{surface.name}.roughness"] = np.array(surface.roughness, float)
        for i, surface in enumerate(surfaces):
            modelled = self._surface(i, self.defaults)
            if max(
                np.abs(modelled.reflectance - surface.reflectance).max(),
                np.abs(modelled.transmittance - surface.transmittance).max(),
            ) > _TOLERANCE or (modelled.ior, modelled.roughness) != (surface.ior, surface.roughness):
                raise ValueError(f"the surface {surface.name} is not what this cultivar's pigments make")

    def tables(self, values: Values) -> list[SurfaceTables]:
        """The tables of all surfaces in double precision."""
        return [self._surface_tables(i, values) for i in range(len(self.surfaces))]

    def forward(self, values: Values, direction: Values) -> list[SurfaceTables]:
        """Derivatives of the tables along a direction of the parameters."""
        result = [tuple(np.zeros_like(table) for table in tables) for tables in self.tables(values)]
        for name, along in direction.items():
            for i, slopes, weights in self._slopes(values, name):
                for table, slope in zip(result[i], slopes, strict=False):
                    table += _apply_slope(slope, weights, along)
        return cast("list[SurfaceTables]", result)

    def backward(
        self, values: Values, cotangents: list[SurfaceTables], names: tuple[str, ...]
    ) -> dict[str, Array]:
        """Derivatives of a number with respect to parameters, from those with respect to the tables."""
        result = {name: np.zeros_like(values[name]) for name in names}
        for name in names:
            for i, slopes, weights in self._slopes(values, name):
                for cotangent, slope in zip(cotangents[i], slopes, strict=False):
                    result[name] += _apply_transpose(slope, weights, cotangent).reshape(result[name].shape)
        return result

    # --- one surface ------------------------------------------------------------------------------------

    def _surface_tables(self, i: int, values: Values) -> SurfaceTables:
        """The tables of surface `i`, cached until its own parameters change."""
        model, name = self._models[i], self.surfaces[i].name
        prefixes = (name, model.path) if model is not None else (name,)
        key = tuple((n, values[n].tobytes()) for n in self.defaults if n.rpartition(".")[0] in prefixes)
        if key not in self._cache[i]:
            surface = self._surface(i, values)
            self._cache[i] = {key: (spectra_rows(surface, self.grid_nm), *self._cuticle(i, surface))}
        return self._cache[i][key]

    def _cuticle(self, i: int, surface: Surface) -> tuple[Array, Array]:
        """Tables of a changed surface `i`; slope variances are looked up as in those of the original one."""
        return cuticle_tables(surface, narrowest_alpha(self.surfaces[i]))

    def _surface(self, i: int, values: Values, contents: Mapping[str, Array] | None = None) -> Surface:
        """Surface `i` at parameter values, or with other contents at the model's states."""
        surface, model = self.surfaces[i], self._models[i]
        if f"{surface.name}.ior" in values:
            front, back = np.asarray(values[f"{surface.name}.roughness"]).tolist()
            ior = float(values[f"{surface.name}.ior"])
            surface = replace(surface, ior=ior, roughness=(front, back))
        if model is None:
            return surface
        contents = model.contents(values) if contents is None else contents
        front, back = np.asarray(values[f"{model.path}.roughness"]).tolist()
        flesh = values.get(f"{model.path}.flesh_reflectance")
        # Replaces a pigment path: it has these contents at the model's states.
        path = SimpleNamespace(
            at=lambda states: dict(contents),
            flesh_reflectance=None if flesh is None else float(flesh),
            ior=float(values[f"{model.path}.ior"]),
            roughness=(front, back),
            wide_roughness=surface.wide_roughness,
            wide_share=surface.wide_share,
        )
        model_path = cast("PigmentPath", path)
        reflectance, transmittance = model.model(model_path, surface.wavelength_nm, model.states)
        return replace(surface, reflectance=reflectance, transmittance=transmittance)

    def _slopes(self, values: Values, name: str) -> Iterator[tuple[int, tuple[Array, ...], Array | None]]:
        """Surfaces that a parameter changes, the slopes of their tables, and the weights of its entries.

        A pigment's entries are knots: they change the spectra alone, each row with weights `(s, k)`. Entries
        of other parameters have slopes of all tables, on a leading axis, and the weights are None.
        """
        owner, _, quantity = name.rpartition(".")
        for i, (surface, model) in enumerate(zip(self.surfaces, self._models, strict=True)):
            is_modelled = model is not None and model.path == owner
            if quantity in CONTENTS and is_modelled:
                assert model is not None
                yield i, (self._content_slopes(i, model, values, quantity),), model.knot_weights[model.rows]
            elif quantity not in CONTENTS and (is_modelled or surface.name == owner):
                entries = [self._entry_slopes(i, values, name, k) for k in range(values[name].size)]
                yield i, tuple(np.stack(tables) for tables in zip(*entries, strict=True)), None

    def _content_slopes(self, i: int, model: PigmentModel, values: Values, content: str) -> Array:
        """`(s, n, 4)` derivatives of the spectra, each row by the content at the state it depends on."""
        contents = model.contents(values)
        scale = np.maximum(np.abs(contents[content]), _SCALES.get(content, 1.0))
        first, second = _steps(contents[content], _STEP * scale, *RANGES[content])

        def rows(step: Array | float) -> Array:
            changed = {**contents, content: contents[content] + step}
            return spectra_rows(self._surface(i, values, changed), self.grid_nm)

        return _parabola_slope(rows(0.0), rows(first), rows(second), first[model.rows], second[model.rows])

    def _entry_slopes(self, i: int, values: Values, name: str, entry: int) -> tuple[Array, ...]:
        """Derivatives of all three tables by one entry of a parameter."""
        quantity, value = name.rpartition(".")[2], float(values[name].flat[entry])
        scale = max(value, _SCALES.get(quantity, 1.0))
        step = _ROUGHNESS_STEP * value if quantity == "roughness" else _STEP * scale
        first, second = _steps(np.array([value]), np.array([step]), *RANGES[quantity])

        def tables(step: float) -> SurfaceTables:
            changed = values[name].copy()
            changed.flat[entry] += step
            surface = self._surface(i, {**values, name: changed})
            return spectra_rows(surface, self.grid_nm), *self._cuticle(i, surface)

        at_steps = zip(tables(0.0), tables(float(first[0])), tables(float(second[0])), strict=True)
        return tuple(_parabola_slope(*three, first, second) for three in at_steps)


def _steps(value: Array, step: Array, low: float, high: float) -> tuple[Array, Array]:
    """Two difference steps from each value: one up and one down, or two to the side that is in range."""
    first = np.where(value + step > high, -step, step)
    second = np.where(value - step < low, 2.0 * step, np.where(value + step > high, -2.0 * step, -step))
    return first, second


def _parabola_slope(at_0: Array, at_first: Array, at_second: Array, first: Array, second: Array) -> Array:
    """The slope at step 0 of the parabola through the values at steps 0, `first` and `second`."""
    shape = (-1,) + (1,) * (at_0.ndim - 1)
    a, b = first.reshape(shape), second.reshape(shape)
    return np.asarray((at_first - at_0) * b / (a * (b - a)) - (at_second - at_0) * a / (b * (b - a)))


def _apply_slope(slope: Array, weights: Array | None, along: Array) -> Array:
    """A table's change along a direction: by rows with weights of knots, else by entries."""
    if weights is None:
        return np.tensordot(along.ravel(), slope, axes=1)
    return slope * (weights @ along)[:, None, None]


def _apply_transpose(slope: Array, weights: Array | None, cotangent: Array) -> Array:
    """The transpose of `_apply_slope`."""
    if weights is None:
        return np.tensordot(slope, cotangent, axes=cotangent.ndim)
    return np.asarray(np.einsum("sni,sni->s", slope, cotangent) @ weights)
