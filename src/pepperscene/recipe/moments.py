"""Moments of a plan: the views that twins and the cameras of a rig share."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.recipe.plan import Plan


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
