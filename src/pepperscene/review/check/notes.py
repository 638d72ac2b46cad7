"""Notes on all frames of a set: outlier scenes, drawn values, exposures and rendering errors."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from pepperscene.frame import RenderingErrors
from pepperscene.recipe.camera_tables import AUTO
from pepperscene.recipe.plan import Plan
from pepperscene.recipe.variation.recorded import (
    as_number,
    distinct_draws,
    goodness_of_fit,
    read_variation,
    recorded_twins,
)
from pepperscene.review.check.one_frame import FrameTraits
from pepperscene.review.check.whole_set import STATISTICS, describe_statistic, known_values

_MIN_SCENES: Final = 8  # chosen: with fewer, no scene is an outlier
_OUTLIER_DEVIATIONS: Final = 6.0  # chosen: robust; of 42 scenes with nine numbers each, none by chance
_MAD_TO_SD: Final = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""

_UNLIKELY: Final = 1e-4
"""Chosen: a probability that one of ten thousand correct values has by chance."""

_DARK: Final = 40.0
"""Chosen: mean grey value. The photographs of Barth et al. 2018, by flash in the dark, have 37."""
_BRIGHT: Final = 180.0  # chosen: mean grey value; leaves of such photographs are nearly white
_SATURATED: Final = 0.05  # chosen: fraction of the pixels; well exposed daylight has a tenth of it
_LONGEST_NAME: Final = 40  # chosen: of a limit in a note


def notes(frames: Sequence[FrameTraits], info: Mapping[str, Any]) -> Iterator[str]:
    """Yield what is unusual but valid.

    Args:
        frames: all frames of the set.
        info: the content of `dataset.json`, of valid types, or empty.
    """
    yield from outlier_scenes(frames)
    if info:
        yield from unlikely_draws(frames, info["recipe"])
    yield from exposure_notes(frames, info)
    errors = RenderingErrors()
    for frame in frames:
        errors.add(*(frame.sampling.get(name) for name in ("target", "error_codes", "noise_codes")))
    yield from errors.notes()


def outlier_scenes(frames: Sequence[FrameTraits]) -> Iterator[str]:
    """Yield scenes whose means differ strongly from those of the others."""
    for name in STATISTICS:
        _, scenes, means = known_values(frames, name)
        if len(scenes) < _MIN_SCENES:
            continue
        centre = np.median(means)
        distances = np.abs(means - centre)
        limit = _OUTLIER_DEVIATIONS * _MAD_TO_SD * np.median(distances)
        for scene, mean in zip(scenes[distances > limit], means[distances > limit], strict=True):
            set_index, rotation = divmod(int(scene), 1000)
            text = f"{describe_statistic(name)} {mean:.4g}, median of all scenes {centre:.4g}"
            if limit > 0:
                yield f"set {set_index}, rotation {rotation} is an outlier: {text}"


def unlikely_draws(frames: Sequence[FrameTraits], recipe: Mapping[str, Any]) -> Iterator[str]:
    """Yield a note for each value whose draws do not fit its distribution."""
    plan, twins = Plan.model_validate(recipe["plan"]), recorded_twins(recipe)
    inside = [frame for frame in frames if frame.index < plan.count]
    indices = np.array([frame.index for frame in inside], np.int64)
    for varied in read_variation(recipe):
        # The values of twins are not drawn.
        if varied.name in twins:
            continue
        numbers = np.array([as_number(varied, frame.drawn.get(varied.name)) for frame in inside], float)
        draws = distinct_draws(varied, plan, indices, numbers)
        p = goodness_of_fit(varied, draws)
        if p is not None and p < _UNLIKELY:
            yield (
                f"the {len(draws)} draws of {varied.name} do not fit the recipe's distribution, "
                f"{varied.describe()}: such draws have a probability of {p:.1g}"
            )


def exposure_notes(frames: Sequence[FrameTraits], info: Mapping[str, Any]) -> Iterator[str]:
    """Yield at most one note on the mean brightness, and one on limits of automatic exposure."""
    if "expect" not in info:
        # The recipe's expectations are checked elsewhere.
        yield from _brightness(frames, info)
    automatic = [frame.automatic for frame in frames if frame.automatic]
    reached = [limit for exposure in automatic if (limit := exposure.get("limited_by")) is not None]
    if reached:
        limits = Counter(str(limit)[:_LONGEST_NAME] for limit in reached)
        listing = ", ".join(f"{count} {name}" for name, count in sorted(limits.items()))
        number = f"{len(reached)} of {len(automatic)} automatic exposures"
        yield f"{number} reached a limit ({listing}), so their grey is not auto_exposure.target_grey"


def _brightness(frames: Sequence[FrameTraits], info: Mapping[str, Any]) -> Iterator[str]:
    photos = [(frame.mean, frame.saturated) for frame in frames if frame.mean is not None]
    if not photos:
        return
    mean, saturated = (sum(values) / len(photos) for values in zip(*photos, strict=True))
    is_auto = info.get("recipe", {}).get("camera", {}).get("exposure_us") == AUTO
    if mean < _DARK:
        problem = f"the photographs are dark: their mean grey value is {mean:.0f} of 255"
        yield f"{problem}; {_advice(is_auto, 'longer', 'raise')}"
    elif mean > _BRIGHT or saturated > _SATURATED:
        problem = "the photographs are overexposed: "
        problem += f"their mean grey value is {mean:.0f} of 255, and {saturated:.1%} of their pixels"
        yield f"{problem} have a channel at 255; {_advice(is_auto, 'shorter', 'lower')}"


def _advice(is_auto: bool, length: str, change: str) -> str:
    if is_auto:
        return f"{change} auto_exposure.target_grey, or widen auto_exposure.exposure_us"
    return f'set a {length} camera.exposure_us, or exposure_us = "auto"'
