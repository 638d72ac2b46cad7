"""Dry runs: numbers of scenes, cost, camera places, poses and drawings."""

from __future__ import annotations

import io
import json
import tempfile
from pathlib import Path

import cv2
import numpy as np
import pytest
from matplotlib.patches import Wedge
from PIL import Image
from stand_in import StandIn

from pepperscene.building.execution.build import build
from pepperscene.building.execution.job import BuildJob, BuildOptions
from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.camera.pose_files.formats import read_poses
from pepperscene.errors import ArgumentError
from pepperscene.recipe.resolve.frame_setups import FrameSetups
from pepperscene.recipe.resolve.load import resolve_recipe
from pepperscene.review.preview import picture
from pepperscene.review.preview import places as places_module
from pepperscene.review.preview.picture import draw_plan, row_geometry
from pepperscene.review.preview.places import scene_places, write_selected_poses
from pepperscene.review.preview.preview import ProbeFrame, build_seconds, preview_plan
from pepperscene.review.preview.summary import count_scenes, horizontal_field_deg, summarise_plan
from pepperscene.review.preview.text import format_bytes, plan_lines
from pepperscene.units import format_duration

SMALL = {"plan.sets": 2, "plan.rotations": 2, "plan.frames": 3, "row.plants_front": 1, "row.plants_back": 0}
NUMBERS = {"camera.width": 640, "camera.height": 480, "camera.sensor": "generic_rgb"}
RANDOM = {"views": {"kind": "random", "target": "fruit", "distance_mm": [200.0, 400.0]}, "plan.frames": 4}


def small(**changes):
    return resolve_recipe("barth2018", {**SMALL, **{key.replace("__", "."): v for key, v in changes.items()}})


def no_places(resolved, **options):
    renderer = FrameRenderer(resolved, StandIn)
    indices = resolved.recipe.plan.select_indices(None)
    return renderer, scene_places(renderer, indices, **options)


@pytest.mark.parametrize(
    ("changes", "scenes"),
    [
        ({}, 4),
        ({"plan.select": [0, 1, 11]}, 2),
        ({"row.spacing_mm": {"uniform": [150, 300], "per": "scene"}}, 4),
        ({"camera.exposure_us": {"uniform": [40, 90]}}, 4),
        ({"twins": {"camera.gain": [1.0, 2.0]}}, 4),
        ({"twins": {"row.spacing_mm": [180.0, 200.0]}}, 8),
        ({"rig": [{"name": "right"}], "row.spacing_mm": {"uniform": [150, 300], "per": "frame"}}, 12),
    ],
)
def test_scenes_are_counted_as_the_setups_of_frames_differ(changes, scenes):
    resolved = resolve_recipe("barth2018", {**SMALL, **changes})
    plan, setups = resolved.recipe.plan, FrameSetups(resolved)
    indices = plan.select_indices(None)
    specs = [plan.frame(index) for index in indices]
    assert count_scenes(resolved.recipe, indices) == scenes
    assert len({(setups.at(spec).plants, spec.set, spec.rotation) for spec in specs}) == scenes


def test_the_field_of_view_is_that_of_the_recipe():
    camera = resolve_recipe("barth2018", {**NUMBERS, "camera.hfov_deg": 62.5}).camera
    assert horizontal_field_deg(camera) == pytest.approx(62.5, abs=1e-9)


def test_the_field_of_view_of_a_distorted_lens_agrees_with_opencv():
    intrinsics = {"fx": 500.0, "fy": 510.0, "cx": 330.0, "cy": 235.0}
    coefficients = [-0.2, 0.05, 0.001, -0.002, 0.01]
    changes = {f"camera.{key}": value for key, value in intrinsics.items()}
    changes |= {"camera.distortion_model": "plumb_bob", "camera.distortion": coefficients}
    camera = resolve_recipe("barth2018", {**NUMBERS, **changes}).camera
    matrix = np.array([[500.0, 0, 330.0], [0, 510.0, 235.0], [0, 0, 1]])
    # In OpenCV the centre of the first pixel is at 0.
    borders = np.array([[[-0.5, 239.5]], [[639.5, 239.5]]])
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
    slopes = cv2.undistortPoints(borders, matrix, np.array(coefficients), criteria=criteria)[:, 0]
    left, right = np.column_stack([slopes, np.ones(2)])
    cosine = left @ right / np.linalg.norm(left) / np.linalg.norm(right)
    assert horizontal_field_deg(camera) == pytest.approx(np.degrees(np.arccos(cosine)), abs=1e-6)


