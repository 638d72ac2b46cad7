import re
from pathlib import Path

import numpy as np
import pytest

from pepperscene.errors import InputError
from pepperscene.shipped import shipped_folder
from pepperscene.spectra import read_provenance, read_spectra, read_spectrum

EVERY = sorted(shipped_folder("materials").rglob("*.csv"))
GROUPS = ("leaf", "fruit", "light", "organ", "chart")
MATERIALS = [path for path in EVERY if path.parent.name in GROUPS]


def write(folder: Path, text: str) -> Path:
    path = folder / "lamp.csv"
    path.write_text(text, encoding="utf-8")
    return path


def name(path: Path) -> str:
    return path.relative_to(shipped_folder("materials")).as_posix()


@pytest.mark.parametrize("path", EVERY, ids=name)
def test_every_shipped_file_reads_and_tells_where_it_comes_from(path):
    spectra = read_spectra(path)
    assert all(s.values.min() >= 0 for s in spectra.values())
    # A missing key, kind or file beside is refused.
    provenance = read_provenance(path)
    assert all((provenance.title, provenance.source, provenance.licence, provenance.unit))
    assert (provenance.kind == "MODEL") == ("MODEL" in path.stem)
    # Nobody measures with a formula.
    assert provenance.kind == "measured" or not provenance.instrument


@pytest.mark.parametrize("path", MATERIALS, ids=name)
def test_measurements_tell_their_instrument_and_licences_get_their_notice(path):
    provenance = read_provenance(path)
    assert provenance.kind != "measured" or provenance.instrument
    # Files under licences that ask for a notice are named in it.
    notice = (shipped_folder("materials") / "LICENCES.md").read_text(encoding="utf-8")
    patterns = [re.escape(name).replace(r"\*", ".*") for name in re.findall(r"`([\w/*]+\.csv)`", notice)]
    assert any(re.fullmatch(p, f"{path.parent.name}/{path.name}") for p in patterns)


def test_shipped_reflectances_are_reflectances():
    for group in ("leaf/vrhel_leaf", "fruit/vrhel_fruit_vegetable", "organ/vrhel_white_fabric"):
        assert all(s.values.max() <= 1 for s in read_spectra(f"{group}_reflectance").values())


def test_columns_by_name(tmp_path):
    path = write(tmp_path, "wavelength_nm,warm,cold\n400,1,2\n\n500,3,6\n")
    spectra = read_spectra(path)
    assert list(spectra) == ["warm", "cold"]
    assert spectra["cold"].at(450) == pytest.approx(4.0)
    assert spectra["cold"].at(600) == 0.0
    assert read_spectrum(path, "cold", outside="hold").at(600) == 6.0
    assert np.array_equal(read_spectra(str(path.with_suffix("")))["warm"].values, [1, 3])


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "first column: must be named wavelength_nm"),
        ("nm,a\n1,2\n", "must be named wavelength_nm"),
        ("wavelength_nm\n400\n500\n", "at least one spectrum"),
        ("wavelength_nm,a,a\n400,1,1\n500,1,1\n", "each once"),
        ("wavelength_nm,a\n400,1\n", "at least two"),
        ("wavelength_nm,a\n400,1\n500\n", "row 3 = 1: must have 2 columns"),
        ("wavelength_nm,a\n400,1\n500,x\n", "row 3, column a = 'x': must be a finite number"),
        ("wavelength_nm,a\n400,1\n500,\n", "row 3, column a = '': must be a finite number"),
        ("wavelength_nm,a\n400,nan\n500,1\n", "row 2, column a"),
        ("wavelength_nm,a\n500,1\n400,1\n", "row 3, column wavelength_nm = 400.0: must be larger"),
        ("wavelength_nm,a\n0.4,1\n0.5,1\n", "row 2, column wavelength_nm = 0.4: must be in nanometres"),
    ],
)
def test_a_wrong_table_is_told_with_row_and_column(tmp_path, text, told):
    path = write(tmp_path, text)
    with pytest.raises(InputError) as fault:
        read_spectra(path)
    assert str(fault.value).startswith(str(path))
    assert told in str(fault.value)


def test_a_file_that_is_no_text(tmp_path):
    path = tmp_path / "lamp.csv"
    path.write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(InputError, match="UTF-8"):
        read_spectra(path)


def test_missing_files_and_columns():
    with pytest.raises(InputError, match="light/astm_g173_300_1100"):
        read_spectra("light/no_such_lamp")
    with pytest.raises(InputError, match="direct_W_m2_nm"):
        read_spectrum("light/astm_g173_300_1100", "moonlight")


def test_provenance_must_be_whole(tmp_path):
    path = write(tmp_path, "wavelength_nm,a\n400,1\n500,1\n")
    with pytest.raises(InputError, match=r"lamp\.toml: cannot be read"):
        read_provenance(path)
    path.with_suffix(".toml").write_text('title = "x"\nsource = "y"\nlicence = "MIT"\nkind = "guess"\n')
    with pytest.raises(InputError, match="kind = 'guess'"):
        read_provenance(path)
