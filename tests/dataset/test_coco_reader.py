"""Reading instances in the format of COCO: own exports, and files of other programs."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from painted_set import FLOOR, FRAMES, WIRE
from PIL import Image

from pepperscene.classes import OrganClass
from pepperscene.dataset.readers import CocoSet, open_images
from pepperscene.dataset.readers.coco_masks import decode_counts, decode_segmentation
from pepperscene.dataset.readers.image_set import VOID
from pepperscene.errors import ArgumentError, InputError, SetupError
from pepperscene.export import export_dataset
from pepperscene.truth.encodings import encode_rle

mask_tools = pytest.importorskip("pycocotools.mask", reason="the extra `export` installs pycocotools")

# pycocotools 2.0.11 decodes masks in a way that NumPy 2 tolerates for now.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")

SIZE = (6, 8)
SQUARE = [[1, 1, 5, 1, 5, 4, 1, 4]]  # columns 1 to 4, rows 1 to 3


def square(top, bottom, left, right):
    mask = np.zeros(SIZE, bool)
    mask[top:bottom, left:right] = True
    return mask


def rle(mask):
    runs = encode_rle(mask)
    return {"size": list(mask.shape), "counts": [int(count) for count in runs["counts"]]}


def annotation(number, category, segmentation, image=1, **fields):
    return {
        "id": number, "image_id": image, "category_id": category, "segmentation": segmentation, **fields,
    }  # fmt: skip


def write_coco(folder, annotations=(), categories=("pepper", "leaf"), images=("a.png",), **fields):
    """A folder with `annotations.json`; images are numbered from 1, and so are categories."""
    records = []
    for number, name in enumerate(images, start=1):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(np.full((*SIZE, 3), number, np.uint8)).save(folder / name)
        records.append({"id": number, "file_name": name, "height": SIZE[0], "width": SIZE[1]})
    content = {
        "images": records,
        "annotations": list(annotations),
        "categories": [{"id": k, "name": name} for k, name in enumerate(categories, start=1)],
        **fields,
    }
    (folder / "annotations.json").write_text(json.dumps(content))
    return folder


# --- own exports --------------------------------------------------------------------------------------------


def assert_same_partition(read, expected):
    """Both images divide the same pixels into the same regions; their numbers can differ."""
    np.testing.assert_array_equal(read > 0, expected > 0)
    pairs = set(zip(read.ravel().tolist(), expected.ravel().tolist(), strict=True))
    assert len(pairs) == len({first for first, _ in pairs}) == len({second for _, second in pairs})


def test_own_export_has_the_classes_and_organs_of_the_rendered_set(painted, tmp_path):
    out = export_dataset(painted.folder, "coco", tmp_path / "out", "train=.6,val=.4").folder
    with pytest.raises(InputError, match=r"several annotation files \(instances_train.json, instances_val"):
        open_images(out)
    read = 0
    for split in ("train", "val"):
        images = open_images(out / "annotations" / f"instances_{split}.json")
        assert isinstance(images, CocoSet)
        assert images.name == f"out {split}"
        for image in images:
            index = int(image.name)
            np.testing.assert_array_equal(image.colour, painted.image(index, "colour"))
            np.testing.assert_array_equal(image.classes, painted.image(index, "class"))
            # What belongs to no plant is a crowd or background, without an instance.
            expected = painted.image(index, "instance").copy()
            expected[np.isin(expected, [WIRE, FLOOR])] = 0
            assert_same_partition(image.instances, expected)
            read += 1
    assert read == len(FRAMES)


def test_own_export_of_some_classes_leaves_the_rest_void(painted, tmp_path):
    options = {"classes": "pepper,peduncle", "ripe_from": 0.6, "frames": "0:5"}
    out = export_dataset(painted.folder, "coco", tmp_path / "out", **options).folder
    for rest in (VOID, OrganClass.BACKGROUND):
        assert open_images(out).names() == ("000000", "000003")
        for image in open_images(out):
            truth = painted.image(int(image.name), "class")
            fruit = np.isin(truth, [OrganClass.PEPPER, OrganClass.PEDUNCLE])
            np.testing.assert_array_equal(image.classes, np.where(fruit, truth, rest))
        # A table gives the rest a class.
        (out / "classes.toml").write_text('otherwise = "background"\n')


# --- files of other programs --------------------------------------------------------------------------------


def test_polygons_and_run_lengths_are_painted(tmp_path):
    text = mask_tools.encode(np.asfortranarray(square(4, 6, 0, 8)).astype(np.uint8))
    text = {"size": list(SIZE), "counts": text["counts"].decode()}
    annotations = [
        annotation(7, 1, SQUARE),
        annotation(8, 2, rle(square(0, 1, 0, 8))),
        annotation(9, 2, text),
    ]
    image = open_images(write_coco(tmp_path, annotations))[0]
    classes, instances = np.full(SIZE, VOID), np.zeros(SIZE, int)
    for number, (mask, organ) in enumerate(
        [(square(1, 4, 1, 5), 2), (square(0, 1, 0, 8), 1), (square(4, 6, 0, 8), 1)], start=1
    ):
        classes[mask], instances[mask] = organ, number
    np.testing.assert_array_equal(image.classes, classes)
    np.testing.assert_array_equal(image.instances, instances)
    assert (image.classes.dtype, image.instances.dtype) == (np.uint8, np.uint16)
    assert (image.colour == 1).all()
    selected = open_images(tmp_path).select("classes")[0]
    assert (selected.colour, selected.instances, selected.metadata) == (None, None, {})
    nothing = open_images(tmp_path).select("colour")[0]
    assert nothing.classes is None


def test_smaller_annotations_lie_on_larger_ones_and_on_crowds(tmp_path):
    annotations = [
        annotation(1, 1, rle(square(2, 4, 2, 4))),
        annotation(2, 2, rle(square(0, 6, 0, 6))),
        annotation(3, 1, rle(square(0, 6, 0, 8)), iscrowd=1),
    ]
    image = open_images(write_coco(tmp_path, annotations))[0]
    expected = np.full(SIZE, int(OrganClass.PEPPER))
    expected[:, :6] = OrganClass.LEAF
    expected[2:4, 2:4] = OrganClass.PEPPER
    np.testing.assert_array_equal(image.classes, expected)
    assert sorted(np.unique(image.instances)) == [0, 1, 2]
    assert (image.instances[2:4, 2:4] == 1).all()
    assert (image.instances[:, 6:] == 0).all()


def test_crowds_of_two_classes_are_void(tmp_path):
    crowds = [
        annotation(k, k, rle(square(0, 6, 2 * k, 6)), iscrowd=1) for k in (1, 2)
    ]  # columns 2 to 5 and 4 to 5
    classes = open_images(write_coco(tmp_path, crowds))[0].classes
    assert classes[0].tolist() == [VOID, VOID, 2, 2, VOID, VOID, VOID, VOID]


def test_names_of_fruit_are_peppers(tmp_path):
    names = ["fruit", "Sweet Pepper", "bell pepper", "Pepper"]
    annotations = [annotation(k, k, rle(square(k, k + 1, 0, 8))) for k in range(1, 5)]
    image = open_images(write_coco(tmp_path, annotations, names))[0]
    assert (image.classes[1:5] == OrganClass.PEPPER).all()


def test_a_table_gives_classes_to_categories_and_to_the_rest(tmp_path):
    folder = write_coco(
        tmp_path, [annotation(1, 1, SQUARE), annotation(2, 2, rle(square(5, 6, 0, 8)))], ["capsicum", "pot"]
    )
    with pytest.raises(InputError, match="the category 'capsicum' has no known class"):
        open_images(folder)
    table = {"capsicum": "pepper", "pot": "void", "otherwise": "background"}
    image = open_images(folder, labels=table)[0]
    expected = np.where(square(1, 4, 1, 5), OrganClass.PEPPER, OrganClass.BACKGROUND)
    expected[5] = VOID
    np.testing.assert_array_equal(image.classes, expected)
    # An object without a class is no instance.
    assert sorted(np.unique(image.instances)) == [0, 1]
    (folder / "classes.toml").write_text('capsicum = "pepper"\npot = "void"\notherwise = "background"\n')
    np.testing.assert_array_equal(open_images(folder)[0].classes, expected)


def test_images_are_found_in_usual_folders_and_sorted_by_number(tmp_path):
    folder = write_coco(tmp_path, images=("images/img10.png", "images/img2.png"))
    content = json.loads((folder / "annotations.json").read_text())
    for record in content["images"]:
        record["file_name"] = record["file_name"].removeprefix("images/")
    (folder / "annotations.json").unlink()
    (folder / "annotations").mkdir()
    (folder / "annotations" / "all.json").write_text(json.dumps(content))
    (folder / "annotations" / "panoptic_all.json").write_text("{}")
    assert open_images(folder).names() == ("img2", "img10")
    assert (open_images(folder)[0].colour == 2).all()


def change(key, value, index=0):
    def edit(content):
        content[key][index].update(value)

    return edit


def runs(size, counts):
    return change("annotations", {"segmentation": {"size": size, "counts": counts}})


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda content: content.pop("images"), "images: must be a list of objects, as in COCO's instances"),
        (lambda content: content.update(images=[], annotations=[]), "lists no images"),
        (change("annotations", {"id": 1}, 1), "annotations.id = 1: must be an integer that occurs once"),
        (change("annotations", {"category_id": 9}), "annotation 1.category_id = 9: is no category"),
        (change("annotations", {"image_id": 5}), "annotations.image_id = 5: is the id of no image"),
        (change("images", {"file_name": "../a.png"}), "must be a path inside the folder"),
        (change("images", {"file_name": "/etc/passwd"}), "must be a path inside the folder"),
        (change("images", {"file_name": "b.png"}), "b.png: is missing, although"),
        (change("images", {"height": 0}), "must have a height and a width"),
        (change("images", {"height": 7}), "a.png: has 8x6 pixels, but annotations.json says 8x7"),
        (change("annotations", {"segmentation": None}), "annotation 1: must be polygons, or run lengths"),
        (change("annotations", {"segmentation": [[1, 2, 3, 4, 5, "6"]]}), "must have polygons of three"),
        (change("annotations", {"segmentation": [[1, 2, 3, 4, 5, 1e30]]}), "has a polygon far outside"),
        (runs([8, 6], [48]), "is of the size [8, 6], but its image is [6, 8]"),
        (runs([6, 8], [47]), "has run lengths that do not fill its image"),
        (runs([6, 8], [1.5]), "must have counts that are integers or text"),
        (runs([6, 8], "0" * 50), "has run lengths that do not fill its image"),
        (runs([6, 8], "P"), "has damaged run lengths"),
    ],
)
def test_rejects_damaged_files_in_one_sentence(tmp_path, edit, message):
    folder = write_coco(tmp_path, [annotation(1, 1, SQUARE), annotation(2, 2, SQUARE)])
    content = json.loads((folder / "annotations.json").read_text())
    edit(content)
    (folder / "annotations.json").write_text(json.dumps(content))
    with pytest.raises(InputError) as caught:
        open_images(folder)[0]
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_rejects_other_arguments(tmp_path):
    folder = write_coco(tmp_path)
    with pytest.raises(InputError, match="applies only to the published data set"):
        open_images(folder, half="synthetic")
    with pytest.raises(ArgumentError, match="labels: must be a table from names of categories"):
        open_images(folder, labels="published")
    with pytest.raises(InputError, match=r"labels: apple: is no category of .*: pepper, leaf"):
        open_images(folder, labels={"apple": "pepper"})
    with pytest.raises(InputError, match=r"labels: leaf = 'blade': must be one of background"):
        open_images(folder, labels={"leaf": "blade"})
    (folder / "annotations.json").write_text("[1")
    with pytest.raises(InputError, match="is not valid JSON"):
        open_images(folder)


def test_polygons_need_pycocotools(tmp_path, monkeypatch):
    folder = write_coco(tmp_path, [annotation(1, 1, SQUARE)])
    monkeypatch.setitem(sys.modules, "pycocotools.mask", None)
    with pytest.raises(SetupError, match=r"pip install 'pepperscene\[export\]'"):
        open_images(folder)[0]


@given(hnp.arrays(bool, st.tuples(st.integers(1, 40), st.integers(1, 40))))
def test_text_of_pycocotools_is_decoded(mask):
    encoded = mask_tools.encode(np.asfortranarray(mask).astype(np.uint8))
    segmentation = {"size": list(mask.shape), "counts": encoded["counts"].decode()}
    np.testing.assert_array_equal(decode_segmentation(segmentation, mask.shape), mask)


@given(st.text(max_size=40))
def test_any_text_is_decoded_or_rejected(text):
    try:
        counts = decode_counts(text)
    except ValueError:
        return
    assert all(isinstance(count, int) for count in counts)
