"""Metamers: surfaces that are equal to the sensor under one light and different under another.

A smooth curve in the null space of light x QE x lambda under LED A is added to a grey and taken from it. Only
a renderer that is spectral throughout keeps both equal under LED A and separates them as the integrals do
under others. Bounds: under the flash the noise that both patches share cancels and .005 % to .045 % is left;
skylight goes through Russian roulette, with a standard error of .07 %.
"""

import numpy as np
import pytest
from bodies import (
    PITCH_M,
    SENSORS,
    axis_camera,
    columns_of,
    even_lamp,
    irradiance_by_hand,
    matt,
    response_by_hand,
    sheet,
)

from pepperscene.render import render_scene
from pepperscene.scene import assemble_scene, uniform_sky
from pepperscene.spectra import Spectrum

NM = np.arange(380.0, 780.1, 0.5)
LED_A = columns_of("light/houser2013_cool_white_led")["slide_4_lumileds_cool_white"]
LED_B = columns_of("light/cie_illuminants_colour_science")["led_b1"]  # warm, 2,733 K
D65 = columns_of("light/cie_illuminants_colour_science")["d65"]
LUX = 100_000.0


def responses(sensor, spd):
    """`(3, n)` electrons per nanometre and reflectance under a light of `LUX`."""
    return response_by_hand(sensor, NM) * irradiance_by_hand(spd, LUX, NM) / np.pi


def electrons_of(reflectance, sensor, spd):
    return np.trapezoid(reflectance * responses(sensor, spd), NM)


def metamers(sensor):
    """Two reflectances `(n,)` in [0, 1] that are metamers under LED A and very different under LED B."""
    # Cosines with half periods of 20 nm and more; of the null space, the curve with the most effect under B.
    basis = np.cos(np.pi * np.arange(20)[:, None] * (NM - 380.0) / 400.0)
    under_a = np.trapezoid(responses(sensor, LED_A)[:, None] * basis, NM)
    null = np.linalg.svd(under_a)[2][3:]
    under_b = np.trapezoid(responses(sensor, LED_B)[:, None] * (null @ basis), NM)
    curve = np.linalg.svd(under_b)[2][0] @ null @ basis
    curve *= 0.5 / np.abs(curve).max()
    return 0.5 + curve, 0.5 - curve


def rendered(reflectance, sensor, spd, by):
    """`(3,)` electrons of a patch that fills the image, lit by a flash or by a uniform sky."""
    light, side = Spectrum(*spd), 8 if by == "flash" else 48
    lamp, sky = (even_lamp(light, LUX), None) if by == "flash" else (None, uniform_sky(light, LUX))
    camera = axis_camera(side, side, sensor=sensor, flash=lamp)
    scene = assemble_scene(sheet(1.0, 1.0, 0.5, "patch"), {"patch": matt("patch", NM, reflectance)}, sky)
    electrons = render_scene(scene, camera, ["electrons"], "reference", seed=7)["electrons"]
    if by == "flash":  # its beam compensates the lens' fall-off
        return electrons.mean((0, 1), np.float64)
    slope = (np.arange(side) + 0.5 - side / 2) * 2 * PITCH_M[sensor] / 4.16e-3
    falloff = (1.0 + slope[:, None] ** 2 + slope**2) ** -2.0  # cos^4
    return electrons.mean((0, 1), np.float64) / falloff.mean()


@pytest.mark.parametrize("sensor", SENSORS)
def test_pair_differs_but_is_equal_to_the_sensor(sensor):
    a, b = metamers(sensor)
    assert min(a.min(), b.min()) >= 0.0
    assert max(a.max(), b.max()) <= 1.0
    assert np.sqrt(np.mean((a - b) ** 2)) > 0.05
    assert electrons_of(a, sensor, LED_A) == pytest.approx(electrons_of(b, sensor, LED_A), rel=1e-9)


@pytest.mark.parametrize(
    ("sensor", "by", "bound"), [(SENSORS[0], "flash", 0.001), (SENSORS[1], "sky", 0.003)]
)
def test_metamers_are_rendered_equal(sensor, by, bound):
    a, b = (rendered(reflectance, sensor, LED_A, by) for reflectance in metamers(sensor))
    assert a == pytest.approx(b, rel=bound)


@pytest.mark.parametrize(("sensor", "spd", "by"), [(SENSORS[0], D65, "sky"), (SENSORS[1], LED_B, "flash")])
def test_metamers_differ_under_another_light_as_their_integrals(sensor, spd, by):
    electrons = np.array([rendered(reflectance, sensor, spd, by) for reflectance in metamers(sensor)])
    expected = np.array([electrons_of(reflectance, sensor, spd) for reflectance in metamers(sensor)])
    assert electrons == pytest.approx(expected, rel=0.005)
    # Their relative difference.
    difference, target = np.log(electrons[0] / electrons[1]), np.log(expected[0] / expected[1])
    assert np.abs(target).max() > 0.05
    assert difference == pytest.approx(target, abs=0.005)
