"""YOLO: polygons filled again give the masks, in pieces and with holes."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from painted_set import FRAMES, SIZE

from pepperscene.classes import OrganClass
from pepperscene.dataset import read_image
from pepperscene.dataset.export import export_dataset
from pepperscene.dataset.export.yolo import BRIDGED, polygons

cv2 = pytest.importorskip("cv2", reason="the extra `test` brings OpenCV")


@pytest.fixture(scope="module")
def made(painted):
    return painted


@pytest.fixture(scope="module")
def out(made, tmp_path_factory):
    return export_dataset(
        made.folder, "yolo", tmp_path_factory.mktemp("out") / "out", "train=.6,val=.4"
    ).folder


def filled(points, size):
    """A mask as Ultralytics makes it: coordinates cut off to whole numbers, sides painted."""
    mask = np.zeros(size, np.uint8)
    cv2.fillPoly(mask, [np.asarray(points).astype(np.int32)], 1)
    return mask > 0


def objects(path):
    """Class and mask of every line of a label file."""
    found = []
    for line in path.read_text().splitlines():
        kind, *numbers = line.split()
        points = np.array(numbers, dtype=float).reshape(-1, 2)
        # With four numbers a line would be a box.
        assert len(points) >= 3
        assert points.min() > 0
        assert points.max() < 1
        found.append((int(kind), filled(points * SIZE[::-1], SIZE)))
    return found


def overlap(one, other):
    return np.count_nonzero(one & other) / np.count_nonzero(one | other)


def test_every_organ_is_found_again(made, out):
    for split, indices in (("train", FRAMES[:4]), ("val", FRAMES[4:])):
        assert sorted(path.stem for path in (out / "labels" / split).iterdir()) == [
            f"{i:06d}" for i in indices
        ]
        for index in indices:
            picture = read_image(out / "images" / split / f"{index:06d}.png")
            assert (picture == made.image(index, "colour")).all()
            instance, told = made.image(index, "instance"), made.metadata(index)["instances"]
            masks = {}
            for kind, mask in objects(out / "labels" / split / f"{index:06d}.txt"):
                value = int(np.bincount(instance[mask], minlength=1).argmax())
                assert kind == told[str(value)]["class"] - 1
                masks.setdefault(value, []).append(mask)
            large = 0
            for value, one in told.items():
                organ = one["class"] > 0 and one["plant"] >= 0
                if not organ or one["pixels"] < 12:
                    assert int(value) not in masks
                elif one["pixels"] > 200:
                    whole = np.any(masks[int(value)], axis=0)
                    assert overlap(whole, instance == int(value)) >= 0.9
                    large += 1
            assert large > 8


def test_the_description_names_classes_and_folders(out):
    yaml = pytest.importorskip("yaml", reason="a reader of YAML")
    told = yaml.safe_load((out / "data.yaml").read_text())
    assert told == {
        "train": "images/train",
        "val": "images/val",
        "names": {int(one) - 1: one.name.lower() for one in OrganClass if one},
    }
    for key in ("train", "val"):
        assert (out / told[key]).is_dir()


def test_readers_find_train_and_val_whatever_the_splits_are_called(made, tmp_path):
    yaml = pytest.importorskip("yaml", reason="a reader of YAML")
    for number, (split, train, val) in enumerate([
        (None, "train", "train"), ("a=.5,b=.5", "a", "a"), ("train=.5,validation=.5", "train", "validation"),
        ("val=.5,x=.5", "val", "val"),
    ]):  # fmt: skip
        export_dataset(made.folder, "yolo", tmp_path / str(number), split)
        told = yaml.safe_load((tmp_path / str(number) / "data.yaml").read_text())
        assert (told["train"], told["val"]) == (f"images/{train}", f"images/{val}")


def test_the_smallest_organ_can_be_told(made, tmp_path):
    export_dataset(made.folder, "yolo", tmp_path / "out", frames="3:4", smallest_px=300)
    told = made.metadata(3)["instances"].values()
    wanted = [one for one in told if one["class"] and one["plant"] >= 0 and one["pixels"] >= 300]
    found = objects(tmp_path / "out" / "labels" / "train" / "000003.txt")
    assert 0 < len(found) <= len(wanted)


def test_a_hole_stays_open():
    mask = np.zeros((60, 80), bool)
    mask[10:50, 10:70] = True
    mask[20:40, 20:35] = mask[15:30, 50:60] = mask[45, 45] = False
    (ring,) = polygons(mask, 12)
    assert (filled(ring, mask.shape) == mask).all()


def test_an_island_in_a_hole_is_joined():
    yy, xx = np.mgrid[:101, :101] - 50
    away = np.hypot(xx, yy)
    mask = (away < 45) & ~((away > 20) & (away < 24))
    (ring,) = polygons(mask, 12)
    # The bridge over the ring's hole is painted.
    assert 0 < np.count_nonzero(filled(ring, mask.shape) & ~mask) <= 5
    assert (mask <= filled(ring, mask.shape)).all()


def test_near_pieces_are_one_object_and_far_ones_are_two():
    near, far = np.zeros((2, 40, 200), bool)
    near[10:30, 10:40] = near[10:30, 44:80] = True
    far[10:30, 10:40] = far[10:30, 150:190] = True
    assert len(polygons(near, 12)) == 1
    apart = polygons(far, 12)
    # The greater first.
    assert [cv2.boundingRect(one) for one in apart] == [(150, 10, 40, 20), (10, 10, 30, 20)]
    assert (np.any([filled(one, far.shape) for one in apart], axis=0) == far).all()


def test_what_is_smaller_than_the_smallest_is_left_out():
    mask = np.zeros((20, 60), bool)
    mask[5:8, 5:9] = mask[5, 40:43] = True
    assert len(polygons(mask, 12)) == 1
    assert polygons(mask, 13) == []
    assert polygons(np.zeros((5, 5), bool), 1) == []


@st.composite
def blots(draw):
    """Masks of overlapping discs, with some cut away again."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    mask = np.zeros((64, 80), np.uint8)
    for value in rng.choice([1, 1, 0], 14):
        cv2.ellipse(
            mask, tuple(map(int, rng.integers(0, 64, 2))), tuple(map(int, rng.integers(2, 16, 2))),
            float(rng.uniform(0, 180)), 0, 360, int(value), -1,
        )  # fmt: skip
    return mask > 0


@settings(deadline=None, max_examples=60)
@given(blots())
def test_polygons_cover_a_mask_but_for_bridges_and_specks(mask):
    found = polygons(mask, 4)
    whole = np.any([filled(one, mask.shape) for one in found], axis=0) if found else np.zeros_like(mask)
    _, labels = cv2.connectedComponents(mask.view(np.uint8))
    sizes = np.bincount(labels.ravel())
    # Only pieces below the smallest may be missing, and only bridges may be painted.
    missed = mask & ~whole
    specks = np.isin(labels, np.flatnonzero(sizes < 4))
    assert np.count_nonzero(missed & ~specks) <= 0.01 * np.count_nonzero(mask)
    small = sum(int(size) for size in sizes[1:] if size < 4)
    assert np.count_nonzero(whole & ~mask) <= 0.01 * mask.sum() + BRIDGED * mask.sum() + 2 * small
    for one, other in itertools.combinations(found, 2):
        assert not (filled(one, mask.shape) & filled(other, mask.shape) & mask).any()
