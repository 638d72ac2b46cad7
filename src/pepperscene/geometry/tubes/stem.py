"""The main stem: angular sections between swollen nodes, and the outline that a twine lies on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.bodies import MeshBatch, fineness
from pepperscene.geometry.organ_arrays import hashed, organ_measure, size
from pepperscene.geometry.spine import Spines, spines
from pepperscene.geometry.tubes.tube import (
    STATE,
    Rings,
    centred,
    centrelines,
    circle,
    closed,
    rounded,
    streaked,
)
from pepperscene.grammar.plant import Organ, Plant

_SIDES: Final = 12  # chosen: three points to a ridge; sections and nodes share it, so that their rings meet
_FADING: Final = 0.12  # chosen: part of a section within which its ridges rise out of the node
_DARK: Final = 0.2  # chosen: how much greener grooves are than ridges
# A node's outline, chosen by eye from photographs of Capsicum: parts of its length, and of its swelling. It
# swells slowly from below, is widest above its middle, and steps back above that collar.
_OUTLINE: Final = np.array(
    [[0.0, 0.0], [0.1, 0.13], [0.23, 0.55], [0.4, 0.91], [0.57, 1.0], [0.68, 0.78], [0.82, 0.28], [1.0, 0.0]]
)
_LUMPS: Final = 0.035  # chosen: depth of the hollows between a node's bulges over its radius
_NODE_POINTS: Final = 7  # chosen: enough for a smooth bend of some degrees
_NODE_STEPS: Final = 24  # chosen: pieces of a node's bent axis, most of which its rings miss by little
_CORK: Final = 0.15  # chosen: how much further a node's collar has browned than the rest


def internodes(organs: Sequence[Organ], detail: float) -> MeshBatch:
    """Main stem sections: angular, with four or five uneven ridges that fade into the nodes.

    Measures: radius_m (base, over the ridges), radius_tip_m, groove_m (depth between ridges), seed,
    state_mean (at the base), state_tip, state_spread.
    """
    base, tip = size(organs, "radius_m"), size(organs, "radius_tip_m")
    part, angle = _section_rows(detail), circle(fineness(_SIDES, detail, 8))
    spine = centrelines(organs, max(8, 2 * len(part)))
    radius = base[:, None] + (tip - base)[:, None] * part
    # Ridges stand full but near the ends, where the section is as round as the node.
    edge = np.clip(np.minimum(part, 1.0 - part) / _FADING, 0.0, 1.0)
    full = edge**2 * (3.0 - 2.0 * edge)
    groove = _grooves(organ_measure(organs, "seed", 0.0), part, angle)
    depth = np.clip(organ_measure(organs, "groove_m", 0.0), 0.0, 0.5 * np.minimum(base, tip))
    reach = radius[..., None] - (depth[:, None] * full)[..., None] * groove
    right, up = centred(reach * np.sin(angle), reach * np.cos(angle), radius)
    # Grooves are greener than ridges, and the state runs on from one end to the other.
    along = spine.lengths[:, None] * part
    told = np.array(["state_tip" in organ.measures for organ in organs])
    rise = np.where(
        told, organ_measure(organs, "state_tip", 0.0) - organ_measure(organs, "state_mean", STATE), 0.0
    )
    state = rise[:, None, None] * part[:, None] + _DARK * full[:, None] * (groove - 0.5)
    rings = Rings(along, right, up, part, state + streaked(organs, along, len(angle)))
    return closed(spine, rings, rounded(base, spine.lengths), rounded(tip, spine.lengths))


def nodes(organs: Sequence[Organ], detail: float) -> MeshBatch:
    """Swellings between two stem sections: a shoulder, a corky collar, and a furrow above it.

    Measures: radius_m (widest), radius_end_m (upper end), radius_start_m (lower end; else as the upper),
    seed, state_mean, state_spread.
    """
    part, radius = _swelling(organs, detail)
    angle = circle(fineness(_SIDES, detail, 8))
    spine = _bent(organs)
    # It bulges to some sides, as if for what grows there; its ends are round as the sections' are.
    phase = 2.0 * np.pi * hashed(organ_measure(organs, "seed", 0.0), 103, 2)
    hollow = 0.5 - 0.3 * np.cos(2.0 * angle + phase[:, :1]) - 0.2 * np.cos(3.0 * angle + phase[:, 1:])
    share = np.sin(np.pi * part)[:, None]
    reach = radius[..., None] * (1.0 - _LUMPS * share * hollow[:, None, :])
    right, up = centred(reach * np.sin(angle), reach * np.cos(angle), radius)
    # Its collar is corky.
    state = -_CORK * np.exp(-(((part - 0.64) / 0.12) ** 2))[:, None]
    along = spine.lengths[:, None] * part
    rings = Rings(along, right, up, part, state + streaked(organs, along, len(angle)))
    return closed(spine, rings, *(rounded(radius[:, end], spine.lengths) for end in (0, -1)))


def stem_profile(plant: Plant) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The main stem's outline: `(k, 3)` points of its axis from the ground up, `(k,)` its radius there.

    Sections and swollen nodes, over their ridges; between the points the triangles of `mesh_plant` at
    detail 1 are straight, so what lies on this outline lies on them.

    Raises:
        ValueError: the plant has no stem.
    """
    sections, swellings = plant.of_form("internode"), plant.of_form("node")
    if not sections:
        raise ValueError("a plant without stem sections has no outline")
    # One after the other as they stand in the plant.
    order = {id(organ): number for number, organ in enumerate(plant.organs)}
    points, radii, number = [], [], []
    part = _section_rows(1.0)
    ends = np.stack([size(sections, "radius_m"), size(sections, "radius_tip_m")], axis=1)
    for organs, rows, radius in (
        (sections, part, ends[:, :1] + (ends[:, 1:] - ends[:, :1]) * part),
        (swellings, *_swelling(swellings, 1.0)),
    ):
        if organs:
            spine = _bent(organs) if organs is swellings else centrelines(organs, max(8, 2 * len(rows)))
            points.append(spine.frames(spine.lengths[:, None] * rows)[0].reshape(-1, 3))
            radii.append(radius.ravel())
            number.append(np.repeat([order[id(organ)] for organ in organs], len(rows)))
    turn = np.argsort(np.concatenate(number), kind="stable")
    axis, outline = np.concatenate(points)[turn], np.concatenate(radii)[turn]
    # Neighbours share their joints; a repeated point has no direction.
    apart = np.concatenate([[True], np.linalg.norm(np.diff(axis, axis=0), axis=1) > 1e-5])
    return axis[apart], outline[apart]


