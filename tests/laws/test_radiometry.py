"""The chain from lux to electrons against calculations that share no code with it.

Every factor is computed again, with its unit, from the numbers of the data files.
"""

import dataclasses
import math
import tomllib

import numpy as np
import pytest
from bodies import (
    EVEN_SKY,
    axis_camera,
    columns_of,
    irradiance_by_hand,
    lux,
    point_flash_camera,
    response_by_hand,
    sheet,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from pepperscene.camera import (
    AngularProfile,
    Camera,
    Developing,
    Distortion,
    expected_electrons,
    load_flash,
    load_lens,
    load_sensor,
    relative_illumination,
)
from pepperscene.materials import lambertian_surface
from pepperscene.render import Renderer
from pepperscene.scene import assemble_scene
from pepperscene.shipped import shipped_folder
from pepperscene.spectra import Spectrum

# --- rendered patches ---------------------------------------------------------------------------------------


REFLECTANCE = 0.18
NM = np.arange(360.0, 831.0, 0.5)


def electrons_by_hand(irradiance: np.ndarray) -> np.ndarray:
    """Electrons of a photosite on the axis for the grey patch under an irradiance W m-2 nm-1."""
    return np.trapezoid(REFLECTANCE / np.pi * irradiance * response_by_hand("ueye_ui5250re", NM), NM)


def electrons_of_patch(camera, sky=None, quality: str = "standard") -> np.ndarray:
    """Rendered electrons in the middle of an 18 % matt patch at 50 cm."""
    surfaces = {"grey": lambertian_surface("grey", REFLECTANCE)}
    scene = assemble_scene(sheet(1.0, 1.0, 0.5, "grey"), surfaces, sky)
    return Renderer(scene).render(camera, ["electrons"], quality)["electrons"][1:5, 2:6].mean((0, 1))


def test_point_flash_gives_its_illuminance():
    spd = columns_of("flashes/spectra/lumileds_cool_white")["lumileds_cool_white"]
    expected = electrons_by_hand(irradiance_by_hand(spd, 200_000.0, NM))
    assert electrons_of_patch(point_flash_camera(8, 6)) == pytest.approx(expected, rel=0.01)


def test_matrix_flash_equals_its_integral():
    # A matrix of discs beside the lens: integrate cosine, profile and distance.
    camera = axis_camera(8, 6)
    flash = camera.flash
    radii = flash.radius_m * np.sqrt((np.arange(200) + 0.5) / 200)
    turns = (np.arange(64) + 0.5) / 64 * 2 * np.pi
    points = np.broadcast_arrays(radii[:, None] * np.cos(turns), radii[:, None] * np.sin(turns), 0.0)
    centres = np.pad(flash.emitters_m, ((0, 0), (0, 1))) + np.array(flash.offset_m)
    ray = np.array([0.0, 0.0, 0.5]) - (np.stack(points, -1)[..., None, :] + centres)
    distance = np.linalg.norm(ray, axis=-1)
    cosine = ray[..., 2] / distance
    profile = np.interp(np.arccos(cosine), flash.profile.angle_rad, flash.profile.relative_intensity)
    falloff = float(np.mean(profile * cosine / distance**2))
    expected = electrons_by_hand(flash.radiant_intensity(NM) * falloff)
    assert electrons_of_patch(camera) == pytest.approx(expected, rel=0.01)


def test_uniform_sky_gives_its_illuminance():
    # The patch faces a uniform sky: it receives the whole illuminance.
    irradiance = irradiance_by_hand((NM, np.ones(NM.size)), 5500.0, NM)
    electrons = electrons_of_patch(axis_camera(8, 6, flash=False), EVEN_SKY, "reference")
    assert electrons == pytest.approx(electrons_by_hand(irradiance), rel=0.01)
    # By estimate, 5.5 klx on 18 % grey in 50 us at f/2 give about 90 electrons in green.
    assert electrons[1] == pytest.approx(90.0, rel=0.3)


def test_light_of_the_sky_falls_with_the_fourth_power_of_the_cosine():
    # A uniform sky has the same radiance everywhere; only the lens makes a difference.
    camera = axis_camera(flash=False)
    behind = assemble_scene(
        sheet(0.01, 0.01, -1.0, "grey"), {"grey": lambertian_surface("grey", 0.5)}, EVEN_SKY
    )
    electrons = Renderer(behind).render(camera, ["electrons"], "draft")["electrons"]
    lens = camera.to_metadata()
    v, u = np.mgrid[0:600, 0:800] + 0.5
    slope2 = ((u - lens["cx"]) / lens["fx"]) ** 2 + ((v - lens["cy"]) / lens["fy"]) ** 2
    measured, expected = (
        image.reshape(30, 20, 40, 20).mean((1, 3))
        for image in (electrons[..., 1].astype(float), (1.0 + slope2) ** -2.0)
    )
    assert measured / measured.max() == pytest.approx(expected / expected.max(), rel=5e-3)


# --- the camera alone ---------------------------------------------------------------------------------------


LENS, SENSOR = load_lens("lensagon_cmfa0420nd"), load_sensor("ueye_ui5250re")
COARSE = dataclasses.replace(SENSOR, columns=80, rows=60, pitch_m=10 * SENSOR.pitch_m)


def squared_slopes(camera):
    """`(h, w)` squared slopes of the image's pixels, from the intrinsics in a frame's metadata."""
    data = camera.to_metadata()
    v, u = np.mgrid[0 : camera.height, 0 : camera.width] + 0.5
    return ((u - data["cx"]) / data["fx"]) ** 2 + ((v - data["cy"]) / data["fy"]) ** 2


@given(right=st.floats(-1e-3, 1e-3), down=st.floats(-1e-3, 1e-3))
@settings(max_examples=25, deadline=None)
def test_light_falls_with_the_fourth_power_of_the_cosine(right, down):
    camera = Camera(dataclasses.replace(LENS, principal_offset_m=(right, down)), COARSE)
    np.testing.assert_allclose(relative_illumination(camera), (1 + squared_slopes(camera)) ** -2, rtol=1e-12)


def test_vignetting_multiplies_the_cosine_falloff():
    table = AngularProfile(np.deg2rad([0, 20, 30]), np.array([1.0, 0.9, 0.5]), "hold")
    camera = Camera(dataclasses.replace(LENS, vignetting=table), COARSE)
    angle = np.rad2deg(np.arctan(np.sqrt(squared_slopes(camera))))
    expected = np.interp(angle, [0, 20, 30], [1.0, 0.9, 0.5]) * np.cos(np.deg2rad(angle)) ** 4
    np.testing.assert_allclose(relative_illumination(camera), expected, rtol=1e-9)
    assert angle.max() > 45  # held beyond the table's end


def test_falloff_can_be_disabled():
    lens = load_lens("lensagon_cmfa0420nd_typical_distortion")
    camera = Camera(lens, COARSE, developing=Developing(falloff=False))
    np.testing.assert_array_equal(relative_illumination(camera), np.ones((60, 80)))
    electrons = expected_electrons(np.full((60, 80, 3), 1e20), camera)
    expected = 1e20 * math.pi / 16 * 0.9 * (45e-6) ** 2 * 50e-6
    assert electrons.min() == electrons.max() == pytest.approx(expected, rel=1e-12)


@given(
    k1=st.floats(-0.07, 0.2), k2=st.floats(0, 0.1), k3=st.floats(0, 0.02),
    p1=st.floats(-0.004, 0.004), p2=st.floats(-0.004, 0.004),
    offset=st.tuples(st.floats(-5e-4, 5e-4), st.floats(-5e-4, 5e-4)),
)  # fmt: skip
@settings(max_examples=40, deadline=None)
def test_all_light_that_enters_the_pupil_reaches_the_sensor(k1, k2, k3, p1, p2, offset):
    # Under the radiance L the pupil of area A receives L A times the integral of cos(theta) over the solid
    # angle that the image shows. In the plane z = 1 that is the integral of cos^4(theta) dx dy inside the
    # image's outline, which is known without the fall-off: the rays through the image's border.
    lens = dataclasses.replace(LENS, distortion=Distortion(k1, k2, p1, p2, k3), principal_offset_m=offset)
    camera = Camera(lens, COARSE)
    slopes = camera.ray_slopes()
    border = np.concatenate([slopes[0, :-1], slopes[:-1, -1], slopes[-1, :0:-1], slopes[:0:-1, 0]])
    # With r^2 = x^2 + y^2: the divergence of (x, y) / (2 (1 + r^2)) is (1 + r^2)^-2, so the flux is a contour
    # integral (Green), here by Simpson's rule on each edge.
    a, b = border, np.roll(border, -1, axis=0)
    edge = b - a

    def flux(p):
        return (p[:, 0] * edge[:, 1] - p[:, 1] * edge[:, 0]) / (2 * (1 + (p**2).sum(axis=-1)))

    into_pupil = (flux(a) + 4 * flux((a + b) / 2) + flux(b)).sum() / 6
    pixel = (COARSE.pixel_pitch_m / lens.focal_length_m) ** 2  # L pi / (4 N^2) = L A / f^2
    on_sensor = relative_illumination(camera).sum() * pixel
    # Pixels are summed at their centres and the border is a polygon: with 80 x 60 pixels, the error is 1e-3.
    assert on_sensor == pytest.approx(into_pupil, rel=1e-3)


@pytest.mark.parametrize("channels", [1, 3])
def test_electrons_of_one_and_three_channels(channels):
    efficiency = Spectrum(np.array([400.0, 900.0]), np.full((channels, 2), 0.5))
    mono = {"pattern": "mono"} if channels == 1 else {}
    camera = Camera(LENS, dataclasses.replace(COARSE, quantum_efficiency=efficiency, **mono))
    signal = np.random.default_rng(3).uniform(0, 1e20, (60, 80, channels))
    electrons = expected_electrons(signal, camera)
    falloff = (1 + squared_slopes(camera)[..., None]) ** -2
    expected = signal * falloff * math.pi / 16 * 0.9 * (45e-6) ** 2 * 50e-6
    np.testing.assert_allclose(electrons, expected, rtol=1e-9)
    with pytest.raises(ValueError, match="must have the shape"):
        expected_electrons(np.zeros((60, 80, 4 - channels)), camera)


def test_light_scales_with_pupil_area_and_exposure():
    signal = np.ones((60, 80, 3))

    def middle(lens=LENS, **changes):
        return expected_electrons(signal, Camera(lens, COARSE, **changes))[30, 40, 0]

    reference = middle()
    assert middle(dataclasses.replace(LENS, f_number=4.0)) == pytest.approx(reference / 4)
    assert middle(exposure_s=200e-6) == pytest.approx(4 * reference)
    # Focusing does not change it.
    assert middle(focus_m=0.3) == pytest.approx(reference)


# --- LEDs of the flash, integrated over random points from its file's numbers -------------------------------


FOLDER = shipped_folder("materials") / "flashes"
DRAWS = 400_000
"""The LEDs' contributions differ by 3 %, so the mean of this many draws is off by 5e-5 (one deviation)."""


def load_table(name):
    return tomllib.loads((FOLDER / f"{name}.toml").read_text(encoding="utf-8"))


def random_points(table, rng):
    """`(DRAWS, 2)` points on the LEDs, uniform over their areas, metres from the centre of the matrix."""
    matrix, radius = table["matrix"], table["radius_mm"]
    middle = (np.array([matrix["columns"], matrix["rows"]]) - 1) / 2
    led = (rng.integers(0, [matrix["columns"], matrix["rows"]], (DRAWS, 2)) - middle) * matrix["pitch_mm"]
    within = rng.uniform(-radius, radius, (3 * DRAWS, 2))
    within = within[np.hypot(*within.T) < radius][:DRAWS]
    assert len(within) == DRAWS
    return (led + within) * 1e-3


def falloff(points, target, table):
    """`(n,)` p(theta) cos / r^2 of points of the flash at a target `(3,)` on a plane that faces it."""
    ray = target - np.column_stack([points, np.zeros(len(points))])
    distance = np.linalg.norm(ray, axis=-1)
    cosine = ray[:, 2] / distance
    profile = table["profile"]
    relative = np.interp(
        np.degrees(np.arccos(cosine)), profile["angle_deg"], profile["relative_intensity"], right=0
    )
    return relative * cosine / distance**2


@pytest.mark.parametrize("name", ["led_matrix_200klx", "led_nir_850nm"])
def test_leds_give_the_stated_strength_at_the_stated_distance(name):
    table, flash = load_table(name), load_flash(name)
    file = (FOLDER / table["spectrum"]["file"]).relative_to(shipped_folder("materials")).with_suffix("")
    nm = np.arange(*columns_of(str(file))[table["spectrum"]["column"]][0][[0, -1]], 0.1)
    points = random_points(table, np.random.default_rng(20180))
    factor = falloff(points, np.array([0, 0, table["at_mm"] * 1e-3]), table)
    assert factor.std() / factor.mean() / math.sqrt(DRAWS) < 1e-4
    irradiance = flash.radiant_intensity(nm) * factor.mean()
    # Five deviations of the draws, and as much for the quadrature over wavelength.
    if "irradiance_W_m2" in table:
        assert np.trapezoid(irradiance, nm) == pytest.approx(table["irradiance_W_m2"], rel=5e-4)
    else:
        assert lux(nm, irradiance) == pytest.approx(table["illuminance_lx"], rel=5e-4)
