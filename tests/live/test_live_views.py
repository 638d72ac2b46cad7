"""Views of a living scene: those of the data set are its frames, others are repeatable."""

from __future__ import annotations

import numpy as np
import pytest
import row_cache

import pepperscene as ps
from pepperscene.errors import ArgumentError, InputError

LABELS = (
    "class", "instance", "distance", "depth_z", "normal", "coverage", "position", "uv", "flow", "stereo",
    "harvest", "amodal",
)  # fmt: skip
LIGHT = ("colour", "electrons", "class")
ALL_LIGHT = ("colour", "raw", "electrons", "instance", "albedo", "colour_stereo", "ripeness", "leaf_age")


def assert_equal(frame, expected):
    assert list(frame.images) == list(expected.images)
    for name, image in expected.images.items():
        if isinstance(image, np.ndarray):
            np.testing.assert_array_equal(frame[name], image, err_msg=name)
        else:
            assert frame[name] == image, name


@pytest.fixture(scope="module")
def built(small_recipe, rows):
    """Frames of the recipe by index, outputs and quality, as a build renders them."""
    renderer = ps.FrameRenderer(small_recipe)

    def render(index, outputs, quality="draft"):
        with row_cache.rows_from(rows):
            return renderer.render(small_recipe.plan.frame(index), outputs, quality)

    return render


def test_views_at_the_poses_of_the_data_set_are_its_frames(scene, built, small_recipe):
    assert_equal(scene.render(outputs=LABELS), built(1, LABELS))
    other = ps.FrameRenderer(small_recipe).camera(small_recipe.plan.frame(2)).pose
    assert_equal(scene.render(other, LABELS), built(2, LABELS))
    assert scene.view_count == 0


def test_photographs_of_the_data_set_are_its_frames_and_others_repeat(scene, built, small_recipe, rows):
    assert_equal(scene.render(outputs=LIGHT), built(1, LIGHT))
    pose = ps.look_at((0.1, -0.6, 1.2), (0.0, 0.0, 1.3))
    first, second = scene.render(np.array([pose, pose]), ("raw",))
    assert not np.array_equal(first["raw"], second["raw"])
    assert scene.view_count == 2
    with row_cache.rows_from(rows):
        other = ps.open_scene(small_recipe, 1)
    other.view_count = 1
    assert_equal(other.render(pose, ("raw",)), second)
    # An edited scene shows the edit by the same light.
    scene.add(ps.geometry.sphere((0.0, -0.3, 1.25), 0.05), surface=ps.lambertian_surface("card", 0.0))
    frame = scene.render(pose, ("electrons", "instance"))
    black = frame["instance"] == frame["instance"].max()
    assert black.mean() > 0.01
    # What it shows is stray light and a blurred border.
    assert frame["electrons"][black].mean() < 0.2 * frame["electrons"][~black].mean()


@pytest.mark.long
def test_all_outputs_of_light_are_those_of_the_frame(scene, built):
    assert_equal(scene.render(outputs=ALL_LIGHT, quality="standard"), built(1, ALL_LIGHT, "standard"))


def test_views_of_another_turn_have_the_room_of_that_frame():
    """Lamps, cloth and chart of a turntable, in a scene that another frame has opened."""
    recipe = ps.load_recipe(
        "turntable",
        {
            "camera.width": 64, "camera.height": 48, "auto_exposure.lock": True, "plan.frames": 6,
            "stand.turn_deg": 60, "override.stem.parts": 4,
        },
    )  # fmt: skip
    outputs = ("colour", "instance", "distance")
    frames, live = ps.FrameRenderer(recipe), ps.open_scene(recipe, 2)
    spec = recipe.plan.frame(4)
    expected, pose = frames.render(spec, outputs, "draft"), frames.camera(spec, traced=False).pose
    seen = live.render(pose, outputs)
    assert_equal(seen, expected)
    assert seen.metadata["lamps"] == expected.metadata["lamps"]
    assert_equal(live.render(pose, outputs[1:]), frames.render(spec, outputs[1:]))
    # After an edit of the plant, here of a leaflet in view, the room is still where it was in that frame.
    leaflets = [organ.instance for organ in live.organs if organ.kind == "leaflet"]
    gone = max(leaflets, key=lambda number: (expected["instance"] == number).sum())
    live.remove(gone)
    edited = live.render(pose, outputs)
    same = edited["instance"] == expected["instance"]
    assert np.array_equal(~same, expected["instance"] == gone)
    np.testing.assert_allclose(edited["distance"][same], expected["distance"][same], rtol=1e-5)
    difference = edited["colour"][same].astype(float) - expected["colour"][same]
    assert np.abs(difference).mean() < 3.0


