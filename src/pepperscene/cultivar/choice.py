"""One of several outcomes, each with its probability."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Final

from pydantic import AfterValidator, Field, model_validator

from pepperscene.cultivar.origin import Origin

SUM_TOLERANCE: Final = 1e-6  # of probabilities and weights, which people write with few digits
NOTHING: Final = "none"
NUMBERS: Final = (
    "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve"
)  # fmt: skip

Probability = Annotated[float, Field(ge=0.0, le=1.0)]


class Choice(Origin):
    """One of several outcomes, written as outcome = probability beside the origin; they sum to 1.

    Attributes:
        probabilities: outcome -> probability, in the order of the file.
    """

    probabilities: dict[str, Probability]

    @model_validator(mode="before")
    @classmethod
    def _gathered(cls, raw: Any) -> Any:
        """The file's flat table, with the outcomes set apart from the origin."""
        if isinstance(raw, Choice):
            return raw
        if not isinstance(raw, Mapping):
            such = "one = 0.7, two = 0.3" if issubclass(cls, Number) else "petiole = 0.9, none = 0.1"
            raise ValueError(f"must be a table of probabilities, such as {{ {such}, chosen = … }}")
        if "probabilities" in raw:
            return raw
        outcomes = {key: value for key, value in raw.items() if key not in Origin.model_fields}
        for name, value in outcomes.items():
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= 1.0:
                raise ValueError(f"{name} must be a probability, from 0 to 1")
        total = math.fsum(outcomes.values())
        if abs(total - 1.0) > SUM_TOLERANCE:
            raise ValueError(f"the probabilities sum to {total:g} and must sum to 1")
        origin = {key: value for key, value in raw.items() if key in Origin.model_fields}
        return {**origin, "probabilities": outcomes}


class Number(Choice):
    """How many: the outcomes are the words one to twelve."""

    @property
    def numbers(self) -> dict[int, float]:
        """Number -> probability, in the order of the file."""
        return {NUMBERS.index(word) + 1: share for word, share in self.probabilities.items()}


def _counts(number: Number, words: tuple[str, ...]) -> Number:
    for word in number.probabilities:
        if word not in words:
            raise ValueError(f"{word} must be one of {', '.join(words)}")
    return number


Count = Annotated[Number, AfterValidator(lambda number: _counts(number, NUMBERS))]
Lobes = Annotated[Number, AfterValidator(lambda number: _counts(number, NUMBERS[1:5]))]
