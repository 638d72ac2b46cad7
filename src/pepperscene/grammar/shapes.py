"""Centrelines and measures of what grows on nodes and stalks, all organs of one kind and level at once.

Angles lie in the vertical plane of an organ's azimuth: inclinations are above the horizontal.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from pepperscene.cultivar import CALYX
from pepperscene.grammar.frames import FloatArray, Sites, StalkFrames, chains, direction, middles, upper_side
from pepperscene.grammar.plant import Indices, Organ


@dataclass(frozen=True, eq=False)
class OrganBatch:
    """`n` organs of one kind.

    Attributes:
        kind: its name.
        number: `(n,)` of each in the plant.
        parent: `(n,)` number of what each grows out of.
        phytomer: `(n,)` where they stand.
        curves: `(n, k, 3)` centrelines.
        up: `(n, 3)` upper sides.
        measures: name -> `(n,)`.
    """

    kind: str
    number: Indices
    parent: Indices
    phytomer: Indices
    curves: FloatArray
    up: FloatArray
    measures: Mapping[str, FloatArray]

    def enter(self, organs: list[Organ | None]) -> None:
        """Put the organs at their places in the plant's list."""
        names = tuple(self.measures)
        columns = [column.tolist() for column in self.measures.values()]
        where = zip(self.number.tolist(), self.parent.tolist(), self.phytomer.tolist(), strict=True)
        rows = zip(where, self.curves, self.up, zip(*columns, strict=True), strict=True)
        for (number, parent, phytomer), curve, up, row in rows:
            organs[number] = Organ(self.kind, parent, phytomer, curve, up, dict(zip(names, row, strict=True)))


STALK_POINTS: Final = 10
BLADE_POINTS: Final = 14

# Chosen from photographs:
_JOINT: Final = 0.12  # the bend from a stalk into its blade is taken within about this share of the midrib
_CALYX_HEIGHT: Final = 0.05  # of the fruit's diameter
_FLOWER_DEPTH: Final = 0.3  # of the flower's diameter

_MEASURED: Final[Mapping[str, str]] = {
    "length": "length_m",
    "width": "width_m",
    "diameter": "diameter_m",
    "fold": "fold_rad",
    "curl": "curl_rad",
    "twist": "twist_rad",
    "bend": "bend_rad",
    "margin_wave": "margin_wave_m",
    "blister": "blister_m",
    "vein": "vein_m",
    "state": "state_mean",
}
"""Names of parameters where a measure has another; lengths and angles say their unit there."""


def stalks(name: str, sites: Sites, hang: FloatArray, frames: StalkFrames) -> list[OrganBatch]:
    """Petioles, side shoots, rachises: bent evenly, and towards the blade at their tip, if there is one.

    Args:
        name: of the kind.
        sites: where they start.
        hang: `(n,)` inclination to which the blade at their tip hangs at first; not a number without one.
        frames: of the plant's stalks, to which these are added.
    """
    one, s = sites.parts.values, middles(STALK_POINTS)
    end = one["inclination"] + one["bend"]
    more = np.where(np.isnan(hang), 0.0, one["towards"] * (hang - end))
    # A stalk bends more the farther out, where it is thinner.
    slopes = one["inclination"][:, None] + one["bend"][:, None] * s + more[:, None] * s**1.5
    return [_tube(name, sites, slopes, one["bend"], more, one["sway"], frames, ("channel", "state_spread"))]


def peduncles(name: str, sites: Sites, frames: StalkFrames) -> list[OrganBatch]:
    """Stalks of fruit: an even bend from what bears them to the calyx."""
    one, s = sites.parts.values, middles(STALK_POINTS)
    bend, none = one["end_inclination"] - one["inclination"], np.zeros(len(sites.parts))
    slopes = one["inclination"][:, None] + bend[:, None] * s
    return [_tube(name, sites, slopes, bend, none, none, frames, ())]


def _tube(
    name: str,
    sites: Sites,
    slopes: FloatArray,
    bend: FloatArray,
    more: FloatArray,
    sway: FloatArray,
    frames: StalkFrames,
    measured: tuple[str, ...],
) -> OrganBatch:
    """Stalks of `(n, k)` slopes, which others can grow on from now on."""
    one = sites.parts.values
    steps = direction(sites.heading[:, None], slopes, sway[:, None] * middles(STALK_POINTS))
    curves = chains(sites.start, steps, one["length"])
    roll = sites.roll(slopes[:, 0], steps[:, 0])
    radius = 0.5 * one["diameter"]
    frames.add(
        sites.parts.number,
        azimuth=sites.heading,
        base=one["inclination"],
        bend=bend,
        more=more,
        sway=sway,
        roll=roll,
        radius=radius,
        line=curves,
    )
    measures = {"radius_m": radius, "radius_tip_m": radius * one["tip"]}
    measures |= _measures(one, ("seed", "state", *measured))
    up = upper_side(sites.heading, slopes[:, 0], steps[:, 0], roll)
    return _bodies(name, sites, curves, up, measures)