def test_poses_can_have_the_camera_axes_of_other_programs(scene):
    pose = ps.look_at((0.1, -0.6, 1.2), (0.0, 0.0, 1.3))
    expected = scene.render(pose)
    right, down, forward = pose[:3, :3].T
    for axes, columns in (("opengl", (right, -down, -forward)), ("body", (forward, -right, -down))):
        other = pose.copy()
        other[:3, :3] = np.stack(columns, axis=1)
        assert_equal(scene.render(other, axes=axes), expected)


def test_other_cameras_take_views_of_their_own(scene):
    camera = ps.Camera(ps.load_lens("realsense_d435_infrared"), scene.camera.sensor, np.eye(4))
    frame = scene.render(camera=camera)
    assert frame.metadata["camera"]["lens"] != scene.render().metadata["camera"]["lens"]
    np.testing.assert_array_equal(frame.metadata["camera"]["pose"], scene.camera.pose.tolist())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"pose": np.diag([1.0, 1.0, 2.0, 1.0])}, "pose: pose 0 must be a rotation"),
        ({"pose": np.full((4, 4), np.nan)}, "pose: pose 0 must be a rotation"),
        ({"pose": np.eye(3)}, "must have the shape"),
        ({"pose": np.zeros((0, 4, 4))}, "must be at least one"),
        ({"outputs": ("colours",)}, "unknown output"),
        ({"outputs": ("depth_sensor",)}, "depth_camera: is required"),
        ({"quality": "best"}, "quality"),
        ({"axes": "left"}, "must be one of optical, opengl, body"),
        ({"camera": 3}, "must be a Camera, not int"),
    ],
)
def test_invalid_views_are_refused(scene, arguments, message):
    with pytest.raises(InputError, match=message):
        scene.render(**arguments)
    assert scene.view_count == 0


def test_invalid_scenes_are_refused(small_recipe):
    with pytest.raises(ArgumentError, match="frame 3 does not exist"):
        ps.open_scene(small_recipe, 3)
    with pytest.raises(ArgumentError, match="changes"):
        ps.open_scene(small_recipe, 0, **{"row.plants_front": 2})
    with pytest.raises(InputError, match=r"row\.plants"):
        ps.open_scene("barth2018", 0, **{"row.plants": 2})


FAR = {
    "plan.sets": 1, "plan.rotations": 1, "plan.frames": 2, "plan.select": None, "row.plants_front": 2,
    "row.plants_back": 1, "camera.width": 96, "camera.height": 72, "greenhouse.far_rows": 1,
    "greenhouse.far_reach_mm": 900,
}  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("labels", ["labels", "ignore"])
def test_coarse_plants_are_grown_in_full_where_a_view_is_near(rows, labels):
    with row_cache.rows_from(rows):
        scene = ps.open_scene("greenhouse", 0, **FAR, **{"greenhouse.far_rows_as": labels})
    first, numbers = scene.render(), len(scene.organs)
    pose = ps.look_at((-0.2, -0.9, 1.3), (-0.2, -1.6, 1.2))
    frame = scene.render(pose, ("instance", "distance", "harvest"))
    items = frame.metadata["instances"]
    coarse = [int(value) for value, item in items.items() if item.get("far")]
    near = frame["distance"] < 1.0
    assert near.mean() > 0.3
    assert not (np.isin(frame["instance"], coarse) & near).any()
    assert_equal(scene.render(), first)
    if labels == "labels":
        assert len(scene.organs) > numbers
        fruit = max(frame["harvest"]["fruit"], key=lambda one: (one["plant"] >= 3) * one["visible_pixels"])
        scene.pick(fruit["instance"])
        assert fruit["instance"] not in scene.render(pose)["instance"]
    scene.reset()
    assert len(scene.organs) == numbers
    assert_equal(scene.render(), first)


@pytest.mark.long
def test_random_views_are_those_of_the_data_set(rows):
    views = {
        "kind": "random", "target": "fruit", "distance_mm": [300, 500], "clearance_mm": 30,
        "volume_mm": [[-400, 400], [-800, -200], [700, 2000]], "least_visibility": 0.1,
    }  # fmt: skip
    recipe = ps.load_recipe(
        "barth2018", {"plan.frames": 2, "views": views, "row.plants_front": 1, "row.plants_back": 1,
                      "camera.width": 96, "camera.height": 72},
    )  # fmt: skip
    with row_cache.rows_from(rows):
        scene, renderer = ps.open_scene(recipe, 1), ps.FrameRenderer(recipe)
        expected = renderer.render(recipe.plan.frame(1), ("class", "depth_z"))
    assert_equal(scene.render(outputs=("class", "depth_z")), expected)
    scene.remove(scene.organs[-1].instance)
    edited = scene.render(outputs=("class", "depth_z"))
    assert edited.metadata["camera"]["pose"] == expected.metadata["camera"]["pose"]
