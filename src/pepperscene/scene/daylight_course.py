"""The course of daylight over a day: the sun's path, and light of a clear sky or as it was measured."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass
from datetime import UTC, date, datetime, time, timedelta, timezone
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np

from pepperscene.document import read_text
from pepperscene.errors import ArgumentError, InputError
from pepperscene.scene.sky import diffuse_lux
from pepperscene.spectra import illuminance
from pepperscene.spectra.lights import air_mass, astm_g173, diffuse_spectrum

LOWEST_SUN_RAD: Final = math.radians(1.0)
"""Chosen: the lowest sun that a recipe's daylight can have. Below it, it is night."""
_EXTRATERRESTRIAL_LX: Final = 127_500.0
_CLEAR_EXTINCTION: Final = 0.21
"""Illuminance by the sun above the atmosphere, and its extinction for each air mass under a clear sky (IES
1984, Recommended practice for the calculation of daylight availability, J. IES 13:381)."""
_G173_DIRECT_W_M2: Final = 900.14
_G173_TILTED_W_M2: Final = 1000.37
"""Of ASTM G173-03, over all wavelengths from 280 to 4000 nm."""
_WEATHER_COLUMNS: Final = ["time", "direct_W_m2", "diffuse_W_m2"]
_MOST_STEPS: Final = 1440  # one for each minute of a day
_BRIGHTEST_W_M2: Final = 1500.0  # chosen: above the sun outside of the atmosphere, and reflections of clouds


@dataclass(frozen=True)
class DaylightMoment:
    """Daylight above a greenhouse's cover at a moment.

    Attributes:
        when: in the time zone of the place.
        hours: of the day that it stands for.
        elevation_rad: of the sun, above the horizon.
        azimuth_rad: of the sun, clockwise from north.
        direct_lx, diffuse_lx: on a level plane, from the sun and from the sky.
    """

    when: datetime
    hours: float
    elevation_rad: float
    azimuth_rad: float
    direct_lx: float
    diffuse_lx: float


@dataclass(frozen=True)
class Place:
    """Where the sun shines.

    Attributes:
        latitude_deg: north of the equator.
        longitude_deg: east of Greenwich; None for the middle of the time zone.
        utc_offset_h: of the time zone.
    """

    latitude_deg: float
    longitude_deg: float | None = None
    utc_offset_h: float = 0.0

    def __post_init__(self) -> None:
        longitude = 0.0 if self.longitude_deg is None else self.longitude_deg
        limits = (
            ("latitude", self.latitude_deg, 90.0), ("longitude", longitude, 180.0),
            ("utc_offset", self.utc_offset_h, 14.0),
        )  # fmt: skip
        for name, value, most in limits:
            if not -most <= value <= most:
                raise ArgumentError(name, f"must be from {-most:g} to {most:g}, not {value:g}")

    @property
    def zone(self) -> timezone:
        """Its time zone."""
        return timezone(timedelta(hours=self.utc_offset_h))

    def sun(self, when: datetime) -> tuple[float, float]:
        """Elevation and azimuth of the sun, see `sun_position`."""
        longitude = 15.0 * self.utc_offset_h if self.longitude_deg is None else self.longitude_deg
        return sun_position(when, math.radians(self.latitude_deg), math.radians(longitude))


def sun_position(when: datetime, latitude_rad: float, longitude_rad: float) -> tuple[float, float]:
    """Elevation of the sun's centre, without refraction, and azimuth clockwise from north, radians.

    The approximation of the Astronomical Almanac, within 0.01 degrees from 1950 to 2050 (Michalsky 1988,
    Solar Energy 40:227). The time has a time zone; longitudes are positive east of Greenwich.
    """
    days = (when - datetime(2000, 1, 1, 12, tzinfo=UTC)) / timedelta(days=1)
    mean_longitude = math.radians(280.460 + 0.9856474 * days)
    anomaly = math.radians(357.528 + 0.9856003 * days)
    ecliptic = mean_longitude + math.radians(1.915 * math.sin(anomaly) + 0.020 * math.sin(2.0 * anomaly))
    obliquity = math.radians(23.439 - 0.0000004 * days)
    right_ascension = math.atan2(math.cos(obliquity) * math.sin(ecliptic), math.cos(ecliptic))
    declination = math.asin(math.sin(obliquity) * math.sin(ecliptic))
    # Greenwich mean sidereal time, in revolutions.
    sidereal = 0.7790572733 + 1.00273790935 * days
    hour_angle = 2.0 * math.pi * (sidereal % 1.0) + longitude_rad - right_ascension
    east = -math.cos(declination) * math.sin(hour_angle)
    north = math.sin(declination) * math.cos(latitude_rad)
    north -= math.cos(declination) * math.cos(hour_angle) * math.sin(latitude_rad)
    up = math.sin(declination) * math.sin(latitude_rad)
    up += math.cos(declination) * math.cos(hour_angle) * math.cos(latitude_rad)
    return math.asin(min(max(up, -1.0), 1.0)), math.atan2(east, north) % (2.0 * math.pi)


