"""Covers: the shipped ones against published data, invalid files, and the physics of haze."""

from __future__ import annotations

import numpy as np
import pytest

from pepperscene.errors import InputError
from pepperscene.scene import Cover, load_cover
from pepperscene.scene.cover import directions, tabulate_haze
from pepperscene.spectra import Spectrum, illuminance, sky_spectrum

SHIPPED = ("float_glass_4mm", "diffuse_glass_4mm", "polyethylene_film")


@pytest.mark.parametrize(
    ("name", "light", "haze"),
    [
        # 4 mm of float glass are specified with about 90 %.
        ("float_glass_4mm", (0.88, 0.91), (0.0, 0.0)),
        # Low-iron glass: 91 to 92 % through the glass; haze from 10 to 75 % is sold.
        ("diffuse_glass_4mm", (0.905, 0.92), (0.1, 0.75)),
        # New film in one layer: 85 to 91 %.
        ("polyethylene_film", (0.85, 0.91), (0.15, 0.6)),
    ],
)
def test_shipped_covers_match_product_specifications(name, light, haze):
    cover, daylight = load_cover(name), sky_spectrum("d65")
    transmitted = illuminance(daylight.times(cover.transmittance)) / illuminance(daylight)
    assert light[0] < transmitted < light[1]
    assert haze[0] <= cover.haze <= haze[1]


@pytest.mark.parametrize(
    # The infrared is relative to green: iron darkens glass but not film.
    ("name", "half_nm", "index", "infrared"),
    [(SHIPPED[0], 335, 1.505, 0.85), (SHIPPED[1], 320, 1.505, 0.98), (SHIPPED[2], 375, 1.51, 1.05)],
)
def test_spectra_of_covers_are_those_of_their_materials(name, half_nm, index, infrared):
    transmittance = load_cover(name).transmittance
    assert transmittance.range_nm == (300, 1100)
    dark, below, above, visible = transmittance.at([300, half_nm - 15, half_nm + 15, 420])
    assert dark < 0.01
    assert below < 0.5 * visible < above
    green, far = transmittance.at([550, 1000])
    assert infrared - 0.14 < far / green < infrared
    # Fresnel, with all reflections between the faces: 2 n / (n^2 + 1).
    assert transmittance.values.max() < 2 * index / (index**2 + 1)


def test_glass_follows_from_its_optical_constants():
    # Rubin 1985: n and k of clear soda lime glass at three of his wavelengths.
    for nm, k in ((400, 2.047e-7), (550, 2.200e-7), (850, 3.150e-6)):
        n = 1.5130 - 0.003169 * (nm / 1e3) ** 2 + 0.003962 / (nm / 1e3) ** 2
        inside = np.exp(-4 * np.pi * k * 4e-3 / (nm * 1e-9))
        face = ((n - 1) / (n + 1)) ** 2
        # Light that crosses once, three times, five times, ...
        series = sum((1 - face) ** 2 * inside ** (2 * i + 1) * face ** (2 * i) for i in range(20))
        assert load_cover("float_glass_4mm").transmittance.at([nm])[0] == pytest.approx(series, abs=1e-4)


VALID = """
name = "test"
kind = "MODEL"
licence = "MIT"
haze = 0.4
haze_width_deg = 15
[transmittance]
file = "cover.csv"
column = "transmittance"
[sources]
haze = "chosen"
haze_width_deg = "chosen"
transmittance = "chosen"
"""
CSV = "wavelength_nm,transmittance\n400,0.8\n700,0.9\n"


def write_cover(tmp_path, text=VALID, csv=CSV):
    (tmp_path / "cover.csv").write_text(csv)
    (tmp_path / "cover.toml").write_text(text)
    return tmp_path / "cover.toml"


def test_loads_a_user_file_and_holds_its_end_values(tmp_path):
    cover = load_cover(write_cover(tmp_path))
    assert (cover.name, cover.haze) == ("test", 0.4)
    assert cover.haze_width_rad == pytest.approx(np.radians(15))
    np.testing.assert_allclose(cover.transmittance.at([300, 400, 550, 700, 1000]), [0.8, 0.8, 0.85, 0.9, 0.9])
    # Without haze no width is needed.
    clear = VALID.replace("haze = 0.4\nhaze_width_deg = 15", "haze = 0")
    assert load_cover(write_cover(tmp_path, clear.replace('haze_width_deg = "chosen"\n', ""))).haze == 0


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("haze = 0.4", "haze = 1.2", "haze = 1.2"),
        ("haze_width_deg = 15", "haze_width_deg = 0.5", "haze_width_deg = 0.5"),
        ("haze_width_deg = 15", "haze_width_deg = 120", "haze_width_deg = 120"),
        ("haze_width_deg = 15\n", "", "haze_width_deg"),
        ('kind = "MODEL"', 'kind = "guess"', "kind"),
        ('transmittance = "chosen"\n', "", r"\[sources\].*transmittance"),
        ('file = "cover.csv"', 'file = "none.csv"', "none.csv.*is not a file"),
        ('column = "transmittance"', 'column = "tau"', "tau.*is not one of transmittance"),
    ],
)
def test_raises_on_invalid_file(tmp_path, old, new, message):
    assert old in VALID
    # Keys of [sources] come after those of the top.
    head, tail = VALID.rsplit(old, 1) if "chosen" in old else VALID.split(old, 1)
    with pytest.raises(InputError, match=message):
        load_cover(write_cover(tmp_path, head + new + tail))


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("400,0.8\n700,1.1\n", "row 3, column transmittance = 1.1: must be at most 1"),
        ("400,-0.1\n700,0.9\n", "row 2, column transmittance = -0.1"),
        ("400,0\n700,0\n", "must let visible light through"),
        ("400,1e-5\n790,1e-5\n800,0.9\n", "must let visible light through: 1.06e-05 of it passes"),
    ],
)
def test_raises_on_invalid_curve(tmp_path, rows, message):
    with pytest.raises(InputError, match=message):
        load_cover(write_cover(tmp_path, csv="wavelength_nm,transmittance\n" + rows))


