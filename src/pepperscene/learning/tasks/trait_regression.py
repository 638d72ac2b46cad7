"""Regression of a trait on the reflectance in bands: spectral indices, ridge, partial least squares.

References: ridge regression (Hoerl & Kennard 1970, Technometrics 12:55), partial least squares with one
response (Wold, Sjostrom & Eriksson 2001, Chemom. Intell. Lab. Syst. 58:109).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.sensor.indices import INDICES, has_index, index_bands, normalised_difference
from pepperscene.errors import InputError, SetupError

FloatArray = NDArray[np.float64]

Predictor = Callable[[FloatArray], FloatArray]
"""From reflectances `(n, c)` to a trait `(n,)`."""

Regression = Callable[[FloatArray, FloatArray, FloatArray], Predictor]
"""From reflectances `(n, c)`, traits `(n,)` and the wavelength of each band `(c,)`, nm, to a predictor."""

_RIDGE: Final = 1e-3
"""Penalty of ridge regression, in variances of standardised bands. Chosen: small, but enough that similar
bands do not get large slopes of opposite signs."""

_ROUNDING: Final = 1e-6  # relative; reflectances have 32 bits
_COMPONENTS: Final = 6  # chosen: PROSPECT's leaf has as many parameters between 400 and 1000 nm


def mean_value(_: FloatArray, trait: FloatArray, __: FloatArray) -> Predictor:
    """The mean of the training, whatever the reflectance."""
    mean = float(trait.mean())
    return lambda reflectance: np.full(len(reflectance), mean)


def index_regression(
    name: str, reflectance: FloatArray, trait: FloatArray, bands_nm: FloatArray
) -> Predictor:
    """A straight line on a spectral index of `INDICES`.

    Raises:
        InputError: there is no band in one of its ranges.
    """
    return _line(reflectance, trait, *index_bands(name, bands_nm))


def best_index(reflectance: FloatArray, trait: FloatArray, _: FloatArray) -> Predictor:
    """A straight line on the normalised difference of that pair of bands which fits the training best."""
    pairs = list(combinations(range(reflectance.shape[1]), 2))
    if not pairs:
        raise InputError("best_index", "needs two bands or more")
    fits = [_correlation(normalised_difference(reflectance, *pair), trait) for pair in pairs]
    return _line(reflectance, trait, *pairs[int(np.argmax(fits))])


def ridge(reflectance: FloatArray, trait: FloatArray, _: FloatArray) -> Predictor:
    """Linear regression on all standardised bands, with a small penalty on the squares of the slopes."""
    with _scikit_learn():
        from sklearn.linear_model import Ridge
        from sklearn.preprocessing import StandardScaler
    scaler, model = StandardScaler(), Ridge(_RIDGE * len(trait))
    model.fit(scaler.fit_transform(reflectance), trait)
    return lambda samples: np.asarray(model.predict(scaler.transform(samples)))


def partial_least_squares(
    reflectance: FloatArray, trait: FloatArray, _: FloatArray, components: int = _COMPONENTS
) -> Predictor:
    """Partial least squares on standardised bands: each component is the direction of largest covariance."""
    with _scikit_learn():
        from sklearn.cross_decomposition import PLSRegression
    # Components beyond the rank of the bands would fit rounding errors.
    singular = np.linalg.svd(reflectance - reflectance.mean(axis=0), compute_uv=False)
    rank = max(1, int(np.count_nonzero(singular > _ROUNDING * singular[0])))
    model = PLSRegression(min(components, rank))
    with warnings.catch_warnings():
        # Fewer components can explain all of the training.
        warnings.filterwarnings("ignore", "y residual is constant")
        model.fit(reflectance, trait)
    return lambda samples: np.asarray(model.predict(samples)).ravel()


REGRESSIONS: Final[Mapping[str, Regression]] = {
    "mean": mean_value,
    **{name: partial(index_regression, name) for name in INDICES},
    "best_index": best_index,
    "ridge": ridge,
    "pls": partial_least_squares,
}
"""Baselines by name."""


def has_bands(name: str, bands_nm: FloatArray) -> bool:
    """Whether a baseline can be computed from these bands."""
    return (name not in INDICES or has_index(name, bands_nm)) and (name != "best_index" or len(bands_nm) > 1)


def _line(reflectance: FloatArray, trait: FloatArray, first: int, second: int) -> Predictor:
    index = normalised_difference(reflectance, first, second)
    deviation = index - index.mean()
    size = float(deviation @ deviation)
    slope = float(deviation @ (trait - trait.mean())) / size if size > 0 else 0.0
    offset = float(trait.mean() - slope * index.mean())
    return lambda samples: offset + slope * normalised_difference(samples, first, second)


def _correlation(index: FloatArray, trait: FloatArray) -> float:
    """Squared correlation; 0 if one of both does not vary."""
    a, b = index - index.mean(), trait - trait.mean()
    size = float((a @ a) * (b @ b))
    return float(a @ b) ** 2 / size if size > 0 else 0.0


@contextmanager
def _scikit_learn() -> Iterator[None]:
    """Raise `SetupError` if scikit-learn is not installed."""
    try:
        yield
    except ImportError:
        problem = "scikit-learn is not installed, which this baseline needs"
        raise SetupError(f"{problem}; install it with `pip install 'pepperscene[learn]'`") from None