def stem_branches(plant: Plant) -> NDArray[np.float64]:
    """`(j, 4)` centre and radius, metres, of what grows out of the main stem, where it comes out of its side.

    Stalks, fruit stalks and scars, with their flared feet: what a twine must pass.
    """
    stem = {"internode", "node"}
    forms = [plant.kinds[organ.kind].form for organ in plant.organs]
    found = []
    for organ, form in zip(plant.organs, forms, strict=True):
        if (
            form in stem
            or organ.parent < 0
            or forms[organ.parent] not in stem
            or "radius_m" not in organ.measures
        ):
            continue
        # Feet start a fifth of the parent's radius below its surface.
        radius = organ.measures["radius_m"]
        start = organ.curve[1] - organ.curve[0]
        ahead = 0.35 * plant.organs[organ.parent].measures["radius_m"]
        centre = organ.curve[0] + ahead * start / max(float(np.linalg.norm(start)), 1e-9)
        found.append([*centre, 1.35 * radius])
    return np.array(found).reshape(-1, 4)


def _bent(organs: Sequence[Organ]) -> Spines:
    """Axes of nodes, which leave one section and run into the next without a kink.

    A node's curve is bent at its middle; its axis is the quadratic Bezier curve with that control point.
    """
    t = np.linspace(0.0, 1.0, _NODE_POINTS)[:, None]
    share = np.concatenate([(1.0 - t) ** 2, 2.0 * t * (1.0 - t), t**2], axis=1)
    curves = [share @ one.curve if len(one.curve) == 3 else one.curve for one in organs]
    return spines(curves, [one.up for one in organs], _NODE_STEPS)


def _section_rows(detail: float) -> NDArray[np.float64]:
    """Where a section's rings lie, in parts of its length: closer towards its ends, where ridges fade."""
    even = np.linspace(0.0, 1.0, fineness(4, detail, 2) + 1)
    return np.asarray(even - 0.9 * np.sin(2.0 * np.pi * even) / (2.0 * np.pi))


def _swelling(organs: Sequence[Organ], detail: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where nodes' rings lie `(r,)`, in parts of their length, and their radii `(n, r)` in metres."""
    pieces = len(_OUTLINE) - 1
    row = np.linspace(0.0, pieces, fineness(pieces, detail, 3) + 1)
    part, bulge = (np.interp(row, np.arange(pieces + 1), column) for column in _OUTLINE.T)
    if not organs:
        return part, np.empty((0, len(part)))
    # The widest ring is as wide as it is told.
    widest, end = size(organs, "radius_m"), size(organs, "radius_end_m")
    told = np.array(["radius_start_m" in organ.measures for organ in organs])
    start = np.where(told, organ_measure(organs, "radius_start_m", 1.0), end)
    straight = start[:, None] + (end - start)[:, None] * part
    return part, straight + (widest[:, None] - straight) * bulge / bulge.max()


def _grooves(
    seed: NDArray[np.float64], part: NDArray[np.float64], angle: NDArray[np.float64]
) -> NDArray[np.float64]:
    """`(n, r, c)` how far into a groove each point of sections is: 0 on the highest ridge, 1 in the deepest.

    Four or five ridges, unevenly far apart and unevenly high, wind a little about the section.
    """
    draw = hashed(seed, 101, 5)[..., None, None]
    count = np.where(draw[:, 0] < 0.5, 4.0, 5.0)
    place = angle + 0.25 * np.pi * (draw[:, 1] - 0.5) * part[:, None] + 2.0 * np.pi * draw[:, 2]
    wave = count * place + 0.5 * np.sin(place + 2.0 * np.pi * draw[:, 3])
    groove = np.abs(np.sin(0.5 * wave)) ** 1.5
    groove = groove + 0.25 * (1.0 - groove) * (0.5 + 0.5 * np.sin(place + 2.0 * np.pi * draw[:, 4]))
    low, high = groove.min(axis=2, keepdims=True), groove.max(axis=2, keepdims=True)
    return np.asarray((groove - low) / (high - low))