@pytest.mark.parametrize(
    ("values", "haze", "width", "message"),
    [
        ([0.5, 1.5], 0.0, 0.0, "transmittance"),
        ([0.0, 0.0], 0.0, 0.0, "visible"),
        ([[0.5, 0.5]], 0.0, 0.0, "one curve"),
        ([0.5, 0.5], 1.5, 0.3, "haze"),
        ([0.5, 0.5], float("nan"), 0.3, "haze"),
        ([0.5, 0.5], 0.5, 0.0, "haze_width_rad"),
    ],
)
def test_cover_raises_on_values_out_of_range(values, haze, width, message):
    with pytest.raises(ValueError, match=message):
        Cover("test", Spectrum(np.array([400.0, 700.0]), np.array(values)), haze, width)


ROWS, COLUMNS, OUT_ROWS = 64, 128, 40
WIDTHS = np.radians([4.0, 12.0, 30.0, 90.0])


def projected(rows=ROWS, columns=COLUMNS):
    """`(rows, 1)` integral of the cosine to the zenith over a texel above the horizon, in closed form."""
    edges = np.sin(np.minimum(np.arange(rows + 1) / rows * np.pi, np.pi / 2)) ** 2
    return (np.diff(edges) * np.pi / columns)[:, None]


def texel(row, column):
    """A map that is dark except for one texel."""
    radiance = np.zeros((1, ROWS, COLUMNS))
    radiance[0, row, column] = 1.0
    return radiance


def haze_of(width):
    return tabulate_haze(width, ROWS, COLUMNS, OUT_ROWS)


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("row", [0, 7, 20, 31])
def test_scattering_conserves_energy(width, row):
    radiance = texel(row, 17)
    scattered = haze_of(width).scatter(radiance)
    assert (scattered * projected()).sum() == pytest.approx((radiance * projected()).sum(), rel=1e-9)
    assert scattered.min() >= 0.0


@pytest.mark.parametrize("width", WIDTHS)
def test_uniform_sky_stays_uniform(width):
    # Otherwise a passive cover could make light brighter, against the second law of thermodynamics.
    scattered = haze_of(width).scatter(np.full((2, ROWS, COLUMNS), 3.0))
    np.testing.assert_allclose(scattered[:, :OUT_ROWS], 3.0, rtol=1e-8)
    assert not scattered[:, OUT_ROWS:].any()


@pytest.mark.parametrize("width", WIDTHS[1:])
@pytest.mark.parametrize(("one", "other"), [((3, 5), (25, 20)), ((30, 100), (31, 3)), ((0, 0), (16, 64))])
def test_scattering_is_reciprocal(width, one, other):
    forward = haze_of(width).scatter(texel(*one))[0][other] / projected()[one[0], 0]
    backward = haze_of(width).scatter(texel(*other))[0][one] / projected()[other[0], 0]
    assert forward == pytest.approx(backward, rel=1e-6, abs=1e-12)


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("row", [1, 12, 31])
def test_lobe_of_a_beam_equals_scattering_of_a_texel(width, row):
    towards = directions(ROWS, COLUMNS)
    lobe = haze_of(width).lobe(towards, towards[row, 40])
    scattered = haze_of(width).scatter(texel(row, 40))[0]
    np.testing.assert_allclose(lobe / lobe.max(), scattered / scattered.max(), atol=1e-9)


@pytest.mark.parametrize("width_deg", [3.0, 6.0, 10.0])
def test_lobe_has_the_given_width(width_deg):
    # From the zenith, on a fine map: for small angles, the mean squared angle is twice the squared width.
    rows, columns = 512, 8
    towards = directions(rows, columns)
    haze = tabulate_haze(np.radians(width_deg), rows, columns, rows // 2)
    energy = haze.lobe(towards, np.array([0.0, 0.0, 1.0])) * projected(rows, columns)
    mean_square = (energy * np.arccos(towards[..., 2]) ** 2).sum() / energy.sum()
    assert np.degrees(np.sqrt(mean_square / 2.0)) == pytest.approx(width_deg, rel=0.03)
