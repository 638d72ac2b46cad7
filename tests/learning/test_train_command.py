"""Wrong input of the command `train`: one sentence, exit code 2, and nothing is written."""

from __future__ import annotations

import pytest
from PIL import Image
from shapes import shape_images, write_shapes
from typer.testing import CliRunner

pytest.importorskip("torch")

from pepperscene.cli import app
from pepperscene.errors import EXIT_BAD_INPUT

QUICK = (
    "--labels",
    "published",
    "--model",
    "small,width=0.25",
    "--steps",
    "2",
    "--batch",
    "2",
    "--size",
    "32x32",
)


@pytest.fixture
def images(tmp_path):
    return write_shapes(tmp_path / "images", 3)


@pytest.fixture
def rejects(tmp_path):
    """Function that runs an invalid command line and checks its error and that nothing was written."""
    out = tmp_path / "model"

    def check(message, *words):
        result = CliRunner().invoke(app, ["train", "--out", str(out), *(str(word) for word in words)])
        assert result.exit_code == EXIT_BAD_INPUT, result.output
        assert result.stdout == ""
        lines = [line for line in result.stderr.splitlines() if not line.startswith("step ")]
        assert len(lines) == 1
        assert lines[0].startswith("error: ")
        assert message in lines[0]
        assert not out.exists()

    return check


def test_train_writes_a_model(images, tmp_path):
    words = ["train", str(images), "--out", str(tmp_path / "model"), *QUICK, "--validation", str(images)]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    assert "step 2 of 2: loss" in result.stderr
    assert result.stdout.startswith("trained, step ")
    assert (tmp_path / "model" / "model.safetensors").is_file()
    result = CliRunner().invoke(
        app, ["evaluate", str(tmp_path / "model"), str(images), "--labels", "published"]
    )
    assert result.exit_code == 0, result.output
    assert "3 of 3 images" in result.stdout


def test_sets_that_cannot_be_used(rejects, images, tmp_path):
    (tmp_path / "empty").mkdir()
    rejects("holds no images", tmp_path / "empty", *QUICK)
    rejects("none: must be a folder of images", tmp_path / "none", *QUICK)
    plain = tmp_path / "plain"
    plain.mkdir()
    for image in shape_images(2):
        Image.fromarray(image.colour).save(plain / f"{image.name}.png")
    rejects("has no pixel of the classes", plain, *QUICK)
    rejects("has no pixel of the classes wire,cut", images, *QUICK, "--classes", "wire,cut")
    rejects("has no colour image or no mask", images, *QUICK, "--validation", plain)


def test_masks_of_another_palette(rejects, images, tmp_path):
    other = write_shapes(tmp_path / "other", 2)
    mask = next(other.glob("*_mask.png"))
    Image.fromarray(shape_images(1)[0].classes + 40).save(mask)
    rejects(f"{mask}: has the values 40", images, other, *QUICK, "--classes", "background,leaf,pepper,stem")


def test_truncated_images(rejects, images):
    file = images / "shapes1.png"
    file.write_bytes(file.read_bytes()[:200])
    rejects(str(file), images, *QUICK)


def test_options_that_are_not_allowed(rejects, images):
    rejects("--model: cannot be combined with --start", images, *QUICK, "--start", "model")
    rejects("--size: must be width and height in pixels", images, "--size", "64")
    rejects("--learning-rate: must be above 0", images, "--learning-rate", "0")
    rejects("--classes: 'fruit' is none of", images, "--classes", "fruit,leaf")
    rejects("--model: must be small, deeplab_vgg16 or module:factory", images, "--model", "huge")
    rejects(
        "does not exist; `pepperscene train` writes it", images, "--start", "none", "--labels", "published"
    )
