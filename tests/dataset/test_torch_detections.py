"""Boxes, masks, labels and areas of objects for detectors, against images made by hand."""

from __future__ import annotations

import numpy as np
import pytest
from memory_set import coded_set, labelled, memory_set

from pepperscene.classes import OrganClass
from pepperscene.dataset.readers import open_images
from pepperscene.dataset.readers.torch_augment import Augmentation
from pepperscene.dataset.readers.torch_augment_steps import RandomFlip, RandomResizedCrop
from pepperscene.dataset.readers.torch_images import collate_detections, torch_detections
from pepperscene.errors import InputError

torch = pytest.importorskip("torch", reason="torch is an extra, which is not installed")

PEPPER, PEDUNCLE = int(OrganClass.PEPPER), int(OrganClass.PEDUNCLE)

CLASSES = [
    [0, 0, 0, 0, 0, 0, 3, 3],
    [0, 2, 2, 2, 0, 0, 3, 0],
    [0, 2, 2, 2, 0, 1, 1, 1],
    [0, 3, 0, 0, 2, 1, 1, 1],
    [2, 0, 0, 0, 2, 255, 255, 0],
    [0, 2, 2, 0, 0, 0, 0, 255],
]
INSTANCES = [
    [0, 0, 0, 0, 0, 0, 9, 9],
    [0, 7, 7, 7, 0, 0, 9, 0],
    [0, 7, 7, 7, 0, 4, 4, 4],
    [0, 7, 0, 0, 3, 4, 4, 4],
    [3, 0, 0, 0, 3, 7, 7, 0],
    [0, 0, 0, 0, 0, 0, 0, 6],
]
"""Fruit 7 of six pixels, which has a pixel of another class and two void ones; fruit 3 in two pieces; fruit
without a number; an organ that is void."""


def plain(*images, **arguments):
    return torch_detections(memory_set(*images), tensors="plain", **arguments)


def test_objects_of_an_image_made_by_hand():
    samples = plain(labelled(CLASSES, INSTANCES), classes=("pepper", "peduncle"))
    image, target = samples[0]
    assert image.shape == (3, 6, 8)
    assert image.dtype == torch.float32
    assert set(target) == {"boxes", "labels", "masks", "image_id", "area", "iscrowd"}
    # By label, then by number: fruit 3 and 7, stalks 7 and 9.
    assert target["labels"].tolist() == [1, 1, 2, 2]
    boxes = [[0, 3, 5, 5], [1, 1, 4, 3], [1, 3, 2, 4], [6, 0, 8, 2]]
    assert target["boxes"].tolist() == boxes
    assert target["area"].tolist() == [3, 6, 1, 3]
    assert target["iscrowd"].tolist() == [0, 0, 0, 0]
    assert target["image_id"] == 0
    classes, instances = np.array(CLASSES), np.array(INSTANCES)
    objects = ((3, PEPPER), (7, PEPPER), (7, PEDUNCLE), (9, PEDUNCLE))
    for mask, (number, organ) in zip(target["masks"], objects, strict=True):
        np.testing.assert_array_equal(mask.numpy(), (instances == number) & (classes == organ))
    types = {key: target[key].dtype for key in ("boxes", "labels", "masks", "area", "iscrowd")}
    assert types == {
        "boxes": torch.float32, "labels": torch.int64, "masks": torch.uint8, "area": torch.float32,
        "iscrowd": torch.int64,
    }  # fmt: skip


def test_labels_follow_the_order_of_the_classes_and_small_objects_are_left_out():
    target = plain(labelled(CLASSES, INSTANCES), classes=(PEDUNCLE, "leaf", "pepper"))[0][1]
    assert target["labels"].tolist() == [1, 1, 2, 3, 3]
    only = plain(labelled(CLASSES, INSTANCES), classes="pepper")[0][1]
    assert only["area"].tolist() == [3, 6]
    large = plain(labelled(CLASSES, INSTANCES), classes=("pepper", "peduncle"), min_pixels=3)[0][1]
    assert large["area"].tolist() == [3, 6, 3]
    assert len(large["masks"]) == len(large["boxes"]) == 3


def test_images_without_objects_have_tensors_of_length_0():
    empty = labelled(np.zeros((5, 7)), np.zeros((5, 7)))
    void = labelled(np.full((5, 7), 255), np.full((5, 7), 3))
    for position, (image, target) in enumerate([plain(empty, void)[k] for k in range(2)]):
        assert image.shape == (3, 5, 7)
        assert target["boxes"].shape == (0, 4)
        assert target["masks"].shape == (0, 5, 7)
        assert {len(target[key]) for key in ("labels", "area", "iscrowd")} == {0}
        assert target["boxes"].dtype == torch.float32
        assert target["masks"].dtype == torch.uint8
        assert target["image_id"] == position


