"""Values of model files and of the model's options are checked before anything is built from them."""

from __future__ import annotations

import json

import numpy as np
import pytest

from pepperscene.errors import InputError
from pepperscene.learning.class_table import ClassTable

torch = pytest.importorskip("torch", reason="the extra `learn` installs torch")
pytest.importorskip("safetensors", reason="the extra `learn` installs safetensors")

from safetensors.torch import save_file  # noqa: E402

from pepperscene.learning.evaluation.evaluate import predict_classes  # noqa: E402
from pepperscene.learning.models import TrainedModel, build_model, large_images, load_model  # noqa: E402
from pepperscene.learning.models.trained_model import weights_as_bytes  # noqa: E402

MODEL = "small,width=0.3"


@pytest.fixture(scope="module")
def trained():
    """A network with random weights and statistics."""
    torch.manual_seed(0)
    module = build_model(MODEL, 8)
    for layer in module.modules():
        if isinstance(layer, torch.nn.BatchNorm2d):
            layer.running_mean.uniform_(-0.1, 0.1)
            layer.running_var.uniform_(0.5, 1.5)
    return TrainedModel(module, MODEL, ClassTable.organs(), None, {"step": 1, "validation_mean_iou": None})


@pytest.fixture
def write_model(trained, tmp_path):
    """Write a model file with other values in its description; `...` leaves a key out."""

    def write(**changes):
        description = {**trained.description(), **changes}
        content = {key: value for key, value in description.items() if value is not ...}
        # Another program may write what JSON does not know.
        text = {"description": json.dumps(content)}
        save_file(trained.module.state_dict(), tmp_path / "model.safetensors", text)
        return tmp_path

    return write


WRONG = [
    *(("width", value) for value in (-5, "abc", 1e8, 10**8, True, float("nan"), [400], 0, ...)),
    *(("classes", value) for value in ("leaf", "apple,leaf", 5, None, "x" * 5000, ..., "leaf,stem")),
    *(("training", value) for value in ("abc", ["a"], None, ...)),
    *(("model", f"small,width={value}") for value in (100000, "nan", -1, "inf", "wide")),
    *(("model", value) for value in (7, "small", "deeplab_vgg16,width=0.02", "other_nets:half", "", None)),
    ("format", "pepperscene training 1"),
    ("other", 1),
]


@pytest.mark.parametrize(("key", "value"), WRONG, ids=lambda value: str(value)[:20])
def test_a_wrong_value_of_a_model_file_is_one_sentence(write_model, key, value):
    folder = write_model(**{key: value})
    with pytest.raises(InputError) as caught:
        load_model(folder)
    assert str(caught.value).startswith(f"{folder / 'model.safetensors'}: ")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 1000 or "holds weights of another model" in str(caught.value)


def test_a_description_that_is_nested_without_end_is_one_sentence(write_model, trained, monkeypatch):
    monkeypatch.setattr(json, "dumps", lambda *_args, **_keys: "[" * 100_000)
    folder = write_model()
    with pytest.raises(InputError, match="cannot be read as safetensors"):
        load_model(folder)


@pytest.mark.parametrize(("key", "value"), [("step", -1), ("step", "a"), ("best", "a"), ("record", [])])
def test_a_wrong_value_of_a_training_state_is_one_sentence(trained, tmp_path, key, value):
    from pepperscene.learning.training.checkpoint import FORMAT, STATE_FILE, read_state

    description = {"format": FORMAT, "step": 1, "best": None, "best_step": 1, "record": {}, key: value}
    content = weights_as_bytes({f"model.{k}": v for k, v in trained.module.state_dict().items()}, description)
    (tmp_path / STATE_FILE).write_bytes(content)
    optimiser = torch.optim.Adam(trained.module.parameters())
    with pytest.raises(InputError, match=rf"{STATE_FILE}: {key}"):
        read_state(tmp_path, trained.module, optimiser, {})


@pytest.mark.parametrize(
    ("shape", "width", "limits"),
    [
        ((70, 1500, 3), None, {"MOST_WHOLE": 20_000, "TILE": 256}),
        ((211, 307, 3), 64, {"MOST_WHOLE": 1000, "_STRIP": 5000}),
    ],
    ids=["tiles", "strips of the scaled image"],
)
def test_parts_give_the_probabilities_of_the_whole_image(trained, monkeypatch, shape, width, limits):
    colour = np.random.default_rng(0).integers(0, 256, shape, np.uint8)
    model = TrainedModel(trained.module, MODEL, trained.classes, width)
    whole = model.probabilities(colour)
    for name, value in limits.items():
        monkeypatch.setattr(large_images, name, value)
    joined = np.full_like(whole, np.nan)
    for (rows, columns), part in large_images.probability_parts(model, colour):
        joined[:, rows, columns] = part
    assert np.abs(joined - whole).max() < 1e-6
    assert (predict_classes(model, colour) == whole.argmax(axis=0)).mean() > 0.9999


def test_an_image_that_would_be_enlarged_beyond_all_bounds_is_refused(trained):
    model = TrainedModel(trained.module, MODEL, trained.classes, 8192)
    with pytest.raises(InputError, match=r"1 x 30000 pixels, and 8192 x 245760000 at the model's width"):
        predict_classes(model, np.zeros((30_000, 1, 3), np.uint8))
