"""The options of absorbed light: bands, accuracy and the day."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pepperscene.errors import ArgumentError
from pepperscene.options import Option

if TYPE_CHECKING:
    from pepperscene.scene.daylight_course import DaylightMoment, Place
    from pepperscene.spectra.wavebands import Waveband


@dataclass(frozen=True)
class LightOptions:
    """What light is traced, and when."""

    bands: Annotated[
        str,
        Option(
            "Bands of wavelengths, separated by commas: par, uva, blue, green, red, far_red, nir, or your "
            "own such as red_edge=700-740. The first one sets the number of samples.",
            "NAMES",
        ),
    ] = "par"
    received: Annotated[bool, Option("Also trace the light that arrives, at twice the cost.")] = False
    target_error: Annotated[float, Option("Relative standard error of leaves and fruit to aim at.", "X")] = (
        0.02
    )
    layer: Annotated[float, Option("Height of a layer.", "MM")] = 500.0
    date: Annotated[
        str | None, Option("Trace the day of this date, instead of the recipe's daylight.", "YYYY-MM-DD")
    ] = None
    latitude: Annotated[float, Option("Latitude of the greenhouse, north of the equator.", "DEG")] = 52.0
    longitude: Annotated[
        float | None, Option("Longitude, east. Default: the middle of the time zone.", "DEG")
    ] = None
    utc_offset: Annotated[float, Option("Time zone, ahead of UTC.", "HOURS")] = 0.0
    every: Annotated[float, Option("Step of a clear day.", "MINUTES")] = 60.0
    north: Annotated[
        float,
        Option("Direction of north in the scene, counter-clockwise from x; 90 is behind the crop.", "DEG"),
    ] = 90.0
    weather: Annotated[
        Path | None, Option("CSV file of measured light of the day: time, direct_W_m2, diffuse_W_m2.", "FILE")
    ] = None

    def wavebands(self) -> tuple[Waveband, ...]:
        """The bands; raises `ArgumentError` for bands, an error or a layer that are not valid."""
        from pepperscene.render.absorbed import check_target
        from pepperscene.spectra.wavebands import parse_wavebands

        check_target(self.target_error)
        if not 10.0 <= self.layer <= 10_000.0:
            raise ArgumentError("layer", f"must be 10 to 10000 millimetres, not {self.layer:g}")
        return parse_wavebands(self.bands.split(","))

    def place(self) -> Place:
        """Where the sun shines; raises `ArgumentError` for angles that do not exist."""
        from pepperscene.scene.daylight_course import Place

        return Place(self.latitude, self.longitude, self.utc_offset)

    def moments(self) -> list[DaylightMoment] | None:
        """The moments of the day; None without a date. Raises `InputError` for what is not valid."""
        from pepperscene.scene.daylight_course import clear_day, measured_day

        if self.date is None:
            if self.weather is not None:
                raise ArgumentError("weather", "needs a date: --date")
            return None
        try:
            day = date.fromisoformat(self.date)
        except ValueError:
            raise ArgumentError("date", f"must be a date such as 2026-06-21, not {self.date!r}") from None
        if self.weather is not None:
            return measured_day(self.weather, day, self.place())
        moments = clear_day(day, self.place(), self.every)
        if not moments:
            raise ArgumentError("date", f"the sun does not rise on {day} at {self.latitude:g} degrees")
        return moments
