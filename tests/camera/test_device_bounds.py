"""Numbers of device files inside and at the ends of their ranges: a working camera, or an error.

A file that loads must give a camera whose functions return finite values, also in single precision, which
the renderer uses.
"""

from __future__ import annotations

import copy
import functools
import json
import tomllib

import numpy as np
import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

from pepperscene.camera import (
    Camera,
    develop,
    expected_electrons,
    load_filter,
    load_flash,
    load_lens,
    load_sensor,
    relative_illumination,
)
from pepperscene.camera.optics.flash import FlashDocument
from pepperscene.camera.optics.lens import LensDocument
from pepperscene.camera.sensor.sensor_files import FilterDocument, SensorDocument
from pepperscene.errors import InputError
from pepperscene.scene import load_cover
from pepperscene.scene.cover import CoverDocument
from pepperscene.shipped import shipped_folder

FOLDER = shipped_folder("materials")
LARGEST_IMAGE = 10_000  # pixels that are developed here
NM = np.arange(380.0, 781.0, 20.0)

DEVICES = {
    "sensors": ("ueye_ui5250re", SensorDocument, load_sensor),
    "lenses": ("lensagon_cmfa0420nd_typical_distortion", LensDocument, load_lens),
    "flashes": ("led_matrix_200klx", FlashDocument, load_flash),
    "filters": ("schott_22022010", FilterDocument, load_filter),
    "covers": ("diffuse_glass_4mm", CoverDocument, load_cover),
}


@functools.cache
def template(kind):
    """The table of a shipped file; its curves are named by absolute paths, and its image is small."""
    name, _, _ = DEVICES[kind]
    table = tomllib.loads((FOLDER / kind / f"{name}.toml").read_text(encoding="utf-8"))
    for part in table.values():
        if isinstance(part, dict) and "file" in part and (FOLDER / kind / part["file"]).is_file():
            part["file"] = str(FOLDER / kind / part["file"])
    if kind == "sensors":
        table |= {"columns": 8, "rows": 6}
    if kind == "lenses":
        table["principal_offset_mm"] = [0.1, -0.1]
        table["sources"]["principal_offset_mm"] = "chosen"
        table["distortion"] |= {"p1": 1e-4, "p2": 1e-4, "k3": 1e-4}
    return table


def numbers(table, above=()):
    """The keys of all numbers of a table."""
    items = table.items() if isinstance(table, dict) else enumerate(table)
    for key, value in items:
        if isinstance(value, dict | list):
            yield from numbers(value, (*above, key))
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield *above, key


@functools.cache
def limits(model, key):
    """The least and the largest value that the model allows for a key."""
    schema = node = model.model_json_schema()
    for part in key:
        node = next(option for option in node.get("anyOf", [node]) if option.get("type") != "null")
        if "$ref" in node:
            node = schema["$defs"][node["$ref"].rpartition("/")[2]]
        node = node["properties"][part]
    node = next(option for option in node.get("anyOf", [node]) if option.get("type") != "null")
    return node.get("minimum", 0.0), node["maximum"]


def changed(kind, changes):
    table = copy.deepcopy(template(kind))
    for (*above, last), value in changes.items():
        part = table
        for name in above:
            part = part[name]
        part[last] = value
    return table


def load(folder, kind, changes):
    path = folder / f"{kind}.toml"
    path.write_text(tomli_w.dumps(changed(kind, changes)), encoding="utf-8")
    return DEVICES[kind][2](path)


def check_finite(*arrays):
    for array in arrays:
        assert np.isfinite(np.asarray(array, dtype=float)).all()
        with np.errstate(over="raise", invalid="raise"):
            assert np.isfinite(np.asarray(array, dtype=float).astype(np.float32)).all()


def check_camera(camera):
    """Projection, field of view, light and image of a camera with a flash."""
    flash = camera.flash
    check_finite(camera.intrinsics, camera.aperture_radius_m, camera.flash_duty, camera.project([[0, 0, 1]]))
    check_finite(flash.irradiance().values, flash.radiant_intensity(NM), flash.emitters_m, flash.offset_m)
    assert float(flash.irradiance().integral()) > 0
    assert flash.axial_area_m2 > 0
    json.dumps(camera.to_metadata(), allow_nan=False)
    if camera.width * camera.height * camera.sensor.binning**2 > LARGEST_IMAGE:
        return
    check_finite(camera.ray_slopes(), camera.pixel_directions(), relative_illumination(camera))
    for power in (0.0, 1e25):
        signal = np.full((camera.height, camera.width, camera.sensor.channels), power)
        electrons = expected_electrons(signal, camera)
        assert np.isfinite(electrons).all()
        image = develop(electrons, camera, np.random.default_rng(1))
        assert image.shape == (camera.height, camera.width, 3)


