"""Sensor, lens and flash files: what is shipped, and every way of getting one wrong."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest
import tomli_w

from pepperscene.camera import load_flash, load_lens, load_sensor
from pepperscene.errors import InputError
from pepperscene.shipped import shipped_folder
from pepperscene.spectra import read_provenance, read_spectra, read_spectrum

FOLDER = shipped_folder("materials")
LOADERS = {"sensors": load_sensor, "lenses": load_lens, "flashes": load_flash}
SHIPPED = [
    (shelf_name, path.stem) for shelf_name in LOADERS for path in sorted((FOLDER / shelf_name).glob("*.toml"))
]


@pytest.mark.parametrize(("kind", "name"), SHIPPED)
def test_every_shipped_file_loads_by_name_and_by_path(kind, name):
    load = LOADERS[kind]
    assert load(name).name == load(FOLDER / kind / f"{name}.toml").name


@pytest.mark.parametrize(
    "path", [p for kind in LOADERS for p in (FOLDER / kind).rglob("*.csv")], ids=lambda p: p.stem
)
def test_every_shipped_curve_tells_its_source(path):
    provenance = read_provenance(path)
    assert provenance.source
    assert provenance.licence
    assert ("MODEL" in path.stem) == (provenance.kind == "MODEL")


def test_the_paper_s_camera():
    sensor, lens, flash = (
        load_sensor("ueye_ui5250re"),
        load_lens("lensagon_cmfa0420nd"),
        load_flash("led_matrix_200klx"),
    )
    assert (sensor.columns, sensor.rows, sensor.binning, sensor.photosites) == (800, 600, 2, (1, 2, 1))
    assert sensor.columns * sensor.pixel_pitch_m == pytest.approx(7.2e-3)
    assert lens.focal_length_m == pytest.approx(4.16e-3)
    assert lens.distortion.is_none
    assert (flash.illuminance_lx, flash.at_m, flash.pulse_s) == pytest.approx((2e5, 0.5, 50e-6))
    # No red, green or blue photosite counts infrared light: the filter is in.
    assert sensor.quantum_efficiency.at([700.0, 800.0]).max() < 1e-3


def test_the_other_sensors():
    assert load_sensor("ueye_ui5250re_full").site_shape == load_sensor("ueye_ui5250re").site_shape
    assert load_sensor("onsemi_mt9v024_full").site_shape == load_sensor("onsemi_mt9v024").site_shape
    nikon, mono = load_sensor("nikon_d5100"), load_sensor("onsemi_mt9v024_mono")
    assert (nikon.columns, nikon.rows, nikon.site_shape) == (1232, 816, (3264, 4928))
    # Green sees most photons around 530 nm, and no colour sees infrared.
    assert nikon.quantum_efficiency.at([520, 530, 540])[1].max() == pytest.approx(0.465, abs=1e-5)
    assert nikon.quantum_efficiency.at([750, 850]).max() < 1e-4
    # Without dyes nothing is lost: at least what the best colour of the same die sees, and alike in infrared.
    assert (mono.channels, mono.site_shape) == (1, (480, 752))
    colours = read_spectra(FOLDER / "sensors" / "spectra" / "onsemi_mt9v024_rgb_qe.csv").values()
    nm = np.arange(380.0, 1081.0, 10)
    best = np.max([colour.at(nm) for colour in colours], axis=0)
    assert np.all(mono.quantum_efficiency.at(nm)[0] >= best - 1e-5)
    np.testing.assert_allclose(mono.quantum_efficiency.at(nm[nm > 850])[0], best[nm > 850], atol=1e-5)


def test_a_filter_that_makes_light_is_named(tmp_path):
    path = copy_of(tmp_path, "sensors", "onsemi_mt9v024", put("infrared_cut", "file", "cut.csv"))
    (tmp_path / "cut.csv").write_text("wavelength_nm,transmittance\n400,1.5\n700,1", encoding="utf-8")
    with pytest.raises(InputError, match=r"infrared_cut = 1\.5: must be a share"):
        load_sensor(path)


def test_an_infrared_cut_filter_multiplies_the_efficiency():
    efficiency = load_sensor("onsemi_mt9v024").quantum_efficiency
    # The tables at 540 nm: the filter's 0.93055 times the green photosite's 0.61696 or less.
    assert 0.5 < efficiency.at(540.0)[1, 0] < 0.93055 * 0.61696 + 1e-9
    assert efficiency.at([850.0]).max() < 1e-3


# Faults -----------------------------------------------------------------------------------------------------


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


TYPICAL = "lensagon_cmfa0420nd_typical_distortion"
WRONG_TABLES = [
    ("sensors", "ueye_ui5250re", put("pitch_um", -4.5), r"mine\.toml: pitch_um = -4\.5"),
    ("sensors", "ueye_ui5250re", put("binning", 3), r"binning must be 1 or even"),
    ("sensors", "ueye_ui5250re", put("binning", 0), r"binning = 0"),
    ("sensors", "ueye_ui5250re_full", put("columns", 1601), r"1601 x 1200 photosites hold no whole Bayer"),
    ("sensors", "ueye_ui5250re", put("pattern", "rgb"), r"pattern = 'rgb'"),
    ("sensors", "ueye_ui5250re", put("pattern", "mono"), r"columns must name 1 for the pattern mono"),
    (
        "sensors",
        "onsemi_mt9v024_mono",
        put("pattern", "bggr"),
        r"quantum_efficiency\.columns must name 3 for the pattern bggr",
    ),
    ("sensors", "ueye_ui5250re", put("bits", 17), r"bits = 17"),
    ("sensors", "ueye_ui5250re", put("bits", "ten"), r"bits = 'ten'"),
    ("sensors", "ueye_ui5250re", put("black_level_dn", 1023), r"black_level_dn must be below"),
    ("sensors", "ueye_ui5250re", put("colour", "blue"), r"colour: is not a known key"),
    ("sensors", "ueye_ui5250re", drop("full_well_e"), r"full_well_e: is required"),
    ("sensors", "ueye_ui5250re", drop("sources", "bits"), r"must give the source of bits"),
    ("sensors", "ueye_ui5250re", put("sources", "weight", "scales"), r"weight, which the file does not have"),
    (
        "sensors",
        "ueye_ui5250re",
        put("quantum_efficiency", "file", "no.csv"),
        r"quantum_efficiency\.file = 'no\.csv'",
    ),
    ("sensors", "ueye_ui5250re", put("quantum_efficiency", "columns", ["r", "g", "x"]), r"MODEL\.csv.*'x'"),
    (
        "sensors",
        "ueye_ui5250re",
        put("quantum_efficiency", "columns", ["r", "g"]),
        r"quantum_efficiency\.columns",
    ),
    ("lenses", "lensagon_cmfa0420nd", put("f_number", 0), r"f_number = 0"),
    ("lenses", "lensagon_cmfa0420nd", put("transmittance", 90), r"transmittance = 90"),
    ("lenses", "lensagon_cmfa0420nd", put("distortion", "k1", float("nan")), r"distortion\.k1 = nan"),
    ("lenses", "lensagon_cmfa0420nd", put("distortion", "k7", 0.1), r"distortion\.k7: is not a known key"),
    ("lenses", "lensagon_cmfa0420nd", put("principal_offset_mm", [0.1]), r"principal_offset_mm"),
    (
        "lenses",
        "lensagon_cmfa0420nd",
        put("principal_offset_mm", [0.1, -0.2]),
        r"must give the source of principal_o",
    ),
    (
        "lenses",
        TYPICAL,
        put("vignetting", "relative", [1, 1, 1, 1, 1, 2.5]),
        r"vignetting\.relative\.5 = 2\.5",
    ),
    (
        "lenses",
        TYPICAL,
        put("vignetting", "relative", [1, 1, 1, 1, 1, -0.5]),
        r"vignetting\.relative\.5 = -0",
    ),
    ("lenses", TYPICAL, put("vignetting", "relative", [1, 1]), r"vignetting: .*equally long"),
    ("lenses", TYPICAL, put("vignetting", "relative", [0.9, 0.9, 0.9, 0.8, 0.8, 0.7]), r"1 at angle 0"),
    ("lenses", TYPICAL, put("vignetting", "angle_deg", [0, 15, 25, 20, 42, 50]), r"increasing list"),
    ("lenses", TYPICAL, put("vignetting", "angle_deg", [0, 15, 25, 35, 42, 95]), r"angle_deg\.5 = 95"),
    (
        "flashes",
        "led_matrix_200klx",
        put("profile", "angle_deg", [0, 20, 10, 26, 35, 45, 65]),
        r"profile: angles must be one increasing list",
    ),
    ("flashes", "led_matrix_200klx", put("profile", "angle_deg", [0, 20]), r"equally long"),
    ("flashes", "led_matrix_200klx", put("profile", "relative_intensity", [2.0] * 7), r"1 at angle 0"),
    ("flashes", "led_matrix_200klx", put("illuminance_lx", 0), r"illuminance_lx = 0"),
    (
        "flashes",
        "led_matrix_200klx",
        put("irradiance_W_m2", 600.0),
        r"must give the source of irradiance_W_m2",
    ),
    ("flashes", "led_matrix_200klx", put("offset_mm", [0, 1]), r"offset_mm"),
    ("flashes", "led_matrix_200klx", put("matrix", "columns", 0), r"matrix\.columns = 0"),
    ("flashes", "led_matrix_200klx", put("matrix", "pitch_mm", -8), r"matrix\.pitch_mm = -8"),
    ("flashes", "led_matrix_200klx", put("matrix", "pitch_mm", 2.9), r"at most half of matrix\.pitch_mm"),
    ("flashes", "led_matrix_200klx", drop("sources", "matrix"), r"must give the source of matrix"),
    (
        "flashes",
        "led_matrix_200klx",
        put("profile", {"angle_deg": [0, 0.1], "relative_intensity": [1, 0]}),
        r"profile: does not fit the other values: .*no light of the profile falls straight ahead",
    ),
    ("flashes", "led_matrix_200klx", put("spectrum", "file", "light/no_such"), r"spectrum\.file = 'light/no"),
    (
        "flashes",
        "led_matrix_200klx",
        put("spectrum", "file", "light/astm_g173_300_1100"),
        r"'lumileds_cool_white': is not one of",
    ),
]


@pytest.mark.parametrize(("kind", "name", "change", "message"), WRONG_TABLES)
def test_a_wrong_table_is_named(tmp_path, kind, name, change, message):
    path = copy_of(tmp_path, kind, name, change)
    with pytest.raises(InputError, match=message):
        LOADERS[kind](path)


HEADER, FIRST, SECOND = "wavelength_nm,r,g,b", "400,.1,.2,.3", "700,.1,.2,.3"
WRONG_CURVES = [
    (f"{HEADER}\n{FIRST}\n500,.1,nan,.3\n{SECOND}", r"row 3, column g = 'nan'"),
    (f"{HEADER}\n{FIRST}\n500,.1,-.2,.3\n{SECOND}", r"row 3, column g = -0\.2: must be at least 0"),
    (f"{HEADER}\n{FIRST}\n{SECOND}\n500,.1,.2,.3", r"row 4, column wavelength_nm = 500"),
    (f"{HEADER}\n{FIRST}\n500,.1,1.2,.3\n{SECOND}", r"quantum_efficiency = 1\.2: must be a share"),
    (f"{HEADER}\n{FIRST}\n500,.1,.3\n{SECOND}", r"row 3"),
    ("nm,r,g,b\n400,.1,.2,.3\n700,.1,.2,.3", r"wavelength_nm"),
    ("", r"wavelength_nm"),
]


@pytest.mark.parametrize(("text", "message"), WRONG_CURVES)
def test_a_wrong_curve_is_named_by_file_row_and_column(tmp_path, text, message):
    path = copy_of(tmp_path, "sensors", "ueye_ui5250re", put("quantum_efficiency", "file", "srf.csv"))
    (tmp_path / "srf.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        load_sensor(path)


def infrared(tmp_path, *changes):
    """The shipped flash's file with an infrared spectrum."""

    def change(table):
        table["spectrum"] = {"file": "ir.csv", "column": "ir"}
        for one in changes:
            one(table)

    path = copy_of(tmp_path, "flashes", "led_matrix_200klx", change)
    (tmp_path / "ir.csv").write_text("wavelength_nm,ir,none\n800,0,0\n850,1,0\n900,0,0", encoding="utf-8")
    return path