def clear_day(day: date, place: Place, step_min: float = 60.0) -> list[DaylightMoment]:
    """The moments of a clear day at which the sun is up, in the middles of steps from midnight on.

    Illuminance is that of the IES's clear sky.
    """
    if not 1.0 <= step_min <= 720.0:
        raise ArgumentError("every", f"must be 1 to 720 minutes, not {step_min:g}")
    moments = []
    for number in range(int(1440.0 // step_min)):
        minutes = timedelta(minutes=(number + 0.5) * step_min)
        when = datetime.combine(day, time(), place.zone) + minutes
        elevation, azimuth = place.sun(when)
        if elevation < LOWEST_SUN_RAD:
            continue
        beam = _EXTRATERRESTRIAL_LX * math.exp(-_CLEAR_EXTINCTION * air_mass(elevation))
        direct, diffuse = beam * math.sin(elevation), diffuse_lux("clear", elevation)
        moments.append(DaylightMoment(when, step_min / 60.0, elevation, azimuth, direct, diffuse))
    return moments


def measured_day(path: Path, day: date, place: Place) -> list[DaylightMoment]:
    """The moments of a file of measured light at which the sun is up.

    Args:
        path: a CSV file with the columns `time`, `direct_W_m2` and `diffuse_W_m2`: ascending times of the
            place as HH:MM, and broadband irradiance of a level plane outside, from the sun and from the sky.
            Each row stands for the time to half way to its neighbours.
        day: of the file.
        place: where it was measured.

    Raises:
        InputError: the file is not such a table, or has no light while the sun is up.
    """
    text = read_text(path)
    try:
        header, *lines = [line for line in csv.reader(io.StringIO(text)) if line]
    except (csv.Error, ValueError):
        raise InputError(path, "is not a table of comma-separated values") from None
    if [name.strip() for name in header] != _WEATHER_COLUMNS:
        raise InputError(path, f"must be {','.join(_WEATHER_COLUMNS)}", key="header", value=",".join(header))
    if not 1 <= len(lines) <= _MOST_STEPS:
        raise InputError(path, f"must be 1 to {_MOST_STEPS} below the header", key="rows", value=len(lines))
    rows = [_weather_row(path, number, line) for number, line in enumerate(lines, start=2)]
    minutes = np.array([row[0] for row in rows])
    if not np.all(np.diff(minutes) > 0):
        raise InputError(path, "must ascend", key="time")
    limits = np.concatenate([[0.0], (minutes[1:] + minutes[:-1]) / 2.0, [1440.0]])
    if len(rows) > 1:
        # The first and the last are in the middle of their times, as the others.
        limits[[0, -1]] = 2.0 * minutes[[0, -1]] - limits[[1, -2]]
    hours, moments = np.diff(np.clip(limits, 0.0, 1440.0)) / 60.0, []
    for (minute, direct, diffuse), length in zip(rows, hours.tolist(), strict=True):
        when = datetime.combine(day, time(), place.zone) + timedelta(minutes=minute)
        elevation, azimuth = place.sun(when)
        if elevation >= LOWEST_SUN_RAD and direct + diffuse > 0.0:
            light = direct * _efficacies()[0], diffuse * _efficacies()[1]
            moments.append(DaylightMoment(when, length, elevation, azimuth, *light))
    if not moments:
        raise InputError(path, "has no light at a time at which the sun is up")
    return moments


def _weather_row(path: Path, number: int, line: list[str]) -> tuple[float, float, float]:
    """Minutes since midnight, direct and diffuse light of a row."""
    key = f"row {number}"
    try:
        clock, direct, diffuse = line[0].strip(), *(float(cell) for cell in line[1:])
        start = time.fromisoformat(clock)
    except ValueError:
        allowed = f"must be a time such as 09:30 and two numbers, not {','.join(line)}"
        raise InputError(path, allowed, key=key) from None
    if not (0.0 <= direct <= _BRIGHTEST_W_M2 and 0.0 <= diffuse <= _BRIGHTEST_W_M2):
        raise InputError(path, f"light must be from 0 to {_BRIGHTEST_W_M2:g} W m-2", key=key)
    return start.hour * 60.0 + start.minute + start.second / 60.0, direct, diffuse


@cache
def _efficacies() -> tuple[float, float]:
    """Lumens per watt over all wavelengths of ASTM G173-03's sunlight, and of its skylight."""
    cosine = float(np.cos(np.arccos(1.0 / 1.5) - np.radians(37.0)))
    skylight = _G173_TILTED_W_M2 - cosine * _G173_DIRECT_W_M2
    direct = illuminance(astm_g173("direct_W_m2_nm")) / _G173_DIRECT_W_M2
    return direct, illuminance(diffuse_spectrum()) / skylight
