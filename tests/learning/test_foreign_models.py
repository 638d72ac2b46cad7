"""Models from strangers: what a file names is never imported; a user's own factory comes from the user."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest
from commands import rejected, run
from painted_bands import CLASSES, write_bands
from PIL import Image

from pepperscene.errors import ArgumentError, InputError

torch = pytest.importorskip("torch", reason="the extra `learn` installs torch")
pytest.importorskip("safetensors.torch", reason="the extra `learn` installs safetensors")

from pepperscene.learning.class_table import ClassTable  # noqa: E402
from pepperscene.learning.models import TrainedModel, build_model, load_model  # noqa: E402
from pepperscene.learning.models.trained_model import apply_model, weights_as_bytes  # noqa: E402

NEEDS_CODE = "runs only with --allow-code (in Python, allow_code=True)"
MODULE = """
open({marker!r}, "a").close()
from torch import nn
def make(classes, channels=4):
    open({marker!r}, "a").close()
    return nn.Sequential(nn.Conv2d(3, channels, 3, 2, 1), nn.Conv2d(channels, classes, 1))
def leave(classes):
    raise SystemExit(7)
class Leaving(nn.Conv2d):
    def __init__(self, classes):
        super().__init__(3, classes, 1)
    def forward(self, images):
        raise SystemExit(7)
"""
NAMES = (
    "evil_net:make", " evil_net : make ", "evil_net:make,channels=4", "../evil_net:make", "os:_exit",
    "evil_net:make.__globals__", "pepperscene.learning.models.registry:build_model", "small:make", ":make",
    "\x00", ["evil_net:make"], {"module": "evil_net"},
)  # fmt: skip
TINY = ("--steps", "1", "--batch", "1", "--size", "32x32", "--width", "0")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, with a module that leaves a file when it is imported."""
    (tmp_path / "evil_net.py").write_text(MODULE.format(marker=str(tmp_path / "marker")))
    Image.fromarray(np.zeros((32, 32, 3), np.uint8)).save(tmp_path / "photo.png")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path])
    yield tmp_path
    sys.modules.pop("evil_net", None)


@pytest.fixture(scope="module")
def sets(tmp_path_factory):
    return write_bands(tmp_path_factory.mktemp("bands") / "set", 2)


def write_model(folder, name, classes=CLASSES):
    """A model file whose description names a model."""
    module = torch.nn.Sequential(torch.nn.Conv2d(3, 4, 3, 2, 1), torch.nn.Conv2d(4, 4, 1))
    model = TrainedModel(module, name, ClassTable.parse(classes))
    content = weights_as_bytes(module.state_dict(), model.description())
    (folder / "model.safetensors").write_bytes(content)


def test_a_model_file_names_models_of_this_package_only(folder, sets):
    before = {*folder.iterdir(), folder / "model.safetensors"}
    for name in NAMES:
        write_model(folder, name)
        with pytest.raises(InputError):
            load_model(folder, allow_code=True)
    write_model(folder, "evil_net:make")
    for words in (
        ("predict", ".", "photo.png", "--out", "out"),
        ("evaluate", "model.safetensors", sets, "--allow-code"),
        ("train", sets, "--start", ".", "--out", "out", "--allow-code", *TINY),
        ("experiments", sets, "--real", sets, "--other", ".", "--out", "out", "--steps", 1, "--seeds", 1),
    ):
        assert "model.safetensors: " in rejected(*words)
    message = rejected("predict", ".", "photo.png", "--out", "out")
    assert "model.safetensors: model = 'evil_net:make': is none of small, " in message
    assert "a network of your own needs --factory module:name and --allow-code" in message
    for words in (
        ("predict", ".", "photo.png", "--out", "out", "--factory", "evil_net:make"),
        ("experiments", sets, "--real", sets, "--out", "out", "--model", "evil_net:make"),
    ):
        assert f": the code of evil_net:make {NEEDS_CODE}\n" in rejected(*words)
    with pytest.raises(ArgumentError, match="allow_code=True"):
        load_model(folder, factory="evil_net:make")
    assert {*folder.iterdir()} == before
    assert "evil_net" not in sys.modules


