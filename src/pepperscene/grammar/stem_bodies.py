"""The main stem's organs: internodes and nodes in turn."""

from __future__ import annotations

from typing import Final

import numpy as np

from pepperscene.grammar.bodies import Bodies
from pepperscene.grammar.curves import FloatArray, across, direction
from pepperscene.grammar.frames import NodeFrames
from pepperscene.grammar.parameters import KindParameters

INTERNODE_POINTS: Final = 3
_CLEAR: Final = 0.4  # chosen: share of the shorter section beside it that half a node takes at most


def stem_bodies(
    names: tuple[str, str], sections: KindParameters, swellings: KindParameters
) -> tuple[Bodies, Bodies, NodeFrames]:
    """Internodes, nodes, and where the nodes stand.

    Node centres are joined by straight sections; the nodes take the bends.

    Args:
        names: of the two kinds.
        sections: the internodes' parameters, from the ground up.
        swellings: the nodes'.
    """
    one, node = sections.values, swellings.values
    axis = direction(one["azimuth"], one["inclination"])
    after = np.concatenate((axis[1:], axis[-1:]))
    reach = one["length"][:, None] * axis
    centre = np.cumsum(reach, axis=0)
    half = np.minimum(0.5 * node["length"], _CLEAR * _shorter(one["length"]))
    # From the upper end of the node below to the lower end of the node above.
    start = centre - reach
    start[1:] += half[:-1, None] * axis[1:]
    end = centre - half[:, None] * axis
    along = np.linspace(0.0, 1.0, INTERNODE_POINTS)[:, None]
    up = across(np.broadcast_to([0.0, -1.0, 0.0], axis.shape), axis)
    internodes = Bodies(
        kind=names[0],
        number=sections.number,
        parent=sections.parent,
        phytomer=sections.phytomer,
        curves=start[:, None] + along * (end - start)[:, None],
        up=up,
        measures={
            "radius_m": 0.5 * one["diameter"],
            "radius_tip_m": 0.5 * one["diameter_tip"],
            "groove_m": one["groove"],
            "seed": one["seed"],
            "state_mean": one["state"],
            "state_tip": one["state_tip"],
            "state_spread": one["state_spread"],
        },
    )
    nodes = Bodies(
        kind=names[1],
        number=swellings.number,
        parent=swellings.parent,
        phytomer=swellings.phytomer,
        curves=np.stack((end, centre, centre + half[:, None] * after), axis=1),
        up=up,
        measures={
            "radius_m": 0.5 * node["width"],
            "radius_start_m": 0.5 * node["diameter"],
            "radius_end_m": 0.5 * node["diameter"],
            "groove_m": node["groove"],
            "seed": node["seed"],
            "state_mean": node["state"],
        },
    )
    bend = axis + after
    bend /= np.linalg.norm(bend, axis=1, keepdims=True)
    return internodes, nodes, NodeFrames(centre, bend, 0.5 * node["width"], half)


def _shorter(length: FloatArray) -> FloatArray:
    """`(parts,)` the shorter of the sections below and above each node."""
    return np.minimum(length, np.append(length[1:], length[-1:]))
