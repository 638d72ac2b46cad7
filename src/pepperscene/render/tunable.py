"""What can be tuned in a picture, and the kernel's tables as functions of it, with their derivatives.

Between the parameters that a person tunes and the numbers that the kernel reads lie PROSPECT, the cuticles'
openness, and the integrals over wavelength of light that meets one surface. All of that is smooth NumPy in
double precision over few numbers, so its derivatives are taken by differences there, far below single
precision, and the kernel's own derivatives (`pepperscene.render.gradients`) are chained to them: rows of
spectra depend on the pigments at their own state alone, which two more spectra of each row tell for all knots
of a pigment at once, and the flash and the channels' integrals are bilinear.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.materials import Surface, cut_surface, leaf_body, rind_reflectance
from pepperscene.render.tables import LEAST_ALPHA, cuticle_tables, spectra_rows

if TYPE_CHECKING:
    from pepperscene.cultivar import Cultivar, PigmentPath

Array = NDArray[np.float64]
Parameters = Mapping[str, ArrayLike]
Values = Mapping[str, Array]
Part = tuple[Array, Array, Array]
"""Of one surface: `(s, n, 4)` rows of spectra, `(2, 4)` sides and `(2, NODES, 2)` openness."""

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

_STEPS: Final[Mapping[str, float]] = {
    "water_cm": 1e-2,
    "dry_matter_g_cm2": 1e-2,
    "brown": 1e-1,
    "flesh_reflectance": 1e-1,
}
"""Amounts at which a content begins to count, 1 for others: differences step by 1e-5 of that, or of the
content where it is larger. Truncation and rounding are then both near 1e-10 of a spectrum."""
_STEP, _ROUGHNESS_STEP = 1e-5, 1e-3
"""Shares of a value by which differences step. The openness of a cuticle is a quadrature with kinks where a
node's mirror direction sets at the horizon: over a thousandth of the roughness they level out."""
_AGREEMENT: Final = 1e-6  # largest difference to the scene's spectra; both come out of the same functions


@dataclass(frozen=True)
class _Contents:
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
class _Body:
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


