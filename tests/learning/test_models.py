"""Networks: sizes, fields of view, options, and files."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from pepperscene.errors import ArgumentError, InputError  # noqa: E402
from pepperscene.learning.class_table import FRUIT_CLASSES, ClassTable  # noqa: E402
from pepperscene.learning.models import TrainedModel, build_model, load_model  # noqa: E402
from pepperscene.learning.models.trained_model import FORMAT, read_weights  # noqa: E402

MODELS = ("small,width=0.25", "deeplab_vgg16,width=0.05", "deeplab_vgg16,width=0.05,field=224")
FACTORIES = """
import torch
from torch import nn

class Halved(nn.Module):
    def __init__(self, classes, scale=1):
        super().__init__()
        self.layer = nn.Conv2d(3, classes, 3, stride=2, padding=1)

    def forward(self, images):
        return self.layer(images)

class Dictionary(Halved):
    def forward(self, images):
        return {"out": self.layer(images)}

def number(classes):
    return classes
"""


@pytest.fixture
def factories(tmp_path, monkeypatch):
    """A module `my_networks` in the current folder."""
    (tmp_path / "my_networks.py").write_text(FACTORIES)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))


def random_image(shape=(37, 50)):
    return np.random.default_rng(0).integers(0, 256, (*shape, 3)).astype(np.uint8)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("size", [(32, 48), (33, 47), (40, 71)])
def test_logits_have_the_size_of_the_image(model, size):
    network = build_model(model, 5).eval()
    with torch.inference_mode():
        assert network(torch.rand(2, 3, *size)).shape == (2, 5, *size)


def test_numbers_of_weights_are_those_of_the_publications():
    # Chen et al. 2015, Table 2: 65.1 and 20.5 million for 21 classes.
    for options, millions in (("", 65.1), (",field=224", 20.5)):
        with torch.device("meta"):
            network = build_model(f"deeplab_vgg16{options}", 21)
        assert sum(weight.numel() for weight in network.parameters()) / 1e6 == pytest.approx(
            millions, abs=0.06
        )
    assert sum(weight.numel() for weight in build_model("small", 8).parameters()) < 1e6


@pytest.mark.parametrize(("field", "kernel", "dilation"), [(128, 4, 4), (224, 3, 12)])
def test_deeplab_sees_the_published_field_at_stride_eight(field, kernel, dilation):
    network = build_model(f"deeplab_vgg16,width=0.02,field={field}", 2).eval()
    with torch.inference_mode():
        cells = network.features(torch.rand(1, 3, 256, 320))
    assert cells.shape[-2:] == (32, 40)
    # The reach of one output in cells: the kernel's, since all other layers of the head have one cell.
    features = torch.rand(1, cells.shape[1], 41, 41, requires_grad=True)
    for module in network.head:
        if isinstance(module, torch.nn.Conv2d):
            torch.nn.init.ones_(module.weight)
    network.head(features)[0, 0, 20, 20].backward()
    (touched,) = torch.nonzero(features.grad[0, 0].abs().sum(dim=0), as_tuple=True)
    assert int(touched.max() - touched.min()) == (kernel - 1) * dilation
    # The published field is that of the kernel without its last cell, in pixels, and a border of the cells.
    assert abs(((kernel - 1) * dilation + 1) * 8 - field) <= 32


def test_options_are_part_of_the_model(factories):
    wide, narrow = build_model("small,width=2", 8), build_model("small, width=1.0", 8)
    assert wide.stem[0].out_channels == 2 * narrow.stem[0].out_channels
    assert build_model("my_networks:Halved,scale=2", 3).layer.out_channels == 3


@pytest.mark.parametrize("name", ["Halved", "Dictionary"])
def test_networks_of_the_user_may_return_smaller_logits_or_a_dictionary(factories, name):
    model = TrainedModel(build_model(f"my_networks:{name}", 8), f"my_networks:{name}", ClassTable.organs())
    probabilities = model.probabilities(random_image())
    assert probabilities.shape == (8, 37, 50)
    np.testing.assert_allclose(probabilities.sum(axis=0), 1, atol=1e-5)


@pytest.mark.parametrize(
    ("model", "message"),
    [
        ("large", "must be small, deeplab_vgg16 or module:factory, not 'large'"),
        ("small,depth=3", "small has no option depth; its options are width"),
        ("small,width", "options are key=value, each once"),
        ("small,width=1,width=2", "options are key=value, each once"),
        ("deeplab_vgg16,field=100", "field must be 128 or 224, not 100"),
        ("no_such_module:make", "no_such_module cannot be imported"),
        ("my_networks:missing", "my_networks has no missing"),
        ("my_networks:number", "my_networks:number must return a torch.nn.Module, not int"),
    ],
)
def test_other_models_are_rejected(factories, model, message):
    with pytest.raises(ArgumentError, match=message.replace("(", "\\(")):
        build_model(model, 8)


def test_weights_of_vgg16_are_copied_by_torchvisions_names(tmp_path):
    from safetensors.torch import save_file

    source = build_model("deeplab_vgg16,width=0.05", 8)
    stored = {f"features.{name}": value for name, value in source.features.state_dict().items()}
    stored["classifier.0.weight"] = torch.zeros(3)
    file = tmp_path / "vgg.safetensors"
    save_file(stored, file)
    network = build_model(f"deeplab_vgg16,width=0.05,weights={file}", 8)
    for name, value in source.features.state_dict().items():
        assert torch.equal(network.features.state_dict()[name], value)
    with pytest.raises(InputError, match=r"must hold features.5.weight of shape \(13, 8, 3, 3\)"):
        build_model(f"deeplab_vgg16,width=0.1,weights={file}", 8)
    with pytest.raises(InputError, match="does not exist"):
        build_model(f"deeplab_vgg16,width=0.1,weights={tmp_path / 'none'}", 8)


@pytest.mark.parametrize("width", [None, 25, 50])
def test_a_model_that_is_written_and_read_predicts_the_same(tmp_path, width):
    table = ClassTable.parse(FRUIT_CLASSES)
    model = TrainedModel(build_model("small,width=0.25", 3), "small,width=0.25", table, width, {"step": 7})
    model.save(tmp_path / "model.safetensors")
    for path in (tmp_path, tmp_path / "model.safetensors"):
        read = load_model(path)
        assert read.classes == table
        assert read.training == {"step": 7}
        image = random_image()
        np.testing.assert_array_equal(read.probabilities(image), model.probabilities(image))


def test_damaged_and_foreign_files_are_rejected(tmp_path):
    model = TrainedModel(build_model("small,width=0.25", 8), "small,width=0.25", ClassTable.organs())
    file = tmp_path / "model.safetensors"
    model.save(file)
    content = file.read_bytes()

    def rejects(message, changed):
        file.write_bytes(changed)
        with pytest.raises(InputError, match=message):
            load_model(file)

    rejects("cannot be read as safetensors", content[:-100])
    rejects("cannot be read as safetensors", b"")
    rejects("holds weights of another model", content.replace(b"width=0.25", b"width=0.50"))
    rejects("is not of the format", content.replace(FORMAT.encode(), FORMAT.upper().encode()))
    # Nothing in a file is executed: a pickle, as `torch.save` writes, is no safetensors file.
    rejects("cannot be read as safetensors", pickle.dumps({"weights": 1}))
    with pytest.raises(InputError, match="does not exist; `pepperscene train` writes it"):
        load_model(tmp_path / "none")
    file.write_bytes(content)
    assert read_weights(file, FORMAT)[1]["classes"].startswith("background,leaf")
