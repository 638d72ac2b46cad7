"""A slot: a place on an organ where others grow, what they are, how many, and where they point."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from pepperscene.cultivar.notation import NOTHING, Angle, Choice, Count, Number, Ratio
from pepperscene.document import Document

Place = Annotated[float, Field(ge=0.0, le=1.0)]


class Flush(Document):
    """Growth in waves along the stem: the chance of anything swings with the place, and its mean stays.

    Attributes:
        nodes: from one wave's crest to the next, drawn once a plant.
        strength: 0 for an even chance, 1 for none between the waves.
    """

    nodes: Ratio
    strength: Ratio
    chosen: str = ""


class Descent(Document):
    """An outcome that is more frequent at the foot of the plant than at its top, while its mean stays.

    Or less frequent, where `by` is negative.

    Attributes:
        of: the outcome.
        by: by how much its share of what grows exceeds the mean at the foot, and falls short at the top.
    """

    of: str
    by: Ratio
    chosen: str = ""


class Slot(Document):
    """What can grow at a place of an organ.

    Attributes:
        name: unique among the slots of its organ.
        what: kind -> probability; `none` for nothing.
        count: how many grow at each place.
        at: places along the organ, 0 base to 1 tip.
        lift: on a node, in half node lengths above its centre.
        azimuth: on a node, around the stem, counter-clockwise seen from above, 0 towards the aisle.
        step: on a node, by how many turns of the cumulated azimuth law its share moves on: from the same slot
            at the node below, or from the share of the slot `after` of the same node. So organs avoid one
            another, and all the same follow the law as a whole.
        after: a slot that stands before this one in the list.
        spread: several at one place fan out about their parent's azimuth by this angle from one to the next.
        aside: they leave their parent's azimuth by this angle, to one side and the other from place to place.
        pairs: one to either side at each place.
        every: on a node, only at each so-manieth, counted from `first`.
        first: on a node, the lowest one (0 is the node above the first internode) that bears anything here.
        flush: see `Flush`; on a node.
        descent: see `Descent`; on a node.
        source: of the plain numbers.
        chosen: why the plain numbers are what they are.
    """

    name: Annotated[str, Field(min_length=1)]
    what: Choice
    count: Count = Number(probabilities={"one": 1.0}, chosen="one where the file says nothing else")
    at: Annotated[tuple[Place, ...], Field(min_length=1)] = (1.0,)
    lift: Annotated[float, Field(ge=-1.0, le=1.0)] = 0.0
    azimuth: Angle | None = None
    step: Ratio | None = None
    after: str | None = None
    spread: Angle | None = None
    aside: Angle | None = None
    pairs: bool = False
    every: Annotated[int, Field(ge=1, le=200)] = 1
    first: Annotated[int, Field(ge=0, le=200)] = 0
    flush: Flush | None = None
    descent: Descent | None = None
    source: str = ""
    chosen: str = ""

    @property
    def kinds(self) -> tuple[str, ...]:
        """The kinds that can grow here, those of probability 0 included."""
        return tuple(kind for kind in self.what.probabilities if kind != NOTHING)

    @property
    def filled(self) -> float:
        """The probability that anything grows here."""
        return sum(share for kind, share in self.what.probabilities.items() if kind != NOTHING)

    @model_validator(mode="after")
    def _modulations_fit(self) -> Self:
        if self.flush is not None:
            strength = self.flush.strength
            if strength.low < 0 or self.filled * (1.0 + strength.high) > 1.0 + 1e-9:
                raise ValueError("flush.strength must be 0 or more and leave every node's chance at most 1")
            if self.flush.nodes.low <= 0:
                raise ValueError("flush.nodes must be greater than 0")
        # Where nothing grows, an inherited descent has nothing to shift.
        if self.descent is not None and self.filled > 0:
            of, by = self.descent.of, self.descent.by
            if of not in self.kinds:
                raise ValueError(f"descent.of must be one of what grows here: {', '.join(self.kinds)}")
            share = self.what.probabilities[of] / self.filled
            most = min(share, 1.0 - share) + 1e-9
            if not -most <= by.low <= by.high <= most:
                raise ValueError(
                    f"descent.by must lie between {-most:.3g} and {most:.3g}, "
                    f"the smaller of {of}'s share and the others'"
                )
        return self
