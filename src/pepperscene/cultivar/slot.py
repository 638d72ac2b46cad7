"""Slots: the positions on an organ where others grow."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from pepperscene.cultivar.notation import NOTHING, Angle, Choice, Count, Number, Ratio
from pepperscene.document import Document

Position = Annotated[float, Field(ge=0.0, le=1.0)]


class Flush(Document):
    """Table of a slot that makes growth come in waves along the stem; the mean probability is unchanged.

    Attributes:
        nodes: wavelength in nodes, drawn once per plant.
        strength: relative amplitude: 0 for a constant probability, 1 for no growth between the waves.
    """

    nodes: Ratio
    strength: Ratio
    chosen: str = ""


class Descent(Document):
    """Table of a slot that makes one outcome more frequent low on the plant; its mean is unchanged.

    Attributes:
        of: the outcome.
        by: excess of its fraction of all that grows over the mean at the foot, and deficit at the top;
            negative if the outcome is more frequent at the top.
    """

    of: str
    by: Ratio
    chosen: str = ""


class Slot(Document):
    """Table of an organ: kinds, number and direction of the organs that grow at one position."""

    name: Annotated[str, Field(min_length=1)]  # unique among the slots of its organ
    what: Choice  # kind -> probability; `none` for nothing
    count: Count = Number(probabilities={"one": 1.0}, chosen="the default is one")  # items at each position
    at: Annotated[tuple[Position, ...], Field(min_length=1)] = (1.0,)  # along the organ, 0 base to 1 tip
    lift: Annotated[float, Field(ge=-1.0, le=1.0)] = 0.0  # on a node, in half node lengths above its centre
    azimuth: Angle | None = None  # on a node, counter-clockwise seen from above, 0 towards the aisle
    # On a node, makes neighbours avoid each other: the quantile level of the azimuth is that of this slot at
    # the node below (or of the slot `after` at the same node) plus this step, modulo 1. All azimuths together
    # still follow their distribution.
    step: Ratio | None = None
    after: str | None = None  # an earlier slot of the list
    # Angle between neighbours if several items share a position; centred on the parent's azimuth.
    spread: Angle | None = None
    aside: Angle | None = None  # angle to the parent's azimuth, to alternating sides along the organ
    pairs: bool = False  # one item to each side at each position
    every: Annotated[int, Field(ge=1, le=200)] = 1  # on a node, only at every n-th, counted from `first`
    # On a node, the lowest one with this slot; 0 is the node above the first internode.
    first: Annotated[int, Field(ge=0, le=200)] = 0
    flush: Flush | None = None  # on a node
    descent: Descent | None = None  # on a node
    source: str = ""  # origin of the plain numbers, as is `chosen`
    chosen: str = ""

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds that can grow here, including those of probability 0."""
        return tuple(kind for kind in self.what.probabilities if kind != NOTHING)

    @property
    def filled(self) -> float:
        """Probability that anything grows here."""
        return sum(chance for kind, chance in self.what.probabilities.items() if kind != NOTHING)

    @model_validator(mode="after")
    def _check_flush_and_descent(self) -> Self:
        if self.flush is not None:
            strength = self.flush.strength
            if strength.low < 0 or self.filled * (1.0 + strength.high) > 1.0 + 1e-9:
                raise ValueError("flush.strength must be 0 or more and keep every probability at most 1")
            if self.flush.nodes.low <= 0:
                raise ValueError("flush.nodes must be greater than 0")
        # If nothing grows, an inherited descent has no effect.
        if self.descent is not None and self.filled > 0:
            of, by = self.descent.of, self.descent.by
            if of not in self.kinds:
                raise ValueError(
                    f"descent.of must be one of the kinds that grow here: {', '.join(self.kinds)}"
                )
            fraction = self.what.probabilities[of] / self.filled
            limit = min(fraction, 1.0 - fraction) + 1e-9
            if not -limit <= by.low <= by.high <= limit:
                raise ValueError(
                    f"descent.by must be between {-limit:.3g} and {limit:.3g}, "
                    f"the smaller of {of}'s fraction and the others'"
                )
        return self
