"""Samples for torch: types of tensors, transforms, seeds, workers and memory."""

from __future__ import annotations

import json
import os
import pickle
import random  # noqa: TID251 - a transform of a user may use it
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from stand_in import PYTHONPATH
from torch_stand_in import coded_images, install_torchvision, remove_torchvision

from pepperscene.dataset import Augmentation, torch_images
from pepperscene.errors import ArgumentError, SetupError

torch = pytest.importorskip("torch", reason="torch is an extra, which is not installed")

KEYS = ("image", "mask", "instances", "distance")

pytestmark = pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")


@pytest.fixture
def tv_tensors(monkeypatch):
    return install_torchvision(monkeypatch, torch)[0]


@pytest.fixture
def without_torchvision(monkeypatch):
    remove_torchvision(monkeypatch)


@pytest.mark.usefixtures("without_torchvision")
def test_tensors_are_plain_where_torchvision_is_missing():
    samples = torch_images(coded_images(), KEYS)
    assert samples.tensors == "plain"
    assert all(type(samples[0][key]) is torch.Tensor for key in KEYS)
    assert repr(samples) == (
        "<TorchImages memory: 4 images, image, mask, instances, distance, as plain tensors>"
    )
    with pytest.raises(
        SetupError, match=r"^torchvision.tv_tensors cannot be imported \(.*\); install a torchvi"
    ):
        torch_images(coded_images(), tensors="tv")


def test_torchvision_of_another_build_is_a_setup_error(monkeypatch):
    import importlib

    def fail(name):
        raise RuntimeError("operator torchvision::nms does not exist\nstack of the failure")

    monkeypatch.setattr(importlib, "import_module", fail)
    assert torch_images(coded_images()).tensors == "plain"
    with pytest.raises(SetupError) as caught:
        torch_images(coded_images(), tensors="tv")
    message = "torchvision.tv_tensors cannot be imported (operator torchvision::nms does not exist); install"
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)


def test_tensors_are_those_of_torchvision_where_it_can_be_imported(tv_tensors):
    samples = torch_images(coded_images(), KEYS)
    assert samples.tensors == "tv"
    assert "as tv_tensors of torchvision" in repr(samples)
    sample, plain = samples[2], torch_images(coded_images(), KEYS, tensors="plain")[2]
    assert type(sample["image"]) is tv_tensors.Image
    for key in KEYS[1:]:
        assert type(sample[key]) is tv_tensors.Mask
    for key in KEYS:
        assert type(plain[key]) is torch.Tensor
        assert sample[key].dtype == plain[key].dtype
        assert torch.equal(sample[key].as_subclass(torch.Tensor), plain[key])


def test_transforms_of_torchvision_move_image_and_labels_together(monkeypatch):
    _, v2 = install_torchvision(monkeypatch, torch)
    samples = torch_images(coded_images(), KEYS, transform=v2.RandomHorizontalFlip(p=1.0), tensors="tv")
    plain = torch_images(coded_images(), KEYS, tensors="plain")
    sample = samples[1]
    assert sample["name"] == "image1"
    for key in KEYS:
        assert torch.equal(sample[key].as_subclass(torch.Tensor), plain[1][key].flip(-1))


def test_augmentation_comes_before_tensors_and_transform(tv_tensors):
    augmentation = Augmentation.standard((24, 32))
    samples = torch_images(coded_images(), KEYS, augmentation=augmentation, transform=_types, seed=0)
    types, shapes, dtypes = samples[0]
    assert types == [tv_tensors.Image, *[tv_tensors.Mask] * 3]
    assert shapes == [(3, 24, 32), (24, 32), (24, 32), (24, 32)]
    assert dtypes == [torch.float32, torch.int64, torch.int64, torch.float32]


def _types(sample):
    tensors = [sample[key] for key in KEYS]
    return (
        [type(tensor) for tensor in tensors],
        [tuple(tensor.shape) for tensor in tensors],
        [tensor.dtype for tensor in tensors],
    )


class RandomNumbers:
    """A transform that adds the next number of each global generator."""

    def __call__(self, sample):
        numbers = [float(torch.rand(())), np.random.random(), random.random()]  # noqa: NPY002
        return {**sample, "numbers": torch.tensor(numbers)}


def read_all(samples, workers, **options):
    loader = torch.utils.data.DataLoader(samples, batch_size=2, num_workers=workers, **options)
    batches = list(loader)
    return {key: torch.cat([batch[key] for batch in batches]) for key in ("image", "mask", "numbers")}


def same(one, two):
    return {key: torch.equal(one[key], two[key]) for key in one}


ALL_SAME = {"image": True, "mask": True, "numbers": True}


def augmented(seed, count=7):
    augmentation = Augmentation.standard((24, 32))
    return torch_images(
        coded_images(count), augmentation=augmentation, transform=RandomNumbers(), seed=seed, tensors="plain"
    )


