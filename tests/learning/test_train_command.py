"""The command `train`: what it prints, and wrong input."""

from __future__ import annotations

import signal
import threading

import numpy as np
import pytest
from commands import rejected, run
from painted_bands import CLASSES, write_bands
from PIL import Image

from pepperscene.learning.class_table import ClassTable

torch = pytest.importorskip("torch", reason="the extra `learn` installs torch")
pytest.importorskip("safetensors", reason="the extra `learn` installs safetensors")

from pepperscene.learning.models import load_model  # noqa: E402

OPTIONS = (
    "--model", "small,width=0.3", "--steps", "2", "--batch", "2", "--size", "48x32", "--width", "0",
    "--validate", "1",
)  # fmt: skip


@pytest.fixture(scope="module")
def bands(tmp_path_factory):
    return write_bands(tmp_path_factory.mktemp("train") / "bands", 3)


@pytest.fixture
def rejects(tmp_path):
    """Function that runs an invalid command line and checks its error: one line with a message."""

    def check(message, *arguments):
        out = tmp_path / "out"
        assert message in rejected("train", *arguments, "--out", out)
        assert not out.exists()

    return check


def test_trains_evaluates_and_predicts(bands, tmp_path):
    out = tmp_path / "model"
    result = run("train", bands, "--validation", bands, "--out", out, "--classes", CLASSES, *OPTIONS)
    assert result.exit_code == 0, result.output
    model = load_model(out)
    quality = f"mean IoU {model.training['validation_mean_iou']:.3f} of the validation"
    assert result.stdout == f"trained, step {model.training['step']}, {quality}: {out}\n"
    lines = result.stderr.splitlines()
    assert [line.partition(":")[0] for line in lines] == ["step 1 of 2", "step 2 of 2"]
    assert all("mean IoU" in line and "images/s" in line for line in lines)
    assert model.classes == ClassTable.parse(CLASSES)
    assert (model.model, model.width) == ("small,width=0.3", None)

    result = run("evaluate", out, bands)
    assert result.exit_code == 0, result.output
    assert "IoU: bands, 3 of 3 images" in result.stdout
    result = run("predict", out, bands, "--out", tmp_path / "predicted")
    assert result.exit_code == 0, result.output
    assert len(list((tmp_path / "predicted" / "class").iterdir())) == 3

    # A second training starts from the first one, and scales images as that did.
    options = (text for text in OPTIONS[2:] if text not in ("--width", "0"))
    result = run("train", bands, "--out", tmp_path / "next", "--start", out, *options)
    assert result.exit_code == 0, result.output
    assert load_model(tmp_path / "next").classes == model.classes
    assert load_model(tmp_path / "next").width is None


def test_rejects_wrong_arguments(rejects, bands, tmp_path):
    nothing = tmp_path / "nothing"
    for message, *arguments in (
        ("--model: cannot be combined with --start", "--model", "small", "--start", nothing),
        ("nothing: does not exist", *OPTIONS[2:], "--start", nothing),
        ("--size: must be width and height in pixels, such as 256x192, not 256", "--size", "256"),
        ("--size: must be width and height in pixels", "--size", "-4x32"),
        ("--size: must be two numbers of pixels, 32 to 8192", "--size", "8x64"),
        ("--model: must be small, efficientnet_lite0, deeplab_vgg16 or module", "--model", "unet"),
        ("--device: tpu9 cannot be used", *OPTIONS, "--device", "tpu9"),
        ("--half: applies only to the published data set", "--half", "empirical"),
    ):
        rejects(message, bands, *arguments)


def test_rejects_sets_that_cannot_be_read(rejects, bands, tmp_path):
    rejects("nowhere: must be a folder of images", tmp_path / "nowhere", *OPTIONS)
    (tmp_path / "empty").mkdir()
    rejects("empty: ", tmp_path / "empty", *OPTIONS)
    rejects("empty: ", bands, *OPTIONS, "--validation", tmp_path / "empty")
    # No table of labels: values have no meaning, or some are undefined.
    unknown = write_bands(tmp_path / "unknown", 2)
    (unknown / "classes.toml").unlink()
    rejects("has values", unknown, *OPTIONS)
    (unknown / "classes.toml").write_text('0 = "background"\n1 = "leaf"\n')
    rejects("image0_mask.png", unknown, *OPTIONS)
    rejects("image0_mask.png", bands, unknown, *OPTIONS)
    # A mask in colours, which the table of the folder does not define.
    palette = write_bands(tmp_path / "palette", 2)
    colours = np.full((64, 96, 3), (40, 200, 10), np.uint8)
    Image.fromarray(colours).save(palette / "image1_mask.png")
    rejects("image1_mask.png", bands, palette, *OPTIONS)


@pytest.mark.parametrize("workers", ["0", pytest.param("1", marks=pytest.mark.long)])
def test_rejects_damaged_images(rejects, bands, tmp_path, workers):
    broken = write_bands(tmp_path / "broken", 2)
    for name in ("image1.png", "image1_mask.png"):
        content = (broken / name).read_bytes()
        (broken / name).write_bytes(content[: len(content) // 2])
        message = f"{name}: cannot be read as an image"
        rejects(message, broken, *OPTIONS, "--workers", workers)
        if "mask" in name:
            rejects(message, bands, *OPTIONS, "--validation", broken)
        (broken / name).write_bytes(content)


def test_rejects_sets_without_labels_of_the_classes(rejects, bands, tmp_path):
    without = write_bands(tmp_path / "without", 2, masks=False)
    rejects("without: has no pixel of the classes", bands, *OPTIONS, "--validation", without)
    (without / "image0_mask.png").write_bytes((bands / "image0_mask.png").read_bytes())
    rejects("without: image1 has no mask, which training needs", without, *OPTIONS)


def test_an_interruption_keeps_the_last_checkpoint(bands, tmp_path):
    """Ctrl-C gives one line, which says how to go on; the resumed training ends as an undisturbed one."""
    out, stop = tmp_path / "model", threading.Event()

    def interrupt():
        while not stop.is_set():
            if (out / "state.safetensors").is_file():
                signal.raise_signal(signal.SIGINT)
                return
            stop.wait(0.01)

    watcher = threading.Thread(target=interrupt)
    watcher.start()
    try:
        result = run("train", bands, *OPTIONS, "--steps", "200", "--out", out)
    finally:
        stop.set()
        watcher.join()
    assert result.exit_code == 128 + signal.SIGINT, result.output
    assert result.stderr.splitlines()[-1] == (
        "interrupted; the last checkpoint is kept; run the same command with --resume to continue"
    )
    assert not [path for path in out.iterdir() if path.name.startswith(".")]
    assert load_model(out).training["step"] < 200
