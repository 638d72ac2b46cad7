"""Metamers stay metamers: surfaces that one light makes equal to the sensor, and another tells apart.

Rationale: whatever carries three numbers along the light's path gives two surfaces with the same three
electrons the same three electrons under every light. Only a renderer that is spectral all the way splits them
as the integrals say.

Set-up: the sensor under LED A has a response of three rows, light x QE x lambda. A smooth curve with nothing
in these rows (the null space) is added to a grey and taken from it: equal electrons under LED A, a
root-mean-square difference of .36 in reflectance (above .05 is asked for). Each fills the picture in turn.

Expected: NumPy's quadrature, on half nanometres, from the numbers in the data files.

Bounds: under A the true difference is nil (asserted, 1e-9). In the flash, what is rendered is the sampling
error of the curve alone: both patches are rendered with the same seed, hence at the same wavelengths, so that
the noise of the grey that they share cancels. At 256 samples a pixel of four wavelengths each, evenly spread,
what is left was .005 % to .045 %; .1 % is asked for. Light of the sky goes through Russian roulette, which
looks at the reflectance itself: its noise does not cancel. A sample survives with a chance of about .8, so
that the standard error is sqrt(1 / .8 - 1) / sqrt(48 x 48 x 256) = .07 %, and .3 % lie three times that of
a difference away. The split under other lights is many times the .5 % that it may be off.
"""

from __future__ import annotations

import numpy as np
import pytest
from bodies import (
    PITCH_M,
    bench_lamp,
    chosen_camera,
    columns_of,
    irradiance_by_hand,
    matt,
    response_by_hand,
    sheet,
)

from pepperscene.render import render_scene
from pepperscene.scene import assemble_scene, uniform_sky
from pepperscene.spectra import Spectrum

SENSORS = ("ueye_ui5250re", "onsemi_mt9v024")
NM = np.arange(380.0, 780.1, 0.5)
LED_A = columns_of("light/houser2013_cool_white_led")["slide_4_lumileds_cool_white"]
LED_B = columns_of("light/cie_illuminants_colour_science")["led_b1"]  # warm, 2,733 K
D65 = columns_of("light/cie_illuminants_colour_science")["d65"]
LUX = 100_000.0


def rows(sensor, spd):
    """`(3, n)` electrons per nanometre and reflectance under a light of `LUX`."""
    return response_by_hand(sensor, NM) * irradiance_by_hand(spd, LUX, NM) / np.pi


def electrons_of(reflectance, sensor, spd):
    return np.trapezoid(reflectance * rows(sensor, spd), NM)


def pair(sensor):
    """Two reflectances `(n,)` in [0, 1] that are metamers under LED A, as far apart as they can be."""
    # Cosines with half periods of 20 nm and more; those of the null space that LED B sees most.
    shape = np.cos(np.pi * np.arange(20)[:, None] * (NM - 380.0) / 400.0)
    seen = np.trapezoid(rows(sensor, LED_A)[:, None] * shape, NM)
    null = np.linalg.svd(seen)[2][3:]
    other = np.trapezoid(rows(sensor, LED_B)[:, None] * (null @ shape), NM)
    curve = np.linalg.svd(other)[2][0] @ null @ shape
    curve *= 0.5 / np.abs(curve).max()
    return 0.5 + curve, 0.5 - curve


def rendered(reflectance, sensor, spd, by):
    """`(3,)` electrons of a patch that fills the picture, lit by a flash or by a uniform sky."""
    light = Spectrum(*spd)
    lamp, sky, side = (
        (bench_lamp(light, LUX), None, 8) if by == "flash" else (None, uniform_sky(light, LUX), 48)
    )
    camera = chosen_camera(sensor, lamp, columns=side, rows=side)
    scene = assemble_scene(sheet(1.0, 1.0, 0.5, "patch"), {"patch": matt("patch", NM, reflectance)}, sky)
    electrons = render_scene(scene, camera, ["electrons"], "reference", seed=7)["electrons"]
    if by == "flash":  # whose beam makes up for the lens' fall-off
        return electrons.mean((0, 1), np.float64)
    slope = (np.arange(side) + 0.5 - side / 2) * 2 * PITCH_M[sensor] / 4.16e-3
    falloff = (1.0 + slope[:, None] ** 2 + slope**2) ** -2.0  # cos^4
    return electrons.mean((0, 1), np.float64) / falloff.mean()


@pytest.mark.parametrize("sensor", SENSORS)
def test_the_pair_is_far_apart_and_equal_to_the_sensor(sensor):
    one, other = pair(sensor)
    assert min(one.min(), other.min()) >= 0.0
    assert max(one.max(), other.max()) <= 1.0
    assert np.sqrt(np.mean((one - other) ** 2)) > 0.05
    assert electrons_of(one, sensor, LED_A) == pytest.approx(electrons_of(other, sensor, LED_A), rel=1e-9)


@pytest.mark.parametrize(("by", "bound"), [("flash", 0.001), ("sky", 0.003)])
@pytest.mark.parametrize("sensor", SENSORS)
def test_metamers_are_rendered_equal(sensor, by, bound):
    one, other = (rendered(reflectance, sensor, LED_A, by) for reflectance in pair(sensor))
    assert one == pytest.approx(other, rel=bound)


@pytest.mark.parametrize(("spd", "by"), [(LED_B, "flash"), (D65, "flash"), (D65, "sky")])
@pytest.mark.parametrize("sensor", SENSORS)
def test_metamers_split_under_another_light_as_the_integrals_say(sensor, spd, by):
    found = np.array([rendered(reflectance, sensor, spd, by) for reflectance in pair(sensor)])
    wanted = np.array([electrons_of(reflectance, sensor, spd) for reflectance in pair(sensor)])
    assert found == pytest.approx(wanted, rel=0.005)
    # What sets them apart, as a share of what they have in common.
    split, aim = np.log(found[0] / found[1]), np.log(wanted[0] / wanted[1])
    assert np.abs(aim).max() > 0.05
    assert split == pytest.approx(aim, abs=0.005)