@st.composite
def cameras(draw):
    """Changes of up to three numbers of each device, each within the range that its model allows."""
    changes = {}
    for kind in ("sensors", "lenses", "flashes"):
        keys = [key for key in numbers(template(kind)) if not isinstance(key[-1], int)]
        for key in draw(st.lists(st.sampled_from(keys), max_size=3, unique=True)):
            low, high = limits(DEVICES[kind][1], key)
            if isinstance(low, int):
                value = draw(st.sampled_from([low, high]) | st.integers(low, int(high)))
            else:
                value = draw(st.sampled_from([low, high]) | st.floats(low, high))
            changes.setdefault(kind, {})[key] = value
    return changes


@given(changes=cameras())
def test_any_combination_makes_a_working_camera_or_an_error(tmp_path, changes):
    try:
        sensor, lens, flash = (load(tmp_path, kind, changes.get(kind, {})) for kind in list(DEVICES)[:3])
        camera = Camera(lens, sensor, flash=flash)
    except InputError:
        return
    check_camera(camera)


@pytest.mark.parametrize(
    ("kind", "changes", "message"),
    [
        ("sensors", {("pitch_um",): 1e-308}, r"pitch_um = 1e-308"),
        ("lenses", {("focal_length_mm",): 1e-308}, r"focal_length_mm = 1e-308"),
        ("flashes", {("at_mm",): 1e6}, r"at_mm = 1000000\.0"),
        ("sensors", {("read_noise_e",): 1e6}, r"read_noise_e must be at most full_well_e"),
        ("sensors", {("columns",): 20_000, ("rows",): 20_000, ("binning",): 16}, r"sites must be at most"),
        ("sensors", {("full_well_e",): 0}, r"full_well_e = 0"),
        ("flashes", {("at_mm",): 1e5, ("illuminance_lx",): 1e9}, r"illuminance_lx = 1000000000\.0: .* W/sr"),
    ],
)
def test_impossible_devices_are_errors_at_load(tmp_path, kind, changes, message):
    with pytest.raises(InputError, match=message):
        load(tmp_path, kind, changes)


@pytest.mark.parametrize(
    ("sensor", "lens", "message"),
    [
        ({("columns",): 20_000}, {("focal_length_mm",): 0.1}, r"corner at 89\.\d degrees"),
        ({("pitch_um",): 0.1, ("binning",): 1}, {("focal_length_mm",): 10_000.0}, r"is 1e\+08 pixels"),
        ({}, {("principal_offset_mm", 0): 100.0}, r"corner at 8\d\.\d degrees"),
        ({("columns",): 800, ("rows",): 600}, {("distortion", "k1"): -1.0}, r"invertible over the whole"),
    ],
)
def test_a_lens_and_a_sensor_that_do_not_fit_are_an_error(tmp_path, sensor, lens, message):
    parts = load(tmp_path, "lenses", lens), load(tmp_path, "sensors", sensor)
    with pytest.raises(InputError, match=message):
        Camera(*parts)


@pytest.mark.parametrize("value", ["1.0001", "-1e-308", "1e-308"])
def test_efficiencies_and_transmittances_beyond_possible_fractions_are_errors(tmp_path, value):
    (tmp_path / "curves.csv").write_text(f"wavelength_nm,a,b\n400,{value},{value}\n700,{value},{value}\n")
    efficiency = {"file": "curves.csv", "columns": ["a", "b", "a"]}
    with pytest.raises(InputError):
        load(tmp_path, "sensors", {("quantum_efficiency",): efficiency})
    if value == "1e-308":
        return
    for kind in ("filters", "covers"):
        with pytest.raises(InputError, match="must be"):
            load(tmp_path, kind, {("transmittance",): {"file": "curves.csv", "column": "a"}})
