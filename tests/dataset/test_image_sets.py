"""Sets of labelled images that are read on access, and the torch data set of their samples."""

from __future__ import annotations

import pickle
import sys
from dataclasses import dataclass

import numpy as np
import pytest

from pepperscene.dataset.readers.image_set import FIELDS, ImageSet, LabelledImage
from pepperscene.dataset.readers.torch_images import torch_images
from pepperscene.errors import SetupError


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


def test_missing_torch_is_a_setup_error(small, monkeypatch):
    monkeypatch.delitem(sys.modules, "pepperscene.dataset.readers.torch_data", raising=False)
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(SetupError, match="`pip install torch`"):
        torch_images(small.folder)
