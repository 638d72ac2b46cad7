"""Extreme lights: the sun in view, almost no light, more light than single precision holds."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import EVEN_SKY, RANGE_NM, axis_camera, card, point_flash_camera, response_by_hand, sheet
from strain import FIXED, grey, render, surface

from pepperscene.camera import Camera
from pepperscene.render import Renderer
from pepperscene.scene import Sky, assemble_scene, uniform_sky
from pepperscene.scene.sky import SUN_ANGULAR_RADIUS, Sun
from pepperscene.spectra import Spectrum

pytestmark = pytest.mark.long

NM = np.arange(360.0, 831.0, 0.5)
EVEN = Spectrum(RANGE_NM, np.ones(2))
AHEAD, BEHIND = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, -1.0])
IRRADIANCE = 1.5  # W m-2 nm-1, about the sun's
LEAF = sheet(0.2, 0.2, 0.5, "leaf")


def sun_alone(direction: np.ndarray, radius: float) -> Sky:
    """A sun of the same irradiance for any radius, in a black sky."""
    dark = Spectrum(RANGE_NM, np.ones((1, 2)))
    sun = Sun(direction, Spectrum(RANGE_NM, np.full(2, IRRADIANCE)), radius)
    return Sky(np.zeros((1, 2, 4), np.float32), dark, sun)


def electrons_by_hand(radiance: float) -> np.ndarray:
    """`(3,)` electrons of a photosite on the axis for this radiance, W m-2 sr-1 nm-1, at all wavelengths."""
    return np.trapezoid(response_by_hand("ueye_ui5250re", NM) * radiance, NM, axis=-1)


def close_up(radius: float) -> Camera:
    """A camera whose focal length makes a disc of this radius eight pixels wide."""
    camera = axis_camera(24, 24, flash=False)
    focal_length = camera.lens.focal_length_m * SUN_ANGULAR_RADIUS / radius
    return replace(camera, lens=replace(camera.lens, focal_length_m=focal_length))


@pytest.mark.parametrize("radius", [1e-4, 1e-3, SUN_ANGULAR_RADIUS, 0.02])
@pytest.mark.parametrize("half_hidden", [False, True])
def test_visible_sun_has_its_energy(radius, half_hidden):
    # All pixels together see the disc's irradiance: the sum of their electrons, each of a solid angle of
    # 1 / (fx fy), is that of a radiance E fx fy in one. 15,000 samples hit the disc. A black card hides half
    # of it, or is behind the camera. Directions err by 1e-7 in single precision, a thousandth of the smallest
    # radius.
    z = 0.5 if half_hidden else -0.5
    black = assemble_scene(
        card(0.1, 0.0, 0.2, 0.4, "black", z), {"black": surface("black", 0.0)}, sun_alone(AHEAD, radius)
    )
    camera = close_up(radius)
    frame = render(black, camera, "reference")
    density = camera.intrinsics[0, 0] * camera.intrinsics[1, 1]
    fraction = 0.5 if half_hidden else 1.0
    total = frame["electrons"].astype(float).sum((0, 1))
    assert total == pytest.approx(fraction * electrons_by_hand(IRRADIANCE * density), rel=0.01)
    assert frame["electrons"].max() < 1.05 * electrons_by_hand(IRRADIANCE / (np.pi * radius**2)).max()
    row, column = np.mgrid[0:24, 0:24] + 0.5
    beyond = np.hypot(row - 12.0, column - 12.0) > camera.intrinsics[0, 0] * radius + 1.0
    assert beyond.sum() > 400
    assert frame["electrons"][beyond].max() == 0.0
    if half_hidden:
        assert frame["electrons"][:, 13:].max() == 0.0


@pytest.mark.parametrize("radius", [1e-12, 1e-4, SUN_ANGULAR_RADIUS, 0.05])
@pytest.mark.parametrize("quality", ["draft", "standard"])
def test_light_of_the_sun_on_a_patch_does_not_depend_on_its_radius(radius, quality):
    # A facing matt patch has the radiance R E / pi, times the mean cosine over the disc, 1 - r^2 / 4.
    scene = grey(sheet(0.2, 0.2, 0.5, "grey"), sky=sun_alone(BEHIND, radius))
    result = render(scene, axis_camera(4, 4, flash=False), quality)["electrons"].mean((0, 1))
    expected = electrons_by_hand(0.5 * IRRADIANCE / np.pi) * (1 - radius**2 / 4)
    assert result == pytest.approx(expected, rel=0.005)


@pytest.mark.parametrize(
    ("direction", "radius", "message"),
    [
        *((AHEAD, radius, "radius") for radius in (0.0, -0.1, np.nan, 2.0)),
        *((bad, 0.01, "unit vector") for bad in (np.zeros(3), 2.0 * AHEAD, np.full(3, np.nan))),
    ],
)
def test_rejects_suns_without_radius_or_direction(direction, radius, message):
    with pytest.raises(ValueError, match=message):
        sun_alone(direction, radius)


@pytest.mark.parametrize("lux", [1e-12, 1e-3, 1e6, 1e9])
def test_electrons_are_proportional_to_the_illuminance(lux):
    def by_flash(lx):
        return render(grey(LEAF), point_flash_camera(illuminance_lx=lx), FIXED)["electrons"] / lx

    def by_sky(lx):
        camera = axis_camera(8, 6, flash=False)
        return render(grey(LEAF, sky=uniform_sky(EVEN, lx)), camera)["electrons"] / lx

    assert by_flash(lux) == pytest.approx(by_flash(200_000.0), rel=1e-5)
    assert by_sky(lux) == pytest.approx(by_sky(200_000.0), rel=1e-4)


@pytest.mark.parametrize("lux", [1e-45, 1e-38, 1e-30])
def test_almost_no_light_adds_nothing(lux):
    def electrons(sky, camera):
        return render(grey(LEAF, sky=sky), camera, FIXED)["electrons"]

    faint, usual = point_flash_camera(illuminance_lx=lux), point_flash_camera()
    none, faint_sky = replace(usual, flash=None), uniform_sky(EVEN, lux)
    assert electrons(EVEN_SKY, faint) == pytest.approx(electrons(EVEN_SKY, none), rel=1e-4)
    assert electrons(faint_sky, usual) == pytest.approx(electrons(None, usual), rel=1e-4)
    assert electrons(None, faint).max() <= lux
    assert electrons(faint_sky, none).max() <= lux


@pytest.mark.parametrize(
    "strength", [{"illuminance_lx": 1e30}, {"illuminance_lx": None, "irradiance_W_m2": 1e30}]
)
def test_rejects_too_strong_a_flash(strength):
    with pytest.raises(ValueError, match="a light is too strong"):
        Renderer(grey(LEAF)).render(point_flash_camera(**strength), ["electrons"])


@pytest.mark.parametrize("light", ["radiance", "weights", "sun"])
def test_rejects_too_strong_daylight(light):
    weights, radiance = np.ones((1, 2, 4), np.float32), Spectrum(RANGE_NM, np.ones((1, 2)))
    sky = {
        "radiance": Sky(weights, radiance.times(1e30)),
        "weights": Sky(weights * np.float32(1e30), radiance),
        "sun": Sky(weights, radiance, Sun(AHEAD, EVEN.times(1e30))),
    }[light]
    with pytest.raises(ValueError, match="a light is too strong"):
        Renderer(grey(LEAF, sky=sky)).render(point_flash_camera(), ["electrons"])


@pytest.mark.parametrize("bad", [np.nan, np.inf, -1.0])
def test_rejects_non_finite_and_negative_skies(bad):
    radiance = Spectrum(RANGE_NM, np.ones((1, 2)))
    with pytest.raises(ValueError, match="weights"):
        Sky(np.full((1, 2, 4), bad, np.float32), radiance)
    if bad < 0.0:
        with pytest.raises(ValueError, match="weights and radiance"):
            Sky(np.ones((1, 2, 4), np.float32), radiance.times(bad))
