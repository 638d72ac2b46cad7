"""Sets of labelled images that are read on access, and the torch data set of their samples."""

from __future__ import annotations

import builtins
import pickle
import sys
from dataclasses import dataclass

import numpy as np
import pytest
from data_sets import FRAMES

from pepperscene.dataset.readers import open_images
from pepperscene.dataset.readers.image_set import FIELDS, VOID, ImageSet, LabelledImage
from pepperscene.dataset.readers.torch_images import torch_images
from pepperscene.errors import InputError, SetupError
from pepperscene.export import Splits


@dataclass(frozen=True, eq=False, kw_only=True)
class LoggedSet(ImageSet):
    """Images of one grey each, and a log of those that were read."""

    log: list

    def names(self):
        return tuple(str(item) for item in self.items)

    def read(self, item):
        self.log.append(item)
        grey = np.full((2, 3, 3), item, np.uint8)
        return LabelledImage(str(item), grey if "colour" in self.fields else None, None)


@pytest.fixture
def images():
    return LoggedSet(name="logged", items=tuple(range(10)), log=[])


def test_set_is_a_sequence_that_is_read_on_access(images):
    part = images[2:8:2]
    assert images.log == []
    assert part.names() == ("2", "4", "6")
    assert part[-1].name == "6"
    assert images.log == [6]
    assert len(images) == 10
    assert [image.name for image in images] == list(images.names())
    with pytest.raises(IndexError):
        images[10]
    part = images.take([7, 1])
    assert isinstance(part, LoggedSet)
    assert part.names() == ("7", "1")


def test_fields_that_are_not_selected_are_not_read(images):
    assert images.fields == FIELDS
    assert images.select("colour")[0].colour is not None
    empty = images.select()[0]
    assert empty.colour is None
    with pytest.raises(ValueError, match="holds no image"):
        _ = empty.size
    with pytest.raises(ValueError, match="unknown fields depth; allowed are colour"):
        images.select("depth")


def test_rejects_arrays_of_different_sizes():
    with pytest.raises(ValueError, match="differ in size"):
        LabelledImage("one", np.zeros((2, 3, 3), np.uint8), np.zeros((3, 2), np.uint8))


def test_size_is_that_of_any_array():
    image = LabelledImage("one", None, None, distance_m=np.zeros((4, 5), np.float32))
    assert image.size == (4, 5)
    assert pickle.loads(pickle.dumps(image)).size == (4, 5)


ALL = ("image", "mask", "instances", "distance")


@pytest.fixture
def torch():
    return pytest.importorskip("torch", reason="torch is an extra, which is not installed")


class Mirror:
    """A transform that can be sent to a worker."""

    def __call__(self, sample):
        return {key: value if key == "name" else value.flip(-1) for key, value in sample.items()}


def test_samples_have_the_content_of_the_images(torch, small):
    samples = torch_images(small.folder, ALL)
    assert isinstance(samples, torch.utils.data.Dataset)
    assert len(samples) == FRAMES
    for image, sample in zip(open_images(small.folder), samples, strict=False):
        assert sample["name"] == image.name
        assert sample["image"].dtype == torch.float32
        assert sample["image"].shape == (3, *image.size)
        assert float(sample["image"].max()) <= 1.0
        colour = np.rint(255 * sample["image"].numpy()).astype(np.uint8).transpose(1, 2, 0)
        np.testing.assert_array_equal(colour, image.colour)
        for key, array in (("mask", image.classes), ("instances", image.instances)):
            assert sample[key].dtype == torch.int64
            np.testing.assert_array_equal(sample[key].numpy(), array)
        np.testing.assert_array_equal(sample["distance"].numpy(), image.distance_m)


def test_image_can_be_uint8(torch, small):
    sample = torch_images(small.folder, ("image",), dtype="uint8")[2]
    assert sample["image"].dtype == torch.uint8
    np.testing.assert_array_equal(sample["image"].numpy().transpose(1, 2, 0), small.image(2, "colour"))
    assert set(sample) == {"image", "name"}


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_workers_read_in_parallel(torch, small):
    samples = torch_images(small.folder, ALL, transform=Mirror())
    batches = list(torch.utils.data.DataLoader(samples, batch_size=2, num_workers=2))
    assert [name for batch in batches for name in batch["name"]] == list(samples.images.names())
    masks = torch.cat([batch["mask"] for batch in batches])
    for index, mask in enumerate(masks):
        np.testing.assert_array_equal(mask.numpy(), small.image(index, "class")[:, ::-1])


def test_can_be_pickled_for_spawned_workers(torch, small):
    samples = torch_images(small.folder, transform=Mirror())
    copy = pickle.loads(pickle.dumps(samples))
    assert torch.equal(copy[3]["image"], samples[3]["image"])


def test_selects_the_frames_of_a_split(torch, small):
    splits = Splits((("train", range(4)), ("val", range(4, 5))))
    names = torch_images(small.folder, splits=splits).images.names()
    assert names == ("000000", "000001", "000002", "000003")
    assert torch_images(small.folder, splits=splits, split="val").images.names() == ("000004",)
    with pytest.raises(InputError, match="'test' holds no frame of set"):
        torch_images(small.folder, splits=splits, split="test")


def test_masks_of_photographs_are_training_targets(torch, tmp_path):
    from PIL import Image

    Image.fromarray(np.full((4, 4, 3), 100, np.uint8)).save(tmp_path / "a.png")
    Image.fromarray(np.array([[0, 1, 2, 255]] * 4, np.uint8)).save(tmp_path / "a_mask.png")
    images = open_images(tmp_path, labels="published")
    sample = torch_images(images)[0]
    # A prediction that is correct at labelled pixels has no loss, for any values at void pixels.
    correct = 100.0 * torch.nn.functional.one_hot(sample["mask"].clamp(max=7), 8).permute(2, 0, 1)
    loss = torch.nn.functional.cross_entropy(correct[None], sample["mask"][None], ignore_index=VOID)
    assert float(loss) == pytest.approx(0.0, abs=1e-6)
    with pytest.raises(InputError, match="a has no distance: leave it out of keys"):
        torch_images(images, ("image", "distance"))[0]
    with pytest.raises(InputError, match="splits: need frame indices"):
        torch_images(images, splits=Splits())


def test_missing_torch_is_a_setup_error(small, monkeypatch):
    original = builtins.__import__

    def import_without_torch(name, *args, **kwargs):
        if name.partition(".")[0] == "torch":
            raise ModuleNotFoundError("No module named 'torch'", name="torch")
        return original(name, *args, **kwargs)

    monkeypatch.delitem(sys.modules, "pepperscene.dataset.readers.torch_data", raising=False)
    monkeypatch.setattr(builtins, "__import__", import_without_torch)
    with pytest.raises(SetupError, match="`pip install torch`"):
        torch_images(small.folder)
