"""Frames of a recipe that varies everything have the same bytes however they are built."""

from __future__ import annotations

import json

import pytest
from data_sets import contents

from pepperscene.building.execution.build import build
from pepperscene.building.execution.job import BuildOptions

RECIPE = """
extends = "greenhouse"
name = "varied"
cultivar = { kaite_february = 0.5, red_blocky = 0.5 }

[plan]
sets = 2
rotations = 1
frames = 2
select = []

[row]
plants_front = 2
plants_back = 1
spacing_mm = { low = 170, high = 260 }

[views]
kind = "random"
target = { fruit = 0.5, leaf = 0.5 }
distance_mm = [400, 700]
least_visibility = 0.1

[camera]
sensor = { generic_rgb = 0.5, ueye_ui5250re = 0.5 }
width = 64
height = 48
hfov_deg = { low = 40, high = 70 }
focus_mm = { low = 300, high = 900, scale = "log" }
flash = { none = 0.5, led_matrix_200klx = 0.5 }
exposure_us = "auto"

[auto_exposure]
target_grey = { low = 60, high = 130 }

[developing]
white_balance = "daylight"
white_balance_error = [{ mean = 1, sd = 0.05 }, 1, { mean = 1, sd = 0.05 }]

[daylight]
illuminance_lx = { low = 2000, high = 60000, scale = "log" }
sun_azimuth_deg = { low = -180, high = 180 }
sun_elevation_deg = { low = 10, high = 60 }
cover = { float_glass_4mm = 0.5, diffuse_glass_4mm = 0.5, per = "set" }

[greenhouse]
far_rows = 0
floor = { true = 0.5, false = 0.5 }
"""
OUTPUTS = ("colour", "class", "instance", "distance")


@pytest.fixture(scope="module")
def recipe(tmp_path_factory):
    path = tmp_path_factory.mktemp("recipe") / "varied.toml"
    path.write_text(RECIPE)
    return path


@pytest.fixture(scope="module")
def whole(recipe, tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    build(recipe, folder / "set", None, OUTPUTS, BuildOptions(quality="draft"))
    return contents(folder / "set")


def test_frames_differ_in_their_values(whole):
    drawn = [
        json.loads(content)["drawn"]
        for name, content in whole.items()
        if name.startswith("frames/") and name.endswith(".json")
    ]
    assert len(drawn) == 4
    for key in ("camera.hfov_deg", "camera.focus_mm", "daylight.illuminance_lx", "auto_exposure.target_grey"):
        assert len({frame[key] for frame in drawn}) == 4
    for key in ("cultivar", "row.spacing_mm", "daylight.cover"):
        assert drawn[0][key] == drawn[1][key]


def test_frames_alone_and_in_reverse_order_have_the_bytes_that_they_have_in_the_set(recipe, whole, tmp_path):
    for index in (3, 0):
        build(recipe, tmp_path / "set", [index], OUTPUTS, BuildOptions(quality="draft"))
    built = contents(tmp_path / "set")
    assert built == {name: content for name, content in whole.items() if name in built}
    assert sum("000003" in name for name in built) == 1 + len(OUTPUTS)


@pytest.mark.long
def test_frames_of_workers_have_the_same_bytes(recipe, whole, tmp_path):
    build(recipe, tmp_path / "set", None, OUTPUTS, BuildOptions(quality="draft", workers=2))
    assert contents(tmp_path / "set") == whole
