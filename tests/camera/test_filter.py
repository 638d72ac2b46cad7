"""Filters before the lens: what they let through, and every way of getting their file wrong."""

from __future__ import annotations

import numpy as np
import pytest

from pepperscene.camera import Filter, load_filter, load_flash, load_sensor
from pepperscene.errors import InputError
from pepperscene.shipped import shipped_folder
from pepperscene.spectra import Spectrum, read_provenance, sky_spectrum

FOLDER = shipped_folder("materials") / "filters"
NAMES = [path.stem for path in sorted(FOLDER.glob("*.toml"))]
NM = np.arange(300.0, 1201.0)


@pytest.mark.parametrize("name", NAMES)
def test_every_shipped_filter_loads_and_tells_its_source(name):
    filter_ = load_filter(name)
    assert filter_.name == load_filter(FOLDER / f"{name}.toml").name
    through = filter_.transmittance.at(NM)
    assert through.min() >= 0
    assert 0.85 < through.max() <= 1


@pytest.mark.parametrize("path", sorted(FOLDER.rglob("*.csv")), ids=lambda path: path.stem)
def test_every_curve_of_a_filter_tells_its_source(path):
    provenance = read_provenance(path)
    assert provenance.source
    assert provenance.licence
    assert ("MODEL" in path.stem) == (provenance.kind == "MODEL")


@pytest.mark.parametrize("name", ["schott_22022010", "largan_k098_bir690uv"])
def test_infrared_cuts_pass_the_visible_and_stop_the_infrared(name):
    through = load_filter(name).transmittance
    assert through.at([450.0, 500, 550]).min() > 0.75
    assert through.at(np.arange(760.0, 1000.0)).max() < 0.02


def test_the_band_pass_follows_its_formula_and_belongs_to_the_infrared_flash():
    through = load_filter("bandpass_850nm").transmittance
    expected = 0.9 / ((1 + np.exp((820 - NM) / 3)) * (1 + np.exp((NM - 880) / 3)))
    np.testing.assert_allclose(through.at(NM), expected, rtol=0, atol=1e-5)
    # Nine tenths of the LED pass the band, of daylight in 380 to 780 nm nothing.
    led = load_flash("led_nir_850nm").spectrum
    passed = np.trapezoid(led.at(NM) * through.at(NM), NM) / led.integral()
    assert passed == pytest.approx(0.9 * 0.92, abs=0.02)
    assert np.max(sky_spectrum("d65").at(NM[NM < 740]) * through.at(NM[NM < 740])) == 0


@pytest.mark.parametrize("name", NAMES)
def test_a_sensor_behind_a_filter_sees_the_product(name):
    sensor, filter_ = load_sensor("onsemi_mt9v024"), load_filter(name)
    behind = sensor.with_filter(filter_.transmittance)
    # On the knots of both curves; in between a product of lines is not a line.
    nm = np.union1d(sensor.quantum_efficiency.wavelength_nm, filter_.transmittance.wavelength_nm)
    expected = sensor.quantum_efficiency.at(nm) * filter_.transmittance.at(nm)
    np.testing.assert_allclose(behind.quantum_efficiency.at(nm), expected, rtol=0, atol=1e-15)


@pytest.mark.parametrize("values", [[0.1, 1.1], [-0.1, 0.5], [[0.1, 0.2], [0.3, 0.4]]])
def test_filters_that_are_none_are_refused(values):
    with pytest.raises(ValueError, match="transmittance must be one curve"):
        Filter("none", Spectrum(np.array([400.0, 700.0]), np.array(values)))


GOOD = """name = "mine"
kind = "measured"
licence = "none"
[transmittance]
file = "curve.csv"
column = "t"
[sources]
transmittance = "measured here"
"""
WRONG = [
    (GOOD, "wavelength_nm,t\n400,.5\n500,1.2\n", r"row 3, column t = 1\.2: must be a share"),
    (GOOD, "wavelength_nm,t\n400,-.5\n500,.2\n", r"row 2, column t = -0\.5: must be at least 0"),
    (GOOD, "wavelength_nm,x\n400,.5\n500,.2\n", r"'t': is not one of x"),
    (GOOD, None, r"transmittance\.file = 'curve\.csv': is not a file"),
    (GOOD.replace('"measured"', '"guessed"'), None, r"kind = 'guessed'"),
    (GOOD.replace('column = "t"\n', ""), None, r"transmittance\.column: is required"),
    (GOOD.replace('transmittance = "measured here"\n', ""), None, r"must give the source of transmittance"),
    ("width_mm = 3\n" + GOOD, None, r"width_mm: is not a known key"),
]


@pytest.mark.parametrize(("text", "curve", "message"), WRONG)
def test_a_wrong_file_is_named(tmp_path, text, curve, message):
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    if curve:
        (tmp_path / "curve.csv").write_text(curve, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        load_filter(tmp_path / "mine.toml")


def test_an_unknown_name_lists_what_there_is():
    with pytest.raises(InputError, match="nor one of the shipped filters") as fault:
        load_filter("rose")
    assert all(name in str(fault.value) for name in NAMES)