@pytest.mark.parametrize(
    ("processes", "seconds"),
    [
        (1, 4 * 10 + 12 * 2),  # four scenes, one after the other
        (2, 2 * 10 + 6 * 2),
        (3, 2 * 10 + 6 * 2),  # one process makes two scenes
        (4, 10 + 3 * 2),
        (8, 10 + 2 * 2),  # scenes are divided, and each part is set up
    ],
)
def test_a_build_takes_as_long_as_its_slowest_process(tmp_path, processes, seconds):
    job = BuildJob.create(small(), tmp_path, ("class",), BuildOptions())
    assert build_seconds(job, range(12), processes, ProbeFrame(10.0, 2.0, 1)) == pytest.approx(seconds)


def test_frames_with_plants_of_their_own_are_each_set_up(tmp_path):
    resolved = small(row__spacing_mm={"uniform": [150, 300], "per": "frame"})
    job = BuildJob.create(resolved, tmp_path, ("class",), BuildOptions())
    assert build_seconds(job, range(12), 1, ProbeFrame(10.0, 2.0, 1)) == pytest.approx(12 * 12)
    summary = summarise_plan(resolved, range(12))
    assert len(summary.warnings) == 1
    assert "row.spacing_mm varies per frame" in summary.warnings[0]


@pytest.mark.slow
def test_disk_space_is_that_of_the_files_of_a_build(tmp_path, monkeypatch):
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    resolved = small(plan__select=[1, 4, 5])
    options = BuildOptions(renderer=StandIn)
    preview = preview_plan(resolved, ("class", "distance"), options)
    assert list(temporary.iterdir()) == []
    built = tmp_path / "set"
    build(resolved, built, [1], ("class", "distance"), options)
    size = sum(
        path.stat().st_size
        for folder in ("class", "distance", "frames")
        for path in (built / folder).iterdir()
    )
    assert preview.cost.frame_bytes == size
    assert preview.cost.disk_bytes == 3 * size
    assert (preview.cost.index, preview.cost.frames, preview.cost.scenes) == (1, 3, 2)
    assert preview.cost.memory_bytes > 1e8


def test_written_poses_are_those_of_the_selected_frames(tmp_path):
    resolved = small(plan__select=[0, 2, 7], rig=[{"name": "right", "position_mm": [60.0, 0.0, 0.0]}])
    renderer = FrameRenderer(resolved, StandIn)
    expected = [renderer.camera(resolved.recipe.plan.frame(index)).pose for index in (0, 2, 7)]
    for name in ("poses.json", "poses.csv", "poses.txt", "model"):
        write_selected_poses(tmp_path / name, renderer, (0, 2, 7))
        read = read_poses(tmp_path / name)
        np.testing.assert_allclose(read.poses, expected, atol=1e-9)
        if name == "poses.txt":
            assert read.times_s.tolist() == [0.0, 2.0, 7.0]
        else:
            assert read.names == ("000000.png", "000002.png", "000007.png")


@pytest.mark.parametrize(
    ("changes", "is_written"),
    [
        ({}, True),
        # Cameras that are loaded for each value, but image the same.
        ({"twins": {"camera.f_number": [2.0, 4.0]}}, True),
        ({"rig": [{"name": "wide", "lens": "none", "hfov_deg": 80.0}]}, False),
        ({"rig": [{"name": "small", "width": 400, "height": 300}]}, False),
    ],
)
def test_intrinsics_are_written_if_all_frames_have_the_same(tmp_path, changes, is_written):
    resolved = small(**changes)
    renderer = FrameRenderer(resolved, StandIn)
    write_selected_poses(tmp_path / "poses.json", renderer, range(resolved.recipe.plan.count))
    content = json.loads((tmp_path / "poses.json").read_text(encoding="utf-8"))
    assert ("fl_x" in content) == is_written


def test_places_are_those_of_the_scene_of_the_first_selected_frame():
    resolved = small(plan__select=[4, 7])
    renderer, places = no_places(resolved, grown=False)
    assert (places.spec.set, places.spec.rotation) == (0, 1)
    expected = [renderer.camera(resolved.recipe.plan.frame(index)).pose for index in (3, 4, 5)]
    np.testing.assert_array_equal(places.poses, expected)
    assert places.selected.tolist() == [False, True, False]


