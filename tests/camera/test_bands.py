"""Sensors with bands: curves of bands, the forms of sensor files, and errors in them."""

from __future__ import annotations

import numpy as np
import pytest
import tomli_w

from pepperscene.camera import Band, load_sensor
from pepperscene.camera.sensor.bands import band_curves, describe_bands
from pepperscene.errors import InputError
from pepperscene.spectra import Spectrum

SENSOR = {
    "name": "bands", "kind": "MODEL", "columns": 8, "rows": 6, "pattern": "bands", "binning": 1,
    "pitch_um": 4.0, "full_well_e": 10_000, "read_noise_e": 5, "bits": 12, "black_level_dn": 10,
}  # fmt: skip
CURVES = "wavelength_nm,first,second,third\n400,0,0,0\n500,0.5,0.1,0\n600,0,0.1,0.8\n700,0,0,0\n"


def load(folder, changes):
    (folder / "curves.csv").write_text(CURVES)
    table = {key: value for key, value in {**SENSOR, **changes}.items() if value is not None}
    (folder / "sensor.toml").write_bytes(tomli_w.dumps(table).encode())
    return load_sensor(folder / "sensor.toml")


def test_gaussian_is_half_as_high_half_a_width_beside_its_centre():
    curve = band_curves([700.0], [10.0], [0.6], ["gaussian"])
    np.testing.assert_allclose(curve.at([695.0, 700.0, 705.0])[0], [0.3, 0.6, 0.3], rtol=1e-12)
    # The area of a Gaussian: peak x width x sqrt(pi / (4 ln 2)).
    assert curve.integral()[0] == pytest.approx(0.6 * 10.0 * np.sqrt(np.pi / np.log(16.0)), rel=1e-4)


@pytest.mark.parametrize("centre", [700.0, 700.1])
def test_box_has_its_width_and_area(centre):
    curve = band_curves([centre], [20.0], [0.5], ["box"])
    assert curve.integral()[0] == pytest.approx(10.0, rel=1e-9)
    edges = curve.at([centre - 10.5, centre - 9.5, centre + 9.5, centre + 10.5])
    assert edges[0].tolist() == [0, 0.5, 0.5, 0]
    (band,) = describe_bands(curve)
    assert (band.centre_nm, band.width_nm) == pytest.approx((centre, 20.0), abs=0.011)


def test_bands_one_by_one_and_regular_bands(tmp_path):
    bands = [{"name": "a", "centre_nm": 500, "width_nm": 20, "peak": 0.4}, {"centre_nm": 800, "width_nm": 5}]
    sensor = load(tmp_path, {"bands": bands})
    assert sensor.bands == (Band("a", 500.0, 20.0), Band("", 800.0, 5.0))
    assert sensor.quantum_efficiency.values.max(axis=1).tolist() == [0.4, 0.5]
    table = {"first_nm": 400, "last_nm": 1000, "count": 61, "width_nm": 6}
    sensor = load(tmp_path, {"regular_bands": table})
    assert [band.centre_nm for band in sensor.bands] == pytest.approx(np.arange(400, 1001, 10), abs=0.01)
    assert {band.width_nm for band in sensor.bands} == {6.0}
    assert sensor.band_names == ()


def test_curves_of_a_csv_file_keep_their_names_and_order(tmp_path):
    sensor = load(tmp_path, {"band_curves": {"file": "curves.csv", "columns": ["third", "first"]}})
    # Triangles: the mean wavelength is the mean of the corners, and the width half of the base.
    assert sensor.bands == (Band("third", 600.0, 100.0), Band("first", 500.0, 100.0))
    assert load(tmp_path, {"band_curves": {"file": "curves.csv"}}).channels == 3


def test_efficiency_of_the_photosites_multiplies_all_bands(tmp_path):
    bands = {"bands": [{"centre_nm": 550, "width_nm": 10, "peak": 0.5}]}
    behind = load(tmp_path, {**bands, "quantum_efficiency": {"file": "curves.csv", "columns": ["third"]}})
    # The curve is 0.4 at 550 nm.
    assert behind.quantum_efficiency.at([550.0])[0, 0] == pytest.approx(0.2)


def test_filter_in_front_moves_the_band(tmp_path):
    sensor = load(tmp_path, {"bands": [{"centre_nm": 600, "width_nm": 40, "shape": "box"}]})
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
        load(tmp_path, changes)
    assert caught.value.key == key
    assert problem in caught.value.problem
