import re
from pathlib import Path

import numpy as np
import pytest

from pepperscene.errors import InputError
from pepperscene.shipped import shipped_folder
from pepperscene.spectra import Provenance, read_provenance, read_spectra, read_spectrum

SHIPPED = sorted(shipped_folder("materials").rglob("*.csv"))
LICENSED_FOLDERS = ("leaf", "fruit", "light", "organ", "chart")


def write(folder: Path, text: str) -> Path:
    path = folder / "lamp.csv"
    path.write_text(text, encoding="utf-8")
    return path


def name(path: Path) -> str:
    return path.relative_to(shipped_folder("materials")).as_posix()


@pytest.mark.parametrize("path", SHIPPED, ids=name)
def test_shipped_files_are_valid_and_have_a_provenance(path):
    spectra = read_spectra(path)
    if path.stem != "cie_daylight_components":  # characteristic vectors have both signs
        assert all(s.values.min() >= 0 for s in spectra.values())
    provenance = read_provenance(path)
    assert all((provenance.title, provenance.source, provenance.licence, provenance.unit))
    assert (provenance.kind == "MODEL") == ("MODEL" in path.stem)
    assert provenance.kind == "measured" or not provenance.instrument
    if path.parent.name in LICENSED_FOLDERS:
        assert provenance.kind != "measured" or provenance.instrument
        # The notice names every file whose licence requires one.
        notice = (shipped_folder("materials") / "LICENCES.md").read_text(encoding="utf-8")
        patterns = [re.escape(p).replace(r"\*", ".*") for p in re.findall(r"`([\w/*]+\.csv)`", notice)]
        assert any(re.fullmatch(p, f"{path.parent.name}/{path.name}") for p in patterns)


def test_shipped_reflectances_are_at_most_1():
    for group in ("leaf/vrhel_leaf", "fruit/vrhel_fruit_vegetable", "organ/vrhel_white_fabric"):
        assert all(s.values.max() <= 1 for s in read_spectra(f"{group}_reflectance").values())


def test_reads_columns_by_name(tmp_path):
    path = write(tmp_path, "wavelength_nm,warm,cold\n400,1,2\n\n500,3,6\n")
    spectra = read_spectra(path)
    assert list(spectra) == ["warm", "cold"]
    assert spectra["cold"].at(450) == pytest.approx(4.0)
    assert spectra["cold"].at(600) == 0.0
    assert read_spectrum(path, "cold", outside="hold").at(600) == 6.0
    assert np.array_equal(read_spectra(str(path.with_suffix("")))["warm"].values, [1, 3])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "first column: must be named wavelength_nm"),
        ("wavelength_nm\n400\n500\n", "at least one spectrum"),
        ("wavelength_nm,a,a\n400,1,1\n500,1,1\n", "each name once"),
        ("wavelength_nm,a\n400,1\n", "at least two"),
        ("wavelength_nm,a\n400,1\n500\n", "row 3 = 1: must have 2 columns"),
        ("wavelength_nm,a\n400,1\n500,x\n", "row 3, column a = 'x': must be a finite number"),
        ("wavelength_nm,a\n400,nan\n500,1\n", "row 2, column a"),
        ("wavelength_nm,a\n500,1\n400,1\n", "row 3, column wavelength_nm = 400.0: must be greater"),
        ("wavelength_nm,a\n0.4,1\n0.5,1\n", "row 2, column wavelength_nm = 0.4: must be in nanometres"),
    ],
)
def test_errors_name_row_and_column(tmp_path, text, message):
    path = write(tmp_path, text)
    with pytest.raises(InputError) as caught:
        read_spectra(path)
    assert str(caught.value).startswith(str(path))
    assert message in str(caught.value)


def test_missing_files_and_columns_list_what_exists(tmp_path):
    with pytest.raises(InputError, match="light/astm_g173_300_1100"):
        read_spectra("light/no_such_lamp")
    with pytest.raises(InputError, match="direct_W_m2_nm"):
        read_spectrum("light/astm_g173_300_1100", "moonlight")
    (tmp_path / "lamp.csv").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(InputError, match="UTF-8"):
        read_spectra(tmp_path / "lamp.csv")


def test_provenance_of_a_users_file_may_leave_out_any_key_but_not_the_file(tmp_path):
    path = write(tmp_path, "wavelength_nm,a\n400,1\n500,1\n")
    with pytest.raises(InputError, match=r"lamp\.toml: cannot be read"):
        read_provenance(path)
    path.with_suffix(".toml").write_text('title = "my lamp"\n', encoding="utf-8")
    provenance = read_provenance(path)
    assert (provenance.title, provenance.kind, provenance.licence) == ("my lamp", "measured", "")
    path.with_suffix(".toml").write_text('kind = "guess"\n', encoding="utf-8")
    with pytest.raises(InputError, match="kind = 'guess'"):
        read_provenance(path)


def test_the_page_lists_all_keys_of_provenance():
    page = (Path(__file__).parents[2] / "docs" / "reference" / "devices.md").read_text(encoding="utf-8")
    section = page.partition("\n## Spectra\n")[2].partition("\n## ")[0]
    assert re.findall(r"^\| `(\w+)` \|", section, re.MULTILINE) == list(Provenance.model_fields)