class Tunable:
    """The parameters of a scene's surfaces, and the surfaces' tables as functions of them.

    Args:
        surfaces: of the scene, in its order.
        cultivar: whose pigments made them; None offers cuticles alone.
        grid_nm: `(n,)` of the packed spectra.

    Attributes:
        defaults: every parameter at the value that the surfaces have.

    Raises:
        ValueError: a surface of that name is not what the cultivar's pigments make.
    """

    def __init__(self, surfaces: tuple[Surface, ...], cultivar: Cultivar | None, grid_nm: Array) -> None:
        self.surfaces, self.grid_nm = surfaces, grid_nm
        self.defaults: dict[str, Array] = {}
        self._bodies = [_body(surface, cultivar) for surface in surfaces]
        self._known: list[dict[tuple[tuple[str, bytes], ...], Part]] = [{} for _ in surfaces]
        for body in self._bodies:
            if body is not None and cultivar is not None:
                self.defaults |= _path_values(body.path, cultivar.pigments[body.path])
        for surface, body in zip(surfaces, self._bodies, strict=True):
            if surface.ior > 1.0 and (body is None or body.path != surface.name):
                self.defaults[f"{surface.name}.ior"] = np.array(float(surface.ior))
                self.defaults[f"{surface.name}.roughness"] = np.array(surface.roughness, float)
        for i, surface in enumerate(surfaces):
            made = self._surface(i, self.defaults)
            if max(
                np.abs(made.reflectance - surface.reflectance).max(),
                np.abs(made.transmittance - surface.transmittance).max(),
            ) > _AGREEMENT or (made.ior, made.roughness) != (surface.ior, surface.roughness):
                raise ValueError(f"the surface {surface.name} is not what this cultivar's pigments make")

    def parts(self, values: Values) -> list[Part]:
        """The tables of all surfaces in double precision."""
        return [self._part(i, values) for i in range(len(self.surfaces))]

    def forward(self, values: Values, direction: Values) -> list[Part]:
        """How the tables change along a direction of the parameters."""
        found = [tuple(np.zeros_like(table) for table in part) for part in self.parts(values)]
        for name, along in direction.items():
            for i, slopes, shares in self._slopes(values, name):
                for table, slope in zip(found[i], slopes, strict=False):
                    table += _weighted(slope, shares, along)
        return cast("list[Part]", found)

    def backward(self, values: Values, cotangents: list[Part], names: tuple[str, ...]) -> dict[str, Array]:
        """Derivatives of a number with respect to parameters, from those with respect to the tables."""
        found = {name: np.zeros_like(values[name]) for name in names}
        for name in names:
            for i, slopes, shares in self._slopes(values, name):
                for cotangent, slope in zip(cotangents[i], slopes, strict=False):
                    found[name] += _gathered(slope, shares, cotangent).reshape(found[name].shape)
        return found

    # --- one surface ------------------------------------------------------------------------------------

    def _part(self, i: int, values: Values) -> Part:
        """The tables of surface `i`, kept until its own parameters change."""
        body, name = self._bodies[i], self.surfaces[i].name
        own = (name, body.path) if body is not None else (name,)
        key = tuple((n, values[n].tobytes()) for n in self.defaults if n.rpartition(".")[0] in own)
        if key not in self._known[i]:
            surface = self._surface(i, values)
            self._known[i] = {key: (spectra_rows(surface, self.grid_nm), *cuticle_tables(surface))}
        return self._known[i][key]

    def _surface(self, i: int, values: Values, contents: Mapping[str, Array] | None = None) -> Surface:
        """Surface `i` at these parameters, with other contents at the model's states if they are given."""
        surface, body = self.surfaces[i], self._bodies[i]
        if f"{surface.name}.ior" in values:
            front, back = np.asarray(values[f"{surface.name}.roughness"]).tolist()
            ior = float(values[f"{surface.name}.ior"])
            surface = replace(surface, ior=ior, roughness=(front, back))
        if body is None:
            return surface
        given = _contents(body, values) if contents is None else contents
        front, back = np.asarray(values[f"{body.path}.roughness"]).tolist()
        flesh = values.get(f"{body.path}.flesh_reflectance")
        path = _Contents(
            given, None if flesh is None else float(flesh), float(values[f"{body.path}.ior"]), (front, back)
        )
        reflectance, transmittance = body.model(cast("PigmentPath", path), surface.wavelength_nm, body.states)
        return replace(surface, reflectance=reflectance, transmittance=transmittance)

    def _slopes(self, values: Values, name: str) -> Iterator[tuple[int, tuple[Array, ...], Array | None]]:
        """Surfaces that a parameter changes, their tables' slopes, and the shares of its entries in each row.

        The parameter's entries are a pigment's knots, with shares `(s, k)` of them in each row of spectra,
        the only table to have slopes; or the two sides' roughness or a single number, each with slopes of its
        own on a leading axis, and no shares.
        """
        whose, _, what = name.rpartition(".")
        for i, (surface, body) in enumerate(zip(self.surfaces, self._bodies, strict=True)):
            made_of = body is not None and body.path == whose
            if what in CONTENTS and made_of:
                assert body is not None
                yield i, (self._content_slopes(i, body, values, what),), body.shares[body.rows]
            elif what not in CONTENTS and (made_of or surface.name == whose):
                value = values[name]
                entries = [self._entry_slopes(i, values, name, k) for k in range(value.size)]
                yield i, tuple(np.stack(tables) for tables in zip(*entries, strict=True)), None

    def _content_slopes(self, i: int, body: _Body, values: Values, what: str) -> Array:
        """`(s, n, 4)` of the spectra, each row by the content at the state that it depends on."""
        contents = _contents(body, values)
        scale = np.maximum(np.abs(contents[what]), _STEPS.get(what, 1.0))
        first, second = _moves(contents[what], _STEP * scale, *RANGES[what])

        def rows(move: Array | float) -> Array:
            moved = {**contents, what: contents[what] + move}
            return spectra_rows(self._surface(i, values, moved), self.grid_nm)

        return _slope(rows(0.0), rows(first), rows(second), first[body.rows], second[body.rows])

    def _entry_slopes(self, i: int, values: Values, name: str, entry: int) -> tuple[Array, ...]:
        """Of all three tables by one number of a parameter."""
        what, value = name.rpartition(".")[2], float(values[name].flat[entry])
        scale = max(value, _STEPS.get(what, 1.0))
        step = _ROUGHNESS_STEP * value if what == "roughness" else _STEP * scale
        first, second = _moves(np.array([value]), np.array([step]), *RANGES[what])

        def at(move: float) -> Part:
            moved = values[name].copy()
            moved.flat[entry] += move
            surface = self._surface(i, {**values, name: moved})
            return spectra_rows(surface, self.grid_nm), *cuticle_tables(surface)

        tables = zip(at(0.0), at(float(first[0])), at(float(second[0])), strict=True)
        return tuple(_slope(*three, first, second) for three in tables)


