"""Exposures that are metered at the first view of a scene and locked for its other views."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pepperscene.recipe.plan import FrameSpec
from pepperscene.recipe.resolve.frame_setups import FrameSetup

if TYPE_CHECKING:
    from pepperscene.camera import ChosenExposure, ExposureControl
    from pepperscene.render import Quality


@dataclass(frozen=True)
class FrameExposure:
    """The automatic exposure of a frame.

    Attributes:
        control: what it aims at.
        locked: what another frame's light has decided; None for the frame's own light.
        first: index of that frame.
    """

    control: ExposureControl
    locked: ChosenExposure | None = None
    first: int | None = None

    def to_metadata(self, described: dict[str, Any]) -> dict[str, Any]:
        """JSON-ready description of the chosen exposure, with the frame that has decided it."""
        if self.locked is None:
            return described
        return {"target_grey": self.control.target_grey, **described, "locked_in_frame": self.first}


class FrameExposures:
    """The automatic exposures of a recipe's frames; one that is locked is metered once for all its frames.

    Args:
        frames_of_scene: the frames with the plants of a frame, ascending.
        meter: chooses the exposure of a frame by its own light.
    """

    def __init__(
        self,
        frames_of_scene: Callable[[FrameSpec], Sequence[FrameSpec]],
        meter: Callable[[FrameSpec, str | Quality], ChosenExposure],
    ) -> None:
        self._frames_of_scene, self._meter = frames_of_scene, meter
        self._locked: dict[Hashable, tuple[ChosenExposure, int]] = {}

    def at(self, spec: FrameSpec, setup: FrameSetup, quality: str | Quality) -> FrameExposure | None:
        """That of a frame; None if its exposure is not automatic."""
        table = setup.recipe.exposure_control
        if table is None or not table.lock:
            return None if table is None else FrameExposure(table.control())
        key = (setup.plants, spec.scene, spec.twin, spec.camera, quality)
        if key not in self._locked:
            others = self._frames_of_scene(spec)
            first = next(one for one in others if (one.twin, one.camera) == (spec.twin, spec.camera))
            self._locked[key] = self._meter(first, quality), first.index
        return FrameExposure(table.control(), *self._locked[key])
