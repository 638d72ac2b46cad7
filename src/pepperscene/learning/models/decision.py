"""From a network's logits to probabilities: temperature, weights of the loss and frequencies of classes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, Final, Self, final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, FiniteFloat

from pepperscene.document import Document
from pepperscene.errors import ArgumentError

if TYPE_CHECKING:
    import torch

Floats = NDArray[np.float64]

TEMPERATURES: Final = (0.25, 4.0)
"""Range of fitted temperatures. Chosen: far beyond those of trained networks (Guo et al. 2017)."""

FACTORS: Final = tuple(float(item) for item in np.geomspace(0.5, 16.0, 11))
"""Tried by `fit_factors`. Chosen: from a probability of 2/3 to one of 1/17, in steps of the root of two."""

_MOST_ROUNDS: Final = 4  # chosen: factors hardly depend on each other
_LEAST_SHARE: Final = 1e-6  # chosen: of a class, so that none is excluded in all later steps
_LEAST_PROBABILITY: Final = 1e-6  # chosen: of a pixel's class, so that one wrong pixel does not decide
_LEAST_GAIN: Final = 1e-6  # chosen: of the mean IoU, below which factors stay as they are
_MOST_STEPS: Final = 500  # chosen: of expectation and maximisation; most sets take some dozens
_CHANGE: Final = 1e-7  # chosen: change of the shares at which the steps end


@final
class DecisionDescription(Document):
    """Of a model file: see `Decision`."""

    weights: tuple[Annotated[FiniteFloat, Field(strict=True, gt=0)], ...]
    frequencies: tuple[Annotated[FiniteFloat, Field(strict=True, ge=0, le=1)], ...]
    temperature: Annotated[FiniteFloat, Field(strict=True, ge=TEMPERATURES[0], le=TEMPERATURES[1])] = 1.0
    factors: tuple[Annotated[FiniteFloat, Field(strict=True, gt=0)], ...]


@final
@dataclass(frozen=True)
class Decision:
    """How logits become probabilities of the network's k classes.

    A loss with weights w teaches a network the probabilities of images in which class c is w_c times as
    frequent as in those of its training. The weights are taken back here (Menon et al. 2021), and where the
    shares of the classes in a user's images are known or estimated, probabilities are those for these images
    (Saerens et al. 2002).

    Attributes:
        weights: `(k,)` of the classes in the loss.
        frequencies: `(k,)` shares of the classes in the pixels of the training images.
        temperature: by which logits are divided before (Guo et al. 2017).
        factors: `(k,)`, by default ones, on the probabilities before the largest is chosen. The most probable
            class is right most often, but a rare one has a higher IoU if it is chosen from a lower
            probability on: see `fit_factors`.
        shares: `(k,)` shares of the classes in the images that are predicted; None for the frequencies.
        least_area: pixels of the smallest connected regions of fruit and peduncles that are kept; smaller
            ones get the most probable of the other classes. People who draw masks leave small regions out.
        grown_px: distance by which regions of fruit and peduncles are enlarged afterwards. Networks of
            rendered images are less certain in photographs, first at the borders of what they find.
    """

    weights: tuple[float, ...]
    frequencies: tuple[float, ...]
    temperature: float = 1.0
    factors: tuple[float, ...] = ()
    shares: tuple[float, ...] | None = None
    least_area: int = 0
    grown_px: int = 0

    def __post_init__(self) -> None:
        if not self.factors:
            object.__setattr__(self, "factors", (1.0,) * len(self.weights))

    @property
    def shift(self) -> Floats:
        """`(k,)` added to the logits after the temperature."""
        shift = -np.log(self.weights)
        if self.shares is not None:
            shift += np.log(_ratios(np.array(self.shares), np.array(self.frequencies)))
        return np.asarray(shift)

    def probabilities(self, logits: torch.Tensor) -> torch.Tensor:
        """Probabilities of the classes, which are in the last dimension but two, of logits."""
        shift = logits.new_tensor(self.shift)[:, None, None]
        return (logits / self.temperature + shift).softmax(dim=-3)

    def description(self) -> dict[str, Any]:
        """What is learned, as JSON values; the rest belongs to the images that are predicted."""
        return {name: getattr(self, name) for name in DecisionDescription.model_fields}

    def for_shares(self, shares: Sequence[float] | Floats, merging: NDArray[np.float32]) -> Self:
        """The decision for images with these shares of merged classes `(n,)`.

        Args:
            shares: of the n merged classes; scaled to a sum of 1.
            merging: matrix `(n, k)` of 0 and 1, as of `ClassTable.merging`. Members of a merged class keep
                their proportions.
        """
        before = np.array(self.frequencies)
        merged = merging @ before
        wanted = np.asarray(shares, float) / np.sum(shares) * max(merged.sum(), _LEAST_SHARE)
        # Classes that belong to no merged one keep their frequency.
        ratios = np.where(merging.any(axis=0), merging.T @ _ratios(wanted, merged), 1.0)
        return replace(self, shares=tuple((np.maximum(before, _LEAST_SHARE) * ratios).tolist()))


def estimate_shares(probabilities: NDArray[np.floating], frequencies: Floats) -> Floats:
    """Shares `(n,)` of classes in unlabelled images: expectation and maximisation of Saerens et al. (2002).

    Args:
        probabilities: `(pixels, n)` of the classes, where their shares are `frequencies`.
        frequencies: `(n,)` shares that the probabilities assume.

    Raises:
        ArgumentError: there are no pixels.
    """
    if not len(probabilities):
        raise ArgumentError("prior", "must be images with at least one pixel")
    likelihood = np.asarray(probabilities, np.float64) / np.maximum(frequencies, _LEAST_SHARE)
    shares = np.asarray(frequencies / frequencies.sum())
    for _ in range(_MOST_STEPS):
        joint = likelihood * np.maximum(shares, _LEAST_SHARE)
        updated = (joint / joint.sum(axis=1, keepdims=True)).mean(axis=0)
        change, shares = np.abs(updated - shares).max(), updated
        if change < _CHANGE:
            break
    return shares


def fit_temperature(
    logits: NDArray[np.floating], labels: NDArray[np.integer], shift: Floats, merging: NDArray[np.float32]
) -> float:
    """The temperature of the least cross-entropy on validation pixels (Guo et al. 2017).

    Args:
        logits: `(pixels, k)` of the network's classes.
        labels: `(pixels,)` indices of the classes of the labels.
        shift: as of `Decision.shift`.
        merging: `(n, k)` of 0 and 1, from the network's classes to those of the labels.
    """
    from scipy.optimize import minimize_scalar
    from scipy.special import softmax

    rows = np.arange(len(labels))

    def entropy(log_temperature: float) -> float:
        merged = softmax(logits / np.exp(log_temperature) + shift, axis=1) @ merging.T
        # No pixel counts as more than certain to be wrong.
        return float(-np.log(np.maximum(merged[rows, labels], _LEAST_PROBABILITY)).mean())

    bounds = tuple(np.log(TEMPERATURES))
    return float(np.exp(minimize_scalar(entropy, bounds=bounds, method="bounded").x))


def fit_factors(probabilities: NDArray[np.floating], labels: NDArray[np.integer]) -> Floats:
    """Factors `(k,)` on probabilities with which the most probable classes have the greatest mean IoU.

    One class after the other gets the best of the factors `FACTORS`, until none changes or `_MOST_ROUNDS` are
    over; the most frequent one keeps 1.

    Args:
        probabilities: `(pixels, k)` of validation images.
        labels: `(pixels,)` indices of their classes.
    """
    count = probabilities.shape[1]
    frequent, factors = int(np.bincount(labels, minlength=count).argmax()), np.ones(count)

    def mean_iou(tried: Floats) -> float:
        predicted = (probabilities * tried).argmax(axis=1)
        matrix = np.bincount(labels * count + predicted, minlength=count * count).reshape(count, count)
        hits, either = np.diag(matrix), matrix.sum(axis=0) + matrix.sum(axis=1) - np.diag(matrix)
        return float(np.mean(hits[either > 0] / either[either > 0]))

    best = mean_iou(factors)
    for _ in range(_MOST_ROUNDS):
        before = factors.copy()
        for index in (number for number in range(count) if number != frequent):
            for factor in FACTORS:
                tried = factors.copy()
                tried[index] = factor
                if (found := mean_iou(tried)) > best + _LEAST_GAIN:
                    best, factors = found, tried
        if (factors == before).all():
            break
    return factors


def _ratios(shares: Floats, frequencies: Floats) -> Floats:
    """Shares over frequencies; 1 for a class that the training did not have."""
    known = frequencies > 0
    return np.where(known, np.maximum(shares, _LEAST_SHARE) / np.where(known, frequencies, 1.0), 1.0)
