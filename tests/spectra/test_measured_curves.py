"""Measured curves of users: units, descriptions, and one sentence about each fault."""

from __future__ import annotations

import numpy as np
import pytest
from own_spectra import NM, leaf_curve, write_csv, write_leaf

from pepperscene.errors import InputError
from pepperscene.spectra.measured import check_energy, read_measured

BOTH = ("reflectance", "transmittance")
CURVES = np.stack(leaf_curve(NM))


@pytest.mark.parametrize(
    ("header", "scales", "units"),
    [
        ("wavelength_nm,reflectance,transmittance", (1, 1, 1), {}),
        ("wavelength,reflectance,transmittance", (1, 1, 1), {}),
        ("wavelength,reflectance,transmittance", (1e-3, 1, 1), {"wavelength_unit": "um"}),
        ("wavelength_um,reflectance,transmittance", (1e-3, 1, 1), {}),
        ("Wavelength (µm), Reflectance (%), Transmittance [%]", (1e-3, 100, 100), {}),
        ("wavelength_nm,reflectance_percent,transmittance", (1, 100, 1), {}),
        ("Wavelength [nm],Reflectance,Transmittance", (1, 100, 100), {"unit": "percent"}),
    ],
)
def test_units_in_header_or_key(tmp_path, header, scales, units):
    columns = [scale * values for scale, values in zip(scales, (NM, *CURVES), strict=True)]
    spectrum = read_measured(write_csv(tmp_path / "own.csv", header, *columns), BOTH, **units)
    np.testing.assert_allclose(spectrum.wavelength_nm, NM, rtol=1e-12)
    np.testing.assert_allclose(spectrum.values, CURVES, rtol=1e-7)
    # Outside of the range, the end values hold.
    np.testing.assert_array_equal(spectrum.at([350.0, 1100.0]), spectrum.values[:, [0, -1]])


def test_description_beside_the_file_says_the_unit(tmp_path):
    file = write_csv(tmp_path / "own.csv", "wavelength_nm,reflectance", NM, 100.0 * CURVES[0])
    description = file.with_suffix(".toml")
    for text, allowed in (('title = "Leaf"\nunit = "percent"', True), ('unit = "dB"', False)):
        description.write_text(text)
        if allowed:
            values = read_measured(file, ["reflectance"]).values[0]
            np.testing.assert_allclose(values, CURVES[0], rtol=1e-7)
        else:
            with pytest.raises(InputError, match=r'own\.toml: unit = .dB.: must be "fraction" or "percent"'):
                read_measured(file, ["reflectance"])
    # A recipe of the same name describes no spectra.
    description.write_text('extends = "demo"\nname = "own"')
    assert read_measured(file, ["reflectance"], unit="percent").values.max() < 1.0


HEADER = "wavelength_nm,reflectance,transmittance"
PERCENT = "wavelength_nm,reflectance_percent,transmittance"
BOTH_PERCENT = "wavelength_nm,reflectance_percent,transmittance_percent"
ROWS = ("400,0.1,0.1", "405,0.2,0.1", "410,0.2,0.1")
FAULTS = {
    "no wavelength": (["nm,R,T", *ROWS], "first column = 'nm': must be named wavelength_nm"),
    "empty cell": ([HEADER, "400,0.1,0.1", "405,,0.1"], "row 3, column reflectance = '': must be a finite"),
    "not a number": ([HEADER, "400,0.1,nan", *ROWS[1:]], "row 2, column transmittance = 'nan'"),
    "not sorted": ([HEADER, *ROWS, "390,0,0"], "row 5, column wavelength_nm = 390.0: must be greater"),
    "gap": ([HEADER, *ROWS, "500,0,0"], "row 5, column wavelength = 500.0: must follow 410 nm by at most 50"),
    "micrometres": ([HEADER, "0.4,0.1,0.1", "0.5,0.1,0.1"], "row 2, column wavelength_nm = 0.4: must be in"),
    "percent": (
        [HEADER, "400,10,0.1", "405,50,0.1"],
        'row 2, column reflectance = 10.0: .* unit = "percent"',
    ),
    "negative": ([HEADER, *ROWS, "415,-0.01,0.1"], "row 5, column reflectance = -0.01: must be a fraction"),
    "fractions": (
        [BOTH_PERCENT, "400,10,0.1", "405,50,0.4"],
        "column transmittance_percent = 'percent': has",
    ),
    "too much": (
        [PERCENT, "400,101,0.1", "405,50,0.4"],
        "column reflectance_percent = 101.0: must be in perc",
    ),
    "no column": (["wavelength_nm,R,T", *ROWS], "column = 'reflectance': is not one of r, t"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_one_sentence_with_file_key_and_value(tmp_path, fault):
    text, message = FAULTS[fault]
    (tmp_path / "own.csv").write_text("\n".join(text))
    with pytest.raises(InputError, match=rf"own\.csv: .*{message}") as raised:
        read_measured(tmp_path / "own.csv", BOTH)
    assert "\n" not in str(raised.value)


def test_units_must_not_contradict_each_other(tmp_path):
    with pytest.raises(InputError, match=r"wavelength_unit = .um.: must be that of the header, nm"):
        read_measured(write_leaf(tmp_path), BOTH, wavelength_unit="um")


def test_no_more_light_than_there_is(tmp_path):
    file = write_leaf(tmp_path, 1.2)
    reflectance, transmittance = (read_measured(file, [name]) for name in BOTH)
    message = (
        r"leaf\.csv: row \d+, column transmittance = 0\.54: must be at most 0\.448, which the reflectance"
    )
    with pytest.raises(InputError, match=message):
        check_energy(file, reflectance, transmittance, ["transmittance"])
    # Rounding of decimals is no fault.
    exact = write_csv(tmp_path / "exact.csv", HEADER, NM, 0.0 * NM + 0.7, 0.0 * NM + 0.3)
    reflectance, transmittance = (read_measured(exact, [name]) for name in BOTH)
    check_energy(exact, reflectance, transmittance, ["transmittance"])
