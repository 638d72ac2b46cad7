"""From where, and into what direction, organs of one kind grow out of what bears them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pepperscene.grammar.curves import FloatArray
from pepperscene.grammar.frames import NodeFrames, StalkFrames
from pepperscene.grammar.parameters import KindParameters


@dataclass(frozen=True, eq=False)
class Sites:
    """`(n,)` places where organs of one kind start.

    Attributes:
        start: `(n, 3)` points.
        azimuth: of the vertical planes that they grow in.
        sway: out of those planes, at their start.
        slope: inclination of what they go on from, for those that continue a stalk.
        continues: which of them go on from a stalk's tip.
        inset: how deep they start below the surface of what bears them, metres.
        parts: their parameters.
        stalks: on which they stand, or None on nodes.
    """

    start: FloatArray
    azimuth: FloatArray
    sway: FloatArray
    slope: FloatArray
    continues: NDArray[np.bool_]
    inset: FloatArray
    parts: KindParameters
    stalks: StalkFrames | None

    @property
    def heading(self) -> FloatArray:
        """`(n,)` azimuth into which they start."""
        return np.asarray(self.azimuth + self.sway)

    def roll(self, inclination: FloatArray, tangent: FloatArray) -> FloatArray:
        """`(n,)` roll against the vertical plane: as what they continue, or into their bearer's plane.

        Args:
            inclination: `(n,)` of their first part.
            tangent: `(n, 3)` of their first part.
        """
        if self.stalks is None:
            return np.zeros(len(self.parts))
        at, parent = self.parts.values["at"], self.parts.parent
        flat = self.stalks.roll_of_side(parent, at, self.azimuth, inclination, tangent)
        sideways = self.parts.values["sideways"] > 0.0
        return np.where(sideways, flat, np.where(self.continues, self.stalks.roll[parent], 0.0))


def on_nodes(parts: KindParameters, nodes: NodeFrames) -> Sites:
    """Sites on the sides of the stem's nodes."""
    azimuth, nothing = parts.values["azimuth"], np.zeros(len(parts))
    return Sites(
        start=nodes.sides(parts.phytomer, azimuth, parts.values["lift"]),
        azimuth=azimuth,
        sway=nothing,
        slope=nothing,
        continues=np.zeros(len(parts), dtype=bool),
        inset=nodes.depth(parts.phytomer),
        parts=parts,
        stalks=None,
    )


def on_stalks(parts: KindParameters, stalks: StalkFrames) -> Sites:
    """Sites on the centrelines of stalks; what stands at a tip and not aside goes on from there."""
    at, parent = parts.values["at"], parts.parent
    continues = (at >= 1.0) & (parts.values["sideways"] == 0.0)
    bent = stalks.sway[parent] * at
    # What continues a stalk goes on in its sway; all else takes the direction there for its own plane.
    azimuth = stalks.azimuth[parent] + parts.values["azimuth"] + np.where(continues, 0.0, bent)
    return Sites(
        start=stalks.points(parent, at),
        azimuth=azimuth,
        sway=np.where(continues, bent, 0.0),
        slope=stalks.inclination(parent, at),
        continues=continues,
        inset=np.where(at >= 1.0, 0.0, stalks.radius[parent]),
        parts=parts,
        stalks=stalks,
    )