def reference(classes, instances, organs):
    """Label, number, mask and box of each object, one after another."""
    for label, organ in enumerate(organs, 1):
        for number in np.unique(instances[instances > 0]):
            mask = (instances == number) & (classes == organ)
            if mask.any():
                rows, columns = np.nonzero(mask)
                yield label, mask, (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)


def test_objects_of_painted_images_are_those_of_a_plain_loop(painted):
    organs = ("pepper", "peduncle", "leaf")
    samples = torch_detections(painted.folder, organs, tensors="plain")
    image, target = open_images(painted.folder)[1], samples[1][1]
    expected = list(reference(image.classes, image.instances, (PEPPER, PEDUNCLE, int(OrganClass.LEAF))))
    assert len(expected) > 10
    assert target["labels"].tolist() == [label for label, _, _ in expected]
    np.testing.assert_array_equal(target["masks"].numpy(), [mask for _, mask, _ in expected])
    np.testing.assert_array_equal(target["boxes"].numpy(), [box for _, _, box in expected])
    np.testing.assert_array_equal(target["area"].numpy(), target["masks"].sum((1, 2)).numpy())


def test_objects_are_found_after_the_augmentation():
    image = labelled(CLASSES, INSTANCES)
    target = plain(image, augmentation=Augmentation((RandomFlip(probability=1.0),)))[0][1]
    assert target["boxes"].tolist() == [[3, 3, 8, 5], [4, 1, 7, 3]]
    original = plain(image)[0][1]
    assert torch.equal(target["masks"], original["masks"].flip(-1))
    # Crops of two rows hold parts of objects; those that are too small are left out.
    crop = Augmentation((RandomResizedCrop((2, 8), scale=(1.0, 1.0)),))
    cropped = plain(image, augmentation=crop, seed=0, min_pixels=3)
    areas = set()
    for epoch in range(20):
        cropped.set_epoch(epoch)
        picture, target = cropped[0]
        assert picture.shape[1:] == target["masks"].shape[1:] == (2, 8)
        areas.add(tuple(target["area"].tolist()))
    assert areas == {(), (3.0,), (6.0,)}


class Halve:
    """A transform of image and target, which can be sent to a worker."""

    def __call__(self, image, target):
        return image[:, ::2], {**target, "boxes": target["boxes"] / 2}


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_batches_are_lists_of_images_and_targets():
    one, none = labelled(CLASSES, INSTANCES), labelled(np.zeros((4, 4)), np.zeros((4, 4)))
    samples = plain(one, none, one, transform=Halve())
    loader = torch.utils.data.DataLoader(samples, batch_size=2, num_workers=1, collate_fn=collate_detections)
    batches = list(loader)
    assert [len(images) for images, _ in batches] == [2, 1]
    images, targets = batches[0]
    assert [tuple(image.shape) for image in images] == [(3, 3, 8), (3, 2, 4)]
    assert [len(target["boxes"]) for target in targets] == [2, 0]
    assert targets[0]["boxes"][1].tolist() == [0.5, 0.5, 2.0, 1.5]
    assert [target["image_id"] for _, part in batches for target in part] == [0, 1, 2]


def test_image_id_is_the_position_also_from_the_end():
    samples = torch_detections(coded_set(4), tensors="plain")
    assert samples[-1][1]["image_id"] == 3
    assert samples[np.int64(2)][1]["image_id"] == 2
    with pytest.raises(IndexError):
        samples[4]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"classes": ()}, "classes: must be some of background, .*, each once, not none"),
        ({"classes": ("pepper", "apple")}, "classes: must be some of .*, not pepper, apple"),
        ({"classes": ("pepper", 2)}, "each once, not pepper, 2"),
        ({"classes": (255,)}, "classes: must be some of .*, not 255"),
        ({"min_pixels": 0}, "min_pixels: must be an integer from 1, not 0"),
        ({"min_pixels": 1.5}, "min_pixels: must be an integer from 1, not 1.5"),
    ],
)
def test_invalid_arguments_are_one_sentence(arguments, message):
    arguments = {"source": coded_set(1), **arguments}
    with pytest.raises(InputError, match=message) as caught:
        torch_detections(**arguments)
    assert "\n" not in str(caught.value)


def test_images_without_instance_numbers_are_refused():
    image = labelled(CLASSES, INSTANCES)
    without = memory_set(type(image)("photo", image.colour, image.classes))
    with pytest.raises(InputError, match="photo has no instances"):
        torch_detections(without)[0]
