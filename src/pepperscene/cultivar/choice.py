"""One of several outcomes, each with its probability."""

from __future__ import annotations

import math
from typing import Annotated, Final, Self

from pydantic import Field, model_validator

from pepperscene.cultivar.origin import Origin

SUM_TOLERANCE: Final = 1e-6  # of probabilities and weights, which people write with few digits

Probability = Annotated[float, Field(ge=0.0, le=1.0)]


class Choice(Origin):
    """One of several outcomes; the subclasses' probabilities are at least 0 and sum to 1."""

    @model_validator(mode="after")
    def _sums_to_one(self) -> Self:
        total = math.fsum(self.probabilities.values())
        if abs(total - 1.0) > SUM_TOLERANCE:
            raise ValueError(f"the probabilities sum to {total:g} and must sum to 1")
        return self

    @property
    def probabilities(self) -> dict[str, float]:
        """Outcome -> probability, in the order of the fields."""
        names = [name for name in type(self).model_fields if name not in Origin.model_fields]
        return {name: getattr(self, name) for name in names}