def test_samples_with_a_seed_do_not_depend_on_workers():
    samples = augmented(seed=5)
    reference = read_all(samples, 0)
    for workers in (1, 2):
        assert same(read_all(samples, workers), reference) == ALL_SAME
    numbers = reference["numbers"].flatten()
    assert len(numbers.unique()) == numbers.numel()
    assert same(read_all(augmented(seed=6), 0), reference) == dict.fromkeys(ALL_SAME, False)
    # In another order, and as part of another batch.
    assert torch.equal(samples[3]["image"], reference["image"][3])
    assert torch.equal(samples[-1]["image"], reference["image"][-1])
    assert torch.equal(pickle.loads(pickle.dumps(samples))[3]["numbers"], reference["numbers"][3])


def test_epochs_differ_and_workers_that_stay_alive_notice_them():
    samples = augmented(seed=5)
    expected = []
    for epoch in range(3):
        samples.set_epoch(epoch)
        assert samples.epoch == epoch
        expected.append(read_all(samples, 0))
    assert same(expected[0], expected[1]) == dict.fromkeys(ALL_SAME, False)
    loader = torch.utils.data.DataLoader(samples, batch_size=2, num_workers=2, persistent_workers=True)
    for epoch in (2, 0, 1):
        samples.set_epoch(epoch)
        images = torch.cat([batch["image"] for batch in loader])
        assert torch.equal(images, expected[epoch]["image"])


def test_samples_with_a_seed_leave_the_global_generators_as_they_are():
    samples = augmented(seed=5)
    torch.manual_seed(1)
    np.random.seed(1)  # noqa: NPY002, TID251
    random.seed(1)
    expected = RandomNumbers()({})["numbers"]
    torch.manual_seed(1)
    np.random.seed(1)  # noqa: NPY002, TID251
    random.seed(1)
    samples[0]
    assert torch.equal(RandomNumbers()({})["numbers"], expected)


def test_without_a_seed_workers_differ_and_the_generator_of_the_loader_makes_them_reproducible():
    samples = augmented(seed=None, count=8)

    def read(seed):
        return read_all(samples, 2, generator=torch.Generator().manual_seed(seed))

    one = read(1)
    assert same(read(1), one) == ALL_SAME
    assert same(read(2), one) == dict.fromkeys(ALL_SAME, False)
    numbers = one["numbers"].flatten()
    assert len(numbers.unique()) == numbers.numel()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"tensors": "numpy"}, "tensors: must be auto, plain, tv, not 'numpy'"),
        ({"seed": -1}, "seed: must be an integer from 0, or None, not -1"),
        ({"seed": 1.5}, "seed: must be an integer from 0, or None, not 1.5"),
        ({"keys": ()}, "keys: must be some of image, mask, instances, distance, not none"),
        ({"augmentation": len}, "augmentation: must be an Augmentation, not builtin_function_or_method"),
    ],
)
def test_rejects_invalid_arguments(arguments, message):
    with pytest.raises(ArgumentError, match=message):
        torch_images(coded_images(), **arguments)


def test_rejects_invalid_epochs():
    samples = torch_images(coded_images())
    for epoch in (-1, 0.5, "1"):
        with pytest.raises(ArgumentError, match="epoch: must be an integer from 0"):
            samples.set_epoch(epoch)
    with pytest.raises(IndexError):
        samples[4]


STATM = Path("/proc/self/statm")

SCRIPT = """
import json, resource, sys
from pathlib import Path

import torch

from pepperscene.dataset import Augmentation, torch_images

def memory():
    # Without shared memory, which holds the batches that wait.
    resident, shared = Path("/proc/self/statm").read_text().split()[1:3]
    return (int(resident) - int(shared)) * resource.getpagesize()

def add_memory(sample):
    return {**sample, "bytes": memory(), "process": torch.utils.data.get_worker_info().id}

augmentation = Augmentation.standard((300, 400))
samples = torch_images(sys.argv[1], augmentation=augmentation, transform=add_memory, seed=0)
samples = torch.utils.data.ConcatDataset([samples] * 10)
loader = torch.utils.data.DataLoader(samples, batch_size=5, num_workers=2, persistent_workers=True)
epochs = []
for epoch in range(10):
    sizes = {}
    for batch in loader:
        for process, size in zip(batch["process"].tolist(), batch["bytes"].tolist()):
            sizes[process] = max(size, sizes.get(process, 0))
    sizes[2] = memory()
    epochs.append([sizes[process] for process in range(3)])
print(json.dumps(epochs))
"""


@pytest.mark.slow
@pytest.mark.skipif(not STATM.exists(), reason="needs Linux to know the present memory of a process")
def test_ten_epochs_with_two_workers_need_no_more_memory_than_three(painted):
    result = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(painted.folder)],
        capture_output=True,
        text=True,
        timeout=300,
        # Arrays return to the system when they are freed; otherwise the allocator's reserve varies by 70 MiB.
        env={**os.environ, "PYTHONPATH": PYTHONPATH, "MALLOC_MMAP_THRESHOLD_": "65536"},
    )
    assert result.returncode == 0, result.stderr
    epochs = np.array(json.loads(result.stdout.splitlines()[-1]))
    # Of each worker and the main process. The images of the last seven epochs are 500 MiB in each worker.
    assert (epochs[-3:].max(axis=0) - epochs[:3].max(axis=0) < 8 * 2**20).all(), epochs / 2**20
