"""Files of sensors, bands, lenses, flashes and filters: shipped ones, errors, and the page on them."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from pydantic import BaseModel

from pepperscene.camera import (
    Band,
    Filter,
    Flash,
    Lens,
    Projector,
    Sensor,
    load_filter,
    load_flash,
    load_lens,
    load_projector,
    load_sensor,
)
from pepperscene.camera.optics.flash import FlashDocument
from pepperscene.camera.optics.lens import LensDocument
from pepperscene.camera.optics.projector import ProjectorDocument
from pepperscene.camera.sensor.bands import BandTable, band_curves, describe_bands
from pepperscene.camera.sensor.sensor_files import FilterDocument, SensorDocument
from pepperscene.errors import InputError
from pepperscene.scene.cover import Cover, CoverDocument, load_cover
from pepperscene.shipped import shipped_folder
from pepperscene.spectra import Spectrum, read_spectrum

FOLDER = shipped_folder("materials")
LOADERS = {
    "sensors": load_sensor, "lenses": load_lens, "flashes": load_flash, "filters": load_filter,
    "projectors": load_projector,
}  # fmt: skip
SHIPPED = [(kind, path.stem) for kind in LOADERS for path in sorted((FOLDER / kind).glob("*.toml"))]
NM = np.arange(300.0, 1201.0)


@pytest.mark.parametrize(("kind", "name"), SHIPPED)
def test_shipped_device_loads_by_name_and_by_path(kind, name):
    load = LOADERS[kind]
    assert load(name).name == load(FOLDER / kind / f"{name}.toml").name


def test_camera_of_the_paper():
    sensor, lens = load_sensor("ueye_ui5250re"), load_lens("lensagon_cmfa0420nd")
    flash = load_flash("led_matrix_200klx")
    assert (sensor.columns, sensor.rows, sensor.binning, sensor.photosites) == (800, 600, 2, (1, 2, 1))
    assert sensor.columns * sensor.pixel_pitch_m == pytest.approx(7.2e-3)
    assert lens.focal_length_m == pytest.approx(4.16e-3)
    assert lens.distortion.is_zero
    assert (flash.illuminance_lx, flash.at_m, flash.pulse_s) == pytest.approx((2e5, 0.5, 50e-6))
    # No red, green or blue photosite counts infrared light: the filter is included.
    assert sensor.quantum_efficiency.at([700.0, 800.0]).max() < 1e-3


def test_infrared_cut_multiplies_the_efficiency():
    efficiency = load_sensor("onsemi_mt9v024").quantum_efficiency
    # The tables at 540 nm: the filter's 0.93055 times the green photosite's 0.61696 or less.
    assert 0.5 < efficiency.at(540.0)[1, 0] < 0.93055 * 0.61696 + 1e-9
    assert efficiency.at([850.0]).max() < 1e-3


def test_electrons_per_joule_of_a_known_wavelength():
    # At 500 nm a photon has h c / lambda = 3.9729e-19 J.
    sensor = load_sensor("ueye_ui5250re")
    expected = sensor.quantum_efficiency.at(500.0) / 3.972892e-19
    np.testing.assert_allclose(sensor.electrons_per_joule(500.0), expected, rtol=1e-6)


@pytest.mark.parametrize("kind", LOADERS)
def test_unknown_name_lists_shipped_devices(kind):
    with pytest.raises(InputError, match=f"nor one of the shipped {kind}") as caught:
        LOADERS[kind]("nikon")
    assert all(name in str(caught.value) for shipped_kind, name in SHIPPED if shipped_kind == kind)


def copy_of(tmp_path, kind, name, change):
    """A shipped file copied, its table changed by `change(table)`."""
    table = tomllib.loads((FOLDER / kind / f"{name}.toml").read_text(encoding="utf-8"))
    (tmp_path / "spectra").mkdir()
    for path in (FOLDER / kind / "spectra").glob("*.csv"):
        (tmp_path / "spectra" / path.name).write_bytes(path.read_bytes())
    change(table)
    copy = tmp_path / "mine.toml"
    copy.write_text(tomli_w.dumps(table), encoding="utf-8")
    return copy


def put(*keys_and_value):
    *keys, last, value = keys_and_value

    def change(table):
        for key in keys:
            table = table[key]
        table[last] = value

    return change


def drop(*keys):
    def change(table):
        for key in keys[:-1]:
            table = table[key]
        del table[keys[-1]]

    return change


def without_lux(table):
    del table["illuminance_lx"], table["sources"]["illuminance_lx"]


def with_watts(table):
    table["irradiance_W_m2"] = 40
    table["sources"]["irradiance_W_m2"] = "chosen"


NAMES = {
    "sensors": "ueye_ui5250re",
    "lenses": "lensagon_cmfa0420nd_typical_distortion",
    "flashes": "led_matrix_200klx",
    "filters": "schott_22022010",
    "projectors": "realsense_d435",
}
NARROW = {"angle_deg": [0, 0.1], "relative_intensity": [1, 0]}
INVALID = [
    ("sensors", put("pitch_um", -4.5), r"mine\.toml: pitch_um = -4\.5"),
    ("sensors", put("binning", 3), r"binning must be 1 or even"),
    ("sensors", lambda t: t.update(binning=1, columns=1601), r"1601 x 600 photosites hold no whole Bayer"),
    ("sensors", put("pattern", "rgb"), r"pattern = 'rgb'"),
    ("sensors", put("pattern", "mono"), r"columns must name 1 for the pattern mono"),
    ("sensors", put("black_level_dn", 1023), r"black_level_dn must be below"),
    ("sensors", drop("full_well_e"), r"full_well_e: is required"),
    ("sensors", drop("sources", "bits"), r"\[sources\].*\bbits\b"),
    ("sensors", put("sources", "weight", "scales"), r"\[sources\].*\bweight\b"),
    ("sensors", put("quantum_efficiency", "file", "no.csv"), r"quantum_efficiency\.file = 'no\.csv'"),
    ("sensors", put("quantum_efficiency", "columns", ["r", "g", "x"]), r"MODEL\.csv.*'x'"),
    ("sensors", put("quantum_efficiency", "columns", ["r", "g"]), r"columns must name 3 for the pattern"),
    ("lenses", put("distortion", "k1", float("nan")), r"distortion\.k1 = nan"),
    ("lenses", put("distortion", {"k5": 0.1}), r"distortion: k5 is not a .* plumb_bob, which has k1, k2, p1"),
    (
        "lenses",
        put("distortion", {"model": "equidistant", "p1": 0.1}),
        r"n: p1 is not a .* model equidistant",
    ),
    ("lenses", put("distortion", {"model": "fisheye"}), r"distortion\.model = 'fisheye'"),
    ("lenses", put("principal_offset_mm", [0.1, -0.2]), r"\[sources\].*principal_offset_mm"),
    ("lenses", put("vignetting", "relative", [1, 1, 1, 1, 1, 2.5]), r"vignetting\.relative\.5 = 2\.5"),
    ("lenses", put("vignetting", "relative", [1, 1]), r"vignetting: .*equally long"),
    ("lenses", put("vignetting", "relative", [0.9, 0.9, 0.9, 0.8, 0.8, 0.7]), r"1 at angle 0"),
    ("lenses", put("vignetting", "angle_deg", [0, 15, 25, 20, 42, 50]), r"increasing list"),
    ("flashes", with_watts, r"exactly one of illuminance_lx and irradiance_W_m2 must be given"),
    ("flashes", without_lux, r"exactly one of illuminance_lx and irradiance_W_m2 must be given"),
    ("flashes", put("profile", "angle_deg", [0, 20, 10, 26, 35, 45, 65]), r"profile: angles must be one"),
    ("flashes", put("matrix", "pitch_mm", 2.9), r"at most half of matrix\.pitch_mm"),
    ("flashes", put("profile", NARROW), r"profile: does not fit the other values: .*no light of the profile"),
    ("flashes", put("spectrum", "file", "light/no_such"), r"spectrum\.file = 'light/no"),
    ("flashes", put("spectrum", "file", "light/astm_g173_300_1100"), r"'lumileds_cool_white': is not one of"),
    ("filters", put("transmittance", "file", "no.csv"), r"transmittance\.file = 'no\.csv': is not a file"),
    ("filters", put("transmittance", "column", "x"), r"'x': is not one of"),
    ("filters", drop("sources", "transmittance"), r"\[sources\].*\btransmittance\b"),
]


@pytest.mark.parametrize(("kind", "change", "message"), INVALID)
def test_raises_on_invalid_table(tmp_path, kind, change, message):
    with pytest.raises(InputError, match=message):
        LOADERS[kind](copy_of(tmp_path, kind, NAMES[kind], change))


RGB, CURVE = "wavelength_nm,r,g,b\n400,.1,.2,.3", "wavelength_nm,t\n400,.5"
TABLES = {
    "rgb": ("sensors", "onsemi_mt9v024", "quantum_efficiency"),
    "cut": ("sensors", "onsemi_mt9v024", "infrared_cut"),
    "filter": ("filters", "schott_22022010", "transmittance"),
}


@pytest.mark.parametrize(
    ("table", "text", "message"),
    [
        ("rgb", f"{RGB}\n500,.1,nan,.3", r"row 3, column g = 'nan'"),
        ("rgb", f"{RGB}\n500,.1,-.2,.3", r"row 3, column g = -0\.2: must be at least 0"),
        ("rgb", f"{RGB}\n500,.1,1.2,.3", r"row 3, column g = 1\.2: must be at most 1"),
        ("cut", f"{CURVE}\n700,1.5", r"row 3, column t = 1\.5: must be at most 1"),
        ("filter", f"{CURVE}\n700,1.2", r"row 3, column t = 1\.2: must be at most 1"),
        ("filter", f"{CURVE}\n700,-.2", r"row 3, column t = -0\.2: must be at least 0"),
    ],
)
def test_raises_on_invalid_curve_with_row_and_column(tmp_path, table, text, message):
    kind, name, key = TABLES[table]
    columns = {} if table == "rgb" else {"column": "t"}
    path = copy_of(tmp_path, kind, name, lambda document: document[key].update(file="curve.csv", **columns))
    (tmp_path / "curve.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        LOADERS[kind](path)


def infrared(tmp_path, *changes):
    """The shipped flash's file with an infrared spectrum."""

    def change(table):
        table["spectrum"] = {"file": "ir.csv", "column": "ir"}
        for one in changes:
            one(table)

    path = copy_of(tmp_path, "flashes", NAMES["flashes"], change)
    (tmp_path / "ir.csv").write_text("wavelength_nm,ir,none\n800,0,0\n850,1,0\n900,0,0", encoding="utf-8")
    return path


