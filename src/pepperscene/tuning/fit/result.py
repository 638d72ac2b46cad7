"""What a fit found, and how sure it can be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pepperscene.tuning.parameters.parameter import Parameter
from pepperscene.tuning.parameters.tuned import TunedParts

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class KindFit:
    """One kind of organ, before and after.

    Attributes:
        target: CIELAB of the patches' mean colour, and the sd of their pixels in L*, a*, b*: `(2, 3)`.
        before, after: the same of the model at the recipe's own values and at the fitted ones.
        delta_e_before, delta_e_after: CIEDE2000 between the mean colours of model and patches.
        pixels_before, pixels_after, pixels_target: `(n, 3)` linear sRGB, evenly picked, to be shown.
    """

    target: Array
    before: Array
    after: Array
    delta_e_before: float
    delta_e_after: float
    pixels_target: Array
    pixels_before: Array
    pixels_after: Array


@dataclass(frozen=True, eq=False)
class SpectrumFit:
    """One measured reflectance, before and after.

    Attributes:
        wavelength_nm, target, before, after: `(n,)`.
        rmse_before, rmse_after: root mean square differences in reflectance.
    """

    wavelength_nm: Array
    target: Array
    before: Array
    after: Array
    rmse_before: float
    rmse_after: float


@dataclass(frozen=True)
class Start:
    """One run of the optimiser.

    Attributes:
        values: where it began, by parameter.
        cost: half the sum of squared residuals at its end, that of the bounds included.
        evaluations: of the model.
        message: why it ended.
    """

    values: Mapping[str, tuple[float, ...]]
    cost: float
    evaluations: int
    message: str


@dataclass(frozen=True, eq=False)
class FitResult:
    """What a fit found.

    Attributes:
        parameters: that were fitted, in order.
        values: the best of each, `(k,)`.
        sd: one standard deviation of each, `(k,)`, by the curvature of data and bounds together.
        gained: share of the bounds' variance that the data take away, `(k,)`: 0 where they say nothing.
        correlation: `(p, p)` of all entries in order.
        undetermined: a sentence for each entry that the data cannot determine.
        kinds: by kind of organ, of the patches.
        spectra: by name, of measured reflectances.
        starts: in the order in which they were run.
        chi_squared: sum of squared residuals of the data at the best values.
        data: number of those residuals.
        leftover: by group of parameters that were not fitted, the likeliest cause first, the share of
            `chi_squared` that they could still take away.
        verdict: sentences that say what was found.
        tuned: the recipe's parts at the best values.
    """

    parameters: tuple[Parameter, ...]
    values: Mapping[str, Array]
    sd: Mapping[str, Array]
    gained: Mapping[str, Array]
    correlation: Array
    undetermined: tuple[str, ...]
    kinds: Mapping[str, KindFit]
    spectra: Mapping[str, SpectrumFit]
    starts: tuple[Start, ...]
    chi_squared: float
    data: int
    leftover: Mapping[str, float]
    diagnostics: tuple[str, ...]
    tuned: TunedParts