def _body(surface: Surface, cultivar: Cultivar | None) -> _Body | None:
    """How the cultivar's pigments make the surface; None where they do not."""
    if cultivar is None:
        return None
    states = np.linspace(0.0, 1.0, len(surface.reflectance))
    if surface.name == "cut":
        # The rim of a scar is half of the stem's darkest rind: both rows follow from state 1.
        stem = cultivar.kinds[cultivar.stem.node].surface
        path, one = cultivar.pigments[stem], np.ones(1)
        return _Body(stem, one, _shares(path, one), np.zeros(len(states), np.intp), _scar)
    if surface.name not in cultivar.pigments:
        return None
    path = cultivar.pigments[surface.name]
    forms = {kind.form for kind in cultivar.kinds.values() if kind.surface == surface.name}
    model = _leaf if forms & {"blade", "flower"} else _rind
    return _Body(surface.name, states, _shares(path, states), np.arange(len(states)), model)


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


def _path_values(name: str, path: PigmentPath) -> dict[str, Array]:
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


def _contents(body: _Body, values: Values) -> dict[str, Array]:
    return {what: body.shares @ values[f"{body.path}.{what}"] for what in CONTENTS}


# --- differences ----------------------------------------------------------------------------------------


def _moves(value: Array, step: Array, low: float, high: float) -> tuple[Array, Array]:
    """Two moves from each value: one step up and one down, or two to the side where there is room."""
    first = np.where(value + step > high, -step, step)
    second = np.where(value - step < low, 2.0 * step, np.where(value + step > high, -2.0 * step, -step))
    return first, second


def _slope(here: Array, there: Array, beyond: Array, first: Array, second: Array) -> Array:
    """The slope at `here` of the parabola through values at no move, at the first and at the second."""
    shape = (-1,) + (1,) * (here.ndim - 1)
    a, b = first.reshape(shape), second.reshape(shape)
    return np.asarray((there - here) * b / (a * (b - a)) - (beyond - here) * a / (b * (b - a)))


def _weighted(slope: Array, shares: Array | None, along: Array) -> Array:
    """A table's change along a direction: by rows where there are shares of knots, else by entries."""
    if shares is None:
        return np.tensordot(along.ravel(), slope, axes=1)
    return slope * (shares @ along)[:, None, None]


def _gathered(slope: Array, shares: Array | None, cotangent: Array) -> Array:
    """The transpose of `_weighted`."""
    if shares is None:
        return np.tensordot(slope, cotangent, axes=cotangent.ndim)
    return np.asarray(np.einsum("sni,sni->s", slope, cotangent) @ shares)
