"""Defocus against the geometry of a thin lens."""

import dataclasses

import numpy as np
import pytest
from bodies import axis_camera, knife_edge

from pepperscene.render import Renderer

WIDTH = 64  # columns of the cropped image, whose middle is on the axis


def camera_focused_at(focus_m: float | None):
    camera = axis_camera(WIDTH, 8, flash=False)
    lens = dataclasses.replace(camera.lens, f_number=0.8)  # wide open, so that the blur spans many pixels
    return dataclasses.replace(camera, lens=lens, focus_m=focus_m)


def disc_fraction_left_of(x: np.ndarray) -> np.ndarray:
    """Area of the unit disc with abscissa below x, over pi: the edge spread function of a round pupil."""
    inside = np.clip(x, -1.0, 1.0)
    return 0.5 + (inside * np.sqrt(1.0 - inside**2) + np.arcsin(inside)) / np.pi


@pytest.mark.parametrize(("z", "focus_m"), [(0.1, 0.4), (3.0, 0.15)])
def test_knife_edge_is_blurred_by_the_circle_of_confusion(z, focus_m):
    # Through a pupil of radius a, a point at z is imaged onto a disc of radius a |1/z - 1/d| in slopes, with
    # d the focal plane's distance: f a |1/z - 1/d| on the sensor. The edge's profile is that disc's,
    # integrated. 8 rows x 256 samples: standard error below .5 / sqrt(2048) = .011 of the sky; stratified,
    # far less.
    camera = camera_focused_at(focus_m)
    image = Renderer(knife_edge(z)).render(camera, ["electrons"], "reference")["electrons"][..., 1]
    profile = image.mean(axis=0) / image[:, :1].mean()
    radius_px = camera.intrinsics[0, 0] * camera.aperture_radius_m * abs(1.0 / z - 1.0 / focus_m)
    sub = (np.arange(WIDTH * 64) + 0.5) / 64 - WIDTH / 2
    # A point to the right of the axis is imaged to the right: the sky is left of the edge.
    sky = 1.0 - disc_fraction_left_of(sub / max(radius_px, 1e-6))
    expected = sky.reshape(WIDTH, 64).mean(axis=1)
    assert radius_px < WIDTH / 2
    assert radius_px > 4
    assert np.abs(profile - expected).max() < 0.02


def test_objects_in_focus_are_as_sharp_as_through_a_pinhole():
    scene = knife_edge(0.4)
    pinhole = Renderer(scene).render(camera_focused_at(None), ["electrons"], "reference")["electrons"]
    focused = Renderer(scene).render(camera_focused_at(0.4), ["electrons"], "reference")["electrons"]
    assert focused == pytest.approx(pinhole, abs=0.03 * float(pinhole.max()))


def test_labels_are_rendered_through_the_pupils_centre():
    # One class per pixel needs one ray: that through the middle of the pupil, whatever the focus.
    scene = knife_edge(0.1)
    names = ["class", "distance"]
    blurred, sharp = (Renderer(scene).render(camera_focused_at(focus), names) for focus in (0.4, None))
    for name in names:
        np.testing.assert_array_equal(blurred[name], sharp[name])