def test_only_a_flash_in_lux_needs_visible_light(tmp_path):
    with pytest.raises(InputError, match=r"spectrum\.column = 'ir': must contain light in 400 to 700 nm, or"):
        load_flash(infrared(tmp_path))
    (tmp_path / "watts").mkdir()
    flash = load_flash(infrared(tmp_path / "watts", without_lux, with_watts))
    assert (flash.illuminance_lx, flash.irradiance_W_m2) == (None, 40)
    # A triangle of 100 nm: its peak is 40 W/m2 over 50 nm.
    assert flash.irradiance().at(850.0)[0] == pytest.approx(0.8)
    (tmp_path / "none").mkdir()
    dark = infrared(tmp_path / "none", without_lux, with_watts, put("spectrum", "column", "none"))
    with pytest.raises(InputError, match=r"spectrum\.column = 'none': must contain some light"):
        load_flash(dark)


def test_flash_can_use_a_shipped_led_or_one_beside_its_file(tmp_path):
    file, column = "light/nist_phosphor_led_colour_science.csv", "phos_1"
    spectrum = put("spectrum", {"file": file, "column": column})
    path = copy_of(tmp_path, "flashes", NAMES["flashes"], spectrum)
    np.testing.assert_array_equal(load_flash(path).spectrum.values, read_spectrum(file, column).values)
    (tmp_path / "light").mkdir()
    (tmp_path / file).write_text(f"wavelength_nm,{column}\n500,1\n600,1", encoding="utf-8")
    np.testing.assert_array_equal(load_flash(path).spectrum.values, [1, 1])


