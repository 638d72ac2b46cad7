"""Label edges coincide with the edges of the photograph, and misaligned labels are detected.

Half a pixel between the rays of labels and of light, or a distortion applied to only one of them, is visible
in no single value. The statistic is that of `pepperscene check`, the correlation of both kinds of edges over
shifts, on the middle of an image of three plants with all noise of the camera.
"""

from dataclasses import replace

import numpy as np
import pytest
from small_scenes import bright_day

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.render import render_scene
from pepperscene.review.check.edges import CHANCE, match_edges

COLUMNS, ROWS = 640, 480  # photosites, 2x2 to a pixel


@pytest.fixture(scope="module", params=["flash", pytest.param("daylight", marks=pytest.mark.long)])
def view(request):
    """The camera, its photograph and a function that renders the labels of another camera."""
    recipe = load_recipe("demo")
    changes = {"row": replace(recipe.row, plants_front=2, plants_back=1)}
    if request.param == "daylight":
        changes |= bright_day(recipe, 3000.0)
    frames = FrameRenderer(recipe.model_copy(update=changes))
    spec = frames.recipe.plan.frame(140)
    camera = frames.camera(spec)
    camera = replace(camera, sensor=replace(camera.sensor, columns=COLUMNS, rows=ROWS))
    scene = frames.scene(spec)

    def labels(other):
        return render_scene(scene, other, outputs=("instance",))["instance"]

    photograph = render_scene(scene, camera, outputs=("colour",), quality="draft").colour
    return camera, photograph, labels


def test_true_labels_match_the_photograph(view):
    camera, photograph, labels = view
    peak = match_edges(photograph, labels(camera))
    assert peak.fits
    assert (peak.right_px, peak.down_px) == (0, 0)
    assert peak.height > 3 * CHANCE


def test_shift_of_misaligned_labels_is_measured(view):
    camera, photograph, labels = view
    true = labels(camera)
    inner = np.s_[10:-10, 10:-10]
    for right, down in ((2, 0), (0, 2), (-4, 4), (8, -8)):
        peak = match_edges(photograph[inner], np.roll(true, (down, right), (0, 1))[inner])
        assert not peak.fits
        assert (peak.right_px, peak.down_px) == (right, down)
    assert not match_edges(photograph, true[:, ::-1]).fits


def test_labels_through_another_lens_are_detected(view):
    camera, photograph, labels = view
    longer = replace(camera, lens=replace(camera.lens, focal_length_m=1.03 * camera.lens.focal_length_m))
    assert not match_edges(photograph, labels(longer)).fits
