"""Torch data sets: random numbers of workers and epochs, the tensors of torchvision, memory, and errors."""

from __future__ import annotations

import json
import pickle
import random  # noqa: TID251 - its state is compared
import shutil
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from data_sets import set_without_plants
from memory_set import SIZE, coded_arrays, coded_set, image_of, memory_set
from PIL import Image as Picture
from processes import run_python

from pepperscene.dataset.readers import open_images
from pepperscene.dataset.readers.image_set import VOID
from pepperscene.dataset.readers.torch_augment import Augmentation
from pepperscene.dataset.readers.torch_augment_steps import RandomFlip
from pepperscene.dataset.readers.torch_images import torch_detections, torch_images
from pepperscene.errors import InputError, SetupError
from pepperscene.export import Splits, export_dataset

torch = pytest.importorskip("torch", reason="torch is an extra, which is not installed")

# Python 3.12 warns of forks in processes with threads, such as those of torch.
pytestmark = pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")

ALL = ("image", "mask", "instances", "distance")
STANDARD = Augmentation.standard((24, 32))


def first(batch):
    """The only sample of a batch."""
    return batch[0]


def samples_of(dataset, workers=0, generator=None, **options):
    """The samples of one epoch, in order."""
    loader = torch.utils.data.DataLoader(
        dataset, batch_size=1, num_workers=workers, collate_fn=first, generator=generator, **options
    )
    return list(loader)


def are_equal(some, others):
    """Whether the tensors of two lists of samples are all equal."""
    assert len(some) == len(others)
    return all(
        torch.equal(one[key], other[key])
        for one, other in zip(some, others, strict=True)
        for key in one
        if key != "name"
    )


class GlobalNumbers:
    """A transform that draws from the global generators."""

    def __call__(self, sample):
        numbers = [float(torch.rand(())), np.random.random(), random.random()]  # noqa: NPY002
        return {"name": sample["name"], "numbers": torch.tensor(numbers, dtype=torch.float64)}


# Random numbers.


def test_random_numbers_depend_on_seed_epoch_and_position_only():
    def new(seed=5):
        return torch_images(coded_set(), ALL, augmentation=STANDARD, seed=seed, tensors="plain")

    expected = samples_of(new())
    assert are_equal(samples_of(new(), 2), expected)
    dataset = new()
    assert are_equal([dataset[position] for position in (4, 1, -2, 4)], [expected[k] for k in (4, 1, 4, 4)])
    # All positions, epochs and seeds have other numbers.
    dataset.set_epoch(1)
    next_epoch = samples_of(dataset)
    others = [*expected, *next_epoch, *samples_of(new(6))]
    assert len({sample["image"].numpy().tobytes() for sample in others}) == len(others)
    assert dataset.epoch == 1
    dataset.set_epoch(np.int64(0))
    assert are_equal(samples_of(dataset), expected)


@pytest.mark.parametrize("method", ["fork", pytest.param("spawn", marks=pytest.mark.long)])
def test_set_epoch_reaches_persistent_workers(method):
    if method not in torch.multiprocessing.get_all_start_methods():
        pytest.skip(f"the system cannot start processes by {method}")
    dataset = torch_images(coded_set(3), augmentation=STANDARD, seed=5, tensors="plain")
    alone = torch_images(coded_set(3), augmentation=STANDARD, seed=5, tensors="plain")
    loader = torch.utils.data.DataLoader(
        dataset, batch_size=1, num_workers=1, collate_fn=first, persistent_workers=True,
        multiprocessing_context=method,
    )  # fmt: skip
    for epoch in (0, 1, 7):
        dataset.set_epoch(epoch)
        alone.set_epoch(epoch)
        assert are_equal(list(loader), samples_of(alone))


def test_transforms_of_users_draw_the_same_numbers_for_any_workers():
    dataset = torch_images(coded_set(4), transform=GlobalNumbers(), seed=3, tensors="plain")
    expected = samples_of(dataset)
    assert len({number for sample in expected for number in sample["numbers"].tolist()}) == 12
    assert are_equal(samples_of(dataset, 2), expected)
    # The augmentation draws from a generator of its own.
    both = torch_images(
        coded_set(4), transform=GlobalNumbers(), augmentation=STANDARD, seed=3, tensors="plain"
    )
    assert are_equal(samples_of(both), expected)
    dataset.set_epoch(1)
    assert not are_equal(samples_of(dataset), expected)


