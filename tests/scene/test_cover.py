"""Covers: the shipped ones against what is told of such sheets, and files that are wrong."""

from __future__ import annotations

import numpy as np
import pytest

from pepperscene.errors import InputError
from pepperscene.scene import Cover, load_cover
from pepperscene.shipped import shipped_folder
from pepperscene.spectra import Spectrum, illuminance, read_provenance, read_spectrum, sky_spectrum

SHIPPED = ("float_glass_4mm", "diffuse_glass_4mm", "polyethylene_film")


def visible(cover):
    """Share of D65's light, by its lux."""
    return illuminance(cover.through(sky_spectrum("d65"))) / illuminance(sky_spectrum("d65"))


@pytest.mark.parametrize(
    ("name", "light", "haze"),
    [
        # About 90 % is told for 4 mm of float glass.
        ("float_glass_4mm", (0.88, 0.91), (0.0, 0.0)),
        # Glass low in iron: 91 to 92 % across the sheet; haze from 10 to 75 % is sold.
        ("diffuse_glass_4mm", (0.905, 0.92), (0.1, 0.75)),
        # New film in one layer: 85 to 91 %.
        ("polyethylene_film", (0.85, 0.91), (0.15, 0.6)),
    ],
)
def test_shipped_covers_are_what_is_sold(name, light, haze):
    cover = load_cover(name)
    assert light[0] < visible(cover) < light[1]
    assert haze[0] <= cover.haze <= haze[1]


def test_no_cover_is_clearer_than_its_two_faces():
    # Fresnel, with all reflections between the faces: 2 n / (n^2 + 1).
    for name, index in (
        ("float_glass_4mm", 1.505),
        ("diffuse_glass_4mm", 1.505),
        ("polyethylene_film", 1.51),
    ):
        assert load_cover(name).transmittance.values.max() < 2 * index / (index**2 + 1)


@pytest.mark.parametrize(
    ("name", "half_nm"), [("float_glass_4mm", 335), ("diffuse_glass_4mm", 320), ("polyethylene_film", 375)]
)
def test_covers_keep_ultraviolet_out(name, half_nm):
    sheet = load_cover(name).transmittance
    assert sheet.at([300])[0] < 0.01
    assert sheet.at([half_nm - 15])[0] < 0.5 * sheet.at([420])[0] < sheet.at([half_nm + 15])[0]


def test_iron_darkens_glass_in_the_infrared_but_not_film():
    clear, low_iron, film = (load_cover(name).transmittance for name in SHIPPED)
    for sheet, ratio in ((clear, 0.85), (low_iron, 0.98), (film, 1.05)):
        assert sheet.at([1000])[0] / sheet.at([550])[0] < ratio
    assert clear.at([1000])[0] < low_iron.at([1000])[0] - 0.1
    assert film.at([1000])[0] > film.at([550])[0]


def test_glass_follows_from_its_optical_constants():
    # Rubin 1985: n and k of clear soda lime glass at three of his wavelengths.
    for nm, k in ((400, 2.047e-7), (550, 2.200e-7), (850, 3.150e-6)):
        n = 1.5130 - 0.003169 * (nm / 1e3) ** 2 + 0.003962 / (nm / 1e3) ** 2
        inside = np.exp(-4 * np.pi * k * 4e-3 / (nm * 1e-9))
        face = ((n - 1) / (n + 1)) ** 2
        # Light that crosses once, three times, five times, ...
        series = sum((1 - face) ** 2 * inside ** (2 * i + 1) * face ** (2 * i) for i in range(20))
        assert load_cover("float_glass_4mm").transmittance.at([nm])[0] == pytest.approx(series, abs=1e-4)


@pytest.mark.parametrize(
    "csv", sorted((shipped_folder("materials") / "covers/spectra").glob("*.csv")), ids=lambda p: p.stem
)
def test_the_curves_are_told_to_be_models(csv):
    told = read_provenance(csv)
    assert told.kind == "MODEL"
    assert csv.stem.endswith("_MODEL")
    assert read_spectrum(csv, "transmittance").wavelength_nm[[0, -1]].tolist() == [300, 1100]


def test_through_multiplies_and_holds_beyond_the_file():
    sheet = Spectrum(np.array([500.0, 533.3, 600.0]), np.array([0.2, 0.9, 0.6]), "hold")
    light = Spectrum(np.array([400.0, 700.0]), np.array([1.0, 4.0]))
    below = Cover("test", sheet).through(light)
    nm = np.array([400.0, 500.0, 533.3, 600.0, 700.0])
    np.testing.assert_allclose(below.wavelength_nm, nm)
    np.testing.assert_allclose(below.values, (1 + (nm - 400) / 100) * [0.2, 0.2, 0.9, 0.6, 0.6])
    assert below.outside == light.outside


