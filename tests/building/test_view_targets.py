"""The target of a random view in the JSON of its frame, against the harvest truth."""

from __future__ import annotations

import numpy as np
import pytest
from rendered_set import RECIPE

from pepperscene.building.execution.build import build
from pepperscene.building.execution.job import BuildOptions
from pepperscene.dataset.store.fields import read_frame
from pepperscene.recipe.resolve.load import load_recipe

VIEWS = {
    "kind": "random", "target": "fruit", "distance_mm": [250, 500], "least_visibility": 0.3,
    "volume_mm": [[-800, 800], [-1500, 0], [300, 2300]],
}  # fmt: skip
CHANGES = {
    **RECIPE, "plan.rotations": 1, "plan.frames": 3, "row.plants_front": 1, "views": VIEWS,
    "camera.width": 160, "camera.height": 120, "camera.fx": 105.0, "camera.fy": 106.0,
    "camera.cx": 79.5, "camera.cy": 59.5,
}  # fmt: skip


def built(folder, changes, outputs=("instance", "harvest")):
    recipe = load_recipe("barth2018", changes)
    return build(recipe, folder, None, outputs, BuildOptions(quality="draft")).dataset


@pytest.fixture(scope="module")
def random_set(tmp_path_factory):
    return built(tmp_path_factory.mktemp("random") / "set", CHANGES)


def test_the_target_is_the_fruit_in_the_middle_of_the_image(random_set):
    for index in random_set.indices():
        target = read_frame(random_set, index)["target"]
        fruit = {one["instance"]: one for one in random_set.image(index, "harvest")["fruit"]}
        aimed = fruit[target["instance"]]
        assert (target["plant"], target["kind"]) == (aimed["plant"], aimed["kind"]) == (0, "fruit")
        # The views have no offset: the centroid of the target's surface is on the optical axis.
        distance = {value: np.hypot(*one["box_3d"]["centre"][:2]) for value, one in fruit.items()}
        assert distance[target["instance"]] < 0.01
        assert 0.25 < aimed["box_3d"]["centre"][2] < 0.5
        assert aimed["visible_fraction"] > 0.2


def test_further_outputs_keep_the_target(random_set):
    before = [random_set.metadata(index)["target"] for index in random_set.indices()]
    built(random_set.folder, CHANGES, ("class",))
    after = [random_set.metadata(index) for index in random_set.indices()]
    assert [frame["target"] for frame in after] == before
    assert all("class" in frame["outputs"] for frame in after)


@pytest.mark.parametrize("views", [{"target": [0, 0, 1200]}, None], ids=["point", "arc"])
def test_other_views_have_no_target(views, tmp_path):
    changes = {key: value for key, value in CHANGES.items() if key != "views"} | {"plan.frames": 1}
    if views is not None:
        changes["views"] = {**VIEWS, **views, "least_visibility": 0}
    dataset = built(tmp_path / "set", changes, ("class",))
    assert "target" not in dataset.metadata(0)
