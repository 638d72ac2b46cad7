"""`pepperscene calibrate`: photographs as displayed, and bad input in one sentence with nothing written."""

from __future__ import annotations

import numpy as np
import pytest
from hidden_cameras import HiddenCamera, chart_rgb, jpeg, photographed_chart
from PIL import Image
from typer.testing import CliRunner

from pepperscene.calibration.photographs import measure_chart, read_chart
from pepperscene.cli import app
from pepperscene.errors import InputError

CAMERA = HiddenCamera(quality=None)


@pytest.fixture(scope="module")
def chart(tmp_path_factory):
    """A photograph of a chart, and its corners."""
    picture, corners = photographed_chart(CAMERA, (300, 400), pitch=48.0)
    path = tmp_path_factory.mktemp("charts") / "chart.jpg"
    path.write_bytes(jpeg(picture, 95))
    return path, corners


def run(*arguments):
    return CliRunner().invoke(app, ["calibrate", *map(str, arguments)])


def test_photographs_are_read_as_displayed(chart, tmp_path):
    path, corners = chart
    picture = np.array(Image.open(path))
    upright = read_chart(path)
    assert upright.corners == pytest.approx(corners, abs=1.0)
    # Stored on its side, with the orientation that turns it back.
    turned = tmp_path / "turned.jpg"
    turned.write_bytes(jpeg(np.rot90(picture).copy(), 100, orientation=6))
    photograph = read_chart(turned)
    assert photograph.picture.shape == picture.shape
    assert photograph.codes == pytest.approx(upright.codes, abs=0.01)


def test_corners_may_begin_anywhere(chart):
    path, corners = chart
    for order in ([0, 1, 2, 3], [2, 3, 0, 1], [1, 0, 3, 2]):
        assert read_chart(path, corners[order]).corners == pytest.approx(corners)


def test_saturated_fields_are_left_out():
    bright = HiddenCamera(white=1.25)
    picture, corners = photographed_chart(bright, (300, 400), pitch=48.0)
    usable = measure_chart(picture, corners, "x").usable
    assert not usable[18].any()
    assert usable[20:23].all()
    with pytest.raises(InputError, match="change the exposure"):
        measure_chart(np.full_like(picture, 255), corners, "x")


@pytest.mark.parametrize(
    ("content", "options", "message"),
    [
        ("noise", (), "shows no ColorChecker that can be detected"),
        ("black", (), "shows no ColorChecker that can be detected"),
        ("black", ("--corners", "50,50,300,50,300,200,50,200"), "is too dark"),
        ("text", (), "cannot be read as an image"),
        ("missing", (), "missing.jpg"),
        ("chart", ("--corners", "1,2,3"), "--corners: must be 8 numbers"),
        ("chart", ("--corners", "1,2,3,x,5,6,7,8"), "--corners: must be numbers"),
        ("chart", ("--corners", "0,0,30,0,30,20,0,20"), "fields of 4 pixels"),
        ("chart", ("--grey-card", "300,200,200,50"), "--grey-card: must be inside"),
        ("chart", ("--grey-card", "10,10,8,8"), "--grey-card: must be at least 24"),
        ("chart", ("--grey-card", "10,10,40,40", "--corners", "1,2,3,4,5,6,7,8"), "cannot be combined"),
        ("black", ("--grey-card", "10,10,40,40"), "everywhere on the card"),
        ("chart", ("--recipe", "no_such_recipe"), "no_such_recipe"),
        ("chart", ("--recipe", "multispectral"), "must have a colour sensor"),
    ],
)
def test_bad_input_is_one_sentence(chart, tmp_path, content, options, message):
    path, out = tmp_path / f"{content}.jpg", tmp_path / "out"
    pictures = {
        "noise": np.random.default_rng(5).integers(0, 256, (200, 300, 3), dtype=np.uint8),
        "black": np.zeros((300, 400, 3), np.uint8),
    }
    if content in pictures:
        path.write_bytes(jpeg(pictures[content], 95))
    elif content == "text":
        path.write_text("no image")
    elif content == "chart":
        path = chart[0]
    done = run(path, "--out", out / "camera.toml", *options)
    assert done.exit_code == 2
    (line,) = done.stderr.strip().splitlines()
    assert line.startswith("error: ")
    assert message in line
    assert not out.exists()


def test_the_output_is_checked_first(tmp_path):
    done = run("missing.jpg", "--out", tmp_path / "camera.txt")
    assert done.exit_code == 2
    assert "--out: must end with .toml" in done.stderr


def test_a_grey_card_changes_the_white_balance_only(tmp_path):
    even = np.full((120, 160, 3), 0.4)
    path, recipe = tmp_path / "card.png", tmp_path / "small.toml"
    recipe.write_text('extends = "greenhouse"\n[camera]\nsensor = "generic_rgb"\nwidth = 160\nheight = 120\n')
    Image.fromarray(HiddenCamera(balance=(1.1, 1.0, 0.9)).photograph(even)).save(path)
    out = tmp_path / "card.toml"
    done = run(path, "--out", out, "--grey-card", "20,20,120,80", "--recipe", recipe)
    assert done.exit_code == 0, done.output
    text = out.read_text(encoding="utf-8")
    assert "white_balance = [" in text
    assert "colour_matrix" not in text
    gains = [float(part.split("±")[0]) for part in done.stdout.splitlines()[0].split(":")[1].split(",")]
    assert gains == pytest.approx([1.1, 1.0, 0.9], abs=0.01)


def test_charts_along_the_pixels_have_no_sharpness():
    from pepperscene.calibration.edges import chart_sharpness

    corners = np.array([[56.0, 54.0], [344.0, 54.0], [344.0, 246.0], [56.0, 246.0]])
    picture = CAMERA.photograph(chart_rgb(CAMERA.sensor, (300, 400), corners))
    photograph = measure_chart(picture, corners, "x")
    assert chart_sharpness(photograph, (picture / 255.0) ** 2.2) is None
