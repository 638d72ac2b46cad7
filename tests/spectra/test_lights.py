"""Illuminance, shipped lights, daylight of CIE 015:2018, low suns; how colour-science is imported."""

import ast
import subprocess
import sys
from pathlib import Path

import colour
import numpy as np
import pytest

import pepperscene
from pepperscene.errors import InputError
from pepperscene.spectra import (
    D65_K,
    Spectrum,
    daylight_basis,
    daylight_mixture,
    illuminance,
    photons_per_joule,
    photopic_efficiency,
    read_spectra,
    read_spectrum,
    scale_to_illuminance,
    sky_spectrum,
    sun_spectrum,
)
from pepperscene.spectra.lights import air_mass, diffuse_spectrum

LED = ("light/houser2013_cool_white_led", "slide_4_lumileds_cool_white")
ILLUMINANTS = "light/cie_illuminants_colour_science"
NM = np.arange(300.0, 831.0, 5.0)


def colour_temperature(spd: Spectrum) -> float:
    """Correlated colour temperature by colour-science (Ohno 2013)."""
    nm = np.arange(380, 781, 5)
    sd = colour.SpectralDistribution(dict(zip(nm.tolist(), spd.at(nm).tolist(), strict=True)))
    xyz = colour.sd_to_XYZ(sd, method="Integration", shape=colour.SpectralShape(380, 780, 5))
    uv = colour.UCS_to_uv(colour.XYZ_to_UCS(xyz))
    return float(colour.uv_to_CCT(uv, method="Ohno 2013")[0])


def test_v_lambda_is_the_table_of_colour_science():
    table = colour.colorimetry.SDS_LEFS_PHOTOPIC["CIE 1924 Photopic Standard Observer"]
    v = photopic_efficiency()
    assert np.array_equal(v.wavelength_nm, table.wavelengths)
    assert np.array_equal(v.values, table.values)


def test_illuminance_is_exact_for_linear_pieces():
    # Two-point Gauss quadrature, exact for cubics, between the nodes of both curves.
    spd = Spectrum(
        np.array([300.0, 411.3, 480.0, 555.5, 602.7, 1100.0]), np.array([0.0, 2.0, 0.1, 5.0, 0.0, 3.0])
    )
    v = photopic_efficiency()
    nm = np.union1d(spd.wavelength_nm, v.wavelength_nm)
    nm = nm[(nm >= v.wavelength_nm[0]) & (nm <= v.wavelength_nm[-1])]
    centre, half = (nm[:-1] + nm[1:]) / 2, np.diff(nm) / 2
    points = [centre + sign * half / np.sqrt(3) for sign in (-1, 1)]
    product = sum(
        np.interp(x, spd.wavelength_nm, spd.values) * np.interp(x, v.wavelength_nm, v.values) for x in points
    )
    assert illuminance(spd) == pytest.approx(683.002 * (product * half).sum(), rel=1e-12)


def test_illuminance_at_the_edge_of_the_visible_range():
    v = photopic_efficiency()
    first, value = v.wavelength_nm[0], v.values[0]
    assert illuminance(Spectrum(np.array([200.0, first]), np.ones(2))) == 0
    # A light that ends inside V's first piece.
    slope = v.values[1] - v.values[0]
    half = Spectrum(np.array([200.0, first + 0.5]), np.ones(2))
    assert illuminance(half) == pytest.approx(683.002 * (0.5 * value + 0.125 * slope), rel=1e-9)


def test_infrared_has_no_illuminance_and_cannot_be_scaled():
    infrared = Spectrum(np.array([850.0, 1000.0]), np.array([1.0, 1.0]))
    assert illuminance(infrared) == 0
    with pytest.raises(ValueError, match="cannot scale"):
        scale_to_illuminance(infrared, 100)


def test_scales_to_an_illuminance():
    for spd in (sun_spectrum(), sky_spectrum()):
        assert illuminance(scale_to_illuminance(spd, 5_500)) == pytest.approx(5_500)
        assert spd.at(560) == pytest.approx(1.0)