GOOD = """
name = "test"
kind = "MODEL"
licence = "MIT"
haze = 0.4
haze_width_deg = 15
[transmittance]
file = "sheet.csv"
column = "transmittance"
[sources]
haze = "chosen"
haze_width_deg = "chosen"
transmittance = "chosen"
"""
CSV = "wavelength_nm,transmittance\n400,0.8\n700,0.9\n"


def written(tmp_path, text=GOOD, csv=CSV):
    (tmp_path / "sheet.csv").write_text(csv)
    (tmp_path / "cover.toml").write_text(text)
    return tmp_path / "cover.toml"


def test_a_cover_file_of_ones_own(tmp_path):
    cover = load_cover(written(tmp_path))
    assert (cover.name, cover.haze) == ("test", 0.4)
    assert cover.haze_width_rad == pytest.approx(np.radians(15))
    np.testing.assert_allclose(cover.transmittance.at([300, 400, 550, 700, 1000]), [0.8, 0.8, 0.85, 0.9, 0.9])
    # Without haze no width is needed.
    clear = GOOD.replace("haze = 0.4\nhaze_width_deg = 15", "haze = 0").replace(
        'haze_width_deg = "chosen"\n', ""
    )
    assert load_cover(written(tmp_path, clear)).haze == 0


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("haze = 0.4", "haze = 1.2", "haze = 1.2"),
        ("haze = 0.4", "haze = -0.1", "haze = -0.1"),
        ("haze_width_deg = 15", "haze_width_deg = 0.5", "haze_width_deg = 0.5"),
        ("haze_width_deg = 15", "haze_width_deg = 120", "haze_width_deg = 120"),
        ("haze_width_deg = 15\n", "", "haze_width_deg"),
        ('kind = "MODEL"', 'kind = "guess"', "kind"),
        ('kind = "MODEL"\n', "", "kind"),
        ("haze = 0.4", "haze = 0.4\ncolour = 3", "colour"),
        ('transmittance = "chosen"\n', "", r"\[sources\].*transmittance"),
        ('haze_width_deg = "chosen"\n', "", r"\[sources\].*haze_width_deg"),
        ('file = "sheet.csv"', 'file = "none.csv"', "none.csv.*is not a file"),
        ('column = "transmittance"', 'column = "tau"', "tau.*is not one of transmittance"),
    ],
)
def test_wrong_cover_files_are_refused(tmp_path, old, new, told):
    assert old in GOOD
    # The last place: keys of tables come after those of the top.
    head, tail = GOOD.rsplit(old, 1) if "chosen" in old else GOOD.split(old, 1)
    with pytest.raises(InputError, match=told):
        load_cover(written(tmp_path, head + new + tail))


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        ("400,0.8\n700,1.1\n", "row 3, column transmittance = 1.1: must be a share, at most 1"),
        ("400,-0.1\n700,0.9\n", "row 2, column transmittance = -0.1"),
        ("400,0\n700,0\n", "must let visible light through"),
        ("400,0.5\n700,nan\n", "must be a finite number"),
    ],
)
def test_wrong_curves_are_refused(tmp_path, rows, told):
    with pytest.raises(InputError, match=told):
        load_cover(written(tmp_path, csv="wavelength_nm,transmittance\n" + rows))


def test_a_missing_cover_lists_the_shipped_ones():
    with pytest.raises(InputError, match="diffuse_glass_4mm, float_glass_4mm, polyethylene_film"):
        load_cover("thatch")


@pytest.mark.parametrize(
    ("values", "haze", "width", "told"),
    [
        ([0.5, 1.5], 0.0, 0.0, "transmittance"),
        ([-0.5, 0.5], 0.0, 0.0, "transmittance"),
        ([0.0, 0.0], 0.0, 0.0, "visible"),
        ([[0.5, 0.5]], 0.0, 0.0, "one curve"),
        ([0.5, 0.5], 1.5, 0.3, "haze"),
        ([0.5, 0.5], float("nan"), 0.3, "haze"),
        ([0.5, 0.5], 0.5, 0.0, "haze_width_rad"),
        ([0.5, 0.5], 0.5, float("nan"), "haze_width_rad"),
    ],
)
def test_impossible_covers_are_refused(values, haze, width, told):
    with pytest.raises(ValueError, match=told):
        Cover("test", Spectrum(np.array([400.0, 700.0]), np.array(values)), haze, width)