def test_initial_weights_that_a_model_file_names_are_not_read(folder):
    """They are read before a training only, where the user has named them."""
    model = build_model("deeplab_vgg16,width=0.02", 4)
    described = TrainedModel(model, "deeplab_vgg16,width=0.02,weights=/dev/zero", ClassTable.parse(CLASSES))
    content = weights_as_bytes(model.state_dict(), described.description())
    (folder / "model.safetensors").write_bytes(content)
    assert load_model(folder).model == "deeplab_vgg16,width=0.02"


def test_a_factory_of_the_user_needs_the_permission_each_time(folder, sets):
    words = ("train", sets, "--out", "mine", "--model", "evil_net:make,channels=3", *TINY)
    assert rejected(*words) == f"error: --model: the code of evil_net:make {NEEDS_CODE}\n"
    assert not (folder / "mine").exists()
    assert not (folder / "marker").exists()

    assert run(*words, "--allow-code").exit_code == 0
    assert (folder / "marker").exists()
    own = ("--factory", "evil_net:make,channels=3", "--allow-code")
    assert run("predict", "mine", "photo.png", "--out", "seen", *own).exit_code == 0
    assert run("evaluate", "mine", sets, *own).exit_code == 0
    started = run("train", sets, "--start", "mine", "--out", "next", "--model", own[1], "--allow-code", *TINY)
    assert started.exit_code == 0, started.output
    assert run(*words, "--allow-code", "--resume").exit_code == 0
    for file in (folder / "mine").iterdir():
        assert b"allow_code" not in file.read_bytes()
    # Another network than that of the file.
    words = ("predict", "mine", "photo.png", "--out", "o", "--factory", "evil_net:make", "--allow-code")
    assert "holds weights of another model" in rejected(*words)


def test_a_factory_does_not_replace_a_model_of_this_package(folder, sets):
    assert run("train", sets, "--out", "small", "--model", "small,width=0.3", *TINY).exit_code == 0
    own = ("evil_net:make", "--allow-code")
    error = rejected("predict", "small", "photo.png", "--out", "out", "--factory", *own)
    assert error == "error: --factory: does not apply to small,width=0.3, a model of this package\n"
    error = rejected("train", sets, "--start", "small", "--out", "out", "--model", *own, *TINY)
    assert error == "error: --model: cannot be combined with --start, which has a model\n"
    assert not (folder / "marker").exists()
    assert not (folder / "out").exists()


def test_the_folder_of_a_training_names_nothing_to_import(folder, sets):
    """Its state records the options of the training, which a resumption compares and does not follow."""
    words = ("train", sets, "--out", "mine", "--model", "small,width=0.3", *TINY)
    assert run(*words).exit_code == 0
    for name in ("state.safetensors", "model.safetensors"):
        file = folder / "mine" / name
        content = file.read_bytes()
        assert b"small,width=0.3" in content
        file.write_bytes(content.replace(b"small,width=0.3", b"evil_net:make,a"))
    assert "'evil_net:make,a' there and 'small,width=0.3' here" in rejected(*words, "--resume")
    (folder / "mine" / "state.safetensors").unlink()
    rejected(*words, "--resume")
    assert not (folder / "marker").exists()


def test_a_factory_or_network_that_exits_is_one_sentence(folder, sets):
    (folder / "leaving_net.py").write_text("raise SystemExit(7)")
    for model, message in (
        ("evil_net:leave", "evil_net:leave cannot be made (SystemExit: 7)"),
        ("evil_net:Leaving", "the network failed with SystemExit: 7"),
        ("leaving_net:make", "leaving_net cannot be imported (SystemExit: 7)"),
    ):
        error = rejected("train", sets, "--out", "out", "--model", model, "--allow-code", *TINY)
        assert error == f"error: --model: {message}\n"


def test_a_network_without_memory_is_reported_as_such(folder):
    class Greedy(torch.nn.Module):
        def forward(self, images):
            raise RuntimeError("CUDA out of memory")

    with pytest.raises(RuntimeError, match="out of memory"):
        apply_model(Greedy(), torch.zeros(1, 3, 4, 4))


def test_the_current_folder_is_searched_during_an_allowed_import_only(folder):
    before = list(sys.path)
    build_model("evil_net:make", 3, allow_code=True)
    assert sys.path == before
    (folder / "failing_net.py").write_text("import nothing_of_this_name")
    with pytest.raises(ArgumentError):
        build_model("failing_net:make", 3, allow_code=True)
    assert sys.path == before
    with pytest.raises(ArgumentError):
        build_model("evil_net:make", 3)
    assert json.dumps(sys.path) == json.dumps(before)
