"""The plan of a data set: every frame has an index, and the index alone tells what it shows."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated, Final, TypeVar

import numpy as np
from pydantic import Field, model_validator

from pepperscene.document import Document
from pepperscene.errors import ArgumentError


class Stream(IntEnum):
    """What random numbers are drawn for; every frame depends on these values, so never renumber them."""

    PLANT = 0
    SKY = 1
    TWINE = 2
    FRAME = 3
    SETTLE = 4
    PLACE = 5
    FAR = 6


def random_generator(seed: int, stream: Stream, *address: int) -> np.random.Generator:
    """The generator of one stream at one address.

    Args:
        seed: of the recipe.
        stream: what the numbers are for.
        address: which one of its kind: (set, plant) for a plant, its twine and how its organs settle, (set,)
            for the sky, (set, rotation, 0) for how a row settles, (set, 0) for the row's places, (set, 1,
            plant) for how a plant stands in its own, (0, model) for a plant of the far rows and (1, set,
            rotation) for where they stand.
    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(int(stream), *address)))


def frame_seed(seed: int, index: int) -> int:
    """The 32-bit seed of a frame's sampler and sensor noise."""
    sequence = np.random.SeedSequence(seed, spawn_key=(int(Stream.FRAME), index))
    return int(sequence.generate_state(1)[0])


MOST_FRAMES: Final = 1_000_000
"""File names carry six digits."""

_RANGE: Final = re.compile(r"(\d{0,9}):(\d{0,9})", re.ASCII)

Item = TypeVar("Item")


@dataclass(frozen=True)
class FrameSpec:
    """One frame of a plan.

    Attributes:
        index: number of the frame in the whole data set, 0-based.
        set: which set of plants is grown.
        rotation: by how many places the plants of the row have moved on.
        step: position along the camera's path.
    """

    index: int
    set: int
    rotation: int
    step: int


class Plan(Document):
    """How many frames there are, and which of them are built when none are asked for.

    Attributes:
        sets: of plants, each grown anew.
        rotations: of the row, each a scene of its own.
        frames: along the camera's path in every scene.
        select: indices that a build makes by default; None for all.
    """

    sets: Annotated[int, Field(strict=True, ge=1, le=1000)]
    rotations: Annotated[int, Field(strict=True, ge=1, le=1000)]
    frames: Annotated[int, Field(strict=True, ge=1, le=100_000)]
    select: (
        Annotated[
            tuple[Annotated[int, Field(strict=True, ge=0)], ...], Field(min_length=1, max_length=10_000)
        ]
        | None
    ) = None

    @model_validator(mode="after")
    def _consistent(self) -> Plan:
        if self.count > MOST_FRAMES:
            raise ValueError(f"sets x rotations x frames = {self.count} must be at most {MOST_FRAMES}")
        if self.select is not None and max(self.select) >= self.count:
            raise ValueError(f"select holds {max(self.select)}, but the indices end at {self.count - 1}")
        return self

    @property
    def count(self) -> int:
        """Number of frames in the whole data set."""
        return self.sets * self.rotations * self.frames

    def frame(self, index: int) -> FrameSpec:
        """The frame of an index: index = (set * rotations + rotation) * frames + step.

        Raises:
            ValueError: there is no such frame.
        """
        if not 0 <= index < self.count:
            raise ValueError(f"frame {index} lies outside 0 to {self.count - 1}")
        scene, step = divmod(index, self.frames)
        row, rotation = divmod(scene, self.rotations)
        return FrameSpec(index, row, rotation, step)

    def select_indices(self, frames: str | Sequence[int] | None, argument: str = "frames") -> tuple[int, ...]:
        """The indices to build, ascending and without repeats.

        Args:
            frames: "A:B" (half-open, either end may be left out), indices, or None for the plan's own choice.
            argument: the name to use in error messages.

        Raises:
            ArgumentError: not of that form, empty, or outside the plan.
        """
        if frames is None:
            return tuple(sorted(set(self.select))) if self.select is not None else tuple(range(self.count))
        wanted = self._between(frames, argument) if isinstance(frames, str) else frames
        outside = [index for index in wanted if not 0 <= index < self.count]
        if outside or not wanted:
            found = f"frame {outside[0]}" if outside else "no frame"
            raise ArgumentError(argument, f"{found} asked for; the plan holds 0 to {self.count - 1}")
        return tuple(sorted({int(index) for index in wanted}))

    def _between(self, text: str, argument: str) -> range:
        match = _RANGE.fullmatch(text.strip())
        if match is None:
            raise ArgumentError(argument, f"{text!r} must be A:B with 0 <= A < B <= {self.count}")
        first = int(match[1] or 0)
        beyond = int(match[2] or self.count)
        if not first < beyond <= self.count:
            raise ArgumentError(argument, f"{text!r} must be A:B with 0 <= A < B <= {self.count}")
        return range(first, beyond)


def rotated(row: Sequence[Item], rotation: int) -> list[Item]:
    """The row moved on: position p holds item (p - rotation) mod n."""
    return [row[(position - rotation) % len(row)] for position in range(len(row))]
