"""Every cultivar and recipe that validation admits gives an image, or one sentence."""

from __future__ import annotations

import dataclasses
import warnings

import numpy as np
import pytest
import whole_range
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pepperscene.classes import IGNORE_CLASS, OrganClass
from pepperscene.dataset.recipe.load import resolve_recipe
from pepperscene.dataset.scenes.frame_renderer import FrameRenderer
from pepperscene.errors import PepperError
from pepperscene.frame import OUTPUTS

pytest.importorskip("mitsuba")

COLOUR = (("colour", "class", "instance"), ("colour", "distance", "normal"), ("class", "instance", "harvest"))
SHAPE = (12, 16)


def check_image(name: str, image: np.ndarray, frame) -> None:
    """Shape, type and finite values of one output."""
    assert image.shape[:2] == SHAPE
    assert image.dtype == OUTPUTS[name].dtype
    if name == "instance":
        known = {int(key) for key in frame.metadata["instances"]}
        assert {int(value) for value in np.unique(image)} - {0} <= known
    elif name == "class":
        assert set(np.unique(image).tolist()) <= {*map(int, OrganClass), IGNORE_CLASS}
    elif name == "distance":
        assert not np.isnan(image).any()
        assert (image > 0).all()
    elif image.dtype.kind == "f":
        assert np.isfinite(image).all()


def attempt(tables: dict, changes: dict, outputs: tuple[str, ...]) -> bool:
    """Render one frame; whether validation admits it."""
    try:
        cultivar = whole_range.cultivar_of(tables)
        recipe = resolve_recipe("barth2018", changes)
        renderer = FrameRenderer(dataclasses.replace(recipe, cultivar=cultivar))
        frame = renderer.render(renderer.recipe.plan.frame(0), outputs, "draft")
    except PepperError as error:
        assert "\n" not in str(error)
        assert str(error)
        LAST.append(str(error))
        return False
    for name in outputs:
        if name in OUTPUTS and hasattr(frame.images[name], "dtype"):
            check_image(name, frame.images[name], frame)
    return True


@pytest.mark.parametrize(
    "examples", [pytest.param(40, id="few"), pytest.param(2_000, id="many", marks=pytest.mark.long)]
)
def test_the_whole_range_gives_an_image_or_one_sentence(examples):
    admitted = []

    @settings(
        max_examples=examples,
        derandomize=True,
        deadline=None,
        database=None,
        report_multiple_bugs=False,
        suppress_health_check=list(HealthCheck),
    )
    @given(whole_range.cultivar_tables(), whole_range.recipe_changes(), st.sampled_from(COLOUR))
    def once(tables, changes, outputs):
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            admitted.append(attempt(tables, changes, outputs))

    once()
    assert sum(admitted) > 0.2 * len(admitted)