def test_flash_without_a_matrix_is_one_emitter(tmp_path):
    def change(table):
        del table["matrix"], table["sources"]["matrix"]
        table["radius_mm"] = 30

    flash = load_flash(copy_of(tmp_path, "flashes", NAMES["flashes"], change))
    np.testing.assert_array_equal(flash.emitters_m, [[0, 0]])
    assert flash.radius_m == pytest.approx(0.03)


def test_a_matrix_is_centred_and_offsets_are_in_millimetres(tmp_path):
    matrix = put("matrix", {"columns": 3, "rows": 2, "pitch_mm": 10.0})
    flash = load_flash(copy_of(tmp_path, "flashes", NAMES["flashes"], matrix))
    expected = [[x, y] for y in (-0.005, 0.005) for x in (-0.01, 0.0, 0.01)]
    np.testing.assert_allclose(flash.emitters_m, expected, atol=1e-15)

    def move_axis(table):
        table["principal_offset_mm"] = [0.12, -0.05]
        table["sources"]["principal_offset_mm"] = "calibrated"

    (tmp_path / "lens").mkdir()
    lens = load_lens(copy_of(tmp_path / "lens", "lenses", "lensagon_cmfa0420nd", move_axis))
    assert lens.principal_offset_m == pytest.approx((1.2e-4, -5e-5))


