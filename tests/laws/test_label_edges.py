"""Label edges lie on the edges of the photograph, and labels that are off are found out.

Rationale: class and instance come from one ray through each pixel's centre, the photograph from light through
a lens of finite aperture, a mosaic and its interpolation. A half pixel between the two conventions, or a
distortion that only one of them knows, would spoil every label and show in no single value.

Set-up: three plants by flash and by daylight, 320x240 pixels out of the middle of the picture, with all the
camera's noise. The statistic is that of `pepperscene check`, the correlation of both kinds of edges for all
shifts.

Expected: true labels have their peak at no shift and far above chance; labels seen through a lens that
shifts, stretches or mirrors the picture do not.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_scenes import bright_day

from pepperscene.dataset import FrameRenderer, load_recipe
from pepperscene.dataset.check.edges import CHANCE, match
from pepperscene.render import render_scene

COLUMNS, ROWS = 640, 480  # photosites, two by two of which are a pixel


@pytest.fixture(scope="module", params=["flash", "daylight"])
def seen(request):
    """The camera, its photograph and a function that labels what another camera sees."""
    recipe = load_recipe("demo")
    changes = {"row": recipe.row.model_copy(update={"plants_front": 2, "plants_back": 1})}
    if request.param == "daylight":
        changes |= bright_day(recipe, 3000.0)
    stage = FrameRenderer(recipe.model_copy(update=changes))
    shot = stage.recipe.plan.frame(140)
    whole = stage.camera(shot)
    camera = replace(whole, sensor=replace(whole.sensor, columns=COLUMNS, rows=ROWS))
    scene = stage.scene(shot)

    def labels(other):
        return render_scene(scene, other, outputs=("instance",))["instance"]

    photograph = render_scene(scene, camera, outputs=("colour",), quality="draft").colour
    return camera, photograph, labels


def test_true_labels_lie_on_the_photograph(seen):
    camera, photograph, labels = seen
    found = match(photograph, labels(camera))
    assert found.fits
    assert (found.right_px, found.down_px) == (0, 0)
    assert found.height > 3 * CHANCE


def test_labels_that_are_off_are_told_with_their_shift(seen):
    camera, photograph, labels = seen
    true = labels(camera)
    inner = np.s_[10:-10, 10:-10]
    for right, down in ((2, 0), (0, 2), (-4, 4), (8, -8)):
        found = match(photograph[inner], np.roll(true, (down, right), (0, 1))[inner])
        assert not found.fits
        assert (found.right_px, found.down_px) == (right, down)
    assert not match(photograph, true[:, ::-1]).fits


def test_labels_through_another_lens_are_found_out(seen):
    camera, photograph, labels = seen
    longer = replace(camera, lens=replace(camera.lens, focal_length_m=1.03 * camera.lens.focal_length_m))
    assert not match(photograph, labels(longer)).fits
