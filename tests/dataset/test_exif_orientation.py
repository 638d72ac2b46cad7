"""Masks, annotations and predictions stay on the objects of photographs with any EXIF orientation.

An object is red in the photograph, and of a shape without any symmetry.
"""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image, ImageOps

from pepperscene.colour import open_patches
from pepperscene.dataset.readers import open_images
from pepperscene.errors import InputError
from pepperscene.truth.encodings import encode_rle

ORIENTATIONS = range(1, 9)
LABELS = {0: "background", 1: "pepper"}
RED, GREY = (200, 30, 20), (90, 90, 90)
SHAPES = ((24, 36), (30, 30))


def stored_object(shape):
    mask = np.zeros(shape, np.uint8)
    mask[3:15, 5:9] = mask[11:15, 5:19] = 1
    mask[3:7, 5:13] = 1
    return mask


def exif_of(orientation):
    exif = Image.Exif()
    exif[0x0112] = orientation
    return exif


def turned(array, orientation):
    """An array as Pillow displays it."""
    image = Image.fromarray(array)
    image.getexif()[0x0112] = orientation
    return np.asarray(ImageOps.exif_transpose(image))


def write_photo(path, mask, orientation):
    colour = np.where(mask[..., None] == 1, np.uint8(RED), np.uint8(GREY))
    Image.fromarray(colour).save(path, exif=exif_of(orientation))


def write_coco(folder, mask):
    height, width = mask.shape
    annotation = {
        "id": 1,
        "image_id": 1,
        "category_id": 1,
        "segmentation": encode_rle(mask > 0),
        "iscrowd": 0,
    }
    content = {
        "images": [{"id": 1, "file_name": "a.png", "width": width, "height": height}],
        "annotations": [annotation],
        "categories": [{"id": 1, "name": "pepper"}],
    }
    (folder / "annotations.json").write_text(json.dumps(content))


def check_on_object(image):
    np.testing.assert_array_equal(image.classes == 2, image.colour[..., 0] == RED[0])


@pytest.mark.parametrize("kind", ["mask", "coco"])
@pytest.mark.parametrize("shape", SHAPES, ids=["oblong", "square"])
@pytest.mark.parametrize("marked", ["stored", "displayed"])
@pytest.mark.parametrize("orientation", ORIENTATIONS)
def test_marks_stay_on_their_object(orientation, marked, shape, kind, tmp_path):
    stored = stored_object(shape)
    write_photo(tmp_path / "a.png", stored, orientation)
    mask = stored if marked == "stored" else turned(stored, orientation)
    if kind == "coco":
        write_coco(tmp_path, mask)
        labels = {"otherwise": "background"}
    else:
        Image.fromarray(mask).save(tmp_path / "a_mask.png")
        labels = dict(LABELS)
    check_on_object(open_images(tmp_path, labels={**labels, "exif": marked})[0])

    # Without a statement, the sizes must tell.
    tells = marked == "displayed" or kind == "mask"
    if orientation == 1 or (orientation > 4 and shape[0] != shape[1] and tells):
        check_on_object(open_images(tmp_path, labels=labels)[0])
    else:
        with pytest.raises(InputError, match='say which with exif = "displayed" or "stored"'):
            open_images(tmp_path, labels=labels)[0]


def test_the_folder_says_what_its_masks_mark(tmp_path):
    stored, table = stored_object(SHAPES[1]), '0 = "background"\n1 = "pepper"\nexif = "{}"\n'
    write_photo(tmp_path / "a.png", stored, 6)
    Image.fromarray(stored).save(tmp_path / "a_mask.png")
    (tmp_path / "classes.toml").write_text(table.format("stored"))
    check_on_object(open_images(tmp_path)[0])
    (tmp_path / "classes.toml").write_text(table.format("raw"))
    with pytest.raises(InputError, match='exif = \'raw\': must be "displayed" or "stored"'):
        open_images(tmp_path)


@pytest.mark.parametrize("orientation", ORIENTATIONS)
def test_a_mask_with_an_orientation_of_its_own_is_displayed_by_it(orientation, tmp_path):
    stored = stored_object(SHAPES[1])
    write_photo(tmp_path / "a.png", stored, orientation)
    Image.fromarray(stored).save(tmp_path / "a_mask.png", exif=exif_of(orientation))
    check_on_object(open_images(tmp_path, labels=LABELS)[0])


def test_unlabelled_photographs_need_no_statement(tmp_path):
    write_photo(tmp_path / "a.png", stored_object(SHAPES[1]), 3)
    assert open_images(tmp_path)[0].classes is None
    content = {"images": [{"id": 1, "file_name": "a.png", "width": 30, "height": 30}]}
    content |= {"annotations": [], "categories": [{"id": 1, "name": "pepper"}]}
    (tmp_path / "annotations.json").write_text(json.dumps(content))
    assert (open_images(tmp_path)[0].classes == 255).all()


@pytest.mark.parametrize("orientation", [0, 9, 200])
def test_orientations_that_do_not_exist_turn_nothing(orientation, tmp_path):
    stored = stored_object(SHAPES[0])
    write_photo(tmp_path / "a.png", stored, orientation)
    Image.fromarray(stored).save(tmp_path / "a_mask.png")
    check_on_object(open_images(tmp_path, labels=LABELS)[0])


@pytest.mark.parametrize("marked", ["stored", "displayed"])
@pytest.mark.parametrize("orientation", ORIENTATIONS)
def test_masks_of_patches_stay_on_their_object(orientation, marked, tmp_path):
    stored = stored_object(SHAPES[1])
    write_photo(tmp_path / "a.png", stored, orientation)
    Image.fromarray(stored if marked == "stored" else turned(stored, orientation)).save(tmp_path / "m.png")
    region = '[[patch]]\npicture = "a.png"\nkind = "pepper"\n'
    path = tmp_path / "patches.toml"
    path.write_text(f'{region}mask = {{ file = "m.png", value = 1, exif = "{marked}" }}\n')
    codes = open_patches(path).patches[0].codes
    assert len(codes) > 20
    assert (codes == RED).all()


@pytest.mark.parametrize("orientation", ORIENTATIONS)
def test_predictions_are_read_back_on_their_object(orientation, tmp_path):
    pytest.importorskip("torch", reason="the extra `learn` installs torch")
    from pepperscene.dataset.readers.pictures import read_mask_of
    from pepperscene.learning.class_table import ClassTable
    from pepperscene.learning.evaluation.predict import predict

    class RedModel:
        """Finds red pixels."""

        classes = ClassTable.parse("background,pepper")

        def probabilities(self, image):
            return np.stack([image[..., 0] < 150, image[..., 0] >= 150]).astype(np.float32)

    write_photo(tmp_path / "a.png", stored_object(SHAPES[1]), orientation)
    predict(RedModel(), tmp_path / "a.png", tmp_path / "out")
    mask = read_mask_of(tmp_path / "a.png", tmp_path / "out" / "class" / "a.png")
    expected = turned(stored_object(SHAPES[1]), orientation)
    np.testing.assert_array_equal(mask.values, expected)
