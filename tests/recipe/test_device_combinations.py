"""Devices that are valid alone, together: an image, or an error before anything is written."""

from __future__ import annotations

import itertools
import tomllib

import numpy as np
import pytest
import tomli_w

from pepperscene import BuildOptions, build, open_dataset
from pepperscene.building.scenes.frame_renderer import mitsuba_renderer
from pepperscene.camera import load_flash
from pepperscene.errors import InputError
from pepperscene.recipe.resolve.load import resolve_recipe
from pepperscene.scene import load_cover
from pepperscene.shipped import shipped_folder

MATERIALS = shipped_folder("materials")
SMALL = {"columns": 12, "rows": 8}
ONE_PLANT = {"row.plants_front": 1, "row.plants_back": 0, "plan.sets": 1, "plan.rotations": 1}
UNCORRECTED = {"developing.white_balance": "none", "developing.colour_matrix": False}
NIGHT = {"daylight.illuminance_lx": 0.0}
STRONG_SUN = {"daylight.illuminance_lx": 200_000.0, "daylight.sun_fraction": 0.95}


def shipped_names(kind):
    return sorted(path.stem for path in (MATERIALS / kind).glob("*.toml"))


def device(folder, kind, name, **changes):
    """A copy of a shipped device with other values; its curves are named by absolute paths."""
    table = tomllib.loads((MATERIALS / kind / f"{name}.toml").read_text(encoding="utf-8"))
    for part in table.values():
        if isinstance(part, dict) and "file" in part and (MATERIALS / kind / part["file"]).is_file():
            part["file"] = str(MATERIALS / kind / part["file"])
    for key, value in changes.items():
        if value is None:
            table.pop(key, None)
            table["sources"].pop(key, None)
        else:
            table[key] = value
            table["sources"][key] = "chosen"
    path = folder / f"{kind}_{name}.toml"
    path.write_text(tomli_w.dumps(table), encoding="utf-8")
    return str(path)


def curve(folder, name, text):
    (folder / f"{name}.csv").write_text(text, encoding="utf-8")
    return {"file": f"{name}.csv", "column": "t"}


def filter_of(folder, text):
    return device(folder, "filters", "schott_22022010", transmittance=curve(folder, "filter", text))


def sensor_of(folder, text):
    (folder / "sensor.csv").write_text(text, encoding="utf-8")
    efficiency = {"file": "sensor.csv", "columns": ["red", "green", "blue"]}
    changes = {**SMALL, "quantum_efficiency": efficiency, "infrared_cut": None}
    return device(folder, "sensors", "ueye_ui5250re", **changes)


def flash_of(folder, text, **changes):
    return device(folder, "flashes", "led_matrix_200klx", spectrum=curve(folder, "flash", text), **changes)


def image(folder, changes):
    """The image and the electrons of one small frame."""
    if "camera.sensor" not in changes:
        changes = {**changes, "camera.sensor": device(folder, "sensors", "ueye_ui5250re", **SMALL)}
    recipe = resolve_recipe("barth2018", {**ONE_PLANT, **changes})
    out = folder / "out"
    build(
        recipe, out, "0:1", ("colour", "electrons"), BuildOptions(quality="draft", renderer=mitsuba_renderer)
    )
    dataset = open_dataset(out)
    electrons = dataset.image(0, "electrons")
    assert np.isfinite(electrons).all()
    assert (electrons >= 0).all()
    return dataset.image(0, "colour"), electrons


NO_BLUE = "wavelength_nm,red,green,blue\n400,0,.1,.5\n500,.1,.5,0\n600,.5,.1,0\n700,.5,0,0\n"
NARROW_BLUE = (
    "wavelength_nm,red,green,blue\n400,.1,.1,0\n500.2,.1,.1,0\n500.3,.1,.1,.5\n500.4,.1,.1,0\n700,.1,.1,0\n"
)
ORANGE = "wavelength_nm,t\n550,0\n600,1\n700,1\n"
RED_LED = "wavelength_nm,t\n640,0\n650,1\n660,0\n"