def test_shipped_leds_have_their_colour_temperature_and_the_sun_is_warmer_than_the_sky():
    for file, column, kelvin in ((*LED, 5763), (ILLUMINANTS, "led_b4", 5106), (ILLUMINANTS, "led_b5", 6591)):
        assert colour_temperature(read_spectrum(file, column)) == pytest.approx(kelvin, abs=25)
    assert colour_temperature(sun_spectrum()) < colour_temperature(sky_spectrum("d55"))


@pytest.mark.parametrize("kind", ["d50", "d55", "d65", "d75"])
def test_daylight_matches_the_cie_formula_from_300_to_830_nm(kind):
    # CIE 015:2018: the daylight components, by colour-science. The shipped values have five digits.
    xy = colour.temperature.CCT_to_xy_CIE_D(float(kind[1:]) * 100 * 1.4388 / 1.4380)
    shape = colour.SpectralShape(300, 830, 5)
    cie = colour.sd_CIE_illuminant_D_series(xy, M1_M2_rounding=True, shape=shape)
    np.testing.assert_allclose(sky_spectrum(kind).at(cie.wavelengths) * 100, cie.values, atol=0.006)


@pytest.mark.parametrize("kind", ["d50", "d55", "d65", "d75"])
def test_daylight_continues_in_the_near_infrared(kind):
    daylight = sky_spectrum(kind)
    assert daylight.wavelength_nm[0] <= 300 < 1100 <= daylight.wavelength_nm[-1]
    beyond = daylight.wavelength_nm > 830
    assert daylight.values[beyond].min() > 0
    # The water vapour band around 940 nm is darker than 870 and 1000 nm.
    assert daylight.at([940])[0] < 0.75 * daylight.at([870, 1000]).min()
    # The shape is that of ASTM G173, and its level matches the table's over the last 50 nm.
    column = read_spectrum("light/astm_g173_300_1100", "global_tilt_W_m2_nm")
    shape = diffuse_spectrum() if kind == "d75" else column
    nm = daylight.wavelength_nm[beyond]
    ratio = daylight.values[beyond] / shape.at(nm)
    assert np.ptp(ratio) < 1e-9 * ratio.max()
    last = np.arange(780, 831)
    assert np.mean(daylight.at(last)) == pytest.approx(ratio[0] * np.mean(shape.at(last)), rel=2e-3)


def test_direct_and_diffuse_sum_to_the_global_irradiance_of_astm_g173():
    diffuse = diffuse_spectrum()
    columns = read_spectra("light/astm_g173_300_1100")
    total, direct = columns["global_tilt_W_m2_nm"], columns["direct_W_m2_nm"]
    # The sun is 48.19 degrees from the zenith, the plane is tilted by 37 towards it.
    expected = diffuse.values + np.cos(np.radians(48.19 - 37)) * direct.values
    np.testing.assert_allclose(expected, total.values, rtol=1e-4)
    assert diffuse.values.min() > 0
    # Scattered light is bluer: Rayleigh scattering, reduced by haze and by light from the ground.
    fraction = diffuse.values / total.values
    low, high = (np.interp(nm, diffuse.wavelength_nm, fraction) for nm in (400, 1000))
    assert low > 3 * high


def test_raises_on_unknown_sky():
    with pytest.raises(InputError, match="d50, d55, d65 or d75"):
        sky_spectrum("d93")  # type: ignore[arg-type]


def test_photons_have_the_energy_hc_over_lambda():
    assert photons_per_joule([400, 800]) == pytest.approx([2.0138e18, 4.0276e18], rel=1e-3)
    # 6.62607015e-34 J s and 299792458 m s-1 are exact in the SI.
    assert photons_per_joule(1e9 * 6.62607015e-34 * 299_792_458) == pytest.approx(1.0)


