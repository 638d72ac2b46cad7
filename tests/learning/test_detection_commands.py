"""The commands for detectors: train, evaluate, predict and export-model; and model cards."""

from __future__ import annotations

import json

import numpy as np
import pytest
from commands import rejected, run
from object_set import paint_objects, write_objects
from painted_bands import CLASSES, write_bands
from PIL import Image

torch = pytest.importorskip("torch", reason="the extra `learn` installs torch")
coder = pytest.importorskip("pycocotools.mask", reason="the extra `export` installs pycocotools")

from pepperscene.learning.evaluation.predict import draw_outlines  # noqa: E402
from pepperscene.learning.models import load_model  # noqa: E402

# pycocotools 2.0.11 decodes masks in a way that NumPy 2 tolerates for now.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")

OPTIONS = (
    "--task", "detect", "--model", "small,width=0.3", "--steps", "70", "--batch", "2", "--size", "96x64",
    "--width", "0", "--learning-rate", "0.008", "--augmentation", "0", "--least-area", "20",
    "--validate", "70", "--precision", "float32",
)  # fmt: skip


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """A set in COCO's format, and the folder of a detector that has learned it."""
    folder = tmp_path_factory.mktemp("commands")
    images, model = write_objects(folder / "objects", 4), folder / "model"
    result = run("train", images, "--validation", images, "--out", model, *OPTIONS)
    assert result.exit_code == 0, result.output
    found = load_model(model).training["validation_ap50"]
    assert found > 0.9
    assert result.stdout == f"trained, step 70, AP50 {found:.3f} of the validation: {model}\n"
    assert f"AP50 {found:.3f}" in result.stderr
    return images, model


def test_evaluate_prints_average_precision_and_writes_files(folders, tmp_path):
    images, model = folders
    result = run("evaluate", model, images, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert "Objects, %: objects, 4 of 4 images" in result.stdout
    page = (tmp_path / "out" / "evaluation.html").read_text()
    assert "objects below 20 pixels" in page
    result = run("evaluate", model, images, "--json", "--limit", 2, "--score", 0.99, "--classes", "pepper")
    content = json.loads(result.stdout)
    assert [item["name"] for item in content["classes"]] == ["pepper"]
    assert content["classes"][0]["masks"]["ap50"] > 0.9
    assert (content["sets"][0]["evaluated"], content["least_score"]) == (2, 0.99)
    assert json.loads((tmp_path / "out" / "evaluation.json").read_text())["least_score"] == 0.3


def test_predict_writes_results_that_pycocotools_reads(folders, tmp_path):
    from pycocotools.coco import COCO

    images, model = folders
    for name in ("a", "b"):
        result = run("predict", model, images, "--out", tmp_path / name)
        assert result.exit_code == 0, result.output
        assert result.stdout == f"4 images predicted: {tmp_path / name}\n"
    files = sorted(path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*") if path.is_file())
    assert [str(path) for path in files] == [
        "detections.json", "images.json", *(f"outlines/image{number}.png" for number in range(4)),
    ]  # fmt: skip
    for path in files:
        assert (tmp_path / "a" / path).read_bytes() == (tmp_path / "b" / path).read_bytes()
    content = COCO(str(tmp_path / "a" / "images.json"))
    results = content.loadRes(str(tmp_path / "a" / "detections.json"))
    assert [item["name"] for item in content.loadCats([1, 2])] == ["fruit", "peduncle"]
    # The most certain object of the first image is one of its labelled ones.
    best = max(results.imgToAnns[1], key=lambda item: item["score"])
    image, mask = paint_objects(0), results.annToMask(best).astype(bool)
    labelled = [image.instances == value for value in np.unique(image.instances[image.instances > 0])]
    assert max((mask & own).sum() / (mask | own).sum() for own in labelled) > 0.6
    drawn = np.asarray(Image.open(tmp_path / "a" / "outlines" / "image0.png"))
    assert drawn.shape == image.colour.shape
    assert (drawn != image.colour).any()
    none = run("predict", model, images, "--out", tmp_path / "c", "--score", 1)
    assert none.exit_code == 0
    np.testing.assert_array_equal(
        np.asarray(Image.open(tmp_path / "c" / "outlines" / "image0.png")), image.colour
    )


def test_outlines_surround_masks():
    colour, mask = np.zeros((40, 50, 3), np.uint8), np.zeros((40, 50), bool)
    mask[20:30, 10:35] = True
    drawn = draw_outlines(colour, [(mask, (255, 0, 0), ""), (np.zeros_like(mask), (0, 255, 0), "")])
    around = np.zeros_like(mask)
    around[19:31, 10:35] = around[20:30, 9:36] = True
    np.testing.assert_array_equal((drawn == (255, 0, 0)).all(axis=2), around & ~mask)


def test_export_model_writes_onnx(folders, tmp_path):
    for name in ("onnx", "onnxscript", "onnxruntime"):
        pytest.importorskip(name, reason="the extra `learn-onnx` installs it")
    file = tmp_path / "new" / "model.onnx"
    result = run("export-model", folders[1], "--out", file, "--size", "64x48")
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith(f"{file}: images of 64x48, at most ")
    assert file.is_file()
    error = rejected("export-model", folders[1], "--out", file, "--size", "64")
    assert "--size: must be width and height" in error


def test_model_cards_say_what_a_network_is_for(folders, tmp_path):
    card = (folders[1] / "model_card.md").read_text()
    for text in (
        "# Model card\n", "A detector", "| fruit | pepper |", "- `objects`: 4 images, not rendered",
        "least_area `20`", "Mean AP50 of the masks", "## Use and limits", "step 70.",
    ):  # fmt: skip
        assert text in card, text
    assert "ImageNet" not in card
    bands = write_bands(tmp_path / "bands", 2)
    options = ("--model", "small,width=0.3", "--steps", 1, "--batch", 1, "--size", "32x32")
    result = run("train", bands, "--out", tmp_path / "model", "--classes", CLASSES, *options)
    assert result.exit_code == 0, result.output
    card = (tmp_path / "model" / "model_card.md").read_text()
    assert "A segmentation network" in card
    assert "None: it was trained without `--validation`" in card


def test_rejects_what_does_not_suit_a_detector(folders, tmp_path):
    images, model = folders
    bands, out = write_bands(tmp_path / "bands", 2), tmp_path / "out"
    for message, *arguments in (
        ("--task: must be segment or detect, not 'count'", "train", images, "--out", out, "--task", "count"),
        ("bands: image", "train", bands, "--out", out, *OPTIONS),
        ("image0 has a mask without numbers of instances", "evaluate", model, bands),
        ("--classes: must be classes of objects", "evaluate", model, images, "--classes", "background"),
        ("--score: must be 0 to 1, not 2", "evaluate", model, images, "--score", 2),
        ("--model: must be small or efficientnet_lite0", "train", images, "--out", out, "--task", "detect",
         "--model", "deeplab_vgg16"),
    ):  # fmt: skip
        assert message in rejected(*arguments)
    assert not out.exists()
