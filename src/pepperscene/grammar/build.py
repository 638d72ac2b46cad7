"""Build a plant from its parameters: the stem's internodes and nodes, then all that grows on them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np

from pepperscene.cultivar import CALYX, DEFAULT_KINDS, Cultivar, OrganForm
from pepperscene.grammar.draw import draw_parameters
from pepperscene.grammar.frames import NodeFrames, StalkFrames, direction, orthogonal_units
from pepperscene.grammar.hashing import FloatArray
from pepperscene.grammar.plant import Indices, KindParameters, Organ, Plant, PlantParameters
from pepperscene.grammar.shapes import (
    STALK_POINTS,
    NumberedOrgans,
    blade_hang,
    build_kind,
    make_organs,
    select_measures,
)

INTERNODE_POINTS: Final = 3
_MAX_NODE_FRACTION: Final = 0.4  # chosen: of the shorter adjacent internode, what half a node takes at most


def grow(cultivar: Cultivar, rng: np.random.Generator, lean: float = 0.0) -> Plant:
    """Grow a plant with parameters drawn from the cultivar's distributions; organs may intersect.

    The same state of the generator gives the same arrays, bit for bit.

    Args:
        cultivar: has the distributions.
        rng: gives one number, the plant's key.
        lean: radians, added to the drawn lean of the stem; positive towards the aisle (-y).
    """
    return build_plant(draw_parameters(cultivar, rng, lean))


def build_plant(parameters: PlantParameters) -> Plant:
    """Build the plant that the parameters describe; the same parameters give the same arrays, bit for bit.

    Raises:
        ValueError: the plant does not have exactly one kind of internode and one of node.
    """
    organs = parameters.organs
    internode, node = _kind_of_form(organs, "internode"), _kind_of_form(organs, "node")
    count = 1 + max(int(parts.number.max()) for parts in organs.values() if len(parts))
    stem, frames = _build_stem((internode, node), organs[internode], organs[node])
    built = dict((*stem, *_build_branches(organs, frames, count)))
    kinds = {name: parts.kind for name, parts in organs.items()}
    # Plants whose cultivar has fruit have the kind calyx, even without any fruit.
    if any(kind.form == "fruit" for kind in kinds.values()):
        kinds[CALYX] = DEFAULT_KINDS["calyx"]
    ordered = tuple(built[number] for number in sorted(built))
    return Plant(parameters.cultivar, ordered, kinds, parameters.drawn_from)


def _kind_of_form(organs: Mapping[str, KindParameters], form: OrganForm) -> str:
    """Name of the only kind of this form."""
    names = [name for name, parts in organs.items() if parts.kind.form == form and len(parts)]
    if len(names) != 1:
        raise ValueError(f"a plant must have one kind of {form}, not {len(names)}")
    return names[0]


def _build_stem(
    names: tuple[str, str], internodes: KindParameters, nodes: KindParameters
) -> tuple[NumberedOrgans, NodeFrames]:
    """Internodes and nodes, and the frames of the nodes; straight internodes join nodes, which bend.

    Args:
        names: of the two kinds.
        internodes: their parameters, from the ground up.
        nodes: likewise.
    """
    internode, node = internodes.values, nodes.values
    axis = direction(internode["azimuth"], internode["inclination"])
    next_axis = np.concatenate((axis[1:], axis[-1:]))
    step = internode["length"][:, None] * axis
    centre = np.cumsum(step, axis=0)
    shorter = np.minimum(internode["length"], np.append(internode["length"][1:], internode["length"][-1:]))
    half = np.minimum(0.5 * node["length"], _MAX_NODE_FRACTION * shorter)
    # From the upper end of the node below to the lower end of the node above.
    start = centre - step
    start[1:] += half[:-1, None] * axis[1:]
    end = centre - half[:, None] * axis
    along = np.linspace(0.0, 1.0, INTERNODE_POINTS)[:, None]
    up = orthogonal_units(np.broadcast_to([0.0, -1.0, 0.0], axis.shape), axis)
    stem = make_organs(
        names[0],
        internodes,
        start[:, None] + along * (end - start)[:, None],
        up,
        {
            "radius_m": 0.5 * internode["diameter"],
            "radius_tip_m": 0.5 * internode["diameter_tip"],
            **select_measures(internode, ("groove", "seed", "state", "state_tip", "state_spread")),
        },
    )
    stem += make_organs(
        names[1],
        nodes,
        np.stack((end, centre, centre + half[:, None] * next_axis), axis=1),
        up,
        {
            "radius_m": 0.5 * node["width"],
            "radius_start_m": 0.5 * node["diameter"],
            "radius_end_m": 0.5 * node["diameter"],
            **select_measures(node, ("groove", "seed", "state")),
        },
    )
    node_axis = axis + next_axis
    node_axis /= np.linalg.norm(node_axis, axis=1, keepdims=True)
    return stem, NodeFrames(centre, node_axis, 0.5 * node["width"], half)


def _build_branches(
    organs: Mapping[str, KindParameters], nodes: NodeFrames, count: int
) -> Iterator[tuple[int, Organ]]:
    """All organs except the stem's, level by level, since a stalk must be built before its children."""
    stalks, hang = StalkFrames(count, STALK_POINTS), _tip_blade_hang(organs, count)
    levels = _branch_levels(organs, count)
    for level in range(1, int(levels.max()) + 1):
        for name, all_parts in organs.items():
            rows = np.flatnonzero(levels[all_parts.number] == level)
            if rows.size:
                parts = all_parts.select(rows)
                sites = nodes.sites(parts) if level == 1 else stalks.sites(parts)
                yield from build_kind(name, parts.kind, sites, hang, stalks)


def _branch_levels(organs: Mapping[str, KindParameters], count: int) -> Indices:
    """`(count,)` number of steps from each organ to the stem: 0 for the stem's own, 1 for organs on nodes."""
    parent = np.full(count, -1)
    on_stem = np.zeros(count, dtype=bool)
    for parts in organs.values():
        parent[parts.number] = parts.parent
        on_stem[parts.number] = parts.kind.form in ("internode", "node")
    levels = np.zeros(count, dtype=np.intp)
    # Parents have lower numbers, so their levels are known first.
    for number in np.flatnonzero(~on_stem & (parent >= 0)).tolist():
        levels[number] = levels[parent[number]] + 1
    return levels


def _tip_blade_hang(organs: Mapping[str, KindParameters], count: int) -> FloatArray:
    """`(count,)` base inclination of the blade at each organ's tip: the mean of several, NaN without one."""
    total, number = np.zeros(count), np.zeros(count)
    for parts in organs.values():
        if parts.kind.form == "blade" and len(parts):
            tip = (parts.values["at"] >= 1.0) & (parts.values["sideways"] == 0.0)
            np.add.at(total, parts.parent[tip], blade_hang(parts.values)[tip])
            np.add.at(number, parts.parent[tip], 1.0)
    return np.divide(total, number, out=np.full(count, np.nan), where=number > 0)
