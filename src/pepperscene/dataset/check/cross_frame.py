"""What only many frames together can show: the same frame twice, and statistics that drift."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterator
from statistics import median, stdev
from typing import Final

import numpy as np

from pepperscene.classes import OrganClass
from pepperscene.dataset.check.findings import Finding
from pepperscene.dataset.check.one_frame import FrameTraits
from pepperscene.dataset.recipe.tables import ExpectTable
from pepperscene.dataset.store.dataset import DIGITS, FRAMES, file_name

_SURE: Final = 3.0
"""Chosen: standard errors by which the mean of a part of a plan must leave the range of the whole."""
_FEWEST_SCENES: Final = 4  # chosen: below, a part of a plan says too little of the whole
_FEWEST_OTHERS: Final = 8  # chosen: below, no scene can be said to stand apart from the others
_APART: Final = 6.0  # chosen: robust standard deviations; of 42 scenes in nine numbers, none by chance
_MAD_TO_SD: Final = 1.4826
"""Of a normal distribution: its standard deviation over its median absolute deviation."""

_WAYS: Final = {
    "picture": "has the same photograph as frame {}",
    "content": "has the same images as frame {}",
    "view": "has pose and seed of frame {}",
}
"""What two frames must not share; whoever shares the first shares the others too."""

_NAMES: Final = tuple(one.name.lower() for one in OrganClass)


class Running:
    """The mean of numbers told one by one."""

    def __init__(self) -> None:
        self.count = 0
        self.mean = 0.0

    def add(self, value: float) -> None:
        """One number more."""
        self.count += 1
        self.mean += (value - self.mean) / self.count


class CrossFrameChecks:
    """Takes frames one by one and finds what they are wrong in together.

    Args:
        expect: what the recipe expects, or None.
    """

    def __init__(self, expect: ExpectTable | None) -> None:
        self._expect = expect or ExpectTable()
        self._indices = array("q")
        self._digests = {way: array("Q") for way in (*_WAYS, "row")}
        self._all: dict[str, Running] = {}
        self._scenes: dict[int, dict[str, Running]] = {}

    def add(self, traits: FrameTraits) -> Iterator[Finding]:
        """Take a frame; tell where it is unlike what is expected of a single one."""
        yield from self._single(traits)
        self._indices.append(traits.index)
        for way, digests in self._digests.items():
            digests.append(getattr(traits, way))
        numbers = dict(zip(_NAMES, traits.shares, strict=True)) if traits.shares is not None else {}
        if traits.mean is not None:
            numbers["intensity"] = traits.mean
        scene = self._scenes.setdefault(-1 if traits.scene is None else traits.scene, {})
        for name, value in numbers.items():
            for table in (self._all, scene):
                table.setdefault(name, Running()).add(value)

    def drift(self, whole: bool) -> Iterator[Finding]:
        """Means of the set that lie outside what the recipe expects.

        Args:
            whole: whether the plan's frames are all there; of a part, chance is allowed for.
        """
        ranges = dict(self._expect.share)
        if self._expect.intensity is not None:
            ranges["intensity"] = self._expect.intensity
        for name, (least, most) in ranges.items():
            found = self._all.get(name)
            if found is None:
                continue
            allowed = 0.0 if whole else _SURE * self._standard_error(name)
            if not least - allowed <= found.mean <= most + allowed:
                what = "the mean grey value" if name == "intensity" else f"the share of {name}"
                yield Finding(
                    "drift",
                    None,
                    "",
                    f"{what} is {found.mean:.4g} over {found.count} frames, "
                    f"expected is {least:g} to {most:g}",
                )

    def apart(self) -> Iterator[str]:
        """Scenes whose means stand apart from those of the others."""
        if len(self._scenes) < _FEWEST_OTHERS:
            return
        for name in self._all:
            means = {scene: told[name].mean for scene, told in self._scenes.items() if name in told}
            middle = median(means.values())
            spread = _MAD_TO_SD * median(abs(mean - middle) for mean in means.values())
            for scene, mean in means.items():
                if spread > 0 and abs(mean - middle) > _APART * spread:
                    what = "mean grey value" if name == "intensity" else f"share of {name}"
                    group, rotation = divmod(scene, 1000)
                    yield (
                        f"set {group}, rotation {rotation} stands apart: {what} {mean:.4g}, "
                        f"the others' median is {middle:.4g}"
                    )

    def _standard_error(self, name: str) -> float:
        """Of the mean, from scene to scene: frames of one scene show the same plants."""
        means = [told[name].mean for told in self._scenes.values() if name in told]
        return stdev(means) / math.sqrt(len(means)) if len(means) >= _FEWEST_SCENES else math.inf

    def duplicates(self) -> Iterator[Finding]:
        """Frames that are another frame over again, each told once."""
        indices, told = np.array(self._indices), set[int]()
        for way, what in _WAYS.items():
            digests = np.array(self._digests[way])
            # Equal ones lie side by side, in the order of the frames.
            order = np.lexsort((indices, digests))
            digests, ordered = digests[order], indices[order]
            first = 0
            again = np.flatnonzero((digests[1:] == digests[:-1]) & (digests[1:] != 0)) + 1
            for place in again.tolist():
                if digests[place] != digests[first]:
                    first = place - 1
                index = int(ordered[place])
                if index not in told:
                    told.add(index)
                    yield Finding("duplicate", index, _json(index), what.format(ordered[first]))

    def rows(self) -> dict[int, int]:
        """What the manifest must say of each frame, as digests."""
        return dict(zip(self._indices, self._digests["row"], strict=True))

    def _single(self, traits: FrameTraits) -> Iterator[Finding]:
        """What is expected of every single photograph."""
        if traits.mean is None:
            return
        file = file_name(traits.index, "colour")
        if self._expect.frame_intensity is not None:
            least, most = self._expect.frame_intensity
            if not least <= traits.mean <= most:
                what = f"has the mean grey value {traits.mean:.4g}, expected is {least:g} to {most:g}"
                yield Finding("drift", traits.index, file, what)
        if self._expect.saturated is not None and traits.saturated > self._expect.saturated:
            what = f"{traits.saturated:.1%} of its pixels have a channel at 255, expected is at most "
            yield Finding("drift", traits.index, file, f"{what}{self._expect.saturated:.1%}")


def _json(index: int) -> str:
    return f"{FRAMES}/{index:0{DIGITS}d}.json"