def test_many_places_are_thinned_and_keep_those_of_selected_frames():
    resolved = small(plan__frames=9000, plan__select=[17, 4321])
    _, places = no_places(resolved, grown=False)
    assert 200 < len(places.poses) <= places_module.MOST_PLACES
    assert places.selected.sum() == 2


def test_random_views_without_plants_have_limits_only():
    resolved = resolve_recipe("barth2018", {**SMALL, **RANDOM})
    _, places = no_places(resolved, grown=False)
    assert len(places.poses) == 0
    assert places.limits.distance_m == (0.2, 0.4)
    with pytest.raises(ArgumentError, match="depend on the plants"):
        preview_plan(resolved, ("class",), BuildOptions(), probe=False, poses=Path("never.csv"))


@pytest.mark.slow
def test_random_places_are_within_their_distance_from_a_target():
    resolved = resolve_recipe("barth2018", {**SMALL, **RANDOM})
    renderer = FrameRenderer(resolved)
    places = scene_places(renderer, range(16), grown=True)
    fruit = [item for item in renderer.current_scene.mesh.instances if item.kind == "fruit"]
    assert len(places.poses) == 4
    assert len(places.targets) == len(fruit) > 0
    distances = np.linalg.norm(places.poses[:, None, :3, 3] - places.targets, axis=2)
    inside = (distances > 0.2 - 1e-3) & (distances < 0.4 + 1e-3)
    assert inside.any(axis=1).all()


def test_too_many_poses_and_other_files_are_refused_before_anything_is_rendered(tmp_path):
    def never(scene):
        raise AssertionError("a renderer was made")

    resolved = small(plan__sets=100, plan__rotations=1, plan__frames=1001)
    with pytest.raises(ArgumentError, match="100,100 frames are selected, and a file has at most 100,000"):
        preview_plan(resolved, ("class",), BuildOptions(renderer=never), poses=tmp_path / "poses.csv")
    with pytest.raises(ArgumentError) as caught:
        preview_plan(small(), probe=False, picture=tmp_path / "plan.jpg")
    assert caught.value.where == "picture"
    assert list(tmp_path.iterdir()) == []


def _colours(content):
    with Image.open(io.BytesIO(content)) as image:
        return {colour for _, colour in image.convert("RGB").getcolors(1 << 20)}


def test_drawings_show_plants_cameras_and_targets():
    camera, plant, target = (31, 78, 158), (46, 125, 50), (194, 24, 91)
    for changes, drawn in (({}, {camera, plant}), (RANDOM, {plant, target})):
        resolved = resolve_recipe("barth2018", {**SMALL, **changes})
        renderer, places = no_places(resolved, grown=False)
        rows = row_geometry(renderer.setups.at(places.spec), 0)
        content = draw_plan("name with $", rows, places)
        assert content == draw_plan("name with $", rows, places)
        assert {camera, plant, target} & _colours(content) == drawn


@pytest.mark.parametrize(
    "limits",
    [
        {"azimuth_deg": [-180.0, 180.0], "distance_mm": [200.0, 1500.0]},
        {"azimuth_deg": [120.0, 170.0]},
        {"elevation_deg": [0.0, 0.0]},
        {"azimuth_deg": [0.0, 0.0]},
        {"distance_mm": [400.0, 400.0]},
    ],
)
def test_limits_of_random_views_are_drawn_whole_and_visible(monkeypatch, limits):
    drawings, draw_limits = [], picture._draw_limits

    def record(top, side, *others):
        draw_limits(top, side, *others)
        drawings.extend((top, side))

    monkeypatch.setattr(picture, "_draw_limits", record)
    resolved = resolve_recipe("barth2018", {**SMALL, **RANDOM, "views": {**RANDOM["views"], **limits}})
    renderer, places = no_places(resolved, grown=False)
    draw_plan("limits", row_geometry(renderer.setups.at(places.spec), 0), places)
    assert len(drawings) == 2
    for axes in drawings:
        sectors = [patch for patch in axes.patches if isinstance(patch, Wedge)]
        assert sectors
        for sector in sectors:
            box = sector.get_window_extent()
            assert (axes.bbox.min < box.min).all()
            assert (box.max < axes.bbox.max).all()
            # A sector of one distance or angle has no area.
            assert sector.get_linewidth() >= 1.0
            assert sector.get_edgecolor()[3] >= 0.5


