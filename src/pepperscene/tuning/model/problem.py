"""A fit as a least-squares problem: what the data miss the model by, in units of what is expected.

Mean and spread of each kind's colour, measured spectra, and the bounds themselves are rows of one vector: the
bounds are distributions, and a value as far from its mean as its sd costs as much as a datum that is one sd
off (maximum a posteriori; Tarantola 2005, "Inverse problem theory", section 3.2).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.tuning.model.observables import NUMBERS, numbers, numbers_and_slopes
from pepperscene.tuning.model.view_model import Entry, ParameterStep, Values, ViewModel, entries_of

if TYPE_CHECKING:
    from pepperscene.tuning.model.reflectance import DirectModel
    from pepperscene.tuning.parameters.parameter import Parameter
    from pepperscene.tuning.parameters.tuned import TunedParts


Array = NDArray[np.float64]

_INSIDE: Final = 1e-6  # of a bound's width: where a start that lies on it begins


@dataclass(frozen=True, eq=False)
class NeighbourEffect:
    """What neighbours do to an organ's light and colours, as the whole scene shows it.

    Attributes:
        shade: `(c,)` electrons of the kind's pixels in the scene, in shares of those in the views.
        offset: `(8,)` what is left to add to the views' numbers after that.
    """

    shade: Array
    offset: Array


def alone() -> NeighbourEffect:
    """Organs without neighbours, or before the scene has been looked at."""
    return NeighbourEffect(np.ones(3), np.zeros(NUMBERS))


@dataclass(frozen=True, eq=False)
class Cell:
    """Patches that are compared with views.

    Attributes:
        label: the kind, or a single view's name.
        eyes: the views.
        target: `(8,)` numbers of the patches (see `observables.numbers`).
        sigma: `(8,)` by how much model and patches may differ.
        around: what neighbours do to the views' light and colours.
    """

    label: str
    eyes: tuple[ViewModel, ...]
    target: Array
    sigma: Array
    around: NeighbourEffect

    def linear(self, made: TunedParts) -> Array:
        """`(n, 3)` linear sRGB of all pixels of its views."""
        return np.concatenate([eye.linear(made, self.around.shade) for eye in self.eyes])

    def predicted(self, made: TunedParts) -> Array:
        """`(8,)` the model's numbers."""
        return numbers(self.linear(made)) + self.around.offset

    def slopes(self, made: TunedParts, moves: Sequence[ParameterStep]) -> Array:
        """`(8, p)` derivatives of `predicted` along moves."""
        parts = [eye.linear_and_slopes(made, moves, self.around.shade) for eye in self.eyes]
        linear = np.concatenate([linear for linear, _ in parts])
        return numbers_and_slopes(linear, np.concatenate([slope for _, slope in parts], axis=1))[1]


class FitProblem:
    """Residuals of data and bounds, and their derivatives, as functions of one vector.

    Args:
        parameters: that are fitted.
        tuned: the recipe's parts at some values.
        cells: what pictures tell.
        spectra: what measured reflectances tell, or None.

    Attributes:
        entries: the vector's numbers.
        low, high: `(p,)` their ends.
        data: how many independent data there are: the numbers of all cells, and what spectra are worth.
    """

    def __init__(
        self,
        parameters: Sequence[Parameter],
        tuned: Callable[[Values], TunedParts],
        cells: Sequence[Cell],
        spectra: DirectModel | None = None,
    ) -> None:
        self.parameters, self.cells, self.spectra = tuple(parameters), tuple(cells), spectra
        self.tuned = tuned
        self.entries = entries_of(parameters)
        laws = [one.parameter.prior[one.place] for one in self.entries]
        self.low = np.array([law.low for law in laws])
        self.high = np.array([law.high for law in laws])
        self.mean = np.array([law.mean for law in laws])
        self.sd = np.array([law.sd for law in laws])
        # Neighbouring wavelengths miss alike: a spectrum is worth fewer data than it has residuals.
        worth = 0 if spectra is None else round(spectra.independent)
        self.data = NUMBERS * len(self.cells) + worth

    @property
    def default(self) -> Array:
        """`(p,)` the recipe's own values."""
        return np.concatenate([one.default for one in self.parameters])

    def inside(self, vector: Array) -> Array:
        """The vector, moved off the ends of its bounds."""
        margin = _INSIDE * (self.high - self.low)
        return np.clip(vector, self.low + margin, self.high - margin)

    def values(self, vector: Array) -> dict[str, Array]:
        """A vector's numbers by parameter."""
        ends = np.cumsum([len(one.default) for one in self.parameters])[:-1]
        parts = np.split(np.asarray(vector, float), ends)
        return {one.name: part for one, part in zip(self.parameters, parts, strict=True)}

    def residuals(self, vector: Array) -> Array:
        """`(m + p,)` of the data, then of the bounds."""
        return np.concatenate([self.data_residuals(self.values(vector)), (vector - self.mean) / self.sd])

    def jacobian(self, vector: Array) -> Array:
        """`(m + p, p)` derivatives of `residuals`."""
        return np.vstack([self.data_jacobian(self.values(vector), self.entries), np.diag(1.0 / self.sd)])

    def data_residuals(self, values: Values) -> Array:
        """`(m,)` cell by cell, then of spectra."""
        made = self.tuned(values)
        rows = [(cell.predicted(made) - cell.target) / cell.sigma for cell in self.cells]
        if self.spectra is not None:
            rows.append(self.spectra.residuals(values))
        return np.concatenate(rows) if rows else np.zeros(0)

    def data_jacobian(self, values: Values, entries: Sequence[Entry]) -> Array:
        """`(m, p)` with respect to any entries."""
        made = self.tuned(values)
        moves = [ParameterStep.along(entry, values, self.tuned) for entry in entries] if self.cells else []
        rows = [cell.slopes(made, moves) / cell.sigma[:, None] for cell in self.cells]
        if self.spectra is not None:
            rows.append(self.spectra.jacobian(values, entries))
        return np.concatenate(rows) if rows else np.zeros((0, len(entries)))
