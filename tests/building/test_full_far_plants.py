"""Which plants of far rows are near, and what growing them in full changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pepperscene as ps
from pepperscene.building.scenes import scene_builder
from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.building.scenes.scene_builder import SceneBuilder
from pepperscene.camera import Camera, Motion, load_lens, load_sensor, look_at
from pepperscene.classes import Instance, OrganClass
from pepperscene.cultivar import load_cultivar
from pepperscene.geometry import sphere
from pepperscene.recipe.views.near_plants import CoarsePlants, near_views
from pepperscene.scene import FarRow


@pytest.mark.slow
def test_later_random_views_show_no_coarse_plant_from_near(monkeypatch):
    # The first view alone decides, and the plants that others would come near to stay coarse.
    monkeypatch.setattr(scene_builder, "DECISIVE_VIEWS", 1)
    changes = {
        "row.plants_front": 1,
        "row.plants_back": 0,
        "camera.width": 96,
        "camera.height": 72,
        "greenhouse.far_rows": 1,
        "greenhouse.far_reach_mm": 900,
        "plan": {"sets": 1, "rotations": 1, "frames": 5},
        "views": {
            "kind": "random",
            "target": "fruit",
            "distance_mm": [300, 600],
            "clearance_mm": 30,
            "azimuth_deg": [-30, 30],
            "least_visibility": 0.1,
        },
    }
    recipe = ps.load_recipe("greenhouse", changes)
    renderer = FrameRenderer(recipe)
    for index in range(5):
        spec = recipe.plan.frame(index)
        frame = renderer.render(spec, ["instance", "distance"])
        instances = renderer.scene(spec, traced=False).mesh.instances
        coarse = [number for number, item in enumerate(instances, 1) if item.far_row >= 0 and not item.full]
        assert coarse
        assert not (np.isin(frame["instance"], coarse) & (frame["distance"] < 1.0)).any()


@pytest.fixture(scope="module")
def builder():
    changes = {
        "cultivar": "kaite_february",
        "row.plants_front": 2,
        "row.plants_back": 1,
        "greenhouse.far_rows": 1,
        "greenhouse.far_reach_mm": 700,
    }
    recipe = ps.load_recipe("greenhouse", changes)
    return SceneBuilder(recipe, load_cultivar(recipe.cultivar))


def test_full_plants_change_nothing_but_themselves(builder):
    built = builder.scene(0, 0)
    chosen = [int(built.far_rows[0].plants[1]), int(built.far_rows[2].plants[0])]
    full = builder.with_full_plants(built, chosen)
    for name in ("vertices", "faces", "face_instance"):
        count = built.begin[0] if name == "vertices" else built.begin[1]
        np.testing.assert_array_equal(getattr(full.mesh, name)[:count], getattr(built.mesh, name)[:count])
    assert full.mesh.instances[: built.begin[2]] == built.mesh.instances[: built.begin[2]]

    def points(mesh, plant):
        owner = np.array([item.plant for item in mesh.instances])[mesh.face_instance]
        return mesh.vertices[np.unique(mesh.faces[owner == plant])]

    for row in built.far_rows:
        for plant in row.plants.tolist():
            before, after = points(built.mesh, plant), points(full.mesh, plant)
            if plant in chosen:
                assert len(after) > 3 * len(before)
                # Roots and tips are where they were.
                assert abs(before[:, 2].min() - after[:, 2].min()) < 0.02
            else:
                np.testing.assert_array_equal(before, after)
    assert {item.plant for item in full.mesh.instances if item.full} == set(chosen)
    assert len(full.skeleton.plants) == len(built.skeleton.plants) + 2
    assert any(item.kind == "twine" and item.full for item in full.mesh.instances)
    assert builder.with_full_plants(built, ()) is built


def ball_plants(distance_m):
    """One plant, a ball with a radius of 10 cm, whose surface is as far along y from the origin."""
    ball = replace(sphere((0, 0, 0), 0.1), instances=(Instance(OrganClass.PEPPER, "fruit"),))
    row = FarRow(0, 7, np.array([0]), np.array([0.3]), np.array([[0.0, distance_m + 0.1, 1.0]]))
    return CoarsePlants([ball], [row])


def camera_at(target=(0.0, 1.0, 1.0)):
    camera = Camera(load_lens("lensagon_cmfa0420nd"), load_sensor("ueye_ui5250re"))
    return camera.at_pose(look_at((0.0, 0.0, 1.0), target))


@pytest.mark.parametrize(("distance_m", "expected"), [(0.3, (7,)), (0.99, (7,)), (1.01, ()), (3.0, ())])
def test_near_is_nearer_than_a_metre(distance_m, expected):
    assert ball_plants(distance_m).shown_near(near_views([camera_at()])) == expected


def test_only_what_is_in_view_is_near():
    behind, aside = camera_at((0.0, -1.0, 1.0)), camera_at((1.0, 0.0, 1.0))
    assert ball_plants(0.3).shown_near(near_views([behind, aside])) == ()
    assert ball_plants(0.3).shown_near(near_views([behind, camera_at()])) == (7,)


def test_a_moving_camera_comes_near():
    camera = replace(camera_at(), exposure_s=0.1)
    still = ball_plants(1.2).shown_near(near_views([camera]))
    moving = replace(camera, motion=Motion(np.array([0.0, 6.0, 0.0]), np.zeros(3)))
    assert (still, ball_plants(1.2).shown_near(near_views([moving]))) == ((), (7,))