@pytest.mark.parametrize("folder", [*LOADERS, "covers"])
def test_every_shipped_number_has_a_source_and_every_file_a_licence(folder):
    for path in (FOLDER / folder).glob("*.toml"):
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        assert table["licence"], path.name
        assert table["sources"].keys() == table.keys() - {"name", "licence", "sources", "kind"}, path.name
        assert all(len(source) > 5 for source in table["sources"].values()), path.name


@pytest.mark.parametrize("kind", LOADERS)
def test_own_files_need_neither_sources_nor_a_licence(tmp_path, kind):
    def change(table):
        del table["sources"], table["licence"]

    assert LOADERS[kind](copy_of(tmp_path, kind, NAMES[kind], change)).name


def test_lens_files_have_further_models(tmp_path):
    coefficients = {"model": "equidistant", "k1": 0.1, "k4": 0.01}
    lens = load_lens(copy_of(tmp_path, "lenses", NAMES["lenses"], put("distortion", coefficients)))
    assert lens.distortion.to_json() == coefficients | {"k2": 0.0, "k3": 0.0}


BANDED = {
    "name": "bands", "kind": "MODEL", "columns": 8, "rows": 6, "pattern": "bands", "binning": 1,
    "pitch_um": 4.0, "full_well_e": 10_000, "read_noise_e": 5, "bits": 12, "black_level_dn": 10,
}  # fmt: skip
BAND_CURVES = "wavelength_nm,first,second,third\n400,0,0,0\n500,0.5,0.1,0\n600,0,0.1,0.8\n700,0,0,0\n"


def load_bands(folder, changes):
    (folder / "curves.csv").write_text(BAND_CURVES)
    table = {key: value for key, value in {**BANDED, **changes}.items() if value is not None}
    (folder / "sensor.toml").write_bytes(tomli_w.dumps(table).encode())
    return load_sensor(folder / "sensor.toml")


def test_gaussian_is_half_as_high_half_a_width_beside_its_centre():
    curve = band_curves([BandTable(centre_nm=700.0, width_nm=10.0, peak=0.6)])
    np.testing.assert_allclose(curve.at([695.0, 700.0, 705.0])[0], [0.3, 0.6, 0.3], rtol=1e-12)
    # The area of a Gaussian: peak x width x sqrt(pi / (4 ln 2)).
    assert curve.integral()[0] == pytest.approx(0.6 * 10.0 * np.sqrt(np.pi / np.log(16.0)), rel=1e-4)


