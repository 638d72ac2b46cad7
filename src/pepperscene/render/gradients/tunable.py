"""What can be tuned in a picture, and the kernel's tables as functions of it, with their derivatives.

Between the parameters that a person tunes and the numbers that the kernel reads lie PROSPECT, the cuticles'
openness, and the integrals over wavelength of light that meets one surface. All of that is smooth NumPy in
double precision over few numbers, so its derivatives are taken by differences there, far below single
precision, and the kernel's own derivatives (`gradients.renderer`) are chained to them: rows of
spectra depend on the pigments at their own state alone, which two more spectra of each row tell for all knots
of a pigment at once, and the flash and the channels' integrals are bilinear.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Final, cast

import numpy as np
from numpy.typing import ArrayLike

from pepperscene.materials import Surface
from pepperscene.render.gradients.pigment_models import (
    CONTENTS,
    RANGES,
    Array,
    GivenContents,
    PigmentModel,
    Values,
    contents_of,
    path_values,
    pigment_model,
)
from pepperscene.render.surface.tables import cuticle_tables, spectra_rows

if TYPE_CHECKING:
    from pepperscene.cultivar import Cultivar, PigmentPath


Parameters = Mapping[str, ArrayLike]
Part = tuple[Array, Array, Array]
"""Of one surface: `(s, n, 4)` rows of spectra, `(2, 4)` sides and `(2, NODES, 2)` openness."""

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
        self._bodies = [pigment_model(surface, cultivar) for surface in surfaces]
        self._known: list[dict[tuple[tuple[str, bytes], ...], Part]] = [{} for _ in surfaces]
        for body in self._bodies:
            if body is not None and cultivar is not None:
                self.defaults |= path_values(body.path, cultivar.pigments[body.path])
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
        given = contents_of(body, values) if contents is None else contents
        front, back = np.asarray(values[f"{body.path}.roughness"]).tolist()
        flesh = values.get(f"{body.path}.flesh_reflectance")
        path = GivenContents(
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

    def _content_slopes(self, i: int, body: PigmentModel, values: Values, what: str) -> Array:
        """`(s, n, 4)` of the spectra, each row by the content at the state that it depends on."""
        contents = contents_of(body, values)
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
