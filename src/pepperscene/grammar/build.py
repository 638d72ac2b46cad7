"""The main stem's organs: internodes and nodes in turn."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np

from pepperscene.cultivar import CALYX, USUAL, Cultivar, OrganForm, OrganKind
from pepperscene.grammar.draw import draw_parameters
from pepperscene.grammar.frames import (
    FloatArray,
    NodeFrames,
    Sites,
    StalkFrames,
    across,
    direction,
    on_nodes,
    on_stalks,
)
from pepperscene.grammar.plant import Indices, KindParameters, Organ, Plant, PlantParameters
from pepperscene.grammar.shapes import (
    STALK_POINTS,
    OrganBatch,
    blade_hang,
    blades,
    cuts,
    flowers,
    fruits,
    peduncles,
    stalks,
)

INTERNODE_POINTS: Final = 3
_CLEAR: Final = 0.4  # chosen: share of the shorter section beside it that half a node takes at most


def stem_bodies(
    names: tuple[str, str], sections: KindParameters, swellings: KindParameters
) -> tuple[OrganBatch, OrganBatch, NodeFrames]:
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
    internodes = OrganBatch(
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
    nodes = OrganBatch(
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


def build_plant(parameters: PlantParameters) -> Plant:
    """The plant that the parameters describe; the same parameters give the same arrays, bit for bit.

    Raises:
        ValueError: there is no stem, or its nodes are not as many as its internodes.
    """
    every = parameters.organs
    internode, node = _only(every, "internode"), _only(every, "node")
    count = 1 + max(int(one.number.max()) for one in every.values() if len(one))
    organs: list[Organ | None] = [None] * count
    sections, swellings, nodes = stem_bodies((internode, node), every[internode], every[node])
    for bodies in (sections, swellings, *_branches(every, nodes, count)):
        bodies.enter(organs)
    kinds = {name: one.kind for name, one in every.items()}
    # Every fruit has one; the kind is there whether or not the plant bears fruit.
    kinds |= {CALYX: USUAL["calyx"]} if any(kind.form == "fruit" for kind in kinds.values()) else {}
    return Plant(parameters.cultivar, tuple(organ for organ in organs if organ is not None), kinds)


def _only(every: Mapping[str, KindParameters], form: OrganForm) -> str:
    """The kind that the stem has of a form."""
    found = [name for name, one in every.items() if one.kind.form == form and len(one)]
    if len(found) != 1:
        raise ValueError(f"a plant has one kind of {form}, not {len(found)}")
    return found[0]


def _branches(every: Mapping[str, KindParameters], nodes: NodeFrames, count: int) -> Iterator[OrganBatch]:
    """All organs but those of the stem, level by level, since a stalk must stand before what it bears."""
    frames, hang = StalkFrames(count, STALK_POINTS), _hang(every, count)
    levels = _levels(every, count)
    for level in range(1, int(levels.max()) + 1):
        for name, one in every.items():
            rows = np.flatnonzero(levels[one.number] == level)
            if rows.size:
                parts = one.picked(rows)
                sites = on_nodes(parts, nodes) if level == 1 else on_stalks(parts, frames)
                yield from _shaped(name, one.kind, sites, hang, frames)


def _shaped(
    name: str, kind: OrganKind, sites: Sites, hang: FloatArray, frames: StalkFrames
) -> list[OrganBatch]:
    """The organs of one kind and level."""
    match kind.form:
        case "stalk":
            return stalks(name, sites, hang[sites.parts.number], frames)
        case "peduncle":
            return peduncles(name, sites, frames)
        case "blade":
            return blades(name, sites)
        case "fruit":
            return fruits(name, sites)
        case "cut":
            return cuts(name, sites)
        case "flower":
            return flowers(name, sites)
    raise ValueError(f"{name} is a {kind.form}, which does not branch off")


def _levels(every: Mapping[str, KindParameters], count: int) -> Indices:
    """`(count,)` how many steps each organ is from the stem: 0 for the stem's own, 1 for what nodes bear."""
    parent = np.full(count, -1)
    on_stem = np.zeros(count, dtype=bool)
    for one in every.values():
        parent[one.number] = one.parent
        on_stem[one.number] = one.kind.form in ("internode", "node")
    levels = np.zeros(count, dtype=np.intp)
    # Parents have lower numbers, so each is known before its children ask.
    for number in np.flatnonzero(~on_stem & (parent >= 0)).tolist():
        levels[number] = levels[parent[number]] + 1
    return levels


def _hang(every: Mapping[str, KindParameters], count: int) -> FloatArray:
    """`(count,)` inclination to which the blade at each organ's tip hangs at first.

    The mean, if there are several, and not a number where there is none.
    """
    total, found = np.zeros(count), np.zeros(count)
    for one in every.values():
        if one.kind.form == "blade" and len(one):
            tip = (one.values["at"] >= 1.0) & (one.values["sideways"] == 0.0)
            np.add.at(total, one.parent[tip], blade_hang(one.values)[tip])
            np.add.at(found, one.parent[tip], 1.0)
    return np.divide(total, found, out=np.full(count, np.nan), where=found > 0)


def grow(cultivar: Cultivar, rng: np.random.Generator, lean: float = 0.0) -> Plant:
    """A plant whose parameters are drawn from the cultivar's laws; what touches what is not looked at.

    The same state of the generator gives the same arrays, bit for bit.

    Args:
        cultivar: whose laws they follow.
        rng: gives one number, the plant's key.
        lean: radians, added to the drawn lean of the stem; positive towards the aisle (-y).
    """
    return build_plant(draw_parameters(cultivar, rng, lean))