@pytest.mark.long
@pytest.mark.parametrize(
    ("sensor", "filter_text", "led", "changes"),
    [(NO_BLUE, ORANGE, None, {}), (NO_BLUE, None, RED_LED, NIGHT), (NARROW_BLUE, None, None, {})],
    ids=["behind a filter", "under one LED", "between whole nanometres"],
)
def test_colour_that_detects_nothing_is_dark(tmp_path, sensor, filter_text, led, changes):
    changes = {**UNCORRECTED, **changes, "camera.sensor": sensor_of(tmp_path, sensor)}
    if filter_text:
        changes["camera.filter"] = filter_of(tmp_path, filter_text)
    if led:
        changes["camera.flash"] = flash_of(tmp_path, led)
    _, electrons = image(tmp_path, changes)
    # The denoiser mixes colours by less than a thousandth.
    assert electrons[..., 2].max() < 1e-3 * electrons[..., 0].max()
    assert electrons[..., 0].max() > 100


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("wavelength_nm,t\n300,0\n800,0\n", "behind it is not sensitive at any wavelength"),
        ("wavelength_nm,t\n500.2,0\n500.3,1\n500.4,0\n", "behind it is not sensitive at any whole number"),
    ],
)
def test_filter_that_lets_no_light_to_a_sensor_is_an_error(tmp_path, text, problem):
    with pytest.raises(InputError, match=rf"camera\.filter = .*{problem}"):
        resolve_recipe("barth2018", {"camera.filter": filter_of(tmp_path, text)})


def test_line_of_a_flash_between_whole_nanometres_is_an_error(tmp_path):
    text = "wavelength_nm,t\n849.2,0\n849.4,1\n849.6,0\n"
    flash = flash_of(tmp_path, text, illuminance_lx=None, irradiance_W_m2=40.0)
    with pytest.raises(InputError, match=r"spectrum\.column = 't': must contain light at a whole number"):
        load_flash(flash)


def cover_of(folder, visible, infrared):
    text = f"wavelength_nm,t\n300,{visible}\n700,{visible}\n720,{infrared}\n1100,{infrared}\n"
    changes = {"transmittance": curve(folder, "cover", text), "haze": 1.0, "haze_width_deg": 2.0}
    return device(folder, "covers", "diffuse_glass_4mm", **changes)


@pytest.mark.parametrize(("visible", "infrared"), [(0.0, 1.0), (1e-3, 1.0)])
def test_cover_that_hardly_lets_visible_light_through_is_an_error(tmp_path, visible, infrared):
    with pytest.raises(InputError, match=r"transmittance\.column = 't': must let visible light through"):
        load_cover(cover_of(tmp_path, visible, infrared))


def test_sun_that_is_too_low_for_its_light_is_an_error():
    with pytest.raises(InputError, match=r"towards the sun must be at most 1e\+06 lx"):
        resolve_recipe("barth2018", {**STRONG_SUN, "daylight.sun_elevation_deg": 1.0})


FLASHES, FILTERS = (["none", *shipped_names(kind)] for kind in ("flashes", "filters"))
COMBINATIONS = list(itertools.product(shipped_names("sensors"), FLASHES, FILTERS, [{}, NIGHT]))
STEP = 19
"""Chosen: coprime to the numbers of devices, so that each is tested with many others; all combinations take
more than twenty minutes."""


@pytest.mark.long
@pytest.mark.parametrize(
    ("steps", "first"), [({}, 0), (UNCORRECTED, STEP // 2)], ids=["corrected", "as the device"]
)
def test_shipped_devices_work_together_or_are_refused(tmp_path, steps, first):
    made, combinations = 0, COMBINATIONS[first::STEP]
    for number, (sensor, flash, glass, light) in enumerate(combinations):
        folder = tmp_path / str(number)
        folder.mkdir()
        devices = {"camera.flash": flash, "camera.filter": glass}
        devices["camera.sensor"] = device(folder, "sensors", sensor, **SMALL)
        try:
            image(folder, {**steps, **light, **devices})
            made += 1
        except InputError as error:
            assert "\n" not in str(error)  # noqa: PT017 - either is right
            assert not (folder / "out").exists()
    assert made > len(combinations) // 3
