"""A fit as a least-squares problem: residuals of data and priors, in standard deviations.

The rows are the observables of each group of patches, the measured spectra, and the parameters themselves. A
parameter that is one prior standard deviation from its mean costs as much as a datum that is one standard
deviation off (maximum a posteriori; Tarantola 2005, "Inverse problem theory", section 3.2).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.tuning.bounds import Parameter
from pepperscene.tuning.observables import OBSERVABLE_COUNT, observables, observables_and_derivatives
from pepperscene.tuning.reflectance import DirectModel
from pepperscene.tuning.tuned import TunedParts
from pepperscene.tuning.view_model import Entry, ParameterStep, Values, ViewModel, entries_of

Array = NDArray[np.float64]
_MARGIN: Final = 1e-6  # chosen: fraction of a bound's width by which starts are moved off the bounds


@dataclass(frozen=True, eq=False)
class NeighbourEffect:
    """Effect of neighbouring organs on an organ's light and colour, measured in the whole scene."""

    shade: Array  # (c,) electrons of the kind's pixels in the scene relative to those in the views
    offset: Array  # (8,) what then remains to be added to the observables of the views


NO_NEIGHBOURS: Final = NeighbourEffect(np.ones(3), np.zeros(OBSERVABLE_COUNT))


@dataclass(frozen=True, eq=False)
class Observation:
    """Observables of a group of patches, and the views that they are compared with."""

    label: str  # the kind of organ, or the name of a single view
    view_models: tuple[ViewModel, ...]
    target: Array  # (8,) observables of the patches
    sigma: Array  # (8,) standard deviations of the difference between model and patches
    neighbours: NeighbourEffect

    def linear(self, parts: TunedParts) -> Array:
        """`(n, 3)` linear sRGB of all pixels of the views."""
        return np.concatenate(
            [view_model.linear(parts, self.neighbours.shade) for view_model in self.view_models]
        )

    def predicted(self, parts: TunedParts) -> Array:
        """`(8,)` observables of the model."""
        return observables(self.linear(parts)) + self.neighbours.offset

    def derivatives(self, parts: TunedParts, steps: Sequence[ParameterStep]) -> Array:
        """`(8, p)` derivatives of `predicted` along steps."""
        shade = self.neighbours.shade
        pixels = [view_model.linear_and_derivatives(parts, steps, shade) for view_model in self.view_models]
        linear = np.concatenate([linear for linear, _ in pixels])
        derivatives = np.concatenate([derivatives for _, derivatives in pixels], axis=1)
        return observables_and_derivatives(linear, derivatives)[1]


class FitProblem:
    """Residuals and their derivatives as functions of the vector of all entries.

    Args:
        parameters: The parameters to fit.
        tuned_parts: Returns the recipe's parts at values.
        observations: Observables of patches in images.
        direct_model: Model of measured reflectances, or None.

    Attributes:
        entries: Entries of the vector.
        low, high, mean, sd: `(p,)` of their prior distributions.
        data_count: Number of independent data in observations and spectra.
    """

    def __init__(
        self,
        parameters: Sequence[Parameter],
        tuned_parts: Callable[[Values], TunedParts],
        observations: Sequence[Observation],
        direct_model: DirectModel | None = None,
    ) -> None:
        self.parameters, self.observations = tuple(parameters), tuple(observations)
        self.tuned_parts, self.direct_model = tuned_parts, direct_model
        self.entries = entries_of(parameters)
        priors = [entry.prior for entry in self.entries]
        self.low = np.array([prior.low for prior in priors])
        self.high = np.array([prior.high for prior in priors])
        self.mean = np.array([prior.mean for prior in priors])
        self.sd = np.array([prior.sd for prior in priors])
        # Residuals at neighbouring wavelengths are correlated: a spectrum has fewer data than residuals.
        independent = 0 if direct_model is None else round(direct_model.independent)
        self.data_count = OBSERVABLE_COUNT * len(self.observations) + independent

    @property
    def default(self) -> Array:
        """`(p,)` values of the recipe."""
        return np.concatenate([parameter.default for parameter in self.parameters])

    def inside(self, vector: Array) -> Array:
        """The vector, moved off the ends of its bounds."""
        margin = _MARGIN * (self.high - self.low)
        return np.clip(vector, self.low + margin, self.high - margin)

    def values(self, vector: Array) -> dict[str, Array]:
        """Values of a vector by parameter."""
        ends = np.cumsum([len(parameter.default) for parameter in self.parameters])[:-1]
        parts = np.split(np.asarray(vector, float), ends)
        return {parameter.name: part for parameter, part in zip(self.parameters, parts, strict=True)}

    def residuals(self, vector: Array) -> Array:
        """`(m + p,)` residuals of the data, then of the priors."""
        return np.concatenate([self.data_residuals(self.values(vector)), (vector - self.mean) / self.sd])

    def jacobian(self, vector: Array) -> Array:
        """`(m + p, p)` derivatives of `residuals`."""
        return np.vstack([self.data_jacobian(self.values(vector), self.entries), np.diag(1.0 / self.sd)])

    def data_residuals(self, values: Values) -> Array:
        """`(m,)` residuals of the observations, then of the spectra."""
        parts = self.tuned_parts(values)
        rows = [
            (observation.predicted(parts) - observation.target) / observation.sigma
            for observation in self.observations
        ]
        if self.direct_model is not None:
            rows.append(self.direct_model.residuals(values))
        return np.concatenate(rows) if rows else np.zeros(0)

    def data_jacobian(self, values: Values, entries: Sequence[Entry]) -> Array:
        """`(m, p)` derivatives of `data_residuals` with respect to any entries."""
        parts, steps = self.tuned_parts(values), []
        if self.observations:
            steps = [ParameterStep.along(entry, values, self.tuned_parts) for entry in entries]
        rows = [
            observation.derivatives(parts, steps) / observation.sigma[:, None]
            for observation in self.observations
        ]
        if self.direct_model is not None:
            rows.append(self.direct_model.jacobian(values, entries))
        return np.concatenate(rows) if rows else np.zeros((0, len(entries)))
