"""Checks of drawn values: of a frame against its index and seed, of all frames against distributions."""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any, Final

import numpy as np

from pepperscene.errors import short_repr
from pepperscene.recipe.plan import FrameSpec, Plan
from pepperscene.recipe.rig import FIRST_CAMERA
from pepperscene.recipe.variation.goodness_of_fit import as_number, distinct_draws, goodness_of_fit
from pepperscene.recipe.variation.recorded import read_variation, recorded_draws, recorded_twins, same_value
from pepperscene.recipe.variation.varied import Varied
from pepperscene.review.check.findings import json_object

_UNLIKELY: Final = 1e-4
"""Chosen: a probability that one of ten thousand correct values has by chance."""


def check_drawn(recipe: Mapping[str, Any], spec: FrameSpec, metadata: Mapping[str, Any]) -> Iterator[str]:
    """Yield the contradictions between a frame's JSON and the recipe of `dataset.json`.

    Index and seed determine the values, so no other frame is needed. An invalid record in `dataset.json` is
    a finding of that file, not of every frame.
    """
    with suppress(ValueError, LookupError, TypeError, AttributeError):
        expected = recorded_draws(recipe, read_variation(recipe), spec)
        yield from _check_shared(recipe, spec, metadata)
        drawn = json_object(metadata, "drawn")
        for name, value in expected.items():
            if name not in drawn:
                yield f"has no drawn value {name}; by its index and seed it must be {value!r}"
            elif not same_value(value, drawn[name]):
                found = f"has the drawn value {name} = {short_repr(drawn[name])}"
                yield f"{found}; by its index and seed it must be {value!r}"
        for name in sorted(drawn.keys() - expected.keys()):
            yield f"has the drawn value {name}, which the recipe does not vary"


def _check_shared(recipe: Mapping[str, Any], spec: FrameSpec, metadata: Mapping[str, Any]) -> Iterator[str]:
    """Yield wrong numbers of the moment and the twin, and wrong names of the camera on the rig."""
    expected: dict[str, Any] = {}
    if recorded_twins(recipe):
        expected |= {"moment": spec.moment, "twin": spec.twin}
    if rig := recipe.get("rig"):
        name = rig[spec.camera - 1]["name"] if spec.camera else FIRST_CAMERA
        expected |= {"moment": spec.moment, "rig_camera": name}
    for key, value in expected.items():
        if metadata.get(key) != value:
            yield f"has {key} = {short_repr(metadata.get(key))}; by the plan it must be {value!r}"


class DrawnValues:
    """Accumulates the drawn values of frames, and compares them with their distributions.

    Args:
        info: the content of `dataset.json`; if it is not valid, there is nothing to compare.
    """

    def __init__(self, info: Mapping[str, Any]) -> None:
        self._variation: tuple[Varied, ...] = ()
        recipe = json_object(info, "recipe")
        with suppress(ValueError, LookupError, TypeError):
            self._plan = Plan.model_validate(recipe["plan"])
            twins = recorded_twins(recipe)
            # The values of twins are not drawn.
            self._variation = tuple(item for item in read_variation(recipe) if item.name not in twins)
        self._indices = array("q")
        self._numbers = {varied.name: array("d") for varied in self._variation}

    def add(self, index: int, drawn: Mapping[str, Any]) -> None:
        """Add the drawn values of a frame, by dotted key, as in its JSON."""
        if not self._variation or not 0 <= index < self._plan.count:
            return
        self._indices.append(index)
        for varied in self._variation:
            self._numbers[varied.name].append(as_number(varied, drawn.get(varied.name)))

    def notes(self) -> Iterator[str]:
        """Yield a note for each value whose draws do not fit its distribution."""
        for varied in self._variation:
            numbers = np.array(self._numbers[varied.name])
            draws = distinct_draws(varied, self._plan, self._indices, numbers)
            p = goodness_of_fit(varied, draws)
            if p is not None and p < _UNLIKELY:
                yield (
                    f"the {len(draws)} draws of {varied.name} do not fit the recipe's distribution, "
                    f"{varied.describe()}: such draws have a probability of {p:.1g}"
                )
