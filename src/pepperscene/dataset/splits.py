"""Splits of a data set for training, validation and testing."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from pepperscene.errors import ArgumentError
from pepperscene.recipe.plan import Plan, frames_of_moments, moments

DEFAULT_SPLIT: Final = "train"

_NAME: Final = re.compile(r"[a-z][a-z0-9_]{0,39}", re.ASCII)
"""Valid as the name of a folder, a file and a key: Hugging Face allows no hyphen, and some file systems treat
`Train` and `train` as the same."""

_FRACTION: Final = re.compile(r"\d{0,3}\.?\d{0,9}", re.ASCII)
_SUM_TOLERANCE: Final = 1e-6  # chosen: for fractions written with a few decimals


@dataclass(frozen=True)
class Splits:
    """Assignment of frames to splits.

    Attributes:
        ranges: (name, indices) pairs that do not overlap; a name may have several, other frames are left out.
    """

    ranges: tuple[tuple[str, range], ...] = ((DEFAULT_SPLIT, range(2**31)),)

    def split_of(self, index: int) -> str:
        """The split of a frame, "" for none."""
        return next((name for name, indices in self.ranges if index in indices), "")

    def members(self, indices: Iterable[int]) -> dict[str, tuple[int, ...]]:
        """The frames of each split that are in `indices`, in that order."""
        frames: dict[str, list[int]] = {name: [] for name, _ in self.ranges}
        for index in indices:
            if name := self.split_of(index):
                frames[name].append(index)
        return {name: tuple(members) for name, members in frames.items()}


def split_by_sets(
    plan: Mapping[str, Any], fractions: Mapping[str, float], indices: Sequence[int] | None = None
) -> Splits:
    """Split frames by approximate fractions, so that no plant is in two splits if possible.

    If there are as many sets of plants as splits, every set goes to one split. Otherwise every scene does;
    the scenes of a set show the same plants in another order. A single scene is split into ranges of the
    camera's path. Twins, and the images of a rig at one moment, are always in one split.

    Args:
        plan: `sets`, `rotations`, `frames`, `twins` and `cameras`, as in the recipe in `dataset.json`.
        fractions: of the frames by name of the split, in the order of the indices; their sum is 1.
        indices: of the existing frames; None for all frames of the plan.

    Raises:
        ValueError: there are fewer moments than splits, or fractions are not positive or do not sum to 1.
    """
    whole_plan = _parse_plan(plan)
    frames = np.arange(whole_plan.count) if indices is None else np.unique(np.asarray(indices, np.int64))
    total = sum(fractions.values())
    if not fractions or min(fractions.values()) <= 0 or abs(total - 1) > _SUM_TOLERANCE:
        raise ValueError(f"the fractions sum to {total:g}; they must be positive and sum to 1")
    frame_moments = moments(whole_plan, frames)
    if (count := len(np.unique(frame_moments))) < len(fractions):
        number = f"{len(frames)} frames" + (f" of {count} moments" if count < len(frames) else "")
        raise ValueError(f"{number} cannot make {len(fractions)} splits")
    # The largest units, in moments, of which every split gets at least one.
    unit_sizes = (whole_plan.frames * whole_plan.rotations, whole_plan.frames, 1)
    size = next(size for size in unit_sizes if len(np.unique(frame_moments // size)) >= len(fractions))
    units, frames_per_unit = np.unique(frame_moments // size, return_counts=True)

    # Frames that do not exist yet belong to the split before them.
    ends = [int(units[end]) * size for end in _split_ends(frames_per_unit, list(fractions.values()))[:-1]]
    moment_count = whole_plan.sets * whole_plan.rotations * whole_plan.frames
    bounds = itertools.pairwise([0, *ends, moment_count])
    return Splits(
        tuple(
            (name, block)
            for name, bound in zip(fractions, bounds, strict=True)
            for block in frames_of_moments(whole_plan, *bound)
        )
    )


def read_splits(text: str | None, plan: Mapping[str, Any], indices: Sequence[int]) -> Splits:
    """Parse splits as on the command line; without any, all frames are in the split "train".

    Args:
        text: fractions, "train=.8,val=.1,test=.1", or half-open ranges of indices,
            "train=0:8750,val=8750:8800".
        plan: of the recipe in `dataset.json`.
        indices: of the frames to split.

    Raises:
        ArgumentError: the text is not valid, ranges overlap, exceed the plan or separate twins or the images
            of a rig at one moment, or a split is empty.
    """
    if text is None:
        return Splits()
    pairs = [_parse_pair(part) for part in text.split(",")]
    are_ranges = [":" in value for _, value in pairs]
    if any(are_ranges) and not all(are_ranges):
        raise ArgumentError("split", f"{text!r} must hold either fractions or ranges, not both")
    if are_ranges[0]:
        splits = _split_by_ranges(pairs, plan)
    else:
        fractions = _parse_fractions(pairs)
        try:
            splits = split_by_sets(plan, fractions, indices)
        except ValueError as error:
            raise ArgumentError("split", str(error)) from None
    members = splits.members(indices)
    _check_moments(members, plan)
    empty = [name for name, frames in members.items() if not frames]
    if empty:
        raise ArgumentError("split", f"{empty[0]} would hold none of the {len(indices)} frames")
    return splits


def shared_plants(members: Mapping[str, Sequence[int]], plan: Mapping[str, Any]) -> str:
    """Which splits show the same plants, and what separates them, in one sentence; "" if none do.

    `plan` is that of the recipe in `dataset.json`.
    """
    whole_plan = _parse_plan(plan)
    per_scene, per_set = whole_plan.frames, whole_plan.frames * whole_plan.rotations
    moments_of = {name: moments(whole_plan, indices) for name, indices in members.items()}
    for size, view in ((per_scene, "from other places"), (per_set, "in another order")):
        units = {name: set((found // size).tolist()) for name, found in moments_of.items()}
        for a, b in itertools.combinations(units, 2):
            if units[a] & units[b]:
                count = len(set().union(*(set((found // per_set).tolist()) for found in moments_of.values())))
                remedy = "fractions keep" if count >= len(members) else "a plan with more sets keeps"
                problem = f"{a} and {b} show the same plants {view}: {len(members)} splits have {count}"
                return f"{problem} set{'' if count == 1 else 's'} of plants; {remedy} them apart"
    return ""


def _check_moments(members: Mapping[str, Sequence[int]], plan: Mapping[str, Any]) -> None:
    """Raise `ArgumentError` if frames of one moment, which show the same view, are in different splits."""
    whole_plan = _parse_plan(plan)
    if whole_plan.twins * whole_plan.cameras == 1:
        return
    found: dict[int, tuple[str, int]] = {}
    for name, indices in members.items():
        for index, moment in zip(indices, moments(whole_plan, indices), strict=True):
            other, first = found.setdefault(int(moment), (name, index))
            if other != name:
                problem = f"frame {index} in {name} and frame {first} in {other} show the same moment"
                raise ArgumentError("split", f"{problem}; they must be in one split")


def _parse_pair(part: str) -> tuple[str, str]:
    name, _, value = (piece.strip() for piece in part.partition("="))
    if not _NAME.fullmatch(name) or not value:
        allowed = "must be NAME=FRACTION or NAME=A:B, the name in lower-case letters, digits and _"
        raise ArgumentError("split", f"{part.strip()!r} {allowed}")
    return name, value


def _split_by_ranges(pairs: Sequence[tuple[str, str]], plan: Mapping[str, Any]) -> Splits:
    whole_plan = _parse_plan(plan)
    ranges = []
    for name, value in pairs:
        indices = whole_plan.select_indices(value, "split")
        ranges.append((name, range(indices[0], indices[-1] + 1)))
    ordered = sorted(ranges, key=lambda pair: pair[1].start)
    for (name_a, range_a), (name_b, range_b) in itertools.pairwise(ordered):
        if range_b.start < range_a.stop:
            problem = f"{name_a} and {name_b} overlap: frame {range_b.start} belongs to both"
            raise ArgumentError("split", problem)
    return Splits(tuple(ranges))


def _parse_fractions(pairs: Sequence[tuple[str, str]]) -> dict[str, float]:
    fractions: dict[str, float] = {}
    for name, value in pairs:
        if not _FRACTION.fullmatch(value) or value == "." or not 0 < float(value) <= 1:
            allowed = "must be a fraction above 0 and at most 1, or a range A:B"
            raise ArgumentError("split", allowed, key=name, value=value)
        if name in fractions:
            raise ArgumentError("split", f"{name} has two fractions; give it one")
        fractions[name] = float(value)
    return fractions


def _split_ends(frames_per_unit: Any, fractions: Sequence[float]) -> list[int]:
    """Number of units up to the end of each split: nearest to its fraction, at least one unit per split."""
    frames_before = np.concatenate([[0], np.cumsum(frames_per_unit)])
    ends: list[int] = []
    for number, fraction in enumerate(np.cumsum(fractions)):
        nearest = int(np.abs(frames_before - fraction * frames_before[-1]).argmin())
        low = (ends[-1] if ends else 0) + 1
        high = len(frames_per_unit) - (len(fractions) - 1 - number)
        ends.append(min(max(nearest, low), high))
    return ends


def _parse_plan(plan: Mapping[str, Any]) -> Plan:
    keys = ("sets", "rotations", "frames", "twins", "cameras")
    return Plan.model_validate({key: plan[key] for key in keys if key in plan})
