"""Networks as ONNX files: onnxruntime gives what torch gives."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from object_set import SIZE, object_set
from painted_bands import bands_set

from pepperscene.errors import ArgumentError, SetupError
from pepperscene.learning.options import TrainingOptions, parse_classes

torch = pytest.importorskip("torch", reason="the extra `learn` installs torch")
onnx = pytest.importorskip("onnx", reason="the extra `learn-onnx` installs onnx")
onnxruntime = pytest.importorskip("onnxruntime", reason="the extra `learn-onnx` installs onnxruntime")
pytest.importorskip("onnxscript", reason="the extra `learn-onnx` installs onnxscript")

from pepperscene.learning.models import TrainedModel, export_model  # noqa: E402
from pepperscene.learning.models.detections import Detections  # noqa: E402
from pepperscene.learning.models.trained_model import build_network  # noqa: E402
from pepperscene.learning.training import train  # noqa: E402

OPTIONS = TrainingOptions(
    model="small,width=0.3", steps=70, batch=2, size=SIZE, width=None, augmentation=0, precision="float32",
    learning_rate=8e-3, validate=70, least_area=20,
)  # fmt: skip


def session_of(file):
    return onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])


def run(file, colour):
    """Outputs for an sRGB image `(h, w, 3)`, by name."""
    session = session_of(file)
    image = colour.transpose(2, 0, 1)[None].astype(np.float32) / 255
    return dict(
        zip([item.name for item in session.get_outputs()], session.run(None, {"image": image}), strict=True)
    )


def test_a_segmentation_gives_the_same_probabilities(tmp_path):
    model = train(bands_set(2), tmp_path / "model", replace(OPTIONS, steps=3))
    written = export_model(model, tmp_path / "a" / "model.onnx", SIZE)
    assert (written.size, written.file) == (SIZE, tmp_path / "a" / "model.onnx")
    assert written.difference < 1e-4
    onnx.checker.check_model(str(written.file), full_check=True)
    colour = bands_set(1)[0].colour
    outputs = run(written.file, colour)
    metadata = session_of(written.file).get_modelmeta().custom_metadata_map
    assert json.loads(metadata["factors"]) == list(model.decision.factors)
    assert list(outputs) == ["probabilities"]
    np.testing.assert_allclose(outputs["probabilities"][0], model.probabilities(colour), atol=1e-4)
    # The same network gives the same bytes, without the paths of this machine.
    export_model(model, tmp_path / "b.onnx", SIZE)
    content = (tmp_path / "b.onnx").read_bytes()
    assert content == written.file.read_bytes()
    assert b"/learning/" not in content


def test_a_detector_gives_the_same_objects(tmp_path):
    images = object_set(4)
    model = train(images, tmp_path / "model", replace(OPTIONS, task="detect"))
    written = export_model(model, tmp_path / "model.onnx", SIZE)
    assert written.difference < 1e-4
    # The file says how to use it.
    session = session_of(written.file)
    assert [(item.name, item.shape) for item in session.get_inputs()] == [("image", [1, 3, *SIZE])]
    metadata = session.get_modelmeta().custom_metadata_map
    assert json.loads(metadata["classes"]) == ["fruit", "peduncle"]
    assert json.loads(metadata["colours"]) == model.classes.colours.tolist()
    assert (metadata["task"], metadata["height"], metadata["width"]) == ("detect", "64", "96")
    assert metadata["organs"] == "fruit=pepper,peduncle"
    assert "divided by 255" in metadata["input"]
    compared = 0
    for image in images:
        outputs = run(written.file, image.colour)
        assert {name: value.shape for name, value in outputs.items()} == {
            "boxes": (100, 4), "scores": (100,), "labels": (100,), "masks": (100, 16, 24),
        }  # fmt: skip
        found = model.detections(image.colour)
        own = Detections.of_network(
            outputs["boxes"], outputs["scores"], outputs["labels"], outputs["masks"], seen=SIZE, size=SIZE
        )
        # Objects of nearly equal scores may change places; those that a user sees are far apart.
        certain = found.scores > 0.3
        compared += certain.sum()
        for name in ("scores", "labels", "cells"):
            expected = getattr(found, name)[certain]
            np.testing.assert_allclose(getattr(own, name)[: len(expected)], expected, atol=1e-4)
        np.testing.assert_allclose(own.boxes[certain], found.boxes[certain], atol=1e-2)
    assert compared >= 12


def test_a_detector_may_have_cells_that_are_equal_but_for_rounding(tmp_path):
    # torch and onnxruntime sum in different orders, so that they find other peaks among such cells.
    torch.manual_seed(0)
    classes = parse_classes("detect", None)
    network = build_network("detect", "small,width=0.3", len(classes))
    with torch.no_grad():
        network.centres.weight *= 3e-4
    model = TrainedModel(network, "small,width=0.3", classes, task="detect")
    assert export_model(model, tmp_path / "model.onnx", (32, 32)).difference < 1e-4


def test_rejects_sizes_and_missing_libraries(tmp_path, monkeypatch):
    classes = parse_classes("segment", None)
    network = build_network("segment", "small,width=0.3", len(classes))
    model = TrainedModel(network, "small,width=0.3", classes)
    with pytest.raises(ArgumentError, match="size: must be two numbers of pixels, 32 to 8192"):
        export_model(model, tmp_path / "model.onnx", (16, 64))
    monkeypatch.setitem(__import__("sys").modules, "onnxscript", None)
    with pytest.raises(SetupError, match=r"needs onnxscript.*pepperscene\[learn-onnx\]"):
        export_model(model, tmp_path / "model.onnx", SIZE)
    assert not (tmp_path / "model.onnx").exists()