@pytest.mark.slow
def test_plants_are_drawn_where_scenes_have_them():
    resolved = resolve_recipe("greenhouse", {"row.plants_front": 2, "row.plants_back": 1})
    renderer = FrameRenderer(resolved, StandIn)
    spec = resolved.recipe.plan.frame(0)
    rows = row_geometry(renderer.setups.at(spec), spec.set)
    row = renderer.recipe.row
    # Plants of far rows that are grown in full follow the recipe's own.
    bases = renderer.scene(spec, traced=False).skeleton.bases[: row.plants_front + row.plants_back]
    np.testing.assert_allclose(rows.plants[:, 0], bases[:, 0], atol=1e-12)
    # Offsets across the row, of three standard deviations at most, are left out.
    assert np.abs(rows.plants[:, 1] - bases[:, 1]).max() <= 0.03 + 1e-12


def test_shared_draws_twins_and_automatic_exposure_are_described():
    changes = {
        "camera.exposure_us": "auto",
        "daylight.illuminance_lx": {"uniform": [1000, 9000], "per": "scene", "draw": "weather"},
        "daylight.sun_fraction": {"uniform": [0.0, 0.5], "per": "scene", "draw": "weather", "reversed": True},
        "developing.white_balance": "daylight",
        "twins": {"camera.flash": ["none", "led_matrix_200klx"]},
    }
    resolved = resolve_recipe("barth2018", {**SMALL, **changes})
    text = "\n".join(plan_lines(summarise_plan(resolved, range(24)), None))
    assert "24 = 2 sets x 2 rotations x 3 views x 2 twins; all are selected, of 4 scenes" in text
    assert "per scene  1000 to 9000, uniform; shared draw 'weather'\n" in text
    assert "0 to 0.5, uniform; shared draw 'weather', reversed" in text
    assert "camera.flash: none, led_matrix_200klx" in text
    assert "automatic exposure to a mean grey of 110, 10 to 10000 µs, gain up to 4" in text


def test_the_cameras_of_a_rig_are_described():
    resolved = small(rig=[{"name": "wide", "lens": "none", "hfov_deg": 120.0}])
    main, wide = summarise_plan(resolved, range(24)).cameras
    assert (main.name, wide.name, wide.hfov_deg) == ("main", "wide", pytest.approx(120.0, abs=1e-9))


@pytest.mark.parametrize(
    ("views", "text"),
    [
        (None, "arc: distance 400 mm, azimuth -45 to 45°, height 900 to 2100 mm, pitch 20°"),
        (
            {"kind": "grid", "distance_mm": [400, 600], "height_mm": [1200], "azimuth_deg": [-20, 20]},
            "grid: x 0 mm, distance 400, 600 mm, height 1200 mm, azimuth -20, 20°, pitch 0°",
        ),
        (
            {"kind": "path", "points_mm": [[-500, -600, 1200], [500, -600, 1400]], "speed_mm_s": 200.0},
            "path: 2 points from (-500, -600, 1200) to (500, -600, 1400) mm, speed 200 mm/s, azimuth 0°, "
            "pitch 0°, motion yes",
        ),
        (
            {**RANDOM["views"], "volume_mm": [[-500, 500], [-900, -200], [800, 2000]]},
            "random: target fruit, distance 200 to 400 mm, elevation -20 to 20°, azimuth -60 to 60°, "
            "roll 0°, offset 0, volume -500 to 500 x -900 to -200 x 800 to 2000 mm, clearance 50 mm, "
            "least visibility 0",
        ),
    ],
)
def test_views_are_described_with_their_ranges(views, text):
    resolved = resolve_recipe("barth2018", {"plan.frames": 4, **({"views": views} if views else {})})
    lines = plan_lines(summarise_plan(resolved, range(4)), None)
    assert f"views     {text}" in lines


def test_durations_and_bytes_are_short():
    seconds = {0.034: "0.034 s", 12: "12 s", 59.7: "1 min 0 s", 3700: "1 h 1 min", 90_061: "1 d 1 h"}
    assert {number: format_duration(number) for number in seconds} == seconds
    sizes = {999: "999 B", 226_300: "226 kB", 1.5e9: "1.5 GB", 2e13: "20 TB"}
    assert {number: format_bytes(number) for number in sizes} == sizes
