"""Labelled pictures as a torch data set."""

from __future__ import annotations

import builtins
import pickle
import sys

import numpy as np
import pytest
from small_set import FRAMES, make_small_set

from pepperscene.dataset.export import Splits
from pepperscene.dataset.readers import open_images
from pepperscene.dataset.readers.image_set import VOID
from pepperscene.dataset.readers.torch_images import torch_images
from pepperscene.errors import InputError, SetupError

ALL = ("image", "mask", "instances", "distance")


@pytest.fixture
def torch():
    return pytest.importorskip("torch", reason="torch is an extra, which this environment lacks")


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    return make_small_set(tmp_path_factory.mktemp("made") / "set")


class Mirrored:
    """A transform that a worker can be sent."""

    def __call__(self, sample):
        return {key: value if key == "name" else value.flip(-1) for key, value in sample.items()}


def test_samples_hold_what_the_pictures_hold(torch, built):
    found = torch_images(built.folder, ALL)
    assert isinstance(found, torch.utils.data.Dataset)
    assert len(found) == FRAMES
    for picture, sample in zip(open_images(built.folder), found, strict=False):
        assert sample["name"] == picture.name
        assert sample["image"].dtype == torch.float32
        assert sample["image"].shape == (3, *picture.size)
        assert float(sample["image"].max()) <= 1.0
        restored = np.rint(255 * sample["image"].numpy()).astype(np.uint8).transpose(1, 2, 0)
        np.testing.assert_array_equal(restored, picture.colour)
        for key, array in (("mask", picture.classes), ("instances", picture.instances)):
            assert sample[key].dtype == torch.int64
            np.testing.assert_array_equal(sample[key].numpy(), array)
        np.testing.assert_array_equal(sample["distance"].numpy(), picture.distance_m)


def test_bytes_stay_bytes_when_wanted(torch, built):
    sample = torch_images(built.folder, ("image",), dtype="uint8")[2]
    assert sample["image"].dtype == torch.uint8
    np.testing.assert_array_equal(sample["image"].numpy().transpose(1, 2, 0), built.image(2, "colour"))
    assert set(sample) == {"image", "name"}


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_workers_read_side_by_side(torch, built):
    found = torch_images(built.folder, ALL, transform=Mirrored())
    loader = torch.utils.data.DataLoader(found, batch_size=2, num_workers=2)
    batches = list(loader)
    assert [name for batch in batches for name in batch["name"]] == list(found.images.names())
    masks = torch.cat([batch["mask"] for batch in batches])
    for index, mask in enumerate(masks):
        np.testing.assert_array_equal(mask.numpy(), built.image(index, "class")[:, ::-1])


def test_a_data_set_can_be_sent_to_a_spawned_worker(torch, built):
    found = torch_images(built.folder, transform=Mirrored())
    again = pickle.loads(pickle.dumps(found))
    assert torch.equal(again[3]["image"], found[3]["image"])


def test_only_the_frames_of_a_split_are_there(torch, built):
    splits = Splits((("train", range(4)), ("val", range(4, 5))))
    assert torch_images(built.folder, splits=splits).images.names() == (
        "000000",
        "000001",
        "000002",
        "000003",
    )
    assert torch_images(built.folder, splits=splits, split="val").images.names() == ("000004",)
    with pytest.raises(InputError, match="'test' holds no frame of set"):
        torch_images(built.folder, splits=splits, split="test")


def test_masks_of_photographs_can_be_learned_from(torch, tmp_path):
    from PIL import Image

    Image.fromarray(np.full((4, 4, 3), 100, np.uint8)).save(tmp_path / "a.png")
    ids = np.array([[0, 1, 2, 255]] * 4, np.uint8)
    Image.fromarray(ids).save(tmp_path / "a_mask.png")
    images = open_images(tmp_path, labels="published")
    sample = torch_images(images)[0]
    # A prediction that is right wherever something is known has no loss, whatever it says of the rest.
    right = 100.0 * torch.nn.functional.one_hot(sample["mask"].clamp(max=7), 8).permute(2, 0, 1)
    loss = torch.nn.functional.cross_entropy(right[None], sample["mask"][None], ignore_index=VOID)
    assert float(loss) == pytest.approx(0.0, abs=1e-6)
    with pytest.raises(InputError, match="a has no distance: leave it out of keys"):
        torch_images(images, ("image", "distance"))[0]
    with pytest.raises(InputError, match="splits: go by frame index"):
        torch_images(images, splits=Splits())


def test_arguments_are_checked(built):
    with pytest.raises(InputError, match="must be some of image, mask, instances, distance, not depth"):
        torch_images(built.folder, ("image", "depth"))
    with pytest.raises(InputError, match="must be float32 or uint8, not 'int8'"):
        torch_images(built.folder, dtype="int8")


def test_without_torch_one_sentence_tells_what_to_install(built, monkeypatch):
    found = builtins.__import__

    def without(name, *args, **kwargs):
        if name.partition(".")[0] == "torch":
            raise ModuleNotFoundError("No module named 'torch'", name="torch")
        return found(name, *args, **kwargs)

    monkeypatch.delitem(sys.modules, "pepperscene.dataset.readers.torch_dataset", raising=False)
    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(SetupError, match="`pip install torch`"):
        torch_images(built.folder)