def without_lux(table):
    del table["illuminance_lx"], table["sources"]["illuminance_lx"]


def with_watts(table):
    table["irradiance_W_m2"] = 40
    table["sources"]["irradiance_W_m2"] = "chosen"


def in_watts(table):
    without_lux(table)
    with_watts(table)


@pytest.mark.parametrize("change", [with_watts, without_lux], ids=["both", "none"])
def test_a_flash_has_one_strength(tmp_path, change):
    with pytest.raises(InputError, match=r"exactly one of illuminance_lx and irradiance_W_m2 must be given"):
        load_flash(copy_of(tmp_path, "flashes", "led_matrix_200klx", change))


def test_a_flash_in_lux_needs_visible_light(tmp_path):
    with pytest.raises(InputError, match=r"spectrum\.column = 'ir': must hold light in 400 to 700 nm, or"):
        load_flash(infrared(tmp_path))


def test_a_flash_in_watts_does_not(tmp_path):
    flash = load_flash(infrared(tmp_path, in_watts))
    assert (flash.illuminance_lx, flash.irradiance_W_m2) == (None, 40)
    # A triangle of 100 nm: its peak is 40 W/m2 over 50 nm.
    assert flash.irradiance().at(850.0)[0] == pytest.approx(0.8)


def test_a_flash_needs_some_light(tmp_path):
    path = infrared(tmp_path, in_watts, put("spectrum", "column", "none"))
    with pytest.raises(InputError, match=r"spectrum\.column = 'none': must hold some light"):
        load_flash(path)