def test_an_augmentation_can_be_the_transform():
    dataset = torch_images(coded_set(2), dtype="uint8", transform=STANDARD, seed=3, tensors="plain")
    assert dataset[0]["image"].shape == (3, 24, 32)
    assert are_equal([dataset[0]], [dataset[0]])


@pytest.mark.parametrize(
    "arguments",
    [{"augmentation": STANDARD}, {"transform": GlobalNumbers()}],
    ids=lambda given: next(iter(given)),
)
def test_without_a_seed_workers_follow_the_generator_of_the_loader(arguments):
    dataset = torch_images(coded_set(), tensors="plain", **arguments)

    def epoch(seed):
        return samples_of(dataset, 2, torch.Generator().manual_seed(seed))

    samples = epoch(1)
    # All images are the same; with equal generators, workers would return equal pairs.
    key = "image" if "image" in samples[0] else "numbers"
    assert len({sample[key].numpy().tobytes() for sample in samples}) == len(samples)
    assert are_equal(epoch(1), samples)
    assert not are_equal(epoch(2), samples)
    # In one process, torch's global generator counts.
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(4)
        alone = samples_of(torch_images(coded_set(), augmentation=STANDARD, tensors="plain"))
        torch.manual_seed(4)
        assert are_equal(samples_of(torch_images(coded_set(), augmentation=STANDARD, tensors="plain")), alone)


def global_states():
    kind, keys, *rest = np.random.get_state()  # noqa: NPY002
    return torch.get_rng_state().tolist(), (kind, keys.tolist(), *rest), random.getstate()


class Failing:
    """A transform that changes the global generators and fails."""

    def __call__(self, sample):
        GlobalNumbers()(sample)
        raise ZeroDivisionError


def test_global_generators_are_given_back():
    before = global_states()
    for transform in (GlobalNumbers(), None):
        dataset = torch_images(
            coded_set(), augmentation=STANDARD, transform=transform, seed=3, tensors="plain"
        )
        [dataset[position] for position in range(len(dataset))]
        assert global_states() == before
    failing = torch_images(coded_set(), transform=Failing(), seed=3, tensors="plain")
    with pytest.raises(ZeroDivisionError):
        failing[0]
    assert global_states() == before
    # Without random numbers, none are drawn, with or without a seed.
    for seed in (None, 3):
        torch_images(coded_set(), seed=seed, tensors="plain")[0]
    assert global_states() == before


# Classes.


def masks_of(dataset, **options):
    samples = torch_images(dataset.folder, "mask", tensors="plain", **options)
    return samples.classes, [samples[position]["mask"].numpy() for position in range(len(samples))]


@pytest.mark.parametrize(
    "options",
    [
        {"classes": "other=background+leaf+shoot,fruit=pepper"},
        {"classes": "ripe=pepper.ripe,green=pepper.unripe,leaf"},
        {"ripe_from": 0.4},
    ],
    ids=["with background", "ripeness", "threshold"],
)
def test_classes_are_those_of_the_semantic_export(options, labels, tmp_path):
    folder = export_dataset(labels.folder, "semantic", tmp_path / "out", **options).folder
    names, masks = masks_of(labels, **options)
    table = json.loads((folder / "classes.json").read_text())["classes"]
    assert names == tuple(one["name"] for one in table)
    for index, mask in zip(labels.indices(), masks, strict=True):
        with Picture.open(folder / "masks" / "train" / f"{index:06d}.png") as image:
            np.testing.assert_array_equal(mask, np.asarray(image))
        assert mask.dtype == np.int64


def test_mapped_classes_of_any_images_are_augmented_and_keep_void():
    arrays = coded_arrays()
    arrays["mask"][0] = 255
    images = memory_set(image_of(arrays))
    flip = Augmentation((RandomFlip(probability=1.0),))
    dataset = torch_images(images, classes="fruit=pepper+peduncle,leaf", augmentation=flip, tensors="plain")
    expected = np.select(
        [arrays["mask"] == 255, np.isin(arrays["mask"], (2, 3)), arrays["mask"] == 1], [255, 1, 2]
    )
    np.testing.assert_array_equal(dataset[0]["mask"].numpy(), expected[:, ::-1])
    assert dataset.classes == ("background", "fruit", "leaf")


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"classes": "fruit=apple"}, "'apple' is none of background, leaf"),
        ({"classes": "leaf", "ripe_from": 0.5}, "needs pepper as a class of its own"),
        ({"ripe_from": 1.5}, "1.5 must be 0 to 1"),
        ({"classes": "ripe=pepper.ripe"}, "memory does not know the ripeness of fruit"),
    ],
)
def test_invalid_classes_are_refused(options, problem):
    with pytest.raises(InputError, match=problem):
        torch_images(coded_set(1), tensors="plain", **options)


