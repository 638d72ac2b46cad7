"""Boxes, labels and masks for detection models, against images made by hand."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from torch_stand_in import MemorySet, coded_images, install_torchvision

from pepperscene.classes import OrganClass
from pepperscene.dataset import (
    Augmentation,
    RandomFlip,
    RandomResizedCrop,
    Splits,
    collate_detections,
    open_images,
    torch_detections,
)
from pepperscene.errors import ArgumentError, InputError

torch = pytest.importorskip("torch", reason="torch is an extra, which is not installed")

pytestmark = pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")

CLASSES = """
0 0 0 0 0 0 0 0
0 2 2 0 3 3 0 2
0 2 2 0 3 0 0 2
0 0 0 0 0 0 0 0
2 0 0 1 1 1 0 0
2 0 2 1 1 1 255 255
"""
INSTANCES = """
0 0 0 0 0 0 0 0
0 7 7 0 300 300 0 9
0 7 7 0 300 0 0 9
0 0 0 0 0 0 0 0
60000 0 0 5 5 5 0 0
60000 0 7 5 5 5 8 8
"""


def parse(text, dtype):
    return np.array([line.split() for line in text.strip().splitlines()]).astype(int).astype(dtype)


def made_by_hand():
    classes, instances = parse(CLASSES, np.uint8), parse(INSTANCES, np.uint16)
    colour = np.stack([classes, classes, classes], axis=-1)
    empty = (colour, np.zeros_like(classes), np.zeros_like(instances), None)
    return MemorySet(items=((colour, classes, instances, None), empty))


def test_objects_of_an_image_made_by_hand():
    samples = torch_detections(made_by_hand(), tensors="plain")
    image, target = samples[0]
    assert image.shape == (3, 6, 8)
    assert image.dtype == torch.float32
    assert list(target) == ["boxes", "labels", "masks", "image_id", "area", "iscrowd"]
    # Instance 7 is in two pieces; 255 is no object.
    assert target["boxes"].tolist() == [[1, 1, 3, 6], [7, 1, 8, 3], [0, 4, 1, 6]]
    assert target["labels"].tolist() == [1, 1, 1]
    assert target["area"].tolist() == [5, 2, 2]
    assert target["iscrowd"].tolist() == [0, 0, 0]
    assert target["image_id"] == 0
    instances = parse(INSTANCES, int)
    for mask, value in zip(target["masks"], (7, 9, 60000), strict=True):
        np.testing.assert_array_equal(mask.numpy(), instances == value)
    types = {key: value.dtype for key, value in target.items() if key != "image_id"}
    assert types == {
        "boxes": torch.float32, "labels": torch.int64, "masks": torch.uint8, "area": torch.float32,
        "iscrowd": torch.int64,
    }  # fmt: skip


def test_labels_are_positions_of_classes_from_1():
    for classes in (("peduncle", "pepper", "leaf"), (3, 2, 1), (OrganClass.PEDUNCLE, "pepper", 1)):
        _, target = torch_detections(made_by_hand(), classes, tensors="plain")[0]
        assert target["labels"].tolist() == [1, 2, 2, 2, 3]
        assert target["area"].tolist() == [3, 5, 2, 2, 6]


def test_small_objects_are_left_out():
    _, target = torch_detections(made_by_hand(), min_pixels=3, tensors="plain")[0]
    assert target["area"].tolist() == [5]
    assert target["masks"].shape == (1, 6, 8)


def test_images_without_objects_have_empty_tensors():
    samples = torch_detections(made_by_hand(), dtype="uint8", tensors="plain")
    image, target = samples[1]
    assert image.dtype == torch.uint8
    shapes = {key: tuple(value.shape) for key, value in target.items() if key != "image_id"}
    assert shapes == {"boxes": (0, 4), "labels": (0,), "masks": (0, 6, 8), "area": (0,), "iscrowd": (0,)}
    assert target["image_id"] == 1
    assert target["boxes"].dtype == torch.float32
    assert target["labels"].dtype == torch.int64


def test_one_instance_number_in_two_classes_is_two_objects():
    classes = np.array([[2, 2, 3, 255]], np.uint8)
    items = ((np.zeros((1, 4, 3), np.uint8), classes, np.full((1, 4), 4, np.uint16), None),)
    _, target = torch_detections(MemorySet(items=items), ("pepper", "peduncle"), tensors="plain")[0]
    assert target["boxes"].tolist() == [[0, 0, 2, 1], [2, 0, 3, 1]]
    assert target["labels"].tolist() == [1, 2]


def test_objects_of_a_data_set_are_those_in_its_json(painted):
    samples = torch_detections(painted.folder, ("pepper", "cut"), tensors="plain")
    for position, index in enumerate(painted.indices()):
        entries = painted.metadata(index)["instances"]
        pixels = {
            label: sorted(entry["pixels"] for entry in entries.values() if entry["class"] == organ_class)
            for label, organ_class in ((1, OrganClass.PEPPER), (2, OrganClass.CUT))
        }
        _, target = samples[position]
        for label, expected in pixels.items():
            assert sorted(target["area"][target["labels"] == label].tolist()) == expected
        assert torch.equal(target["masks"].sum((1, 2)).float(), target["area"])
        left, top, right, bottom = target["boxes"].T.int()
        for k, mask in enumerate(target["masks"]):
            assert mask[top[k] : bottom[k], left[k] : right[k]].sum() == mask.sum()
            assert mask[top[k]].any()
            assert mask[bottom[k] - 1].any()
            assert mask[:, left[k]].any()
            assert mask[:, right[k] - 1].any()


def test_boxes_are_made_from_augmented_labels():
    images, flip = made_by_hand(), Augmentation((RandomFlip(probability=1.0),))
    image, target = torch_detections(images, augmentation=flip, tensors="plain")[0]
    plain_image, plain = torch_detections(images, tensors="plain")[0]
    assert torch.equal(image, plain_image.flip(-1))
    assert target["boxes"].tolist() == [[5, 1, 7, 6], [0, 1, 1, 3], [7, 4, 8, 6]]
    assert torch.equal(target["masks"], plain["masks"].flip(-1))
    crops = Augmentation((RandomResizedCrop((5, 5)),))
    samples = torch_detections(images, augmentation=crops, min_pixels=2, seed=0, tensors="plain")
    counts = set()
    for epoch in range(30):
        samples.set_epoch(epoch)
        image, target = samples[0]
        assert image.shape == (3, 5, 5)
        assert target["masks"].shape[1:] == (5, 5)
        assert (target["area"] >= 2).all()
        assert (target["boxes"][:, 2:] > target["boxes"][:, :2]).all()
        counts.add(len(target["labels"]))
    assert len(counts) > 2


def test_types_of_torchvision(monkeypatch):
    tv_tensors, v2 = install_torchvision(monkeypatch, torch)
    image, target = torch_detections(made_by_hand())[0]
    assert type(image) is tv_tensors.Image
    assert type(target["boxes"]) is tv_tensors.BoundingBoxes
    assert target["boxes"].format == "XYXY"
    assert target["boxes"].canvas_size == (6, 8)
    assert type(target["masks"]) is tv_tensors.Mask
    assert type(target["labels"]) is torch.Tensor
    assert torch_detections(made_by_hand())[1][1]["boxes"].shape == (0, 4)
    flipped_image, flipped = torch_detections(made_by_hand(), transform=v2.RandomHorizontalFlip(p=1.0))[0]
    assert torch.equal(flipped_image.as_subclass(torch.Tensor), image.as_subclass(torch.Tensor).flip(-1))
    assert flipped["boxes"].tolist() == [[5, 1, 7, 6], [0, 1, 1, 3], [7, 4, 8, 6]]
    assert flipped["labels"].tolist() == [1, 1, 1]


@pytest.mark.parametrize("workers", [0, 2])
def test_batches_are_two_lists(workers):
    samples = torch_detections(made_by_hand(), tensors="plain")
    loader = torch.utils.data.DataLoader(
        samples, batch_size=2, num_workers=workers, collate_fn=collate_detections
    )
    ((images, targets),) = list(loader)
    assert isinstance(images, list)
    assert isinstance(targets, list)
    assert [target["image_id"] for target in targets] == [0, 1]
    assert [len(target["labels"]) for target in targets] == [3, 0]
    assert torch.equal(images[0], samples[0][0])


def test_splits_and_pickling(small):
    splits = Splits((("train", range(4)), ("val", range(4, 5))))
    samples = torch_detections(small.folder, splits=splits, split="val", tensors="plain")
    assert samples.images.names() == ("000004",)
    copy = pickle.loads(pickle.dumps(samples))
    assert torch.equal(copy[0][0], samples[0][0])
    assert repr(samples) == "<TorchDetections set: 1 images, image, mask, instances, as plain tensors>"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"classes": ("tomato",)}, "classes: must be some of background, leaf, .*, each once, not tomato"),
        ({"classes": ()}, "classes: must be some of .*, not none"),
        ({"classes": ("pepper", 2)}, "classes: must be some of .*, each once, not pepper, 2"),
        ({"classes": (8,)}, "classes: must be some of .*, not 8"),
        ({"min_pixels": 0}, "min_pixels: must be an integer from 1, not 0"),
        ({"dtype": "int8"}, "dtype: must be float32 or uint8"),
    ],
)
def test_rejects_invalid_arguments(arguments, message):
    with pytest.raises(ArgumentError, match=message):
        torch_detections(coded_images(), **arguments)


def test_images_without_instances_are_an_input_error(tmp_path):
    from PIL import Image

    Image.fromarray(np.full((4, 4, 3), 100, np.uint8)).save(tmp_path / "a.png")
    Image.fromarray(np.array([[0, 1, 2, 255]] * 4, np.uint8)).save(tmp_path / "a_mask.png")
    images = open_images(tmp_path, labels="published")
    with pytest.raises(InputError, match="a has no instances, which detections need"):
        torch_detections(images, tensors="plain")[0]
