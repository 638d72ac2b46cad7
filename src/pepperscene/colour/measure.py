"""A number with the interval that it is known within, or the reason why it is not known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pepperscene.colour.resampling import Floats, interval


@dataclass(frozen=True)
class Measure:
    """A number that was measured.

    Attributes:
        value: None where it is not known.
        low: lower end of its 95 % interval; None where that is not known.
        high: upper end; of an angle it may be the lesser number, where the interval goes through 0.
        why: the reason why there is no value, as a sentence begins or ends.
    """

    value: float | None
    low: float | None = None
    high: float | None = None
    why: str = ""


def unknown(why: str) -> Measure:
    """No number."""
    return Measure(None, why=why)


def of_values(values: Floats, resampled: bool, why: str = "it is not defined") -> Measure:
    """A measure of its value and its replicates `(1 + n,)`.

    Args:
        values: the value first.
        resampled: whether the replicates say anything: of a single picture they do not.
        why: the reason, if the value is not finite.
    """
    if not np.isfinite(values[0]):
        return unknown(why)
    ends = interval(values) if resampled else None
    return Measure(float(values[0]), *(ends or (None, None)))


def of_angles(values: Floats, resampled: bool, why: str) -> Measure:
    """The same of angles in degrees: what counts is how far replicates are turned from the value."""
    turned = of_values((values - values[0] + 180.0) % 360.0 - 180.0, resampled, why)
    if turned.value is None or turned.low is None or turned.high is None:
        return turned if turned.value is None else Measure(float(values[0]))
    return Measure(float(values[0]), (values[0] + turned.low) % 360.0, (values[0] + turned.high) % 360.0)
