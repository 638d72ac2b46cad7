"""Rendered charts and turntables against OpenCV, colour-science and cameras that go round the plant."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from bodies import axis_camera, columns_of, even_lamp, irradiance_by_hand, response_by_hand
from camera_colours import delta_e, lab_of_rgb

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.camera import load_flash, reference_correction
from pepperscene.geometry import concatenate_meshes
from pepperscene.materials import stand_surfaces
from pepperscene.recipe.resolve.load import resolve_recipe
from pepperscene.render import render_scene
from pepperscene.scene import CalibrationChart, assemble_scene, stand_meshes, turned_parts, uniform_sky
from pepperscene.scene.charts import ChartKind
from pepperscene.spectra import Spectrum

NM = np.arange(380.0, 781.0, 5.0)
SKY = uniform_sky(Spectrum(np.array([300.0, 1100.0]), np.ones(2)), 10_000.0)
SENSOR = "ueye_ui5250re"
TO_CAMERA = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""From the axes of a stand to those of a camera that looks along +y: right, down, forwards."""
PLANT = {
    "camera.width": 160, "camera.height": 120, "camera.exposure_us": 30_000,
    "plan.frames": 6, "stand.turn_deg": 60, "override.stem.parts": 6,
}  # fmt: skip


def test_patches_have_the_electrons_and_colours_of_their_spectra():
    """In a beam that lights the chart's plane evenly, against the tables of the files and colour-science."""
    spd = columns_of("flashes/spectra/lumileds_cool_white")["lumileds_cool_white"]
    camera = axis_camera(
        160, 120, sensor=SENSOR, flash=even_lamp(load_flash("led_matrix_200klx").spectrum, 60_000.0)
    )
    pitch = 120 * 0.5 / camera.intrinsics[1, 1] / 5.0
    chart = CalibrationChart(kind=ChartKind.COLORCHECKER, position_m=(0.0, 0.0, 0.0), cell_m=pitch)
    mesh = chart.mesh().moved(TO_CAMERA, np.array([0.0, 0.0, 0.5]))
    scene = assemble_scene(mesh, {"chart": stand_surfaces(NM)["chart"]})
    electrons = render_scene(scene, camera, ["electrons"], "standard", seed=3)["electrons"]

    # A patch is 24 pixels wide, of which the middle is measured.
    (cx, cy), step = camera.intrinsics[:2, 2], camera.intrinsics[1, 1] * pitch / 0.5
    across, down = cx + (np.arange(6) - 2.5) * step, cy + (np.arange(4) - 1.5) * step
    middles = [(round(y), round(x)) for y in down for x in across]
    measured = np.array([electrons[y - 6 : y + 6, x - 6 : x + 6].mean((0, 1)) for y, x in middles])
    table = columns_of("chart/colorchecker_iso17321_1").values()
    radiance = (
        np.stack([np.interp(NM, *patch) for patch in table]) / np.pi * irradiance_by_hand(spd, 60_000.0, NM)
    )
    expected = np.trapezoid(radiance[:, None] * response_by_hand(SENSOR, NM), NM)
    assert measured == pytest.approx(expected, rel=0.01)

    white = np.trapezoid(
        irradiance_by_hand(spd, 60_000.0, NM) / np.pi * response_by_hand(SENSOR, NM), NM
    ).max()
    correction = reference_correction(camera)
    labs = [
        lab_of_rgb(image / white * correction.gains @ correction.matrix.T) for image in (measured, expected)
    ]
    assert delta_e(*labs).max() < 0.5


@pytest.mark.parametrize("step", [0, 25])
def test_opencv_finds_the_corners_of_a_turning_board_where_they_are_projected(step):
    """Corners of the ChArUco board and markers, in the picture of the recipe's camera, without the plant."""
    frames = FrameRenderer(resolve_recipe("turntable", {"camera.exposure_us": 30_000}))
    camera, stand = frames.camera(frames.recipe.plan.frame(step)), frames.recipe.stand
    turning, staying = stand_meshes(stand)
    mesh = turned_parts(concatenate_meshes([*turning, *staying]), len(staying), -stand.turned(step))
    surfaces = stand_surfaces(np.arange(300.0, 1101.0, 5.0), stand.pot_colour, stand.backdrop_colour)
    picture = render_scene(assemble_scene(mesh, surfaces, SKY), camera, ["colour"], "draft")["colour"]

    (chart,) = (chart for chart in stand.charts if chart.kind == ChartKind.CHARUCO)
    (columns, rows), side = chart.cells, chart.cell_size_m
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    board = cv2.aruco.CharucoBoard((columns, rows), side, 0.75 * side, dictionary)
    corners, numbers, _, markers = cv2.aruco.CharucoDetector(board).detectBoard(
        cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    )
    assert len(markers) >= 10
    assert len(numbers) >= 9
    # OpenCV's board has its origin at the upper left corner, x to the right, y down.
    places = board.getChessboardCorners()[numbers.ravel()] * (1, -1, 0) + (
        -columns * side / 2,
        rows * side / 2,
        0,
    )
    points = (places @ chart.pose[:3, :3].T + chart.pose[:3, 3] - camera.pose[:3, 3]) @ camera.pose[:3, :3]
    pixels = points @ camera.intrinsics.T
    error = pixels[:, :2] / pixels[:, 2:] - 0.5 - corners.reshape(-1, 2)
    assert np.median(np.linalg.norm(error, axis=1)) < 0.25
    assert np.linalg.norm(error, axis=1).max() < 1.5


