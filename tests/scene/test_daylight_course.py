"""The sun's path against published positions, clear days, and files of measured light."""

from __future__ import annotations

import math
from datetime import date, datetime, timedelta, timezone

import numpy as np
import pytest

from pepperscene.errors import InputError
from pepperscene.scene.daylight_course import Place, clear_day, measured_day, sun_position


def test_sun_is_where_nrel_publishes_it():
    # Reda & Andreas 2008, NREL/TP-560-34302, appendix A.5: zenith 50.11162, azimuth 194.34024 degrees; its
    # refraction at 820 mbar and 11 degrees is 0.0164.
    when = datetime(2003, 10, 17, 12, 30, 30, tzinfo=timezone(timedelta(hours=-7)))
    elevation, azimuth = sun_position(when, math.radians(39.742476), math.radians(-105.1786))
    assert math.degrees(elevation) == pytest.approx(90.0 - 50.11162 - 0.0164, abs=0.02)
    assert math.degrees(azimuth) == pytest.approx(194.34024, abs=0.02)


@pytest.mark.parametrize(
    ("day", "noon_deg"),
    [(date(2024, 6, 20), 90.0 - 52.0 + 23.44), (date(2024, 12, 21), 90.0 - 52.0 - 23.44)],
)
def test_sun_at_noon_of_the_solstices(day, noon_deg):
    place = Place(52.0)
    moments = clear_day(day, place, 4.0)
    highest = max(moments, key=lambda moment: moment.elevation_rad)
    assert math.degrees(highest.elevation_rad) == pytest.approx(noon_deg, abs=0.05)
    assert math.degrees(highest.azimuth_rad) == pytest.approx(180.0, abs=2.5)
    # In the morning the sun is in the east.
    assert math.sin(moments[0].azimuth_rad) > 0.5
    # It is as bright as is known: 100 klx at 61 degrees, 20 to 30 klx at 15 degrees.
    total = highest.direct_lx + highest.diffuse_lx
    assert (90e3 < total < 115e3) if noon_deg > 50 else (18e3 < total < 32e3)


def test_longest_day_has_its_length():
    # 16 h 50 min between sunrise and sunset at 52 degrees north, which refraction lengthens by 10 minutes;
    # the sun is below 1 degree for 16 minutes of it.
    hours = sum(moment.hours for moment in clear_day(date(2024, 6, 20), Place(52.0), 5.0))
    assert hours == pytest.approx(16.3, abs=0.25)


def test_measured_light_has_the_hours_of_its_rows(tmp_path):
    path = tmp_path / "day.csv"
    path.write_text("time,direct_W_m2,diffuse_W_m2\n00:00,0,0\n10:00,500,100\n12:00,0,300\n16:00,0,0\n")
    morning, noon = measured_day(path, date(2024, 6, 20), Place(52.0))
    assert (morning.hours, noon.hours) == (6.0, 3.0)
    assert noon.direct_lx == 0.0
    # 110 lm/W of sunlight and 110 to 140 lm/W of skylight are what is measured (Littlefair 1985).
    assert 95.0 < morning.direct_lx / 500.0 < 120.0
    assert 100.0 < noon.diffuse_lx / 300.0 < 150.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "comma-separated"),
        ("time,direct\n10:00,5\n", "header"),
        ("time,direct_W_m2,diffuse_W_m2\n", "rows"),
        ("time,direct_W_m2,diffuse_W_m2\n10:00,5\n", "row 2"),
        ("time,direct_W_m2,diffuse_W_m2\n25:00,5,5\n", "row 2"),
        ("time,direct_W_m2,diffuse_W_m2\n10:00,nan,5\n", "row 2"),
        ("time,direct_W_m2,diffuse_W_m2\n10:00,5,5\n09:00,5,5\n", "ascend"),
        ("time,direct_W_m2,diffuse_W_m2\n00:30,5,5\n", "sun is up"),
    ],
)
def test_bad_file_of_measured_light(tmp_path, text, message):
    path = tmp_path / "day.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        measured_day(path, date(2024, 6, 20), Place(52.0))


@pytest.mark.parametrize(
    "place", [(91.0, 0.0, 0.0), (52.0, 181.0, 0.0), (52.0, 0.0, 15.0), (np.nan, 0.0, 0.0)]
)
def test_bad_place(place):
    with pytest.raises(InputError, match="must be from"):
        Place(*place)
