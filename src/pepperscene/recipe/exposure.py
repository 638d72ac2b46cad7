"""Automatic exposure: its table in a recipe, and the control that follows from it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Final, Literal

from pydantic import Field, model_validator

from pepperscene.document import Document

if TYPE_CHECKING:
    from pepperscene.camera.image.auto_exposure import ExposureControl

Exposure = Annotated[float, Field(strict=True, ge=1, le=1_000_000)]


AUTO: Final = "auto"
"""Instead of an exposure time: it is chosen for each frame."""


class AutoExposureTable(Document):
    """What an exposure of "auto" aims at, and the settings that it may use.

    Attributes:
        target_grey: mean 8-bit code of the developed photograph.
        exposure_us: shortest and longest exposure time. The default is chosen, as in `ExposureControl`.
        most_gain: highest gain of the amplifier, which is raised where the longest exposure is too dark.
        metering: "average" of the whole image, or "centre" with more weight in its middle.
    """

    target_grey: Annotated[float, Field(strict=True, ge=1, le=250)] = 110.0
    exposure_us: tuple[Exposure, Exposure] = (10.0, 10_000.0)
    most_gain: Annotated[float, Field(strict=True, ge=1, le=1000)] = 4.0
    metering: Literal["average", "centre"] = "average"

    @model_validator(mode="after")
    def _check(self) -> AutoExposureTable:
        if self.exposure_us[0] > self.exposure_us[1]:
            raise ValueError(f"exposure_us = {list(self.exposure_us)} must be [shortest, longest]")
        return self

    def control(self) -> ExposureControl:
        """The control in SI units."""
        from pepperscene.camera.image.auto_exposure import ExposureControl

        shortest_us, longest_us = self.exposure_us
        return ExposureControl(
            self.target_grey, shortest_us / 1e6, longest_us / 1e6, self.most_gain, self.metering
        )
