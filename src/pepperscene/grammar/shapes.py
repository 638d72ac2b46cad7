"""Centrelines and measures of organs on nodes and stalks, all organs of one kind and level at once.

Angles are in the vertical plane of an organ's azimuth; inclinations are above the horizontal.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from pepperscene.cultivar import CALYX, OrganKind
from pepperscene.grammar.frames import Sites, StalkFrames, direction, polylines, segment_midpoints, upper_side
from pepperscene.grammar.hashing import FloatArray
from pepperscene.grammar.plant import KindParameters, Organ

NumberedOrgans = list[tuple[int, Organ]]


def make_organs(
    kind: str, parts: KindParameters, curves: FloatArray, up: FloatArray, measures: Mapping[str, FloatArray]
) -> NumberedOrgans:
    """Make `n` organs of one kind, with their numbers in the plant.

    Args:
        kind: its name.
        parts: their parameters.
        curves: `(n, k, 3)` centrelines.
        up: `(n, 3)` upper sides.
        measures: name -> `(n,)`.
    """
    indices = (parts.number, parts.parent, parts.phytomer)
    columns = [column.tolist() for column in (*indices, *measures.values())]
    return [
        (number, Organ(kind, parent, phytomer, curve, side, dict(zip(measures, row, strict=True))))
        for curve, side, number, parent, phytomer, *row in zip(curves, up, *columns, strict=True)
    ]


STALK_POINTS: Final = 10
BLADE_POINTS: Final = 14

# Chosen from photographs:
_JOINT: Final = 0.12  # the bend from a stalk into its blade takes about this fraction of the midrib
_CALYX_HEIGHT: Final = 0.05  # of the fruit's diameter
_FLOWER_DEPTH: Final = 0.3  # of the flower's diameter

_MEASURE_NAMES: Final[Mapping[str, str]] = {
    "length": "length_m",
    "width": "width_m",
    "diameter": "diameter_m",
    "groove": "groove_m",
    "fold": "fold_rad",
    "curl": "curl_rad",
    "rolled": "rolled_rad",
    "twist": "twist_rad",
    "bend": "bend_rad",
    "margin_wave": "margin_wave_m",
    "blister": "blister_m",
    "vein": "vein_m",
    "bite_width": "bite_width_m",
    "tooth_depth": "tooth_depth_m",
    "state": "state_mean",
}
"""Parameters whose measure has another name, in which lengths and angles have their unit."""


def build_kind(
    name: str, kind: OrganKind, sites: Sites, hang: FloatArray, frames: StalkFrames
) -> NumberedOrgans:
    """Build the organs of one kind and level.

    Args:
        name: of the kind.
        kind: its form.
        sites: where they start.
        hang: inclination of the blade at the tip of each organ of the plant, by number; NaN without one.
        frames: of the plant's stalks; new ones are added.
    """
    match kind.form:
        case "stalk" | "peduncle":
            return _build_stalks(name, sites, hang[sites.parts.number], frames)
        case "blade":
            return _build_blades(name, sites)
        case "fruit":
            return _build_fruits(name, sites)
        case "cut":
            return _build_cuts(name, sites)
        case "flower":
            return _build_flowers(name, sites)
    raise ValueError(f"{name} is a {kind.form}, which does not branch off")


def _build_stalks(name: str, sites: Sites, hang: FloatArray, frames: StalkFrames) -> NumberedOrgans:
    """Petioles, side shoots, rachises, peduncles; added to the frames, so that others can grow on them."""
    values, s = sites.parts.values, segment_midpoints(STALK_POINTS)
    base = values["inclination"]
    extra_measures: tuple[str, ...] = ()
    if sites.parts.kind.form == "peduncle":
        # An even bend from its parent to the calyx.
        bend = values["end_inclination"] - base
        more = sway = np.zeros(len(sites.parts))
    else:
        # Bent evenly, and towards the blade at the tip, if there is one.
        bend, sway, extra_measures = values["bend"], values["sway"], ("channel", "state_spread")
        more = np.where(np.isnan(hang), 0.0, values["towards"] * (hang - (base + bend)))
    # A stalk bends more towards its tip, where it is thinner.
    slopes = base[:, None] + bend[:, None] * s + more[:, None] * s**1.5
    steps = direction(sites.heading[:, None], slopes, sway[:, None] * s)
    curves = polylines(sites.start, steps, values["length"])
    roll, radius = sites.roll(slopes[:, 0], steps[:, 0]), 0.5 * values["diameter"]
    shape = {"azimuth": sites.heading, "base": base, "bend": bend, "more": more, "sway": sway, "roll": roll}
    frames.add(sites.parts.number, **shape, radius=radius, line=curves)
    measures = {"radius_m": radius, "radius_tip_m": radius * values["tip"]}
    measures |= select_measures(values, ("seed", "state", *extra_measures))
    up = upper_side(sites.heading, slopes[:, 0], steps[:, 0], roll)
    return make_organs(name, sites.parts, curves, up, measures)


def _build_blades(name: str, sites: Sites) -> NumberedOrgans:
    """Blades; one at the tip of a stalk leaves it without a kink, and soon hangs."""
    values, s = sites.parts.values, segment_midpoints(BLADE_POINTS)
    hang = blade_hang(values)
    slopes = hang[:, None] - values["droop"][:, None] * s
    # The joint: from the stalk's end slope into the even droop; over at the middle of the midrib, where the
    # cultivar states the inclination.
    joint = np.where(sites.continues, sites.slope - hang, 0.0)
    middle = np.exp(-0.5 / _JOINT)
    slopes += joint[:, None] * (np.exp(-s / _JOINT) - middle) / (1.0 - middle)
    sway = sites.sway[:, None] + values["sway"][:, None] * s
    steps = direction(sites.azimuth[:, None], slopes, sway)
    roll = sites.roll(slopes[:, 0], steps[:, 0]) + values["roll"]
    up = upper_side(sites.azimuth, slopes[:, 0], steps[:, 0], roll)
    shape = ("fold", "curl", "rolled", "twist", "margin_wave", "margin_waves", "blister", "vein", "asymmetry")
    outline = ("widest", "base", "lobes", "lobe_depth", "palmate", "sinus", "teeth", "tooth_depth")
    damage = ("bites", "bite_width", "tears", "tear_depth", "residue", "ageing")
    names = ("length", "width", *shape, *outline, *damage, "seed", "state", "state_spread")
    curves = polylines(sites.start, steps, values["length"])
    return make_organs(name, sites.parts, curves, up, select_measures(values, names))


def blade_hang(values: Mapping[str, FloatArray]) -> FloatArray:
    """`(n,)` inclination of blades at their base, without the joint to a stalk."""
    return np.asarray(values["inclination"] + 0.5 * values["droop"])


def _build_fruits(name: str, sites: Sites) -> NumberedOrgans:
    """Fruit, each below its calyx; one of a kind without calyx hangs from its stalk's end."""
    values = sites.parts.values
    has_calyx = "calyx_radius" in values
    height = (_CALYX_HEIGHT if has_calyx else 0.0) * values["diameter"]
    length = values["diameter"] * values["slenderness"]
    axis, up = _axes(sites.heading + values["aside"], values["inclination"])
    stalk_end = sites.start + height[:, None] * axis
    shape = ("diameter", "lobes", "lobe_depth", "shoulder", "taper", "point", "bend", "neck", "neck_length")
    names = (*shape, "seed", "ripeness", "ripeness_spread", "residue")
    measures = {"length_m": length, **select_measures(values, names)}
    curves = _lines(stalk_end, axis, length)
    if not has_calyx:
        return make_organs(name, sites.parts, curves, up, measures)
    # The calyx is between the stalk and the fruit.
    number = sites.parts.number - 1
    calyx_parts, fruit_parts = replace(sites.parts, number=number), replace(sites.parts, parent=number)
    calyx_measures = {
        "radius_m": values["diameter"] * values["calyx_radius"],
        "tooth": values["calyx_tooth"],
        "seed": values["calyx_seed"],
        "state_mean": values["calyx_state"],
    }
    calyx = make_organs(CALYX, calyx_parts, _lines(sites.start, axis, height), up, calyx_measures)
    return calyx + make_organs(name, fruit_parts, curves, up, measures)


