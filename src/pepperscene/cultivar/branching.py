"""What grows from what: the choices at a node and at the end of a side shoot."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from pepperscene.cultivar.choice import Choice, Probability
from pepperscene.cultivar.notation import Ratio
from pepperscene.document import Document


class LeafChoice(Choice):
    """Whether a node carries a leaf of its own."""

    leaf: Probability
    none: Probability


class ShootChoice(Choice):
    """Whether a node carries a side shoot."""

    side_shoot: Probability
    none: Probability


class FruitChoice(Choice):
    """What a node has of fruit, averaged over the plant: one on its peduncle, the scar of one, or nothing."""

    fruit: Probability
    cut: Probability
    none: Probability


class EndCount(Choice):
    """How many leaves or further shoots stand at the end of a side shoot."""

    one: Probability
    two: Probability
    three: Probability


class EndChoice(Choice):
    """What each of them is."""

    leaf: Probability
    side_shoot: Probability


class Branching(Document):
    """What grows from what (Barth et al. 2018, Fig. 3a and 5).

    Attributes:
        node_leaf: the leaf at a node of the main stem.
        node_shoot: the side shoot at a node of the main stem.
        node_fruit: fruit or cut at a node, averaged over nodes and plants.
        shoot_ends: how many parts end a side shoot.
        shoot_end: what each of them is; a leaf when `depth` is reached.
        depth: how many side shoots can follow one another.
        flush_nodes: nodes from one flush of fruit to the next.
        flush_strength: 0 for evenly set fruit, 1 for none between the flushes.
        cut_descent: how much the cuts' share of fruit positions exceeds its mean at the foot, and falls short
            of it at the top.
    """

    node_leaf: LeafChoice
    node_shoot: ShootChoice
    node_fruit: FruitChoice
    shoot_ends: EndCount
    shoot_end: EndChoice
    depth: Annotated[int, Field(ge=1, le=6)]
    flush_nodes: Ratio
    flush_strength: Ratio
    cut_descent: Ratio

    @model_validator(mode="after")
    def _modulations_fit(self) -> Self:
        fruiting = self.node_fruit.fruit + self.node_fruit.cut
        if fruiting * (1.0 + self.flush_strength.high) > 1.0 or self.flush_strength.low < 0:
            raise ValueError(
                "flush_strength must be 0 or more and leave every node's chance of fruit at most 1"
            )
        share = self.node_fruit.cut / fruiting if fruiting else 0.5
        if not -1e-9 <= self.cut_descent.low <= self.cut_descent.high <= min(share, 1.0 - share) + 1e-9:
            raise ValueError(
                "cut_descent must lie between 0 and the smaller of the cuts' and the fruits' share"
            )
        return self
