"""Sizes, poses and ripeness of fruit, of their stalks, and of the scars of harvested ones."""

from __future__ import annotations

from typing import Self

from pydantic import model_validator

from pepperscene.cultivar.choice import Choice, Probability
from pepperscene.cultivar.notation import Angle, Length, Ratio
from pepperscene.document import Document


class LobeChoice(Choice):
    """Number of a fruit's lobes."""

    three: Probability
    four: Probability


class FruitShape(Document):
    """F-2 and the form of a blocky sweet pepper.

    Attributes:
        diameter: F-2, of a grown fruit.
        slenderness: length divided by diameter.
        inclination: of the axis from stalk end to blossom end, about -90 degrees.
        ripe_fraction: share of the grown fruit that is ripe; that of a young top is green.
        ripe_descent: how much that share rises towards the foot, where fruit is older, and falls to the top,
            over half the plant's height.
        breaker_fraction: share of fruit that is turning, taken from both sides alike.
        unripe, breaker, ripe: ripeness of such fruit, 0 green to 1 ripe.
    """

    diameter: Length
    slenderness: Ratio
    inclination: Angle
    lobes: LobeChoice
    lobe_depth: Ratio
    shoulder: Ratio
    taper: Ratio
    ripe_fraction: Ratio
    ripe_descent: Ratio
    breaker_fraction: Ratio
    unripe: Ratio
    breaker: Ratio
    ripe: Ratio
    ripeness_spread: Ratio

    @model_validator(mode="after")
    def _shares_fit(self) -> Self:
        ripe, breaker, descent = self.ripe_fraction, self.breaker_fraction, self.ripe_descent
        if min(ripe.low, breaker.low, descent.low) < 0 or max(ripe.high, breaker.high) > 1:
            raise ValueError("ripe_fraction, breaker_fraction and ripe_descent must lie in [0, 1]")
        if ripe.high + descent.high > 1 or ripe.low - descent.high < 0:
            raise ValueError(
                "ripe_descent must leave the share of ripe fruit within [0, 1] at both ends of the plant"
            )
        return self


class PeduncleShape(Document):
    """P-1 (length) and its bend from the node to the fruit."""

    length: Length
    diameter: Length
    tip: Ratio
    inclination: Angle
    end_inclination: Angle
    calyx_radius: Ratio


class CutShape(Document):
    """The scar of a harvested peduncle."""

    diameter: Length
    length: Length
