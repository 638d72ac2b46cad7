"""A relief that pixels do not resolve looks on average as it looks from near by, and does not sparkle.

A sheet of 48 mm with the cuticle and the slopes of a leaf in the light of a sun of 5 degrees, seen by a
telephoto camera whose pixels cover 75 um from 1 m, 0.75 mm from 10 m and 7.5 mm from 100 m. The light must be
the same to 1.5 % (measured: 1.1 %), but with the sun in the mirror direction of the normal 4 % from 10 m and
8 % from 100 m (measured: 2.3 and 5.6 %), as a GGX lobe convolved with slopes is none at its peak.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from bodies import RANGE_NM, axis_camera, sheet

from pepperscene.materials import Surface
from pepperscene.render import Quality, render_scene
from pepperscene.render.kernel.camera import CameraRays
from pepperscene.scene import Scene, Sky, Sun, assemble_scene
from pepperscene.spectra import Spectrum

WIDTH_M = 0.048
SLOPE = 0.09
TEXELS = 512


def bumps(seed: int = 0, shape: tuple[int, int] = (TEXELS, TEXELS)) -> np.ndarray:
    """`(h, w)` relief in mm of bumps of 0.3 to 10 mm with an rms slope of 0.09 along u and along v.

    Its amplitudes are such that each octave adds as much to the squared slope.
    """
    rng = np.random.default_rng(seed)
    frequency = np.hypot(*np.meshgrid(*(np.fft.fftfreq(n, 1e3 * WIDTH_M / n) for n in shape), indexing="ij"))
    inside = (frequency > 0.1) & (frequency < 3.0)
    noise = np.fft.fft2(rng.standard_normal(shape))
    height = np.fft.ifft2(np.where(inside, noise / np.where(inside, frequency, 1.0) ** 2, 0.0)).real
    slopes = [np.diff(height, axis=axis) * shape[axis] / (1e3 * WIDTH_M) for axis in (0, 1)]
    return (height * SLOPE / np.sqrt(np.mean([np.mean(slope**2) for slope in slopes]))).astype(np.float32)


def glossy(relief_mm: np.ndarray | None) -> Surface:
    body = np.full((1, 2, 2), 0.1)
    lobes = {"wide_roughness": (0.6, 0.8), "wide_share": 0.5}
    return Surface(
        "leaf", RANGE_NM, body, np.full((1, 2), 0.05), 1.45, (0.2, 0.3), **lobes, relief_mm=relief_mm
    )


def sunny(surface: Surface, tilt: float, sun_angle: float) -> Scene:
    """The sheet, turned about y, in the light of a sun at an angle to the axis of the camera."""
    mesh = sheet(WIDTH_M, WIDTH_M, 0.0, "leaf")
    mesh = replace(mesh, uv=(mesh.vertices[:, :2] / WIDTH_M + 0.5).astype(np.float32))
    c, s = np.cos(tilt), np.sin(tilt)
    mesh = mesh.moved(np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]), np.zeros(3))
    direction = np.array([np.sin(sun_angle), 0.0, -np.cos(sun_angle)])
    sun = Sun(direction, Spectrum(RANGE_NM, np.full(2, 1.0)), np.radians(5.0))
    sky = Sky(np.zeros((1, 2, 4), np.float32), Spectrum(RANGE_NM, np.ones((1, 2))), sun)
    return assemble_scene(mesh, {"leaf": surface}, sky)


@cache
def image(scene: Scene, distance_m: float, columns: int, samples: int, seed: int = 0) -> np.ndarray:
    """`(n, n)` green electrons of the whole sheet from a distance, times the squared distance."""
    camera = axis_camera(columns, columns, flash=None)
    camera = replace(camera, lens=replace(camera.lens, focal_length_m=0.12, vignetting=None), exposure_s=1e-3)
    pose = np.eye(4)
    pose[2, 3] = -distance_m
    quality = Quality(samples, 1, samples, 0, target=None, denoise=False)
    frame = render_scene(scene, camera.at_pose(pose), ["electrons"], quality, seed)
    return frame["electrons"][..., 1].astype(float) * distance_m**2


@pytest.fixture(scope="module")
def relief() -> np.ndarray:
    return bumps()[None]


PEAK = (0.0, 0.0)
VIEWS = [(0.0, 20.0), (0.0, 0.0), (0.0, 50.0), (50.0, 100.0), (50.0, 70.0)]
"""Degrees: tilt of the sheet, and angle of the sun to the axis; twice the tilt is the mirror direction."""


def light(scene: Scene, distance_m: float, columns: int, samples: int) -> float:
    return float(image(scene, distance_m, columns, samples).sum())


@pytest.mark.parametrize(
    "view", [PEAK, VIEWS[3], *(pytest.param(VIEWS[k], marks=pytest.mark.long) for k in (0, 2, 4))], ids=str
)
def test_a_leaf_is_as_bright_from_far_away_as_from_near_by(relief, view):
    scene, plain = (sunny(glossy(heights), *np.radians(view)) for heights in (relief, None))
    near = light(scene, 1.0, 672, 4)
    for distance, columns, samples, at_peak in ((10.0, 72, 64, 0.04), (100.0, 16, 1024, 0.08)):
        bound = at_peak if view == PEAK else 0.015
        assert light(scene, distance, columns, samples) == pytest.approx(near, rel=bound)
    if view == PEAK:
        # The same sheet without the relief is much brighter there, so the test has power.
        assert light(plain, 10.0, 72, 64) > 1.15 * near


def test_a_filtered_leaf_does_not_sparkle(relief, monkeypatch):
    # From 10 m, with one sample for each pixel: the mean is that without filtering, and less of the variance
    # between pixels is left.
    scene = sunny(glossy(relief), *np.radians((0.0, 20.0)))

    def statistics() -> tuple[np.ndarray, float]:
        inner = np.array([image.__wrapped__(scene, 10.0, 72, 1, seed)[8:-8, 8:-8] for seed in range(12)])
        return inner.mean(axis=(1, 2)), float(inner.std() / inner.mean())

    filtered, spread = statistics()
    monkeypatch.setattr(CameraRays, "footprint", lambda rays, si: 0.0 * si.t)
    unfiltered, sparkle = statistics()
    error = np.sqrt((filtered.var(ddof=1) + unfiltered.var(ddof=1)) / len(filtered))
    assert error < 0.005 * unfiltered.mean()
    assert filtered.mean() == pytest.approx(unfiltered.mean(), rel=0.01, abs=4.0 * error)
    assert spread < 0.85 * sparkle
