"""Drawing varied values from the recipe's seed, the name of the draw, and the set, scene or moment."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from typing import Any

import numpy as np

from pepperscene.recipe.plan import FrameSpec, Stream
from pepperscene.recipe.variation.varied import LEVELS, Varied, json_value

Draws = tuple[tuple[Varied, Any], ...]
"""Varied values, each with the value that was drawn."""


def draw_values(variation: Iterable[Varied], seed: int, spec: FrameSpec) -> Draws:
    """The varied values of a recipe with the values of one frame.

    A value depends on the seed, its own draw and the frame's set, scene or moment, and on nothing else: a
    changed distribution leaves all other values as they were. Frames of the same moment, by other cameras of
    a rig or as twins, have the same values.
    """
    return tuple((varied, varied.value(*_draw(varied, seed, spec))) for varied in variation)


def _draw(varied: Varied, seed: int, spec: FrameSpec) -> tuple[float, int]:
    """Probability in [0, 1) of a value, and the number of the set, scene or moment."""
    address = {"set": (spec.set,), "scene": (spec.set, spec.rotation), "frame": (spec.moment,)}[varied.per]
    turn = {"set": spec.set, "scene": spec.scene, "frame": spec.moment}[varied.per]
    words = np.frombuffer(hashlib.sha256(varied.draw.encode()).digest()[:16], "<u4")
    key = (int(Stream.VARIATION), LEVELS.index(varied.per), *address, *(int(word) for word in words))
    probability = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key)).random()
    return (1.0 - probability if varied.reversed else probability), turn


def as_json(draws: Draws) -> dict[str, Any]:
    """Drawn values by dotted key, ready for JSON."""
    return {varied.name: json_value(value) for varied, value in draws}
