"""The plan of a data set: every frame has an index, and the index alone determines what the frame shows."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from numbers import Integral
from typing import Annotated, Any, Final, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from pepperscene.document import Document
from pepperscene.errors import ArgumentError

MAX_FRAMES: Final = 1_000_000  # file names have six digits
_RANGE: Final = re.compile(r"(\d{0,9}):(\d{0,9})", re.ASCII)

Item = TypeVar("Item")


class Stream(IntEnum):
    """Purpose of random numbers. Every frame depends on these values: never renumber them."""

    PLANT = 0
    SKY = 1
    TWINE = 2
    FRAME = 3
    SETTLE = 4
    PLACE = 5
    FAR = 6
    VARIATION = 7
    VIEW = 8
    LIVE = 9


def random_generator(seed: int, stream: Stream, *address: int) -> np.random.Generator:
    """The random generator of one stream at one address.

    Args:
        seed: of the recipe.
        stream: purpose of the numbers.
        address: (set, plant) for a plant, its twine and its contacts; (set, 1, plant) for its posture; (set,)
            for the sky; (set, 0) for positions in a row, and (set, rotation, 0) for its contacts; (0, model)
            for a plant of the far rows, (2, model) for its twine, (3, model) for its contacts, and
            (1, set, rotation) for their positions; (moment,) for a random view. The address of a varied value
            is in `variation.draws`.
    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(int(stream), *address)))


def frame_seed(seed: int, index: int) -> int:
    """The 32-bit seed of a frame's sampler and sensor noise."""
    sequence = np.random.SeedSequence(seed, spawn_key=(int(Stream.FRAME), index))
    return int(sequence.generate_state(1)[0])


def view_seed(seed: int, index: int, number: int) -> int:
    """The 32-bit seed of a view of a frame's scene that is none of the data set's, by its number."""
    sequence = np.random.SeedSequence(seed, spawn_key=(int(Stream.LIVE), index, number))
    return int(sequence.generate_state(1)[0])


def check_seed(seed: int) -> int:
    """Return a recipe's seed as an int; raises `ArgumentError` unless it is whole, from 0 and below 2^63."""
    is_whole = isinstance(seed, Integral) and not isinstance(seed, bool)
    if not (is_whole and 0 <= seed < 2**63):
        raise ArgumentError("seed", f"must be a whole number, at least 0 and below 2^63, not {seed}")
    return int(seed)


@dataclass(frozen=True)
class FrameSpec:
    """One frame of a plan.

    Attributes:
        index: of the frame in the whole data set, 0-based.
        set: number of the set of plants.
        rotation: number of positions by which the plants of the row are shifted.
        step: number of the view in its scene.
        scene: number of the scene: set * rotations + rotation.
        moment: number of the view in the whole plan: scene * frames + step. Twins and the cameras of a rig
            share it.
        twin: number of the twin.
        camera: number of the camera on the rig.
    """

    index: int
    set: int
    rotation: int
    step: int
    scene: int = 0
    moment: int = 0
    twin: int = 0
    camera: int = 0