def test_a_turned_plant_is_seen_as_by_a_camera_that_goes_round_it():
    """Labels of the plant are equal bit by bit; the backdrop stays in the image, and poses tell the turn."""
    turned = FrameRenderer(resolve_recipe("turntable", PLANT))
    plain = FrameRenderer(
        resolve_recipe(
            "turntable", PLANT | {"stand.turn_deg": 0, "views.azimuth_deg": [0, -60], "plan.frames": 2}
        )
    )
    outputs = ["class", "instance", "distance"]
    first = turned.render(turned.recipe.plan.frame(0), outputs)
    by_table, by_camera = (frames.render(frames.recipe.plan.frame(1), outputs) for frames in (turned, plain))
    assert by_table.metadata["turntable"] == {"turn_deg": 60.0}
    assert first.metadata["turntable"] == {"turn_deg": 0.0}
    poses = [np.array(frame.metadata["camera"]["pose"]) for frame in (by_table, by_camera)]
    assert poses[0] == pytest.approx(poses[1], abs=1e-9)
    assert np.array_equal(by_table["class"], by_camera["class"])
    assert not np.array_equal(by_table["class"], first["class"])
    # Charts and cloth that stay are where they were, except where the plant hides them.
    kinds = [item.kind for item in turned.current_scene.mesh.instances]
    for kind in ("colorchecker", "backdrop"):
        number = kinds.index(kind) + 1
        here, before = (frame["instance"] == number for frame in (by_table, first))
        free = (by_table["class"] == 0) & (first["class"] == 0)
        assert (here != before)[free].mean() < 0.02
        assert here.any()


def test_the_light_of_the_room_stays_when_the_plant_turns():
    """A sun from the right in the room: the chart that stays keeps its brightness in the picture."""
    changes = {"daylight.sun_fraction": 0.5, "daylight.sun_azimuth_deg": -20, "camera.exposure_us": 3_000}
    frames = FrameRenderer(resolve_recipe("turntable", PLANT | changes))
    pictures = [
        frames.render(frames.recipe.plan.frame(i), ["electrons", "instance"], "draft") for i in (0, 2)
    ]
    number = [item.kind for item in frames.current_scene.mesh.instances].index("colorchecker") + 1
    both = (pictures[0]["instance"] == number) & (pictures[1]["instance"] == number)
    assert both.sum() > 100
    means = [picture["electrons"][both].mean(axis=0) for picture in pictures]
    assert means[1] == pytest.approx(means[0], rel=0.05)


def test_lamps_of_the_room_stay_when_the_plant_turns():
    """As by a camera that goes round the plant with a lamp, whose places are turned by hand; a lamp at the
    wrong side would change the light by far more."""
    lamp, angle = {"lamp": "led_ring_120mm", "flux_lm": 60_000}, np.radians(-60)
    place = np.array([np.cos(angle), np.sin(angle), 1.0]) * (900, 900, 800)  # from (900, 0, 800)
    alone = PLANT | {"stand.backdrop": "none", "stand.charts": [], "camera.exposure_us": 60_000}
    room = {**lamp, "position_mm": [900, 0, 800], "aim_mm": [0, 0, 300]}
    moved = {**lamp, "position_mm": place.tolist(), "aim_mm": [0, 0, 300]}
    round_it = {"stand.turn_deg": 0, "views.azimuth_deg": [0, -60], "plan.frames": 2}
    outputs, images = ["electrons", "class", "instance", "distance"], []
    for changes in ({"lamps": [room]}, round_it | {"lamps": [moved]}):
        frames = FrameRenderer(resolve_recipe("turntable", alone | changes))
        frames.render(frames.recipe.plan.frame(0), outputs, "draft")  # whose light must not be used again
        images.append(frames.render(frames.recipe.plan.frame(1), outputs, "draft"))
    by_table, by_camera = images
    assert by_table.metadata["lamps"][0]["position_m"] == pytest.approx(1e-3 * place, abs=1e-9)
    assert np.array_equal(by_table["class"], by_camera["class"])
    assert np.array_equal(by_table["instance"], by_camera["instance"])
    light = [image["electrons"].reshape(15, 8, 20, 8, -1).mean((1, 3)) for image in images]
    np.testing.assert_allclose(*light, rtol=0.04, atol=0.01 * light[1].max())
    assert light[0].mean() == pytest.approx(light[1].mean(), rel=0.002)
