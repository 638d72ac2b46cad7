"""Lambertian patches under the shipped LEDs, in every available variant: electrons against quadrature.

A renderer that is not spectral throughout fails with colours under lights of other shapes. A white, a
strongly coloured and a narrow-band patch face camera and lamp; the standard error of a patch's 256 pixels,
estimated from their deviation, must be below .15 %, less than a third of the bound of .5 %.
"""

import numpy as np
import pytest
from bodies import (
    SENSORS,
    axis_camera,
    card,
    columns_of,
    even_lamp,
    irradiance_by_hand,
    matt,
    response_by_hand,
)
from processes import run_python

from pepperscene.errors import SetupError
from pepperscene.geometry import concatenate_meshes
from pepperscene.render import Renderer, variant_name
from pepperscene.render.variant import VARIANTS, choose_variant
from pepperscene.scene import assemble_scene
from pepperscene.spectra import Spectrum

LED_FILES = (
    "light/houser2013_cool_white_led",
    "light/nist_phosphor_led_colour_science",
    "light/cie_illuminants_colour_science",
)
LUX = 200_000.0
SURFACE_NM = np.arange(380.0, 781.0)


def white(nm):
    return np.full_like(nm, 0.9)


def red(nm):
    """A ripe fruit's edge: 3 % below, 88 % above 585 nm, within some 30 nm."""
    return 0.03 + 0.85 / (1.0 + np.exp((585.0 - nm) / 8.0))


def narrow(nm):
    """A line in reflection, 20 nm wide at half height."""
    return 0.9 * np.exp(-4.0 * np.log(2.0) * ((nm - 545.0) / 20.0) ** 2)


PATCHES = (white, red, narrow)


def leds():
    """(wavelengths, values) of each shipped LED."""
    columns = {name: spd for file in LED_FILES for name, spd in columns_of(file).items()}
    return {name: spd for name, spd in columns.items() if name not in ("d50", "d55", "d65", "d75", "a", "e")}


def leds_of(sensor):
    """Every other LED for each of the sensors."""
    return dict(list(leds().items())[SENSORS.index(sensor) :: len(SENSORS)])


def rendered(sensor):
    """`{led: (3 patches, 256 pixels, 3 channels)}` electrons."""
    # Strips of 8 columns and 32 rows, wider than the image at the outer sides.
    pixel = 0.5 * axis_camera(24, 32, sensor=sensor, flash=None).sensor.pixel_pitch_m / 4.16e-3
    strips = [
        card(8 * pixel * place, 0.0, 8 * pixel, 0.1, patch.__name__)
        for place, patch in zip((-1, 0, 1), PATCHES, strict=True)
    ]
    surfaces = {patch.__name__: matt(patch.__name__, SURFACE_NM, patch(SURFACE_NM)) for patch in PATCHES}
    renderer = Renderer(assemble_scene(concatenate_meshes(strips), surfaces))
    electrons_by_led = {}
    for name, spd in leds_of(sensor).items():
        camera = axis_camera(24, 32, sensor=sensor, flash=even_lamp(Spectrum(*spd), LUX))
        electrons = renderer.render(camera, ["electrons"], "standard")["electrons"]
        electrons_by_led[name] = electrons.reshape(32, 3, 8, 3).swapaxes(0, 1).reshape(3, 256, 3)
    return electrons_by_led


def expected(sensor, spd):
    """`(3 patches, 3 channels)` electrons by quadrature."""
    nm = np.arange(380.0, 780.1, 0.5)
    radiance = np.array([patch(nm) for patch in PATCHES]) / np.pi * irradiance_by_hand(spd, LUX, nm)
    return np.trapezoid(radiance[:, None] * response_by_hand(sensor, nm), nm)


@pytest.fixture(scope="module", params=VARIANTS)
def electrons(request):
    """`{sensor: {led: electrons}}` of one variant: the default one here, others in a subprocess."""
    if request.param == variant_name():
        return {sensor: rendered(sensor) for sensor in SENSORS}
    try:
        choose_variant(request.param)
    except SetupError as error:
        pytest.skip(str(error))
    code = (
        "import json; from test_led_integrals import *\n"
        "result = {sensor: {led: x.tolist() for led, x in rendered(sensor).items()} for sensor in SENSORS}\n"
        "print(json.dumps({'variant': variant_name(), **result}))"
    )
    result = run_python(code, PEPPERSCENE_VARIANT=request.param)
    assert result["variant"] == request.param
    return {sensor: {led: np.array(pixels) for led, pixels in result[sensor].items()} for sensor in SENSORS}


@pytest.mark.parametrize("sensor", SENSORS)
def test_electrons_of_each_led_match_the_integral(electrons, sensor):
    assert len(electrons[sensor]) >= 10
    for name, spd in leds_of(sensor).items():
        pixels = electrons[sensor][name]
        mean, integral = pixels.mean(1), expected(sensor, spd)
        lit = integral > 0.01 * integral.max()
        error = pixels.std(1) / np.sqrt(pixels.shape[1]) / mean
        assert error[lit].max() < 0.0015, name
        assert mean[lit] == pytest.approx(integral[lit], rel=0.005), name
