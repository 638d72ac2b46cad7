"""The main stem's numbers: lengths, thickness, the line that it keeps, and states that run on."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from pepperscene.cultivar import Cultivar
from pepperscene.grammar.growth import Growth
from pepperscene.grammar.hashing import FloatArray, shares
from pepperscene.grammar.limits import possible

# Chosen, as a habit of growth that photographs show and no table has:
_TWINE_PULL: Final = 0.7  # sd, rad, of a section's azimuth about the way back to the plant's own line
_THICKER: Final = 1.1  # a node is never thinner than so many times its stem

Columns = dict[str, FloatArray]


def stem_columns(cultivar: Cultivar, growth: Growth, lean: float) -> tuple[Columns, Columns]:
    """The numbers of all internodes and of all nodes, by the names of `KindParameters.values`."""
    section, swelling = (
        cultivar.organs[cultivar.stem.internode].laws,
        cultivar.organs[cultivar.stem.node].laws,
    )
    sections, nodes, places, sizes = growth.sections, growth.nodes, growth.places, growth.sizes
    length = sizes * section["length"].quantiles(shares(sections, "length"), places)
    length = possible("length", length)
    azimuth, inclination = _directions(cultivar, growth, length, lean)
    mean, diameters = _diameters(cultivar, growth)
    # One deviation for the whole stem, so that a section ends as the next begins.
    joints = np.minimum(np.arange(growth.parts + 1) / max(growth.grown, 1), 1.0)
    deviation = np.broadcast_to(shares(growth.key, "state"), joints.shape)
    state = possible("state", section["state"].quantiles(deviation, joints))
    spread = np.broadcast_to(shares(growth.key, "state_spread"), places.shape)
    # Grooves are in proportion to the stem.
    depth = section["groove"].quantiles(np.broadcast_to(shares(growth.key, "groove"), joints.shape), joints)
    groove = possible("groove", depth * diameters / mean)
    width = sizes * swelling["width"].quantiles(shares(nodes, "width"), places)
    return {
        "length": length,
        "azimuth": azimuth,
        "inclination": inclination,
        "diameter": diameters[:-1],
        "diameter_tip": diameters[1:],
        "groove": groove[:-1],
        "state": state[:-1],
        "state_tip": state[1:],
        "state_spread": possible("state_spread", section["state_spread"].quantiles(spread, places)),
        "seed": shares(sections, "seed"),
    }, {
        "width": np.maximum(width, _THICKER * diameters[1:]),
        "length": possible("length", sizes * swelling["length"].quantiles(shares(nodes, "length"), places)),
        "diameter": diameters[1:],
        "groove": groove[1:],
        "state": possible("state", swelling["state"].quantiles(deviation[1:], joints[1:])),
        "seed": shares(nodes, "seed"),
    }


def _diameters(cultivar: Cultivar, growth: Growth) -> tuple[float, FloatArray]:
    """The drawn mean, and `(parts + 1,)` below and above each phytomer: tapering, and thinner where young."""
    stem = cultivar.stem
    mean = possible("diameter", np.array([growth.once(stem.diameter, "stem.diameter")]))[0]
    top = possible("tip", np.array([growth.once(stem.top_diameter, "stem.top_diameter")]))[0]
    slope = 2.0 * (1.0 - top) / (1.0 + top)
    place = np.minimum(np.arange(growth.parts + 1) / max(growth.grown, 1), 1.0)
    size = np.append(growth.sizes, growth.sizes[-1])
    return float(mean), np.asarray(mean * (1.0 + slope * (0.5 - place)) * np.sqrt(size))


def _directions(
    cultivar: Cultivar, growth: Growth, length: FloatArray, lean: float
) -> tuple[FloatArray, FloatArray]:
    """Azimuth and inclination of each section: aslant, and back to the line that the twine holds it to."""
    from scipy.special import ndtri

    stem = cultivar.stem
    aslant = np.sin(stem.zigzag.quantiles(shares(growth.sections, "zigzag"), growth.places))
    pull = _TWINE_PULL * ndtri(shares(growth.sections, "pull"))
    # The plant's own line, from which the stem must not stray: it leans across the row.
    line = -math.sin(growth.once(stem.lean, "stem.lean") + lean)
    back = 2.0 * math.pi * float(shares(growth.key, "stem.side")[0])
    x = y = 0.0
    azimuths, inclinations = np.empty(growth.parts), np.empty(growth.parts)
    for i, (share, turned, step) in enumerate(
        zip(aslant.tolist(), pull.tolist(), length.tolist(), strict=True)
    ):
        azimuth = back + turned
        level_x, level_y = share * math.sin(azimuth), -share * math.cos(azimuth)
        x, y = x + step * level_x, y + step * level_y
        back = math.atan2(-x, y)
        # A section's share of the way is level, the rest of it upwards.
        level_y += line
        azimuths[i] = math.atan2(level_x, -level_y)
        inclinations[i] = math.acos(min(math.hypot(level_x, level_y), 1.0))
    return azimuths, inclinations
