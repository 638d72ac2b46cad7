"""Changed copies of TOML and CSV files: each is read, or refused in one sentence."""

from __future__ import annotations

import re
import tomllib

import tomli_w
from fuzzing import EXAMPLES, NUMBERS, attempt, attempt_file
from hypothesis import strategies as st

from pepperscene import open_patches
from pepperscene.building.execution.slurm import read_slurm_file
from pepperscene.camera import Camera, load_filter, load_flash, load_lens, load_sensor
from pepperscene.cultivar import load_cultivar
from pepperscene.document import read_toml
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


@EXAMPLES
def test_any_toml_document(examples, tmp_path):
    contents = files(RECIPES) + files(MATERIALS / "lenses") + [PATCHES]
    attempt_file(examples, tmp_path / "file.toml", contents, read_toml)


@EXAMPLES
def test_recipe(examples, tmp_path):
    attempt_file(examples, tmp_path / "recipe.toml", files(RECIPES), resolve_recipe)


@EXAMPLES
def test_cultivar(examples, tmp_path):
    contents = [(PLANTS / f"{name}.toml").read_bytes() for name in ("kaite", "kaite_february", "tomato")]
    attempt_file(examples, tmp_path / "plant.toml", contents, load_cultivar)


@EXAMPLES
def test_sensor(examples, tmp_path):
    lens = load_lens("lensagon_cmfa0420nd")
    contents = with_absolute_files("sensors")
    attempt_file(examples, tmp_path / "s.toml", contents, lambda path: Camera(lens, load_sensor(path)))


@EXAMPLES
def test_lens(examples, tmp_path):
    sensor = load_sensor("ueye_ui5250re")
    contents = with_absolute_files("lenses")
    attempt_file(examples, tmp_path / "lens.toml", contents, lambda path: Camera(load_lens(path), sensor))


@EXAMPLES
def test_flash(examples, tmp_path):
    attempt_file(
        examples,
        tmp_path / "flash.toml",
        with_absolute_files("flashes"),
        lambda path: load_flash(path).radiant_intensity([450.0, 550.0]),
    )


@EXAMPLES
def test_filter(examples, tmp_path):
    sensor = load_sensor("ueye_ui5250re")
    attempt_file(
        examples,
        tmp_path / "filter.toml",
        with_absolute_files("filters"),
        lambda path: sensor.with_filter(load_filter(path).transmittance),
    )


@EXAMPLES
def test_cover(examples, tmp_path):
    attempt_file(examples, tmp_path / "cover.toml", with_absolute_files("covers"), load_cover)


@EXAMPLES
def test_provenance(examples, tmp_path):
    (tmp_path / "s.csv").write_text("wavelength_nm,a\n400,1\n500,1\n")
    attempt_file(
        examples,
        tmp_path / "s.toml",
        files(MATERIALS / "light") + files(MATERIALS / "leaf"),
        lambda path: read_provenance(path.with_suffix(".csv")),
    )


@EXAMPLES
def test_patches(examples, tmp_path):
    import numpy as np
    from PIL import Image

    (tmp_path / "pictures").mkdir()
    Image.fromarray(np.full((20, 30, 3), 90, np.uint8)).save(tmp_path / "pictures" / "p1.png")
    attempt_file(examples, tmp_path / "patches.toml", [PATCHES], open_patches)


@EXAMPLES
def test_bounds(examples, tmp_path):
    resolved = resolve_recipe("demo")
    available = all_parameters(resolved.cultivar, resolved.camera)
    content = b'[leaf.chlorophyll]\nmean = 40\nsd = 5\nlow = 20\nhigh = 200\nchosen = "as measured"\n\n'
    content += (
        b'["flash.colour"]\nrelative = "times"\nmean = 1\nsd = 0.1\nlow = 0.5\nhigh = 2\nchosen = "a"\n'
    )
    chosen = [parameter for name, parameter in available.items() if name == "leaf.chlorophyll"]

    def read(path):
        prior_distributions(chosen, available.values(), path)

    attempt_file(examples, tmp_path / "bounds.toml", [content], read)


@EXAMPLES
def test_slurm_jobs(examples, tmp_path):
    content = code_block("how-to/cluster.md", "toml", "# jobs.toml")
    attempt_file(examples, tmp_path / "jobs.toml", [content], read_slurm_file)


@EXAMPLES
def test_spectra(examples, tmp_path):
    contents = [
        (MATERIALS / name).read_bytes()
        for name in ("light/houser2013_cool_white_led.csv", "sensors/spectra/onsemi_mt9v024_rgb_qe.csv")
    ]
    attempt_file(examples, tmp_path / "curves.csv", contents, read_spectra)


@EXAMPLES
def test_sensor_with_a_changed_efficiency(examples, tmp_path):
    lens = load_lens("lensagon_cmfa0420nd")
    (tmp_path / "s.toml").write_bytes((MATERIALS / "sensors" / "nikon_d5100.toml").read_bytes())
    (tmp_path / "spectra").mkdir()
    table = read_toml(tmp_path / "s.toml")["quantum_efficiency"]["file"]
    content = (MATERIALS / "sensors" / table).read_bytes()
    attempt_file(
        examples, tmp_path / table, [content], lambda _: Camera(lens, load_sensor(tmp_path / "s.toml"))
    )


KEY = st.sampled_from(
    [
        "camera.sensor",
        "plan.frames",
        "daylight.cover",
        "views.height_mm",
        "growth.date",
        "row",
        "",
        ".",
        "x.y",
        "expect",
    ]
)
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
TABLE = st.dictionaries(
    st.sampled_from(
        [
            "mean_mm",
            "sd_mm",
            "low_mm",
            "high_mm",
            "value_mm",
            "uniform_mm",
            "histogram_mm",
            "along_mm",
            "with_height",
            "chosen",
            "source",
            "mean",
            "sd_deg",
        ]
    ),
    NUMBER | st.lists(NUMBER, max_size=4) | st.lists(st.lists(NUMBER, max_size=4), max_size=4),
    max_size=5,
)


@EXAMPLES
def test_notation_of_distributions(examples):
    from pepperscene.cultivar.notation import Length
    from pepperscene.document import Document, validate

    class Model(Document):
        length: Length

    def read(table):
        distribution = validate(Model, {"length": {"chosen": "so", **table}}, "file").length
        if not distribution.needs_position:
            values = distribution.quantiles([0.0, 0.25, 0.5, 1.0])
            assert (values[:-1] <= values[1:]).all()
            assert abs(values).max() < 1e7

    attempt(examples, TABLE, read)