def blades(name: str, sites: Sites) -> list[OrganBatch]:
    """Blades; one at the tip of a stalk leaves it without a kink, and soon hangs."""
    one, s = sites.parts.values, middles(BLADE_POINTS)
    hang = blade_hang(one)
    slopes = hang[:, None] - one["droop"][:, None] * s
    # The midrib: from the stalk's end slope into an even droop about its middle.
    joint = np.where(sites.continues, sites.slope - hang, 0.0)
    # It is over half-way along, where the law tells the inclination.
    left = np.exp(-0.5 / _JOINT)
    slopes += joint[:, None] * (np.exp(-s / _JOINT) - left) / (1.0 - left)
    swayed = sites.sway[:, None] + one["sway"][:, None] * s
    steps = direction(sites.azimuth[:, None], slopes, swayed)
    roll = sites.roll(slopes[:, 0], steps[:, 0]) + one["roll"]
    up = upper_side(sites.azimuth, slopes[:, 0], steps[:, 0], roll)
    shape = ("fold", "curl", "twist", "margin_wave", "margin_waves", "blister", "vein", "asymmetry")
    outline = ("widest", "base", "lobes", "lobe_depth")
    measures = _measures(one, ("length", "width", *shape, *outline, "seed", "state", "state_spread"))
    return [_bodies(name, sites, chains(sites.start, steps, one["length"]), up, measures)]


def blade_hang(one: Mapping[str, FloatArray]) -> FloatArray:
    """`(n,)` inclination of blades at their base, but for the joint with a stalk."""
    return np.asarray(one["inclination"] + 0.5 * one["droop"])


def fruits(name: str, sites: Sites) -> list[OrganBatch]:
    """Fruit, each below its calyx; one of a kind without calyx hangs from its stalk's end."""
    one = sites.parts.values
    capped = "calyx_radius" in one
    height = (_CALYX_HEIGHT if capped else 0.0) * one["diameter"]
    length = one["diameter"] * one["slenderness"]
    axis, up = _axes(sites.heading + one["aside"], one["inclination"])
    end = sites.start + height[:, None] * axis
    shape = ("diameter", "lobes", "lobe_depth", "shoulder", "taper", "point", "bend")
    measures = {"length_m": length, **_measures(one, (*shape, "seed", "ripeness", "ripeness_spread"))}
    fruit = _bodies(name, sites, _straight(end, axis, length), up, measures)
    if not capped:
        return [fruit]
    # The calyx stands between the stalk and the fruit.
    calyx = sites.parts.number - 1
    body = {
        "radius_m": one["diameter"] * one["calyx_radius"],
        "tooth": one["calyx_tooth"],
        "seed": one["calyx_seed"],
        "state_mean": one["calyx_state"],
    }
    cap = _bodies(CALYX, sites, _straight(sites.start, axis, height), up, body)
    return [replace(cap, number=calyx), replace(fruit, parent=calyx)]


def cuts(name: str, sites: Sites) -> list[OrganBatch]:
    """Stumps of harvested fruit; each must reach out of what it starts in."""
    one = sites.parts.values
    axis, up = _axes(sites.heading, one["inclination"])
    curves = _straight(sites.start, axis, sites.inset + one["length"])
    return [_bodies(name, sites, curves, up, {"radius_m": 0.5 * one["diameter"], "seed": one["seed"]})]


def flowers(name: str, sites: Sites) -> list[OrganBatch]:
    """Flowers, from the end of their stalk to the plane in which the petals lie when they are flat."""
    one = sites.parts.values
    axis, up = _axes(sites.heading, one["inclination"])
    curves = _straight(sites.start, axis, _FLOWER_DEPTH * one["diameter"])
    measures = {"radius_m": 0.5 * one["diameter"], **_measures(one, ("petals", "open", "seed", "state"))}
    return [_bodies(name, sites, curves, up, measures)]


def _axes(azimuth: FloatArray, inclination: FloatArray) -> tuple[FloatArray, FloatArray]:
    """`(n, 3)` axes and the upper sides across them."""
    return direction(azimuth, inclination), direction(azimuth, inclination + 0.5 * np.pi)


def _straight(start: FloatArray, axis: FloatArray, length: FloatArray) -> FloatArray:
    """`(n, 2, 3)` lines of two points."""
    return np.stack((start, start + length[:, None] * axis), axis=1)


def _measures(one: Mapping[str, FloatArray], names: tuple[str, ...]) -> dict[str, FloatArray]:
    """Parameters that are measures as they stand."""
    return {_MEASURED.get(name, name): one[name] for name in names}


def _bodies(
    name: str, sites: Sites, curves: FloatArray, up: FloatArray, measures: dict[str, FloatArray]
) -> OrganBatch:
    parts = sites.parts
    return OrganBatch(name, parts.number, parts.parent, parts.phytomer, curves, up, measures)
