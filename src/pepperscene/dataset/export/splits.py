"""Which frames are for training, which for validation, which for testing."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from pepperscene.dataset.recipe.plan import Plan
from pepperscene.errors import ArgumentError

EVERYTHING: Final = "train"
"""The split that holds all frames when none is asked for."""

_NAME: Final = re.compile(r"[a-z][a-z0-9_]{0,39}", re.ASCII)
"""What is a folder's name, a file's and a key everywhere: Hugging Face takes no hyphen, and some file systems
do not tell `Train` from `train`."""

_SHARE: Final = re.compile(r"\d{0,3}\.?\d{0,9}", re.ASCII)
_WHOLE: Final = 1e-6  # chosen: shares written with a few decimals may miss 1 by so much


@dataclass(frozen=True)
class Splits:
    """Names of frames' splits.

    Attributes:
        ranges: (name, indices) pairs that do not overlap; a name may have several, and frames in none are
            left out.
    """

    ranges: tuple[tuple[str, range], ...] = ((EVERYTHING, range(2**31)),)

    def named(self, index: int) -> str:
        """The split that a frame belongs to, "" for none."""
        return next((name for name, indices in self.ranges if index in indices), "")

    @property
    def names(self) -> tuple[str, ...]:
        """The splits, each once, in the order in which they were given."""
        return tuple(dict.fromkeys(name for name, _ in self.ranges))

    def members(self, indices: Iterable[int]) -> dict[str, tuple[int, ...]]:
        """The frames of each split that are among `indices`, in their order."""
        found: dict[str, list[int]] = {name: [] for name in self.names}
        for index in indices:
            name = self.named(index)
            if name:
                found[name].append(index)
        return {name: tuple(of) for name, of in found.items()}


def split_by_sets(
    plan: Mapping[str, Any], shares: Mapping[str, float], indices: Sequence[int] | None = None
) -> Splits:
    """Splits of about the given shares that show no plant in common, where that can be.

    Whole sets of plants go to one split when there are as many sets as splits. Otherwise whole scenes do,
    which show the same plants in other places of the row; and of a single scene, runs of frames along the
    path.

    Args:
        plan: `sets`, `rotations` and `frames`, as the recipe in `dataset.json` tells.
        shares: of the frames by split's name, in the order of the indices; their sum is 1.
        indices: the frames that are there; None for all of the plan.

    Raises:
        ValueError: there are fewer frames than splits, or shares that are not above 0 or do not sum to 1.
    """
    told = _plan(plan)
    there = np.arange(told.count) if indices is None else np.unique(np.asarray(indices, dtype=np.int64))
    if not shares or min(shares.values()) <= 0 or abs(sum(shares.values()) - 1) > _WHOLE:
        raise ValueError("shares must be above 0 and sum to 1")
    if len(there) < len(shares):
        raise ValueError(f"{len(there)} frames cannot make {len(shares)} splits")
    # The largest units that give every split at least one.
    sizes = (told.frames * told.rotations, told.frames, 1)
    size = next(one for one in sizes if len(np.unique(there // one)) >= len(shares))
    units, frames = np.unique(there // size, return_counts=True)

    ranges, first = [], 0
    ends = _ends(frames, list(shares.values()))
    for place, (name, end) in enumerate(zip(shares, ends, strict=True)):
        # Between two splits lie the frames that are not there; the last one takes all that follow.
        beyond = told.count if place == len(shares) - 1 else int(units[end]) * size
        ranges.append((name, range(first, beyond)))
        first = beyond
    return Splits(tuple(ranges))


def read_splits(text: str | None, plan: Mapping[str, Any], indices: Sequence[int]) -> Splits:
    """Splits as written on the command line; all frames are for training when nothing is.

    Args:
        text: shares, "train=.8,val=.1,test=.1", or half-open ranges of indices, "train=0:8750,val=8750:8800".
        plan: as the recipe in `dataset.json` tells.
        indices: the frames that are exported.

    Raises:
        ArgumentError: not of that form; ranges overlap or lie outside the plan, or a split is empty.
    """
    if text is None:
        return Splits()
    pairs = [_pair(part) for part in text.split(",")]
    ranged = [":" in value for _, value in pairs]
    if any(ranged) and not all(ranged):
        raise ArgumentError("split", f"{text!r} must hold either shares or ranges, not both")
    splits = _by_ranges(pairs, plan) if ranged[0] else _by_shares(pairs, plan, indices)
    empty = [name for name, of in splits.members(indices).items() if not of]
    if empty:
        raise ArgumentError("split", f"{empty[0]} would hold none of the {len(indices)} frames")
    return splits


def _pair(part: str) -> tuple[str, str]:
    """Name and value of one split."""
    name, _, value = (piece.strip() for piece in part.partition("="))
    if not _NAME.fullmatch(name) or not value:
        allowed = "must be NAME=SHARE or NAME=A:B, the name in lower-case letters, digits and _"
        raise ArgumentError("split", f"{part.strip()!r} {allowed}")
    return name, value


def _by_ranges(pairs: Sequence[tuple[str, str]], plan: Mapping[str, Any]) -> Splits:
    told = _plan(plan)
    ranges = []
    for name, value in pairs:
        indices = told.select_indices(value, "split")
        ranges.append((name, range(indices[0], indices[-1] + 1)))
    ordered = sorted(ranges, key=lambda pair: pair[1].start)
    for (first, one), (second, other) in itertools.pairwise(ordered):
        if other.start < one.stop:
            raise ArgumentError("split", f"{first} and {second} overlap: frame {other.start} belongs to both")
    return Splits(tuple(ranges))


def _by_shares(pairs: Sequence[tuple[str, str]], plan: Mapping[str, Any], indices: Sequence[int]) -> Splits:
    shares: dict[str, float] = {}
    for name, value in pairs:
        if not _SHARE.fullmatch(value) or value == "." or not 0 < float(value) <= 1:
            raise ArgumentError(
                "split", "must be a share above 0 and at most 1, or a range A:B", key=name, value=value
            )
        if name in shares:
            raise ArgumentError("split", f"{name} has two shares; give it one")
        shares[name] = float(value)
    total = sum(shares.values())
    if abs(total - 1) > _WHOLE:
        raise ArgumentError("split", f"the shares sum to {total:g}; they must sum to 1")
    if len(indices) < len(shares):
        raise ArgumentError("split", f"{len(indices)} frames cannot make {len(shares)} splits")
    return split_by_sets(plan, shares, indices)


def _ends(frames: Any, shares: Sequence[float]) -> list[int]:
    """After how many units each split ends: nearest to its share of the frames, at least one unit each."""
    total = np.concatenate([[0], np.cumsum(frames)])
    ends: list[int] = []
    for place, reach in enumerate(np.cumsum(shares)):
        nearest = int(np.abs(total - reach * total[-1]).argmin())
        least = (ends[-1] if ends else 0) + 1
        most = len(frames) - (len(shares) - 1 - place)
        ends.append(min(max(nearest, least), most))
    return ends


def _plan(plan: Mapping[str, Any]) -> Plan:
    return Plan.model_validate({key: plan[key] for key in ("sets", "rotations", "frames")})
