"""Light of lamps against closed forms of illumination engineering, and the choice among many lamps.

Configuration factors of a disc and of a rectangle on a parallel plane: Howell, "A catalog of radiation heat
transfer configuration factors", B-12 and C-21.
"""

import dataclasses
import math

import numpy as np
import pytest
from bodies import axis_camera, columns_of, irradiance_by_hand, matt, response_by_hand, sheet

from pepperscene.camera import Lamp
from pepperscene.camera.lamps.beam import Beam, diffuse_tube_beam, even_beam, lambertian_beam, profile_beam
from pepperscene.camera.lamps.lamp import POINT, EmitterShape, aimed_axes, ring
from pepperscene.camera.lamps.lamp_files import load_lamp
from pepperscene.render import Quality, Renderer
from pepperscene.scene import assemble_scene
from pepperscene.spectra import Spectrum, read_spectrum

NM = np.arange(360.0, 831.0, 0.5)
CURVE = columns_of("flashes/spectra/lumileds_cool_white")["lumileds_cool_white"]
SPECTRUM = Spectrum(*CURVE)
DISTANCE_M, LUMENS, REFLECTANCE = 0.3, 2e4, 0.18
AHEAD = aimed_axes([0.0, 0.0, 1.0])
PATHS = Quality(samples=256, soft=4, most=256, bounces=0, target=None, denoise=False)


def lamp(shape=POINT, beam=None, position=(0.0, 0.0, 0.5 - DISTANCE_M), **changes):
    """A lamp at 0.3 m from the sheet at z = 0.5, towards it."""
    made = Lamp("lamp", SPECTRUM, 1.0, beam or lambertian_beam(), shape, np.array(position), AHEAD)
    return dataclasses.replace(made.with_strength(flux_lm=LUMENS), **changes)


def electrons(lamps, quality=PATHS, at_camera=(), seed=0):
    """Rendered electrons in the middle of a matt grey sheet, without scattered light."""
    nm = np.array([300.0, 1100.0])
    scene = assemble_scene(
        sheet(0.04, 0.04, 0.5, "grey"), {"grey": matt("grey", nm, np.full(2, REFLECTANCE))}, lamps=lamps
    )
    camera = dataclasses.replace(axis_camera(8, 6, flash=False), lamps=tuple(at_camera))
    image = Renderer(scene).render(camera, ["electrons"], quality, seed)["electrons"]
    return image[1:5, 2:6].mean((0, 1))


def expected(lux):
    """E / pi through the camera, by hand."""
    irradiance = irradiance_by_hand(CURVE, lux, NM)
    return np.trapezoid(REFLECTANCE / np.pi * irradiance * response_by_hand("ueye_ui5250re", NM), NM)


def rectangle_factor(width, height, distance):
    """From a small parallel plane opposite the centre to a rectangle: four times that of a quarter."""
    a, b = 0.5 * width / distance, 0.5 * height / distance
    one, other = math.hypot(1.0, a), math.hypot(1.0, b)
    return 2.0 / math.pi * (a / one * math.atan(b / one) + b / other * math.atan(a / other))


def disc_factor(radius, distance):
    return radius**2 / (radius**2 + distance**2)


D = DISTANCE_M
LINE = 0.5 * 1.2 / D  # half of a tube's length over the distance
SHAPES = {
    "even point": (POINT, even_beam(), 1.0 / (4.0 * math.pi * D**2)),
    "lambertian point": (POINT, lambertian_beam(), 1.0 / (math.pi * D**2)),
    # A Lambertian area of the flux F has F / A of exitance, and gives the factor times that.
    "disc": (ring(0.2), lambertian_beam(), disc_factor(0.2, D) / (math.pi * 0.2**2)),
    "ring": (
        ring(0.2, 0.1),
        lambertian_beam(),
        (disc_factor(0.2, D) - disc_factor(0.1, D)) / (math.pi * (0.2**2 - 0.1**2)),
    ),
    "rectangle": (
        EmitterShape(size_m=(0.4, 0.2)),
        lambertian_beam(),
        rectangle_factor(0.4, 0.2, D) / (0.4 * 0.2),
    ),
    # As the rectangle: elements that touch.
    "panel": (
        EmitterShape(4, 2, (0.1, 0.1), (0.1, 0.1)),
        lambertian_beam(),
        rectangle_factor(0.4, 0.2, D) / (0.4 * 0.2),
    ),
    # Each length dl emits F / L / pi^2 sin(theta) dl: the integral of sin(theta) cos / r^2 over the line.
    "tube": (
        EmitterShape(size_m=(1.2, 0.0)),
        diffuse_tube_beam(),
        (math.atan(LINE) + LINE / (1.0 + LINE**2)) / (1.2 * math.pi**2 * D),
    ),
}


