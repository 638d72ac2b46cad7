import numpy as np
import pytest

from pepperscene.errors import InputError
from pepperscene.spectra import (
    LIGHT_SPEED,
    LUMINOUS_EFFICACY,
    PLANCK,
    Spectrum,
    illuminance,
    led_spectrum,
    photons_per_joule,
    sky_spectrum,
    sun_spectrum,
    with_illuminance,
)


def colour_temperature(spd: Spectrum) -> float:
    """Correlated colour temperature by colour-science (Ohno 2013)."""
    import colour

    nm = np.arange(380, 781, 5)
    sd = colour.SpectralDistribution(dict(zip(nm.tolist(), spd.at(nm).tolist(), strict=True)))
    xyz = colour.sd_to_XYZ(sd, method="Integration", shape=colour.SpectralShape(380, 780, 5))
    uv = colour.UCS_to_uv(colour.XYZ_to_UCS(xyz))
    return float(colour.uv_to_CCT(uv, method="Ohno 2013")[0])


def test_a_narrow_line_at_555_nm_has_the_maximum_efficacy():
    line = Spectrum(np.array([554.0, 555.0, 556.0]), np.array([0.0, 1.0, 0.0]))  # 1 W m-2
    assert illuminance(line) == pytest.approx(LUMINOUS_EFFICACY, rel=1e-3)


def test_equal_energy_integrates_v_lambda():
    """The integral of V(lambda) is 106.857 nm (CIE 018:2019, 5 nm tables give 106.86)."""
    flat = Spectrum(np.array([300.0, 900.0]), np.array([1.0, 1.0]))
    assert illuminance(flat) == pytest.approx(LUMINOUS_EFFICACY * 106.857, rel=1e-4)


def test_infrared_gives_no_lux_and_cannot_be_scaled():
    infrared = Spectrum(np.array([850.0, 1000.0]), np.array([1.0, 1.0]))
    assert illuminance(infrared) == 0
    with pytest.raises(ValueError, match="cannot scale"):
        with_illuminance(infrared, 100)


@pytest.mark.parametrize("spd", [sun_spectrum(), sky_spectrum(), led_spectrum()])
def test_scaling_to_lux(spd):
    assert illuminance(with_illuminance(spd, 5_500)) == pytest.approx(5_500)
    assert spd.at(560) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("spd", "kelvin"),
    [
        (led_spectrum(), 5763),
        (led_spectrum("led_b4"), 5106),
        (led_spectrum("led_b5"), 6591),
        (sky_spectrum("d50"), 5001),
        (sky_spectrum("d65"), 6503),
    ],
)
def test_colour_temperatures(spd, kelvin):
    assert colour_temperature(spd) == pytest.approx(kelvin, abs=25)


def test_direct_sun_is_warmer_than_the_sky():
    assert colour_temperature(sun_spectrum()) < colour_temperature(sky_spectrum("d55"))


def test_unknown_lights():
    with pytest.raises(InputError, match="must be one of"):
        led_spectrum("neon")
    with pytest.raises(InputError, match="d50, d55, d65 or d75"):
        sky_spectrum("d93")  # type: ignore[arg-type]


def test_photons_carry_hc_over_lambda():
    assert photons_per_joule(1e9 * PLANCK * LIGHT_SPEED) == pytest.approx(1.0)
    assert photons_per_joule([400, 800]) == pytest.approx([2.0138e18, 4.0276e18], rel=1e-3)
