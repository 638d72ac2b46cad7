"""Light of moving cameras by our integrator, and by Mitsuba's from cameras that stand still."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import axis_camera
from test_reference import BACK, assert_agree, few_pixels, patchy_sky, still_life, sun

from pepperscene.camera import Camera, Motion
from pepperscene.render import Quality, Renderer
from pepperscene.scene import Sky

OURS = Quality(128, 128, 128, 2, target=None, denoise=False)
SKY = 0.03  # of the tests of the reference
PATHS = replace(OURS, samples=256, soft=256, most=256, integrator="path")


def moving_view(line_time_s: float, exposure_s: float, pulse_s: float | None, lux: float = 2e5) -> Camera:
    pose = np.eye(4)
    pose[2, 3] = -0.4
    view = few_pixels(axis_camera(flash=pulse_s is not None).at_pose(pose))
    flash = None if view.flash is None else replace(view.flash, pulse_s=pulse_s, illuminance_lx=lux)
    # A few of the 32 columns in an exposure, sideways, forwards and about all axes.
    rate = 1e-3 / max(exposure_s, 24 * line_time_s)
    motion = Motion(np.multiply(rate, (200.0, 80.0, -100.0)), np.multiply(rate, (100.0, -200.0, 300.0)))
    sensor = replace(view.sensor, line_time_s=line_time_s)
    return replace(view, flash=flash, motion=motion, sensor=sensor, exposure_s=exposure_s)


CASES = {
    "daylight, rolling": (4e-5, 5e-4, None),
    "flash and daylight": (0.0, 1e-3, 5e-5, 4e6),
    "flash and daylight, rolling": (2e-5, 1e-3, 8e-4, 1e5),  # some rows close before the flash ends
    "flash in few rows, and daylight": (4e-5, 3e-4, 2e-4, 4e6),
}


def dim_sky() -> Sky:
    """A sky and a sun, about as strong as the flashes above, averaged over an exposure."""
    sky = patchy_sky(sun(BACK, 0.1, 5.0 * SKY))
    return replace(sky, weights=sky.weights * np.float32(SKY))


def frames(renderer: Renderer, view: Camera, quality: Quality, seeds: range) -> np.ndarray:
    """`(n, h, w, c)` electrons."""
    return np.stack([renderer.render(view, ["electrons"], quality, seed)["electrons"] for seed in seeds])


LONG = ("flash and daylight", "daylight, rolling", "flash in few rows, and daylight")


@pytest.mark.parametrize(
    "case", [pytest.param(name, marks=pytest.mark.long if name in LONG else ()) for name in CASES]
)
def test_light_of_a_moving_camera_equals_the_reference(case):
    view = moving_view(*CASES[case])
    renderer = Renderer(still_life(dim_sky()))
    ours, paths = frames(renderer, view, OURS, range(4)), frames(renderer, view, PATHS, range(100, 112))
    assert_agree(ours, paths)
    # The test has power: it finds the difference to a camera that stands still, and both lights matter.
    still = frames(renderer, replace(view, motion=None), OURS, range(4))
    with pytest.raises(AssertionError):
        assert_agree(still, paths)
    if view.flash is not None:
        is_uneven = (view.shutter.flash_fraction(view.flash.pulse_s) < 1.0).any()
        assert is_uneven == (view.sensor.line_time_s > 0.0)
        daylight = frames(renderer, replace(view, flash=None), OURS, range(1)).mean() / ours.mean()
        assert 0.2 < daylight < 0.8
