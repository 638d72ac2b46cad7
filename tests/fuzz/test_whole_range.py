"""Every cultivar and recipe that validation admits gives an image, or one sentence."""

from __future__ import annotations

import dataclasses
import re
import warnings

import numpy as np
import pytest
import whole_range
from hypothesis import given, settings
from hypothesis import strategies as st

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.classes import IGNORE_CLASS, OrganClass
from pepperscene.errors import InputError
from pepperscene.outputs import OUTPUTS
from pepperscene.recipe.resolve.load import resolve_recipe

OUTPUT_SETS = (
    ("colour", "class", "instance"),
    ("colour", "distance", "normal"),
    ("class", "instance", "distance", "harvest", "amodal"),
)
SHAPE = (12, 16)
VIEW = {"row.plants_front": 1, "row.plants_back": 0, "camera.width": 16, "camera.height": 12}


def check_image(name: str, image, frame) -> None:
    """Shape, type and values of one output."""
    assert OUTPUTS[name].fits(image)
    if not OUTPUTS[name].is_image:
        return
    assert image.shape[:2] == SHAPE
    values = np.unique(image)
    if name == "instance":
        known = {int(key) for key in frame.metadata["instances"]}
        assert set(values.tolist()) - {0} <= known
    elif name == "class":
        assert set(values.tolist()) <= {*map(int, OrganClass), IGNORE_CLASS}
    elif name == "distance":
        assert (image > 0).all()
    elif image.dtype.kind == "f":
        assert np.isfinite(image).all()


def render(tables: dict, changes: dict, outputs: tuple[str, ...]):
    """A frame of a recipe with another cultivar; raises `InputError` if validation does not admit them."""
    cultivar = whole_range.cultivar_of(tables)
    recipe = resolve_recipe("barth2018", {**changes, **VIEW})
    renderer = FrameRenderer(dataclasses.replace(recipe, cultivar=cultivar))
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        frame = renderer.render(renderer.recipe.plan.frame(0), outputs, "draft")
    for name in outputs:
        check_image(name, frame.images[name], frame)
    return frame


@pytest.mark.long
def test_the_whole_range_gives_an_image_or_one_sentence():
    admitted, refused = [], []

    @settings(max_examples=25, report_multiple_bugs=False)
    @given(whole_range.cultivar_tables(), whole_range.recipe_changes(), st.sampled_from(OUTPUT_SETS))
    def once(tables, changes, outputs):
        try:
            render(tables, changes, outputs)
        except InputError as error:
            refused.append(str(error))
        else:
            admitted.append(outputs)

    once()
    assert not [message for message in refused if not message or "\n" in message]
    # Otherwise the draws would not reach the renderer.
    assert len(admitted) > len(refused)


def long_cases(*cases: tuple) -> list:
    return [pytest.param(*case, marks=pytest.mark.long) for case in cases]


def constant_mm(value: float) -> dict:
    return {"value_mm": value, "chosen": "for a test"}


@pytest.mark.long
@pytest.mark.parametrize("diameter_mm", [0.1, *long_cases((0.5,), (6.0,)), 600.0])
def test_berries_and_giant_fruit_give_an_image(diameter_mm):
    tables = whole_range.plain_tables("fruit")
    tables["organs"]["fruit"]["diameter"] = constant_mm(diameter_mm)
    render(tables, {}, ("colour", "class", "instance"))


@pytest.mark.long
@pytest.mark.parametrize(
    ("length_mm", "width_mm"), [(0.1, 0.1), *long_cases((3.0, 2.0), (2000.0, 2000.0)), (2000.0, 0.1)]
)
def test_tiny_and_giant_blades_give_an_image(length_mm, width_mm):
    tables = whole_range.plain_tables("leaf")
    tables["organs"]["lamina"] |= {"length": constant_mm(length_mm), "width": constant_mm(width_mm)}
    render(tables, {}, ("colour", "class", "instance"))


@pytest.mark.long
@pytest.mark.parametrize(("grown", "slots"), [*long_cases(("leaf", 1), ("fruit", 1)), ("cut", 84)])
def test_many_organs_at_a_node_give_an_image(grown, slots):
    render(whole_range.plain_tables(grown, "twelve", slots), {}, ("class", "instance"))


@pytest.mark.parametrize(
    ("grown", "kind", "key", "value_mm"),
    [
        ("fruit", "fruit", "diameter", 1000.0),
        ("leaf", "lamina", "length", 1e5),
        ("leaf", "lamina", "margin_wave", 1e5),
        ("leaf", "petiole", "diameter", 1e-7),
    ],
)
def test_sizes_beyond_any_organ_are_one_sentence(grown, kind, key, value_mm):
    tables = whole_range.plain_tables(grown)
    tables["organs"][kind][key] = constant_mm(value_mm)
    with pytest.raises(InputError, match=f"{kind}.*must be") as error:
        render(tables, {}, ("class",))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "key",
    ["camera.baseline_mm", "twine.diameter_mm", "daylight.illuminance_lx", "daylight.sun_fraction"],
)
def test_parts_that_are_too_small_to_exist_are_one_sentence(key):
    with pytest.raises(InputError, match=rf"{re.escape(key)} = 1e-308: must be"):
        resolve_recipe("greenhouse", {key: 1e-308})
