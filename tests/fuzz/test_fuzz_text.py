"""Changed copies of TOML and CSV files: each is read, or refused in one sentence."""

from __future__ import annotations

import re
import tomllib
from functools import cache

import numpy as np
import pytest
import tomli_w
from fuzzing import EXAMPLES, NUMBERS, attempt, attempt_file
from hypothesis import strategies as st
from PIL import Image

from pepperscene import open_patches
from pepperscene.building.execution.slurm import read_slurm_file
from pepperscene.camera import Camera, load_filter, load_flash, load_lens, load_processor, load_sensor
from pepperscene.camera.isp.processor import read_tone_curve
from pepperscene.cultivar import load_cultivar
from pepperscene.cultivar.notation import Length
from pepperscene.document import Document, read_toml, validate
from pepperscene.recipe.resolve.load import parse_changes, resolve_recipe
from pepperscene.scene import load_cover
from pepperscene.shipped import shipped_folder
from pepperscene.spectra import read_provenance, read_spectra
from pepperscene.tuning.bounds import prior_distributions
from pepperscene.tuning.parameters import all_parameters

MATERIALS, PLANTS, RECIPES = (shipped_folder(name) for name in ("materials", "plants", "recipes"))
DOCS = RECIPES.parent / "docs"

PATCHES = b"""
folder = "pictures"
tone = "srgb"
erode_px = 1

[[patch]]
picture = "p1.png"
kind = "leaf"
box = [3, 5, 12, 15]

[[patch]]
picture = "p1.png"
kind = "pepper.ripe"
name = "triangle"
polygon = [[0, 0], [10, 0], [0, 10]]

[[spectrum]]
file = "vrhel_fruit_vegetable_reflectance"
column = "green_pepper_136"
kind = "pepper.unripe"
"""


def files(folder, pattern="*.toml"):
    return [path.read_bytes() for path in sorted(folder.glob(pattern))]


def code_block(page, language, start):
    text = (DOCS / page).read_text(encoding="utf-8")
    blocks = re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)
    return next(block.encode() for block in blocks if start in block)


def with_absolute_files(kind):
    """The shipped files of devices, whose curves are named by absolute paths."""
    contents = []
    for path in sorted((MATERIALS / kind).glob("*.toml")):
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        for part in table.values():
            if isinstance(part, dict) and "file" in part and (path.parent / part["file"]).is_file():
                part["file"] = str(path.parent / part["file"])
        contents.append(tomli_w.dumps(table).encode())
    return contents


BOUNDS = b"""
[leaf.chlorophyll]
mean = 40
sd = 5
low = 20
high = 200
chosen = "as measured"

["flash.colour"]
relative = "times"
mean = 1
sd = 0.1
low = 0.5
high = 2
chosen = "a"
"""


@cache
def bounds_arguments():
    resolved = resolve_recipe("demo")
    available = all_parameters(resolved.cultivar, resolved.camera)
    return [available["leaf.chlorophyll"]], tuple(available.values())


def read_patches(path):
    pictures = path.parent / "pictures"
    pictures.mkdir(exist_ok=True)
    if not (pictures / "p1.png").exists():
        Image.fromarray(np.full((20, 30, 3), 90, np.uint8)).save(pictures / "p1.png")
    open_patches(path)


def read_provenance_beside(path):
    path.with_suffix(".csv").write_text("wavelength_nm,a\n400,1\n500,1\n")
    read_provenance(path.with_suffix(".csv"))


def read_sensor_of(path):
    """The sensor whose curves the path has."""
    sensor = tomllib.loads((MATERIALS / "sensors" / "nikon_d5100.toml").read_text(encoding="utf-8"))
    sensor["quantum_efficiency"]["file"] = str(path)
    path.with_name("s.toml").write_text(tomli_w.dumps(sensor), encoding="utf-8")
    Camera(LENS, load_sensor(path.with_name("s.toml")))


def read_sensor(path):
    """The sensor in a camera whose exposure suits a line scanner's time of a line."""
    sensor = load_sensor(path)
    Camera(LENS, sensor, exposure_s=min(sensor.line_time_s, 50e-6) if sensor.line_scan else 50e-6)


