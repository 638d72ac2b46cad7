"""Every number of a recipe at the ends of its range, and outside: a scene of finite numbers, or an error."""

from __future__ import annotations

import dataclasses
import math
import typing

import numpy as np
import pytest
from annotated_types import Ge, Gt, Le, Lt
from pydantic.fields import FieldInfo

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.building.scenes.optics import largest_light_reach
from pepperscene.errors import InputError
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolve.load import resolve_recipe
from pepperscene.units import is_table, table_fields

SPECIAL = (0, 0.0, -0.0, 1, -1, 1e-308, 1e308, -1e308, math.nan, math.inf, -math.inf, 2**62, 10**30)
BASE = {
    "plan.rotations": 1,
    "plan.frames": 3,
    "camera.baseline_mm": 60.0,
    "camera.focus_mm": 400.0,
    "greenhouse.gutter_width_mm": 200.0,
    "row.gap_mm": 1000.0,
    "plan.select": [0],
}


def bounds(annotation):
    """The ends of a number's range; empty for other values."""
    found = {}
    for part in getattr(annotation, "__metadata__", ()):
        for meta in getattr(part, "metadata", [part]):
            for kind, name in ((Ge, "ge"), (Gt, "gt"), (Le, "le"), (Lt, "lt")):
                if isinstance(meta, kind):
                    found[name] = getattr(meta, name)
    return found


def numbers(model, above=""):
    """Key and ends of the range of every number of a model and the models inside it."""
    for name, annotation in table_fields(model).items():
        key, field = f"{above}{name}", FieldInfo.from_annotation(annotation)
        options = [field.annotation, *typing.get_args(field.annotation)]
        tables = [part for part in options if is_table(part)]
        if tables:
            yield from numbers(tables[0], f"{key}.")
            continue
        found = {}
        for meta in field.metadata:
            found |= bounds(typing.Annotated[float, meta])
        for part in options:
            found |= bounds(part)
        if found:
            yield key, found


NUMBERS = dict(numbers(Recipe))
del NUMBERS["growth.share"]  # needs two cultivars


def is_pair(key):
    return key in {"views.azimuth_deg", "views.height_mm"}


def values(key):
    ends = [float(end) for end in NUMBERS[key].values()]
    outside = [math.nextafter(end, side) for end in ends for side in (-math.inf, math.inf)]
    whole = [int(end) + step for end in ends for step in (-1, 0, 1)]
    middle = [0.5 * sum(ends)] if len(ends) == 2 else []
    return [*SPECIAL, *ends, *outside, *whole, *middle]


def check_scene(resolved):
    """Cameras, light and surroundings of the recipe."""
    renderer = FrameRenderer(resolved)
    plan = resolved.recipe.plan
    specs = [plan.frame(step) for step in sorted({0, plan.frames - 1})]
    for spec in specs:
        camera = renderer.views.camera(spec)
        outputs = ["stereo"] if resolved.recipe.camera.baseline_m else []
        for view in (camera, renderer.views.partners(spec, outputs).stereo or camera):
            assert np.isfinite(view.pose).all()
            assert np.isfinite(view.intrinsics).all()
            assert 0 < view.exposure_s * view.sensor.gain_e_per_dn < math.inf
    assert np.isfinite(renderer.views.frustums(specs).positions).all()
    assert all(
        map(
            math.isfinite,
            dataclasses.astuple(largest_light_reach([renderer.setups.at(spec) for spec in specs])),
        )
    )
    sky = renderer.sky(specs[0])
    if sky is not None and sky.sun is not None:
        assert float(np.asarray(sky.sun.irradiance.values).max()) > 1e-38


@pytest.mark.long
@pytest.mark.parametrize("key", sorted(NUMBERS))
def test_every_accepted_number_of_a_recipe_makes_a_scene(key):
    accepted = 0
    for value in values(key):
        change = [value, value] if is_pair(key) else value
        try:
            resolved = resolve_recipe("greenhouse", {**BASE, key: change})
        except InputError as error:
            message = str(error)
        else:
            message = ""
            accepted += 1
            if resolved.recipe.plan.frames < 1000:
                check_scene(resolved)
        assert "\n" not in message
    assert accepted


@pytest.mark.parametrize(
    "change",
    [
        {"camera.baseline_mm": 1e-308},
        {"twine.diameter_mm": 1e-308},
        {"daylight.illuminance_lx": 1e-308},
        {"daylight.sun_fraction": 1e-308},
    ],
)
def test_parts_that_are_too_small_to_exist_are_errors(change):
    (key,) = change
    with pytest.raises(InputError, match=rf"{key.replace('.', '[.]')} = 1e-308: must be"):
        resolve_recipe("greenhouse", {**BASE, **change})
