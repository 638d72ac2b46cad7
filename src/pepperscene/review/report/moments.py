"""Frames of one moment in a report: twins, and the images of other cameras of a rig."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, Self, final

from pepperscene.dataset.readers import RenderedSet
from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.recipe.plan import Plan, moments
from pepperscene.recipe.rig import FIRST_CAMERA
from pepperscene.review.report.data import evenly_spaced


@final
class Moments:
    """The moments of the frames of a set.

    Args:
        plan: of the data set.
        cameras: names of the cameras of its rig, the main one first.
        indices: of all frames, ascending.
    """

    def __init__(self, plan: Plan, cameras: Sequence[str], indices: Sequence[int]) -> None:
        self._plan, self._cameras = plan, cameras
        self._positions: dict[int, list[int]] = {}  # by moment, in the order of the frames
        self._indices = indices
        for position, moment in enumerate(moments(plan, indices).tolist()):
            self._positions.setdefault(moment, []).append(position)

    @classmethod
    def of_images(cls, images: ImageSet) -> Self | None:
        """The moments of a set; None for one in which no two images can show the same moment."""
        if not isinstance(images, RenderedSet):
            return None
        with suppress(KeyError, TypeError, ValueError):
            recipe: Mapping[str, Any] = images.dataset.info["recipe"]
            plan = Plan.model_validate(recipe["plan"])
            cameras = [FIRST_CAMERA, *(str(camera["name"]) for camera in recipe.get("rig", ()))]
            is_inside = max(images.items) < plan.count and plan.cameras <= len(cameras)
            if plan.twins * plan.cameras > 1 and is_inside:
                return cls(plan, cameras, images.items)
        return None

    def evenly_spaced(self, limit: int) -> list[int]:
        """At most `limit` positions: all frames of evenly spaced moments, or the first frames of one."""
        groups = list(self._positions.values())
        largest = max(map(len, groups))
        chosen = [groups[number] for number in evenly_spaced(len(groups), max(1, limit // largest))]
        return sorted(position for group in chosen for position in group[: max(limit, 1)])

    def relatives(self, position: int) -> list[tuple[int, str]]:
        """Index and description of the other frames of a frame's moment, the nearest first."""
        plan = self._plan
        own = plan.frame(self._indices[position])
        found = []
        for other in self._positions[own.moment]:
            spec = plan.frame(self._indices[other])
            parts = [f"twin {spec.twin}"] if spec.twin != own.twin else []
            parts += [self._cameras[spec.camera]] if spec.camera != own.camera else []
            if parts:
                found.append((len(parts), spec.index, ", ".join(parts)))
        return [(number, text) for _, number, text in sorted(found)]


def displayed_positions(images: ImageSet, limit: int) -> list[int]:
    """At most `limit` positions of a set, evenly spaced; frames of one moment are shown together."""
    of_set = Moments.of_images(images)
    if of_set is None or len(images) <= limit:
        return evenly_spaced(len(images), limit)
    return of_set.evenly_spaced(limit)
