"""The in-memory type of labelled pictures, and sets of them that are read lazily."""

from __future__ import annotations

import pickle
from dataclasses import dataclass

import numpy as np
import pytest

from pepperscene.dataset.readers.image_set import FIELDS, VOID, ImageSet, LabelledImage


@dataclass(frozen=True, eq=False, kw_only=True)
class Counted(ImageSet):
    """Pictures of one grey each, and a record of what was read."""

    log: list

    def names(self):
        return tuple(str(item) for item in self.items)

    def read(self, item):
        self.log.append(item)
        grey = np.full((2, 3, 3), item, np.uint8)
        return LabelledImage(str(item), grey if "colour" in self.fields else None, None)


@pytest.fixture
def counted():
    return Counted(name="counted", items=tuple(range(10)), log=[])


def test_a_picture_is_read_when_it_is_asked_for(counted):
    some = counted[2:8:2]
    assert counted.log == []
    assert some.names() == ("2", "4", "6")
    assert some[-1].name == "6"
    assert counted.log == [6]


def test_a_set_is_a_sequence(counted):
    assert len(counted) == 10
    assert [picture.name for picture in counted] == list(counted.names())
    with pytest.raises(IndexError):
        counted[10]


def test_a_part_keeps_its_order_and_its_kind(counted):
    part = counted.take([7, 1])
    assert isinstance(part, Counted)
    assert part.names() == ("7", "1")


def test_what_is_not_selected_is_not_read(counted):
    assert counted.fields == FIELDS
    assert counted.select("colour")[0].colour is not None
    bare = counted.select()[0]
    assert bare.colour is None
    with pytest.raises(ValueError, match="holds no image"):
        _ = bare.size
    with pytest.raises(ValueError, match="unknown fields depth; allowed are colour"):
        counted.select("depth")


def test_images_of_different_sizes_are_no_picture():
    with pytest.raises(ValueError, match="differ in size"):
        LabelledImage("one", np.zeros((2, 3, 3), np.uint8), np.zeros((3, 2), np.uint8))


def test_a_picture_knows_its_size_by_any_of_its_images():
    picture = LabelledImage("one", None, None, distance_m=np.zeros((4, 5), np.float32))
    assert picture.size == (4, 5)
    assert pickle.loads(pickle.dumps(picture)).size == (4, 5)


def test_void_is_no_class():
    from pepperscene.classes import OrganClass

    assert VOID not in {int(organ) for organ in OrganClass}
    assert np.iinfo(np.uint8).max >= VOID