def test_ripeness_needs_the_output_harvest(labels, tmp_path):
    folder = shutil.copytree(labels.folder, tmp_path / "set")
    path = folder / "frames" / f"{labels.indices()[0]:06d}.json"
    content = json.loads(path.read_text())
    del content["outputs"]["harvest"]
    path.write_text(json.dumps(content))
    dataset = torch_images(folder, "mask", classes="ripe=pepper.ripe", tensors="plain")
    with pytest.raises(InputError, match="has no output 'harvest', which ripe and unripe fruit need"):
        dataset[0]


# Samples.


def test_samples_have_the_content_of_the_images(small):
    sample = torch_images(small.folder, ("image",), dtype="uint8")[2]
    assert sample["image"].dtype == torch.uint8
    np.testing.assert_array_equal(sample["image"].numpy().transpose(1, 2, 0), small.image(2, "colour"))
    samples = torch_images(small.folder, ALL)
    assert isinstance(samples, torch.utils.data.Dataset)
    assert len(samples) == 9
    for image, sample in zip(open_images(small.folder)[:3], samples, strict=False):
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


def test_can_be_pickled_for_spawned_workers(small):
    samples = torch_images(small.folder, transform=GlobalNumbers(), seed=1)
    copy = pickle.loads(pickle.dumps(samples))
    assert torch.equal(copy[3]["numbers"], samples[3]["numbers"])


def test_selects_the_frames_of_a_split(small):
    splits = Splits((("train", range(4)), ("val", range(4, 5))))
    names = torch_images(small.folder, splits=splits).images.names()
    assert names == ("000000", "000001", "000002", "000003")
    assert torch_images(small.folder, splits=splits, split="val").images.names() == ("000004",)
    with pytest.raises(InputError, match="'test' holds no frame of set"):
        torch_images(small.folder, splits=splits, split="test")


def test_photographs_have_void_pixels_and_lack_what_rendered_sets_have(tmp_path):
    Picture.fromarray(np.full((4, 4, 3), 100, np.uint8)).save(tmp_path / "a.png")
    Picture.fromarray(np.array([[0, 1, 2, 255]] * 4, np.uint8)).save(tmp_path / "a_mask.png")
    images = open_images(tmp_path, labels="published")
    assert torch_images(images)[0]["mask"].tolist() == [[0, 1, 2, VOID]] * 4
    with pytest.raises(InputError, match="a has no distance: leave it out of keys"):
        torch_images(images, ("image", "distance"))[0]
    with pytest.raises(InputError, match="splits: need frame indices"):
        torch_images(images, splits=Splits())


def test_augmented_samples_hold_all_keys_of_one_place():
    dataset = torch_images(coded_set(), ALL, augmentation=STANDARD, seed=1, tensors="plain")
    sample = dataset[2]
    assert list(sample) == ["name", *ALL]
    assert sample["name"] == "coded2"
    assert {tuple(sample[key].shape[-2:]) for key in ALL} == {(24, 32)}
    types = [sample[key].dtype for key in ALL]
    assert types == [torch.float32, torch.int64, torch.int64, torch.float32]
    inside = sample["instances"] > 0
    assert torch.equal(sample["distance"][inside], sample["instances"][inside].float())
    assert torch.equal(sample["mask"][inside], sample["instances"][inside] % 8)
    assert torch.isinf(sample["distance"][~inside]).all()
    assert (sample["mask"][~inside] == 255).all()


def test_samples_do_not_share_memory_with_the_images():
    images = coded_set(1)
    for dtype in ("float32", "uint8"):
        flip = Augmentation((RandomFlip(probability=1.0),))
        for augmentation in (None, flip):
            sample = torch_images(images, ALL, dtype=dtype, augmentation=augmentation, tensors="plain")[0]
            for key in ALL:
                sample[key].fill_(77)
    arrays = coded_arrays()
    np.testing.assert_array_equal(images[0].colour, arrays["image"])
    np.testing.assert_array_equal(images[0].distance_m, arrays["distance"])


