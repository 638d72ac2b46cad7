"""Lights at the ends of what lights can be: the sun in view, next to none, more than single precision."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest
from bodies import RANGE_NM, bench_camera, card, response_by_hand, sheet
from strain import DAYLIGHT, FIXED, grey, picture, point_flash_camera, surface
from typer.testing import CliRunner

from pepperscene.camera import Camera
from pepperscene.cli import app
from pepperscene.errors import EXIT_BAD_INPUT
from pepperscene.render import Renderer
from pepperscene.scene import Sky, assemble_scene, uniform_sky
from pepperscene.scene.sky import SUN_ANGULAR_RADIUS, Sun
from pepperscene.shipped import shipped_folder
from pepperscene.spectra import Spectrum

NM = np.arange(360.0, 831.0, 0.5)
EVEN = Spectrum(RANGE_NM, np.ones(2))
AHEAD, BEHIND = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, -1.0])
IRRADIANCE = 1.5  # W m-2 nm-1, about the sun's


def sun_alone(direction: np.ndarray, radius: float) -> Sky:
    """A sun of one irradiance, however wide, in a black sky."""
    dark = Spectrum(RANGE_NM, np.ones((1, 2)))
    sun = Sun(direction, Spectrum(RANGE_NM, np.full(2, IRRADIANCE)), radius)
    return Sky(np.zeros((1, 2, 4), np.float32), dark, sun)


def electrons_by_hand(radiance: float) -> np.ndarray:
    """`(3,)` of a photosite on the axis that sees this radiance, W m-2 sr-1 nm-1, at all wavelengths."""
    return np.trapezoid(response_by_hand("ueye_ui5250re", NM) * radiance, NM, axis=-1)


def close_up(radius: float) -> Camera:
    """A camera with such a focal length that a disc of this radius is eight pixels wide."""
    camera = bench_camera(columns=24, rows=24, flash=False)
    longer = camera.lens.focal_length_m * SUN_ANGULAR_RADIUS / radius
    return replace(camera, lens=replace(camera.lens, focal_length_m=longer))


# --- the sun ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("radius", [1e-4, 1e-3, SUN_ANGULAR_RADIUS, 0.02])
@pytest.mark.parametrize("half_hidden", [False, True])
def test_the_suns_disc_beside_black_has_its_energy(radius, half_hidden):
    # All pixels together see the disc's irradiance: the sum of their electrons, each of a solid angle of
    # 1 / (fx fy), is that of a radiance E fx fy in one. 15,000 samples hit the disc. Then a black card hides
    # half of it. Directions err by 1e-7 in single precision, a thousandth of the smallest disc's radius.
    at = 0.5 if half_hidden else -0.5
    black = assemble_scene(
        card(0.1, 0.0, 0.2, 0.4, "black", at), {"black": surface("black", 0.0)}, sun_alone(AHEAD, radius)
    )
    camera = close_up(radius)
    frame = picture(black, camera, "reference")
    density = camera.intrinsics[0, 0] * camera.intrinsics[1, 1]
    share = 0.5 if half_hidden else 1.0
    total = frame["electrons"].astype(float).sum((0, 1))
    assert total == pytest.approx(share * electrons_by_hand(IRRADIANCE * density), rel=0.01)
    assert frame["electrons"].max() < 1.05 * electrons_by_hand(IRRADIANCE / (np.pi * radius**2)).max()
    row, column = np.mgrid[0:24, 0:24] + 0.5
    beyond = np.hypot(row - 12.0, column - 12.0) > camera.intrinsics[0, 0] * radius + 1.0
    assert beyond.sum() > 400
    assert frame["electrons"][beyond].max() == 0.0
    if half_hidden:
        assert frame["electrons"][:, 13:].max() == 0.0


@pytest.mark.parametrize("radius", [1e-12, 1e-4, SUN_ANGULAR_RADIUS, 0.05])
@pytest.mark.parametrize("quality", ["draft", "standard"])
def test_a_sun_of_any_width_lights_a_patch_alike(radius, quality):
    # Facing it, a matt patch has the radiance R E / pi, but for the disc's own cosine: 1 - r^2 / 4.
    scene = assemble_scene(
        sheet(0.2, 0.2, 0.5, "grey"), {"grey": surface("grey", 0.5)}, sun_alone(BEHIND, radius)
    )
    found = picture(scene, bench_camera(columns=4, rows=4, flash=False), quality)["electrons"].mean((0, 1))
    assert found == pytest.approx(
        electrons_by_hand(0.5 * IRRADIANCE / np.pi) * (1 - radius**2 / 4), rel=0.005
    )


@pytest.mark.parametrize("radius", [0.0, -0.1, np.nan, 2.0])
def test_a_sun_of_no_width_is_refused(radius):
    with pytest.raises(ValueError, match="radius"):
        sun_alone(AHEAD, radius)


@pytest.mark.parametrize("direction", [np.zeros(3), np.array([0.0, 0.0, 2.0]), np.full(3, np.nan)])
def test_a_sun_in_no_direction_is_refused(direction):
    with pytest.raises(ValueError, match="unit vector"):
        sun_alone(direction, 0.01)


# --- faint and strong ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("lux", [1e-12, 1e-3, 1e6, 1e9])
def test_light_is_proportional_to_the_lamp(lux):
    scene = grey(sheet(0.2, 0.2, 0.5, "leaf"))
    found, expected = (
        picture(scene, point_flash_camera(illuminance_lx=lx), FIXED)["electrons"] / lx
        for lx in (lux, 200_000.0)
    )
    assert found == pytest.approx(expected, rel=1e-5)
    found, expected = (
        picture(
            grey(sheet(0.2, 0.2, 0.5, "leaf"), sky=uniform_sky(EVEN, lx)),
            bench_camera(columns=8, rows=6, flash=False),
        )["electrons"]
        / lx
        for lx in (lux, 200_000.0)
    )
    assert found == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("lux", [1e-45, 1e-38, 1e-30])
def test_next_to_no_light_is_none(lux):
    # Beside daylight, a lamp of so little adds nothing; alone, it shows as little, or nothing.
    scene = grey(sheet(0.2, 0.2, 0.5, "leaf"), sky=DAYLIGHT)
    with_lamp = picture(scene, point_flash_camera(illuminance_lx=lux), FIXED)["electrons"]
    without = picture(scene, replace(point_flash_camera(), flash=None), FIXED)["electrons"]
    assert with_lamp == pytest.approx(without, rel=1e-4)
    night = replace(scene, sky=None)
    assert picture(night, point_flash_camera(illuminance_lx=lux), FIXED)["electrons"].max() <= lux
    dusk = replace(scene, sky=uniform_sky(EVEN, lux))
    assert picture(dusk, replace(point_flash_camera(), flash=None), FIXED)["electrons"].max() <= lux
    lamp = point_flash_camera()
    found = picture(dusk, lamp, FIXED)["electrons"]
    assert found == pytest.approx(picture(night, lamp, FIXED)["electrons"], rel=1e-4)


@pytest.mark.parametrize(
    "strength", [{"illuminance_lx": 1e30}, {"illuminance_lx": None, "irradiance_W_m2": 1e30}]
)
def test_too_strong_a_lamp_is_refused(strength):
    renderer = Renderer(grey(sheet(0.2, 0.2, 0.5, "leaf")))
    with pytest.raises(ValueError, match="a light is too strong"):
        renderer.render(point_flash_camera(**strength), ["electrons"])


@pytest.mark.parametrize("light", ["radiance", "weights", "sun"])
def test_too_strong_a_daylight_is_refused(light):
    weights, radiance = np.ones((1, 2, 4), np.float32), Spectrum(RANGE_NM, np.ones((1, 2)))
    sky = {
        "radiance": Sky(weights, radiance.times(1e30)),
        "weights": Sky(weights * np.float32(1e30), radiance),
        "sun": Sky(weights, radiance, Sun(AHEAD, EVEN.times(1e30))),
    }[light]
    with pytest.raises(ValueError, match="a light is too strong"):
        Renderer(grey(sheet(0.2, 0.2, 0.5, "leaf"), sky=sky)).render(point_flash_camera(), ["electrons"])


@pytest.mark.parametrize("bad", [np.nan, np.inf, -1.0])
def test_skies_of_no_numbers_are_refused(bad):
    radiance = Spectrum(RANGE_NM, np.ones((1, 2)))
    with pytest.raises(ValueError, match="weights"):
        Sky(np.full((1, 2, 4), bad, np.float32), radiance)
    if bad < 0.0:
        with pytest.raises(ValueError, match="weights and radiance"):
            Sky(np.ones((1, 2, 4), np.float32), radiance.times(bad))


@pytest.mark.parametrize("scale", [1e-300, 1e-38, 1e30])
def test_the_scale_of_a_lamps_spectrum_does_not_matter(scale):
    # Its strength is told in lux: the spectrum is relative.
    camera = point_flash_camera(columns=4, rows=4)
    other = replace(camera, flash=replace(camera.flash, spectrum=camera.flash.spectrum.times(scale)))
    scene = grey(sheet(0.2, 0.2, 0.5, "leaf"))
    found, expected = (picture(scene, one)["electrons"] for one in (other, camera))
    assert found == pytest.approx(expected, rel=1e-5)


# --- files --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("cell", ["nan", "inf", "-inf", "1e999", "-0.5", "", "red", "1,2"])
def test_a_spectrum_file_of_no_numbers_is_refused_in_one_sentence(tmp_path, cell):
    # A copy of the shipped lamp with one cell of its spectrum spoilt.
    for name in (
        "led_matrix_200klx.toml",
        "spectra/lumileds_cool_white.csv",
        "spectra/lumileds_cool_white.toml",
    ):
        there = tmp_path / name
        there.parent.mkdir(exist_ok=True)
        shutil.copy(shipped_folder("materials") / "flashes" / name, there)
    table = tmp_path / "spectra" / "lumileds_cool_white.csv"
    lines = table.read_text().splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("wavelength_nm"))
    lines[first + 20] = f"{lines[first + 20].split(',')[0]},{cell}"
    table.write_text("\n".join(lines) + "\n")
    flash = tmp_path / "led_matrix_200klx.toml"
    done = CliRunner().invoke(
        app, ["render", "demo", "--out", str(tmp_path / "one"), "--set", f"camera.flash={flash}"]
    )
    assert done.exit_code == EXIT_BAD_INPUT
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1
    assert table.name in done.stderr
    assert not (tmp_path / "one").exists()