@pytest.mark.parametrize("centre", [700.0, 700.1])
def test_box_has_its_width_and_area(centre):
    curve = band_curves([BandTable(centre_nm=centre, width_nm=20.0, peak=0.5, shape="box")])
    assert curve.integral()[0] == pytest.approx(10.0, rel=1e-9)
    edges = curve.at([centre - 10.5, centre - 9.5, centre + 9.5, centre + 10.5])
    assert edges[0].tolist() == [0, 0.5, 0.5, 0]
    (band,) = describe_bands(curve)
    assert (band.centre_nm, band.width_nm) == pytest.approx((centre, 20.0), abs=0.011)


def test_bands_one_by_one_and_regular_bands(tmp_path):
    bands = [{"name": "a", "centre_nm": 500, "width_nm": 20, "peak": 0.4}, {"centre_nm": 800, "width_nm": 5}]
    sensor = load_bands(tmp_path, {"bands": bands})
    assert sensor.bands == (Band("a", 500.0, 20.0), Band("", 800.0, 5.0))
    assert sensor.quantum_efficiency.values.max(axis=1).tolist() == [0.4, 0.5]
    table = {"first_nm": 400, "last_nm": 1000, "count": 61, "width_nm": 6}
    sensor = load_bands(tmp_path, {"regular_bands": table})
    assert [band.centre_nm for band in sensor.bands] == pytest.approx(np.arange(400, 1001, 10), abs=0.01)
    assert {band.width_nm for band in sensor.bands} == {6.0}
    assert sensor.band_names == ()


def test_curves_of_a_csv_file_keep_their_names_and_order(tmp_path):
    sensor = load_bands(tmp_path, {"band_curves": {"file": "curves.csv", "columns": ["third", "first"]}})
    # Triangles: the mean wavelength is the mean of the corners, and the width half of the base.
    assert sensor.bands == (Band("third", 600.0, 100.0), Band("first", 500.0, 100.0))
    assert load_bands(tmp_path, {"band_curves": {"file": "curves.csv"}}).channels == 3


def test_efficiency_of_the_photosites_multiplies_all_bands(tmp_path):
    bands = {"bands": [{"centre_nm": 550, "width_nm": 10, "peak": 0.5}]}
    behind = load_bands(
        tmp_path, {**bands, "quantum_efficiency": {"file": "curves.csv", "columns": ["third"]}}
    )
    # The curve is 0.4 at 550 nm.
    assert behind.quantum_efficiency.at([550.0])[0, 0] == pytest.approx(0.2)


def test_filter_in_front_moves_the_band(tmp_path):
    sensor = load_bands(tmp_path, {"bands": [{"centre_nm": 600, "width_nm": 40, "shape": "box"}]})
    (band,) = sensor.with_filter(Spectrum(np.array([600.0, 700.0]), np.ones(2))).bands
    assert (band.centre_nm, band.width_nm) == pytest.approx((610.0, 20.0), abs=0.2)


BAND = {"centre_nm": 500, "width_nm": 20}
REGULAR = {"first_nm": 400, "last_nm": 900, "count": 5, "width_nm": 5}
THREE = {"file": "curves.csv", "columns": ["first"] * 3}
COLOURS = {"pattern": "rggb", "binning": 2, "quantum_efficiency": THREE}
BLIND = {"bands": [{"centre_nm": 900, "width_nm": 20}]}


