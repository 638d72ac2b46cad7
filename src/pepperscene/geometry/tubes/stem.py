"""The main stem: ridged internodes between swollen nodes, and the outline that twine rests on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from pepperscene.geometry.batch import (
    MeshBatch,
    form_indices,
    hash_uniform,
    read_measure,
    read_positive,
    subdivisions,
)
from pepperscene.geometry.mesh import FloatArray
from pepperscene.geometry.spine import Spines, organ_spines, spines
from pepperscene.geometry.tubes.tube import (
    DEFAULT_STATE,
    Rings,
    centre_rings,
    ring_angles,
    round_cap,
    state_with_streaks,
    sweep_rings,
)
from pepperscene.grammar.plant import Organ, Plant

_SIDES: Final = 14  # chosen: three points to a ridge; internodes and nodes share it, so that their rings meet
_FADING: Final = 0.12  # chosen: fraction of an internode within which its ridges rise out of the node
_GROOVE_STATE: Final = 0.2  # chosen: how much greener grooves are than ridges
# Outline of a node, chosen from photographs of Capsicum: fractions of its length and of its swelling.
# It swells slowly from below, is widest above its middle, and steps back above that collar.
_OUTLINE: Final = np.array(
    [[0.0, 0.0], [0.1, 0.13], [0.23, 0.55], [0.4, 0.91], [0.57, 1.0], [0.68, 0.78], [0.82, 0.28], [1.0, 0.0]]
)
_LUMPS: Final = 0.035  # chosen: depth of the hollows between a node's bulges over its radius
_NODE_POINTS: Final = 7  # chosen: enough for a smooth bend of some degrees
_NODE_STEPS: Final = 24  # chosen: pieces of a node's bent axis, so that its rings are close to the curve
_CORK: Final = 0.15  # chosen: how much browner the collar of a node is than the rest
# The corky scar of a leaf or bract that has dropped: fraction of nodes that show one, state of its cork,
# height of its middle, half its height and half its width in radians; chosen from photographs of stems.
_SCARRED: Final = 0.6
_SCAR_STATE: Final = 0.1
_SCAR: Final = 0.36, 0.14, 0.55


def mesh_internodes(organs: Sequence[Organ], detail: float) -> MeshBatch:
    """Build internodes with four or five uneven ridges that fade into the nodes.

    Measures: radius_m (base, over the ridges), radius_tip_m, groove_m (depth between ridges), seed,
    state_mean (at the base), state_tip, state_spread.
    """
    base, tip = read_positive(organs, "radius_m"), read_positive(organs, "radius_tip_m")
    v, angle = _internode_rows(detail), ring_angles(subdivisions(_SIDES, detail, 8))
    spine = organ_spines(organs, max(8, 2 * len(v)))
    radius = base[:, None] + (tip - base)[:, None] * v
    # Ridges have their full height except near the ends, where the section is as round as the node.
    edge = np.clip(np.minimum(v, 1.0 - v) / _FADING, 0.0, 1.0)
    height = edge**2 * (3.0 - 2.0 * edge)
    groove = _grooves(read_measure(organs, "seed", 0.0), v, angle)
    depth = np.clip(read_measure(organs, "groove_m", 0.0), 0.0, 0.5 * np.minimum(base, tip))
    reach = radius[..., None] - (depth[:, None] * height)[..., None] * groove
    right, up = centre_rings(reach * np.sin(angle), reach * np.cos(angle), radius)
    # The state changes linearly from base to tip; grooves are greener than ridges.
    along = spine.lengths[:, None] * v
    mean = read_measure(organs, "state_mean", DEFAULT_STATE)
    rise = read_measure(organs, "state_tip", mean) - mean
    state = rise[:, None, None] * v[:, None] + _GROOVE_STATE * height[:, None] * (groove - 0.5)
    rings = Rings(along, right, up, v, state + state_with_streaks(organs, along, len(angle)))
    return sweep_rings(spine, rings, round_cap(base, spine.lengths), round_cap(tip, spine.lengths))


def mesh_nodes(organs: Sequence[Organ], detail: float) -> MeshBatch:
    """Build the swellings between two internodes: a shoulder, a corky collar, and a furrow above it.

    More than half of them show the corky scar of a leaf.

    Measures: radius_m (widest), radius_end_m (upper end), radius_start_m (lower end; default: as the upper),
    seed, state_mean, state_spread.
    """
    v, radius = _node_profile(organs, detail)
    angle = ring_angles(subdivisions(_SIDES, detail, 8))
    spine = _node_spines(organs)
    # It bulges to some sides, as if for organs that grow there; its ends are as round as the internodes.
    phase = 2.0 * np.pi * hash_uniform(read_measure(organs, "seed", 0.0), 103, 2)
    hollow = 0.5 - 0.3 * np.cos(2.0 * angle + phase[:, :1]) - 0.2 * np.cos(3.0 * angle + phase[:, 1:])
    reach = radius[..., None] * (1.0 - _LUMPS * np.sin(np.pi * v)[:, None] * hollow[:, None, :])
    right, up = centre_rings(reach * np.sin(angle), reach * np.cos(angle), radius)
    cork = -_CORK * np.exp(-(((v - 0.64) / 0.12) ** 2))[:, None]
    along = spine.lengths[:, None] * v
    state = cork + state_with_streaks(organs, along, len(angle))
    state = state + _leaf_scars(organs, v, angle) * (_SCAR_STATE - state)
    rings = Rings(along, right, up, v, state)
    return sweep_rings(spine, rings, *(round_cap(radius[:, end], spine.lengths) for end in (0, -1)))


def _leaf_scars(organs: Sequence[Organ], v: FloatArray, angle: FloatArray) -> FloatArray:
    """`(n, r, c)` cover with the cork of leaf scars: an ellipse on one side of a node, or nothing."""
    draw = hash_uniform(read_measure(organs, "seed", 0.0), 107, 2)
    # On a column of the grid, so that it is as wide on a coarse mesh.
    side = 2.0 * np.pi * np.floor(draw[:, :1] * len(angle)) / len(angle)
    off = (angle - side + np.pi) % (2.0 * np.pi) - np.pi
    middle, high, wide = _SCAR
    distance = np.hypot((v[:, None] - middle) / high, (off / wide)[:, None, :])
    return np.clip(1.5 - distance, 0.0, 1.0) * (draw[:, 1] < _SCARRED)[:, None, None]


def stem_profile(plant: Plant) -> tuple[FloatArray, FloatArray]:
    """Compute the outline of the main stem over its ridges, in metres.

    Between the points the triangles of `mesh_plant` at detail 1 are straight, so the outline is on them.

    Returns:
        `(k, 3)` points of the stem's axis from the ground up, and `(k,)` its radius there.

    Raises:
        ValueError: the plant has no stem.
    """
    points, radii, numbers = [], [], []
    for form in ("internode", "node"):
        indices = form_indices(plant, form)
        organs = [plant.organs[index] for index in indices]
        if form == "internode":
            if not organs:
                raise ValueError("a plant without internodes has no stem outline")
            v = _internode_rows(1.0)
            ends = np.stack([read_positive(organs, f"radius{end}_m") for end in ("", "_tip")], axis=1)
            spine, radius = organ_spines(organs, max(8, 2 * len(v))), ends[:, :1] + np.diff(ends) * v
        elif organs:
            spine, (v, radius) = _node_spines(organs), _node_profile(organs, 1.0)
        if organs:
            points.append(spine.frames(spine.lengths[:, None] * v)[0].reshape(-1, 3))
            radii.append(radius.ravel())
            numbers.append(np.repeat(indices, len(v)))
    # Internodes and nodes in the order of the plant.
    order = np.argsort(np.concatenate(numbers), kind="stable")
    axis, outline = np.concatenate(points)[order], np.concatenate(radii)[order]
    # Neighbours share the point of their joint; a repeated point has no direction.
    distinct = np.concatenate([[True], np.linalg.norm(np.diff(axis, axis=0), axis=1) > 1e-5])
    return axis[distinct], outline[distinct]


def stem_branches(plant: Plant) -> FloatArray:
    """Find the positions where organs grow out of the main stem, which the twine must avoid.

    Returns:
        `(j, 4)` centre and radius, metres, of stalks, fruit stalks and scars with their flared feet.
    """
    stem = {"internode", "node"}
    forms = [plant.kinds[organ.kind].form for organ in plant.organs]
    branches = []
    for organ, form in zip(plant.organs, forms, strict=True):
        if form in stem or organ.parent < 0 or forms[organ.parent] not in stem:
            continue
        radius = organ.measures.get("radius_m")
        if radius is None:
            continue
        # Feet start a fifth of the parent's radius below its surface.
        start = organ.curve[1] - organ.curve[0]
        offset = 0.35 * plant.organs[organ.parent].measures["radius_m"]
        centre = organ.curve[0] + offset * start / max(float(np.linalg.norm(start)), 1e-9)
        branches.append([*centre, 1.35 * radius])
    return np.array(branches).reshape(-1, 4)


def _node_spines(organs: Sequence[Organ]) -> Spines:
    """Axes of nodes, which join the internodes without a kink.

    The curve of a node is bent at its middle; its axis is the quadratic Bezier curve with that control point.
    """
    t = np.linspace(0.0, 1.0, _NODE_POINTS)[:, None]
    weights = np.concatenate([(1.0 - t) ** 2, 2.0 * t * (1.0 - t), t**2], axis=1)
    curves = [weights @ organ.curve if len(organ.curve) == 3 else organ.curve for organ in organs]
    return spines(curves, [organ.up for organ in organs], _NODE_STEPS)


def _internode_rows(detail: float) -> FloatArray:
    """`(r,)` v of the rings of internodes: closer towards the ends, where ridges fade."""
    even = np.linspace(0.0, 1.0, subdivisions(4, detail, 2) + 1)
    return np.asarray(even - 0.9 * np.sin(2.0 * np.pi * even) / (2.0 * np.pi))


def _node_profile(organs: Sequence[Organ], detail: float) -> tuple[FloatArray, FloatArray]:
    """`(r,)` v of the rings of nodes, and `(n, r)` their radii in metres."""
    pieces = len(_OUTLINE) - 1
    row = np.linspace(0.0, pieces, subdivisions(pieces, detail, 3) + 1)
    v, bulge = (np.interp(row, np.arange(pieces + 1), column) for column in _OUTLINE.T)
    # The widest ring has the stated radius.
    widest, end = read_positive(organs, "radius_m"), read_positive(organs, "radius_end_m")
    start = read_measure(organs, "radius_start_m", end)
    linear = start[:, None] + (end - start)[:, None] * v
    return v, linear + (widest[:, None] - linear) * bulge / bulge.max()


def _grooves(seed: FloatArray, v: FloatArray, angle: FloatArray) -> FloatArray:
    """`(n, r, c)` groove depth at each point: 0 on the highest ridge, 1 in the deepest groove.

    Four or five ridges, unevenly spaced and unevenly high, wind a little about the internode.
    """
    draw = hash_uniform(seed, 101, 5)[..., None, None]
    count = np.where(draw[:, 0] < 0.5, 4.0, 5.0)
    position = angle + 0.25 * np.pi * (draw[:, 1] - 0.5) * v[:, None] + 2.0 * np.pi * draw[:, 2]
    wave = count * position + 0.5 * np.sin(position + 2.0 * np.pi * draw[:, 3])
    groove = np.abs(np.sin(0.5 * wave)) ** 1.5
    groove = groove + 0.25 * (1.0 - groove) * (0.5 + 0.5 * np.sin(position + 2.0 * np.pi * draw[:, 4]))
    low, high = groove.min(axis=2, keepdims=True), groove.max(axis=2, keepdims=True)
    return np.asarray((groove - low) / (high - low))