@pytest.mark.parametrize("name", SHAPES)
def test_irradiance_of_each_shape_is_its_closed_form(name):
    shape, beam, closed = SHAPES[name]
    factor = lamp(shape, beam).irradiance_factor([[0.0, 0.0, 0.5]], [[0.0, 0.0, -1.0]])
    assert factor[0] == pytest.approx(closed, rel=1e-3)


@pytest.mark.parametrize("name", SHAPES)
def test_plane_lit_by_each_shape_is_as_bright_as_its_closed_form(name):
    shape, beam, closed = SHAPES[name]
    # The camera sees 4 mm of the plane around the axis.
    assert electrons([lamp(shape, beam)]) == pytest.approx(expected(LUMENS * closed), rel=2e-3)


def test_lamp_of_the_camera_moves_with_it():
    """In the camera's axes the same lamp gives the same light, also turned."""
    closed = SHAPES["ring"][2]
    at_camera = lamp(*SHAPES["ring"][:2])
    assert electrons([], at_camera=[at_camera]) == pytest.approx(expected(LUMENS * closed), rel=2e-3)


@pytest.mark.parametrize(
    "beam", [even_beam(), lambertian_beam(), diffuse_tube_beam(), profile_beam([0, 1], [1, 0])]
)
def test_beams_contain_their_flux(beam):
    """The integral over the sphere, by a quadrature of its own."""
    node, weight = np.polynomial.legendre.leggauss(2000)
    turn = (np.arange(360) + 0.5) / 360 * 2 * np.pi
    sine = np.sqrt(1 - node**2)[:, None]
    directions = np.stack(
        [sine * np.cos(turn), sine * np.sin(turn), np.broadcast_to(node[:, None], (2000, 360))], axis=-1
    )
    total = 2 * np.pi * (beam.at(directions).mean(axis=1) * weight).sum()
    assert total == pytest.approx(1.0, rel=5e-4)


def test_strengths_are_those_of_the_spectrum():
    made = lamp().with_strength(ppf_umol_s=100.0)
    nm = np.arange(400.0, 700.5, 0.5)
    watts = made.flux_W * np.interp(nm, *CURVE) / np.trapezoid(CURVE[1], CURVE[0])
    photons = np.trapezoid(watts * nm * 1e-9 / (6.62607015e-34 * 2.99792458e8), nm) / 6.02214076e17
    assert photons == pytest.approx(100.0, rel=1e-3)
    lux = lamp(ring(0.1)).with_strength(illuminance_lx=5000.0, at_m=0.3)
    assert lux.flux_lm * disc_factor(0.1, 0.3) / (math.pi * 0.1**2) == pytest.approx(5000.0, rel=1e-3)


def lattice(count):
    """Lamps of two spectra above a sheet, some of them behind it."""
    rng = np.random.default_rng(4)
    other = read_spectrum("light/cie_illuminants_colour_science", "a")
    return [
        dataclasses.replace(
            lamp(ring(0.02), position=(*rng.uniform(-0.4, 0.4, 2), rng.uniform(-0.2, 0.45))),
            flux_W=float(rng.uniform(0.2, 2.0)),
            spectrum=SPECTRUM if number % 3 else other,
        )
        for number in range(count)
    ]


@pytest.mark.parametrize("count", [5, 40])
def test_choice_among_lamps_is_unbiased(count):
    """All together give the sum of each alone, within four standard errors; few are direct light."""
    lamps, quality = lattice(count), dataclasses.replace(PATHS, soft=256)
    images = np.stack([electrons(lamps, quality, seed=seed) for seed in range(4)])
    alone = sum(electrons([each], dataclasses.replace(PATHS, samples=32)) for each in lamps)
    # The error of the mean, and no less than that of the lamps alone.
    error = np.maximum(images.std(axis=0, ddof=1) / 2.0, 2e-4 * alone)
    assert np.abs(images.mean(axis=0) - alone).max() < 4 * error.max()


def test_shipped_lamps_load():
    for name in ("hps_top_light_1000w", "led_top_light_350w", "led_interlight_2450mm", "t8_tube_36w"):
        assert load_lamp(name).flux_W > 1.0


def test_beam_of_planes_is_periodic():
    beam = Beam(
        np.radians([0.0, 90, 180, 270, 360]),
        np.radians([0.0, 90]),
        np.array([[1, 2], [1, 4], [1, 6], [1, 8], [1, 2]]),
    )
    level = beam.at([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0.5**0.5, -(0.5**0.5), 0]])
    np.testing.assert_allclose(level / level[0], [1, 2, 3, 4, 2.5])