@pytest.mark.parametrize("kelvin", [5001.0, D65_K, 7001.0, 24_999.0])
def test_mixture_is_the_cie_spectrum(kelvin):
    basis = daylight_basis()
    mixed = Spectrum(basis.wavelength_nm, daylight_mixture(kelvin) @ basis.values)
    xy = colour.temperature.CCT_to_xy_CIE_D(kelvin)
    shape = colour.SpectralShape(300, 830, 5)
    cie = colour.sd_CIE_illuminant_D_series(xy, M1_M2_rounding=False, shape=shape)
    np.testing.assert_allclose(mixed.at(NM) / mixed.at(560.0) * 100, cie.values, atol=0.02)


def test_basis_and_shares_are_never_negative():
    basis = daylight_basis()
    assert basis.values.min() >= 0.0
    levels = [illuminance(Spectrum(basis.wavelength_nm, row)) for row in basis.values]
    assert levels == pytest.approx([1.0] * 3)
    shares = daylight_mixture(np.geomspace(1000.0, 1e6, 200))
    assert shares.min() >= 0.0
    np.testing.assert_allclose(shares.sum(axis=0), 1.0, rtol=1e-12)
    # Temperatures beyond the range are clipped to its ends, which are corners of the triangle.
    np.testing.assert_allclose(shares[:, [-1, 0]], [[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]], atol=1e-9)


def test_sunlight_at_air_mass_1_5_is_the_standard():
    # An error of 0.001 in the air mass is one of 0.5 % at 300 nm.
    np.testing.assert_allclose(
        sun_spectrum(np.radians(41.78)).at(NM), sun_spectrum().at(NM), rtol=6e-3, atol=1e-9
    )


def test_attenuation_of_sunlight_grows_with_the_air_mass():
    # Beer's law: logarithms of the transmittances at two elevations are in the ratio of the air masses.
    above = read_spectra("light/astm_g173_300_1100")["extraterrestrial_W_m2_nm"]
    optical_depth = {}
    for degrees in (8.0, 60.0):
        logarithm = np.log(sun_spectrum(np.radians(degrees)).at(NM) / above.at(NM))
        optical_depth[degrees] = logarithm - logarithm[NM == 560]  # the spectra are relative
    ratio = air_mass(np.radians(8.0)) / air_mass(np.radians(60.0))
    np.testing.assert_allclose(optical_depth[8.0], ratio * optical_depth[60.0], rtol=1e-6, atol=1e-9)
    # Rayleigh scattering reddens a low sun: blue falls faster than red.
    blue, red = np.interp([450, 650], NM, optical_depth[8.0])
    assert blue < red


def test_air_mass_is_that_of_kasten_and_young():
    # Kasten & Young 1989, table II.
    found = [air_mass(np.radians(degrees)) for degrees in (90.0, 30.0, 10.0, 0.0)]
    assert found == pytest.approx([1.0, 1.994, 5.58, 38.0], rel=5e-3)


def imported_packages(path):
    """Top-level packages that a file imports anywhere."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (name.name.partition(".")[0] for name in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield (node.module or "").partition(".")[0]


@pytest.mark.long
def test_one_module_imports_colour():
    folder = Path(pepperscene.__file__).parent
    modules = [path for path in folder.rglob("*.py") if "colour" in imported_packages(path)]
    assert modules == [folder / "spectra" / "lights.py"]


@pytest.mark.long
def test_only_the_matplotlib_warning_is_suppressed():
    # What the colour correction of a camera needs of it.
    code = (
        "import sys; sys.modules['matplotlib'] = None\n"
        "import warnings\n"
        "from pepperscene.spectra import colour_science\n"
        "colour = colour_science()\n"
        "lab = colour.XYZ_to_Lab(colour.MSDS_CMFS['CIE 1931 2 Degree Standard Observer'].values[50])\n"
        "assert colour.delta_E(lab, lab, method='CIE 2000') == 0\n"
        "assert not any(f[1] and 'Matplotlib' in f[1].pattern for f in warnings.filters)\n"
        "warnings.warn('something else')\n"
    )
    command = [sys.executable, "-W", "always", "-c", code]
    result = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert result.returncode == 0, result.stderr
    warnings = [line for line in result.stderr.splitlines() if "Warning" in line]
    assert len(warnings) == 1
    assert "something else" in warnings[0]