class Plan(Document):
    """The number of frames, and which of them are built by default.

    Attributes:
        sets: of plants, each grown anew.
        rotations: of the row, each a scene.
        frames: views in every scene.
        select: indices that a build makes by default; None for all.
        twins, cameras: numbers of twins and of cameras on the rig. They follow from other tables of the
            recipe and are not keys of its file.
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
    twins: Annotated[int, Field(strict=True, ge=1)] = 1
    cameras: Annotated[int, Field(strict=True, ge=1)] = 1

    @model_validator(mode="after")
    def _check(self) -> Plan:
        if self.count > MAX_FRAMES:
            further = {"twins": self.twins, "cameras": self.cameras}
            factors = [
                "sets",
                "rotations",
                "frames",
                *(name for name, number in further.items() if number > 1),
            ]
            raise ValueError(f"{' x '.join(factors)} = {self.count} must be at most {MAX_FRAMES}")
        if self.select is not None and max(self.select) >= self.count:
            raise ValueError(f"select holds {max(self.select)}, but the last index is {self.count - 1}")
        return self

    @property
    def count(self) -> int:
        """Number of frames in the whole data set."""
        return self.sets * self.rotations * self.scene_frames

    @property
    def scene_frames(self) -> int:
        """Number of frames of a scene, with all twins and cameras."""
        return self.twins * self.frames * self.cameras

    def frame(self, index: int) -> FrameSpec:
        """The frame of an index.

        index = (((set * rotations + rotation) * twins + twin) * frames + step) * cameras + camera: the frames
        of a scene and of a twin follow each other, and so do the images of a rig.

        Raises:
            ValueError: there is no such frame.
        """
        if not 0 <= index < self.count:
            raise ValueError(f"frame {index} must be between 0 and {self.count - 1}")
        rest, camera = divmod(index, self.cameras)
        rest, step = divmod(rest, self.frames)
        scene, twin = divmod(rest, self.twins)
        moment = scene * self.frames + step
        return FrameSpec(index, *divmod(scene, self.rotations), step, scene, moment, twin, camera)

    def first_of_moment(self, spec: FrameSpec) -> FrameSpec:
        """The frame of the first twin and the first camera at a frame's moment."""
        return self.frame((spec.scene * self.twins * self.frames + spec.step) * self.cameras)

    def scene_indices(self, spec: FrameSpec) -> range:
        """The indices of all frames of a frame's scene, of all twins."""
        first = spec.scene * self.scene_frames
        return range(first, first + self.scene_frames)

    def select_indices(self, frames: str | Sequence[int] | None, argument: str = "frames") -> tuple[int, ...]:
        """The indices to build, ascending and without repeats.

        Args:
            frames: "A:B" (half-open, both ends optional), indices, or None for the plan's own selection.
            argument: the name to use in error messages.

        Raises:
            ArgumentError: `frames` is malformed, empty, or outside the plan.
        """
        if frames is None:
            return tuple(sorted(set(self.select))) if self.select is not None else tuple(range(self.count))
        indices = self._parse_range(frames, argument) if isinstance(frames, str) else frames
        outside = [index for index in indices if not 0 <= index < self.count]
        if outside or not indices:
            problem = f"frame {outside[0]} does not exist" if outside else "must name at least one frame"
            raise ArgumentError(argument, f"{problem}; the plan has frames 0 to {self.count - 1}")
        return tuple(sorted({int(index) for index in indices}))

    def first_frame(self, index: int | None) -> FrameSpec:
        """The frame of an index; None for the first that the plan selects. Errors: `select_indices`."""
        return self.frame(self.select_indices(None if index is None else [index], "frame")[0])

    def _parse_range(self, text: str, argument: str) -> range:
        match = _RANGE.fullmatch(text.strip())
        first, end = (int(match[1] or 0), int(match[2] or self.count)) if match is not None else (0, 0)
        if not first < end <= self.count:
            raise ArgumentError(argument, f"{text!r} must be A:B with 0 <= A < B <= {self.count}")
        return range(first, end)


def rotate_row(row: Sequence[Item], rotation: int) -> list[Item]:
    """Rotate a row: position p holds item (p - rotation) mod n."""
    return [row[(position - rotation) % len(row)] for position in range(len(row))]


def moments(plan: Plan, indices: ArrayLike) -> NDArray[np.int64]:
    """The moment of each frame `(n,)`, as `FrameSpec.moment`."""
    frames: NDArray[Any] = np.asarray(indices, np.int64)
    return frames // plan.scene_frames * plan.frames + frames // plan.cameras % plan.frames


def frames_of_moments(plan: Plan, first: int, end: int) -> list[range]:
    """The indices of all frames of the moments from `first` to before `end`, ascending."""
    if first >= end:
        return []
    # Whole scenes follow each other; in part of a scene, each twin has its own range.
    scene, step = divmod(first, plan.frames)
    if step == 0 and (whole := (end - first) // plan.frames):
        head = [range(scene * plan.scene_frames, (scene + whole) * plan.scene_frames)]
        return head + frames_of_moments(plan, first + whole * plan.frames, end)
    last = min(plan.frames, step + end - first)
    twins = (scene * plan.twins + twin for twin in range(plan.twins))
    head = [
        range((twin * plan.frames + step) * plan.cameras, (twin * plan.frames + last) * plan.cameras)
        for twin in twins
    ]
    return head + frames_of_moments(plan, scene * plan.frames + last, end)