def test_only_the_fields_of_the_keys_are_read():
    dataset = torch_images(coded_set(1), "mask", tensors="plain")
    assert dataset.images.fields == ("classes",)
    assert repr(dataset) == "<TorchImages memory: 1 images, mask, as plain tensors>"
    assert set(dataset[0]) == {"name", "mask"}


# Tensors of torchvision.


class TvTensor(torch.Tensor):
    @classmethod
    def make(cls, data, dtype=None, device=None, requires_grad=None):
        return torch.as_tensor(data, dtype=dtype, device=device).as_subclass(cls)


class Image(TvTensor):
    def __new__(cls, data, *, dtype=None, device=None, requires_grad=None):
        return cls.make(data, dtype, device, requires_grad)


class Mask(TvTensor):
    def __new__(cls, data, *, dtype=None, device=None, requires_grad=None):
        return cls.make(data, dtype, device, requires_grad)


class BoundingBoxes(TvTensor):
    def __new__(cls, data, *, format, canvas_size, dtype=None, device=None, requires_grad=None):
        boxes = cls.make(data, dtype, device, requires_grad)
        boxes.format, boxes.canvas_size = format, canvas_size
        return boxes


@pytest.fixture
def tv_tensors(monkeypatch):
    """A module in place of `torchvision.tv_tensors`, with the documented signatures."""
    package, module = ModuleType("torchvision"), ModuleType("torchvision.tv_tensors")
    module.Image, module.Mask, module.BoundingBoxes = Image, Mask, BoundingBoxes
    package.tv_tensors = module
    monkeypatch.setitem(sys.modules, "torchvision", package)
    monkeypatch.setitem(sys.modules, "torchvision.tv_tensors", module)


@pytest.mark.parametrize("tensors", ["auto", "tv"])
def test_samples_are_tv_tensors(tv_tensors, tensors):
    dataset = torch_images(coded_set(2), ALL, tensors=tensors)
    assert dataset.tensors == "tv"
    assert "as tv_tensors of torchvision" in repr(dataset)
    sample = dataset[0]
    types = {key: type(value) for key, value in sample.items()}
    assert types == {"name": str, "image": Image, "mask": Mask, "instances": Mask, "distance": Mask}
    image, target = torch_detections(coded_set(2), tensors=tensors)[0]
    assert type(image) is Image
    assert type(target["masks"]) is Mask
    assert type(target["boxes"]) is BoundingBoxes
    assert (target["boxes"].format, target["boxes"].canvas_size) == ("XYXY", SIZE)
    assert target["boxes"].shape == (len(target["labels"]), 4)
    assert type(target["labels"]) is torch.Tensor


def test_tv_tensors_have_the_values_of_plain_ones(tv_tensors):
    values = {}
    for tensors in ("plain", "tv"):
        dataset = torch_images(coded_set(2), ALL, tensors=tensors, augmentation=STANDARD, seed=1)
        values[tensors] = dataset[1]
    for key in ALL:
        np.testing.assert_array_equal(values["tv"][key].numpy(), values["plain"][key].numpy())
    sample = torch_images(coded_set(2), dtype="uint8", transform=STANDARD, seed=1)[0]
    assert (type(sample["image"]), type(sample["mask"])) == (Image, Mask)
    # The canvas is that of the augmented image.
    target = torch_detections(coded_set(2), augmentation=STANDARD, seed=1)[0][1]
    assert target["boxes"].canvas_size == (24, 32)


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("raise RuntimeError('operator torchvision::nms does not exist\\nsecond line')", "torchvision::nms"),
        ("raise ModuleNotFoundError(\"No module named 'torchvision'\")", "No module named 'torchvision'"),
    ],
)
def test_torchvision_that_cannot_be_imported(tmp_path, monkeypatch, line, problem):
    (tmp_path / "torchvision").mkdir()
    (tmp_path / "torchvision" / "__init__.py").write_text(line)
    monkeypatch.syspath_prepend(tmp_path)
    for name in [name for name in sys.modules if name.partition(".")[0] == "torchvision"]:
        monkeypatch.delitem(sys.modules, name)
    assert torch_images(coded_set(1)).tensors == "plain"
    assert torch_detections(coded_set(1)).tensors == "plain"
    with pytest.raises(SetupError, match=problem) as caught:
        torch_images(coded_set(1), tensors="tv")
    assert "\n" not in str(caught.value)
    assert "use tensors='plain'" in str(caught.value)


# Memory.

EPOCHS, MAX_GROWTH_MIB = 10, 4.0
"""Chosen: exceeded by .05 MiB per sample in a worker, a sixteenth of a sample's size."""