def _build_cuts(name: str, sites: Sites) -> NumberedOrgans:
    """Stumps of harvested fruit; the inset is added to their length."""
    values = sites.parts.values
    axis, up = _axes(sites.heading, values["inclination"])
    curves = _lines(sites.start, axis, sites.inset + values["length"])
    measures = {"radius_m": 0.5 * values["diameter"], "seed": values["seed"]}
    return make_organs(name, sites.parts, curves, up, measures)


def _build_flowers(name: str, sites: Sites) -> NumberedOrgans:
    """Flowers, from the end of their stalk to the plane of the petals when they are flat."""
    values = sites.parts.values
    axis, up = _axes(sites.heading, values["inclination"])
    curves = _lines(sites.start, axis, _FLOWER_DEPTH * values["diameter"])
    measures = select_measures(values, ("petals", "open", "seed", "state"))
    return make_organs(name, sites.parts, curves, up, {"radius_m": 0.5 * values["diameter"], **measures})


def _axes(azimuth: FloatArray, inclination: FloatArray) -> tuple[FloatArray, FloatArray]:
    """`(n, 3)` axes and their upper sides."""
    return direction(azimuth, inclination), direction(azimuth, inclination + 0.5 * np.pi)


def _lines(start: FloatArray, axis: FloatArray, length: FloatArray) -> FloatArray:
    """`(n, 2, 3)` lines of two points."""
    return np.stack((start, start + length[:, None] * axis), axis=1)


def select_measures(values: Mapping[str, FloatArray], names: tuple[str, ...]) -> dict[str, FloatArray]:
    """Parameters that are measures without conversion."""
    return {_MEASURE_NAMES.get(name, name): values[name] for name in names}