@pytest.mark.parametrize(
    ("file", "column"),
    [
        ("light/houser2013_cool_white_led", "slide_4_lumileds_cool_white"),
        ("light/nist_phosphor_led_colour_science.csv", "phos_1"),
        ("light/cie_illuminants_colour_science", "led_b3"),
    ],
)
def test_a_flash_can_have_a_shipped_led(tmp_path, file, column):
    path = copy_of(
        tmp_path, "flashes", "led_matrix_200klx", put("spectrum", {"file": file, "column": column})
    )
    flash, shipped = load_flash(path), read_spectrum(file, column)
    np.testing.assert_array_equal(flash.spectrum.values, shipped.values)
    # What lies beside the file comes first.
    beside = tmp_path / f"{file.removesuffix('.csv')}.csv"
    beside.parent.mkdir()
    beside.write_text(f"wavelength_nm,{column}\n500,1\n600,1", encoding="utf-8")
    if file.endswith(".csv"):
        np.testing.assert_array_equal(load_flash(path).spectrum.values, [1, 1])


def test_a_flash_without_a_matrix_is_one_emitter(tmp_path):
    def change(table):
        del table["matrix"], table["sources"]["matrix"]
        table["radius_mm"] = 30

    flash = load_flash(copy_of(tmp_path, "flashes", "led_matrix_200klx", change))
    np.testing.assert_array_equal(flash.emitters_m, [[0, 0]])
    assert flash.radius_m == pytest.approx(0.03)