RUN = f"""
import json
import torch
from painted_set import make_painted_set
from pepperscene.dataset.readers import open_images
from pepperscene.dataset.readers.torch_augment import Augmentation
from pepperscene.dataset.readers.torch_images import torch_images

def resident():
    return int(open("/proc/self/statm").read().split()[1]) * 4096 / 2**20

def add_resident(sample):
    return {{"image": sample["image"], "mask": sample["mask"], "resident": resident()}}

make_painted_set(FOLDER, ("colour", "class"))
torch.set_num_threads(1)
images = open_images(FOLDER)
dataset = torch_images(
    images.take([position for position in range(len(images))] * 4), transform=add_resident, seed=0,
    augmentation=Augmentation.standard((180, 240)), tensors="plain",
)
loader = torch.utils.data.DataLoader(
    dataset, batch_size=4, num_workers=2, persistent_workers=True, multiprocessing_context="fork"
)
sizes = []
for epoch in range({EPOCHS}):
    dataset.set_epoch(epoch)
    workers = [float(batch["resident"].max()) for batch in loader]
    sizes.append([resident(), max(workers)])
print(json.dumps(sizes))
"""


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="the system does not report memory sizes")
def test_memory_does_not_grow_with_epochs(tmp_path):
    # With these thresholds, glibc gives freed arrays back at once, and memory does not grow by fragments.
    folders = f"FOLDER = {str(tmp_path)!r}\n"
    sizes = np.array(
        run_python(folders + RUN, MALLOC_MMAP_THRESHOLD_="65536", MALLOC_TRIM_THRESHOLD_="65536")
    )
    growth = sizes[3:].max(axis=0) - sizes[2]
    assert (growth < MAX_GROWTH_MIB).all(), sizes


# Errors.


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"keys": ()}, "keys: must be some of image, mask, .*, depth_z, .*, chlorophyll, .*, not none"),
        ({"keys": ("image", "name")}, "keys: must be some of .*, not name"),
        ({"augmentation": RandomFlip()}, "augmentation: must be an Augmentation, not RandomFlip"),
        ({"transform": 3}, "transform: must be a function, not 3"),
        ({"dtype": "uint16"}, "dtype: must be float32 or uint8, not 'uint16'"),
        ({"tensors": "torchvision"}, "tensors: must be auto, plain, tv, not 'torchvision'"),
        ({"seed": 1.5}, "seed: must be an integer from 0, or None, not 1.5"),
        ({"seed": -1}, "seed: must be an integer from 0, or None, not -1"),
        ({"splits": "train"}, "splits: need frame indices"),
        ({"source": "/no/such/folder"}, "must be a folder of images"),
    ],
)
def test_invalid_arguments_are_one_sentence(arguments, message):
    arguments = {"source": coded_set(1), **arguments}
    with pytest.raises(InputError, match=message) as caught:
        torch_images(**arguments)
    assert "\n" not in str(caught.value)


def test_invalid_epochs_are_one_sentence():
    for epoch in (-1, 0.5, "1"):
        with pytest.raises(InputError, match="epoch: must be an integer from 0, not "):
            torch_images(coded_set(1), tensors="plain").set_epoch(epoch)


def test_an_error_in_a_worker_names_the_image():
    image = coded_set(1)[0]
    dataset = torch_images(memory_set(type(image)("photo", image.colour, None)), tensors="plain")
    # The DataLoader raises another type with the same text.
    with pytest.raises(Exception, match="memory: photo has no mask: leave it out of keys"):
        samples_of(dataset, 1)


def test_depth_along_the_axis_is_read_and_moves_with_the_image(tmp_path):
    dataset = set_without_plants(tmp_path / "set", [0], ("colour", "depth_z"))
    expected = torch.from_numpy(dataset.image(0, "depth_z"))
    (plain,) = torch_images(dataset.folder, ("image", "depth_z"), tensors="plain")
    assert plain["depth_z"].dtype == torch.float32
    assert torch.equal(plain["depth_z"], expected)
    flip = Augmentation((RandomFlip(probability=1.0),))
    (flipped,) = torch_images(dataset.folder, ("image", "depth_z"), augmentation=flip, tensors="plain")
    assert torch.equal(flipped["depth_z"], expected.flip(-1))
    with pytest.raises(InputError, match="depth_z"):
        torch_images(set_without_plants(tmp_path / "other", [0], ("colour",)).folder, "depth_z")[0]