@pytest.mark.parametrize(
    ("changes", "key", "problem"),
    [
        ({}, "", "needs one of bands, regular_bands, band_curves, which are missing"),
        ({"bands": [BAND], "regular_bands": REGULAR}, "", "not bands and regular_bands"),
        ({"bands": [{**BAND, "peak": 1.5}]}, "bands.0.peak", "less than or equal to 1"),
        ({"bands": [{**BAND, "name": "a"}] * 2}, "bands.1.name", "must be different for each band"),
        ({"regular_bands": {**REGULAR, "last_nm": 300}}, "regular_bands", "must be below last_nm"),
        ({"band_curves": {"file": "no.csv"}}, "band_curves.file", "is not a file in the same folder"),
        (
            {"band_curves": {"file": "curves.csv", "columns": ["x"]}},
            "band_curves.columns", "different columns of",
        ),
        ({"pattern": "mono", "bands": [BAND]}, "", 'bands needs the pattern "bands"'),
        ({"pattern": "mono"}, "", "quantum_efficiency is required but missing"),
        (
            {**BLIND, "quantum_efficiency": {"file": "curves.csv", "columns": ["first"]}},
            "maximum of the band 1", "must reach at least",
        ),
        ({"bands": [BAND], "line_scan": True}, "", "line_scan needs a line_time_us above 0"),
        ({"bands": [BAND], "line_time_us": 20_000}, "", "must be at most 10000, or 1e+07 with line_scan"),
        (
            {**COLOURS, "line_scan": True, "line_time_us": 100},
            "", 'line_scan needs the pattern "mono" or "bands"',
        ),
    ],
)  # fmt: skip
def test_errors_name_key_and_what_is_allowed(tmp_path, changes, key, problem):
    with pytest.raises(InputError) as caught:
        load_bands(tmp_path, changes)
    assert caught.value.key == key
    assert problem in caught.value.problem


TEXT = (Path(__file__).resolve().parents[2] / "docs" / "reference" / "devices.md").read_text(encoding="utf-8")
PAGE_DEVICES = {
    "Sensor": (load_sensor, Sensor, SensorDocument, "sensors"),
    "Lens": (load_lens, Lens, LensDocument, "lenses"),
    "Flash": (load_flash, Flash, FlashDocument, "flashes"),
    "Filter": (load_filter, Filter, FilterDocument, "filters"),
    "Projector": (load_projector, Projector, ProjectorDocument, "projectors"),
    "Cover": (load_cover, Cover, CoverDocument, "covers"),
}
each_device = pytest.mark.parametrize("title", PAGE_DEVICES)


def section(title: str) -> str:
    return TEXT.split(f"\n## {title}\n")[1].split("\n## ")[0]


def block(text: str, language: str) -> str:
    (content,) = re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)
    return content


@each_device
def test_example_loads(title, tmp_path):
    load, kind, _, _ = PAGE_DEVICES[title]
    (tmp_path / "curves.csv").write_text(block(TEXT, "text"), encoding="utf-8")
    (tmp_path / "mine.toml").write_text(block(section(title), "toml"), encoding="utf-8")
    device = load(tmp_path / "mine.toml")
    assert isinstance(device, kind)
    assert device.name.startswith("my ")


def keys(model: type[BaseModel]) -> set[str]:
    """Keys of a file of this model, those of its tables included."""
    names = set(model.model_fields)
    for name, field in model.model_fields.items():
        for kind in (field.annotation, *getattr(field.annotation, "__args__", ())):
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                names |= {f"{name}.{key}" for key in keys(kind)}
    return names


@each_device
def test_page_lists_every_key(title):
    text = TEXT.split("\n## Sensor\n")[0] + section(title)  # keys of all files, and those of this device
    for key in keys(PAGE_DEVICES[title][2]):
        table, _, last = key.rpartition(".")
        rows = [row for row in text.splitlines() if row.startswith("|") and f"`{last}`" in row]
        rows += [row for row in text.splitlines() if row.startswith(f"| `[{last}]`")]
        assert [row for row in rows if not table or f"`[{table}]`" in row], key


@each_device
def test_page_lists_every_shipped_device(title):
    folder = PAGE_DEVICES[title][3]
    (row,) = (row for row in TEXT.splitlines() if re.match(rf"\| .+ \| `{folder}` \|", row))
    listed = set(re.findall(r"`(\w+)`", row.split("|")[3]))
    assert listed == {path.stem for path in (shipped_folder("materials") / folder).glob("*.toml")}