LENS, SENSOR = load_lens("lensagon_cmfa0420nd"), load_sensor("ueye_ui5250re")
READERS = {
    "any.toml": (
        lambda: files(RECIPES) + files(MATERIALS / "lenses") + [PATCHES],
        read_toml,
    ),
    "recipe.toml": (lambda: files(RECIPES), resolve_recipe),
    "plant.toml": (
        lambda: [(PLANTS / f"{name}.toml").read_bytes() for name in ("kaite", "kaite_february", "tomato")],
        load_cultivar,
    ),
    "sensor.toml": (lambda: with_absolute_files("sensors"), read_sensor),
    "lens.toml": (lambda: with_absolute_files("lenses"), lambda path: Camera(load_lens(path), SENSOR)),
    "flash.toml": (
        lambda: with_absolute_files("flashes"),
        lambda path: load_flash(path).radiant_intensity([450.0, 550.0]),
    ),
    "filter.toml": (
        lambda: with_absolute_files("filters"),
        lambda path: SENSOR.with_filter(load_filter(path).transmittance),
    ),
    "cover.toml": (lambda: with_absolute_files("covers"), load_cover),
    "isp.toml": (lambda: files(MATERIALS / "isps"), load_processor),
    "tone.csv": (lambda: [b"light,code\n0,0\n0.1,0.4\n0.5,0.8\n1,1\n"], read_tone_curve),
    "provenance.toml": (
        lambda: files(MATERIALS / "light") + files(MATERIALS / "leaf"),
        read_provenance_beside,
    ),
    "patches.toml": (lambda: [PATCHES], read_patches),
    "bounds.toml": (lambda: [BOUNDS], lambda path: prior_distributions(*bounds_arguments(), path)),
    "jobs.toml": (lambda: [code_block("how-to/cluster.md", "toml", "# jobs.toml")], read_slurm_file),
    "curves.csv": (
        lambda: [
            (MATERIALS / name).read_bytes()
            for name in ("light/houser2013_cool_white_led.csv", "sensors/spectra/onsemi_mt9v024_rgb_qe.csv")
        ],
        read_spectra,
    ),
    "efficiency.csv": (
        lambda: [
            (
                MATERIALS
                / "sensors"
                / read_toml(MATERIALS / "sensors/nikon_d5100.toml")["quantum_efficiency"]["file"]
            ).read_bytes()
        ],
        read_sensor_of,
    ),
}
"""Contents of valid files, and what reads them, by the name of a file."""


@EXAMPLES
@pytest.mark.parametrize("name", READERS)
def test_file(examples, tmp_path, name):
    contents, read = READERS[name]
    attempt_file(examples, tmp_path / name, contents(), read)


KEYS = "camera.sensor plan.frames daylight.cover views.height_mm growth.date row . x.y expect"
KEY = st.sampled_from(["", *KEYS.split()])
VALUE = st.one_of(
    st.text(max_size=20),
    st.sampled_from([number.decode() for number in NUMBERS]),
    st.sampled_from(
        ["[1, 2]", "{a = 1}", "1979-05-27", "'''", '"""x', "1\nname = 3", "none", "\x00", "\ud800"]
    ),
)


@EXAMPLES
def test_changes_on_the_command_line(examples):
    pair = st.tuples(KEY, st.sampled_from(["=", " = ", "==", ""]), VALUE).map("".join)
    texts = st.lists(pair | st.text(max_size=12), max_size=3)
    attempt(examples, texts, parse_changes)


@EXAMPLES
def test_recipe_with_changes(examples):
    pair = st.tuples(KEY, st.just("="), VALUE).map("".join)
    texts = st.lists(pair, min_size=1, max_size=2)
    attempt(examples, texts, lambda changes: resolve_recipe("demo", parse_changes(changes)))


NUMBER = st.one_of(
    st.sampled_from(
        [0, -0.0, 1, -1, 2, 1e-308, 1e308, float("nan"), float("inf"), 2**70, True, "7", None, [], {}]
    ),
    st.floats(),
    st.integers(-(2**63), 2**63 - 1),
)
LENGTHS = [f"{name}_mm" for name in ("mean", "sd", "low", "high", "value", "uniform", "histogram", "along")]
TABLE = st.dictionaries(
    st.sampled_from([*LENGTHS, "with_height", "chosen", "source", "mean", "sd_deg"]),
    NUMBER | st.lists(NUMBER, max_size=4) | st.lists(st.lists(NUMBER, max_size=4), max_size=4),
    max_size=5,
)


@EXAMPLES
def test_notation_of_distributions(examples):
    class Model(Document):
        length: Length

    def read(table):
        distribution = validate(Model, {"length": {"chosen": "so", **table}}, "file").length
        if not distribution.needs_position:
            values = distribution.quantiles([0.0, 0.25, 0.5, 1.0])
            assert (values[:-1] <= values[1:]).all()
            assert abs(values).max() < 1e7

    attempt(examples, TABLE, read)