def test_a_matrix_stands_around_its_centre(tmp_path):
    matrix = put("matrix", {"columns": 3, "rows": 2, "pitch_mm": 10.0})
    flash = load_flash(copy_of(tmp_path, "flashes", "led_matrix_200klx", matrix))
    row = [-0.01, 0.0, 0.01]
    expected = [[x, -0.005] for x in row] + [[x, 0.005] for x in row]
    np.testing.assert_allclose(flash.emitters_m, expected, atol=1e-15)


def test_a_principal_point_is_read_in_millimetres(tmp_path):
    def change(table):
        table["principal_offset_mm"] = [0.12, -0.05]
        table["sources"]["principal_offset_mm"] = "calibrated"

    lens = load_lens(copy_of(tmp_path, "lenses", "lensagon_cmfa0420nd", change))
    assert lens.principal_offset_m == pytest.approx((1.2e-4, -5e-5))


@pytest.mark.parametrize("kind", LOADERS)
def test_an_unknown_name_lists_what_there_is(kind):
    with pytest.raises(InputError, match="nor one of the shipped") as fault:
        LOADERS[kind]("nikon")
    assert all(name in str(fault.value) for shelf_name, name in SHIPPED if shelf_name == kind)


def test_efficiencies_per_joule_by_hand():
    # At 500 nm a photon holds h c / lambda = 3.9729e-19 J.
    sensor = load_sensor("ueye_ui5250re")
    np.testing.assert_allclose(
        sensor.electrons_per_joule(500.0), sensor.quantum_efficiency.at(500.0) / 3.972892e-19, rtol=1e-6
    )
