"""Rendered and published data sets, and folders of images with masks, read as the same type."""

from __future__ import annotations

import numpy as np
import pytest
from data_sets import set_without_plants
from PIL import Image

from pepperscene.classes import CLASS_COLOURS, OrganClass
from pepperscene.dataset.readers import FolderSet, PublishedSet, RenderedSet, open_images
from pepperscene.dataset.readers.folder import natural_sort_key
from pepperscene.dataset.readers.image_set import VOID
from pepperscene.dataset.readers.labels import KNOWN_LABELS, parse_labels
from pepperscene.dataset.store.images import png_bytes
from pepperscene.errors import InputError
from pepperscene.truth import class_colour, distance_code, distance_from_code

SIZE = (6, 8)
FRUIT = {0: "background", 1: "pepper", 255: "void"}


@pytest.fixture
def ids():
    """An image with every class."""
    return np.random.default_rng(5).permutation(np.arange(48) % 8).astype(np.uint8).reshape(SIZE)


def save(folder, name, pixels):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path)
    return path


def photo(value=7, size=SIZE):
    """An image of one grey, by which tests recognise it."""
    return np.full((*size, 3), value, np.uint8)


def grey(value, dtype=np.uint8):
    return np.full(SIZE, value, dtype)


def test_reads_rendered_data_set(small):
    images = open_images(small.folder)
    assert isinstance(images, RenderedSet)
    assert images.names() == tuple(f"{index:06d}" for index in range(9))
    assert images.name == "set"
    outputs = {"colour": "colour", "classes": "class", "instances": "instance", "distance_m": "distance"}
    for index, image in zip(small.indices(), images, strict=True):
        for field, output in outputs.items():
            expected = small.image(index, output)
            np.testing.assert_array_equal(getattr(image, field), expected)
            assert getattr(image, field).dtype == expected.dtype
        assert image.metadata["index"] == index
        assert len(image.metadata["harvest"]["fruit"]) == 2


def test_fields_are_decoded_from_other_outputs(tmp_path):
    dataset = set_without_plants(tmp_path / "set", [0], ("class_colour", "distance_code"))
    image = open_images(dataset.folder)[0]
    code = dataset.image(0, "distance_code")
    np.testing.assert_array_equal(image.distance_m, distance_from_code(code))
    assert image.classes.max() < len(OrganClass)
    assert image.colour is None
    assert image.instances is None


def test_only_selected_files_are_opened(copied, small):
    folder = copied(small).folder
    for path in (folder / "distance").iterdir():
        path.unlink()
    images = open_images(folder)
    assert images.select("colour", "classes")[0].metadata == {}
    with pytest.raises(InputError, match=r"distance/000000.exr"):
        images[0]
    for path in (folder / "frames").iterdir():
        path.unlink()
    with pytest.raises(InputError, match="holds no frames"):
        open_images(folder)


def publish(folder, classes, half="synthetic", numbers=(1, 2, 10), values=True, colours=True):
    """Write the published layout, from its description alone."""
    for number in numbers:
        save(folder, f"{half}_image_color/{half}_image_color_{number}.png", photo(number))
        shifted = np.roll(classes, number, axis=1)
        if values:
            name = f"{half}_label_class_all_grayscale"
            save(folder, f"{half}_label_class_grayscale/{name}/{name}_{number}.png", shifted)
        if colours:
            name = f"{half}_label_class_colorscale"
            save(folder, f"{name}/{name}_{number}.png", class_colour(shifted))


def test_reads_published_set_in_order_of_numbers(tmp_path, ids):
    publish(tmp_path, ids)
    images = open_images(tmp_path)
    assert isinstance(images, PublishedSet)
    assert images.names() == ("1", "2", "10")
    for number, image in zip((1, 2, 10), images, strict=True):
        assert (image.colour == number).all()
        np.testing.assert_array_equal(image.classes, np.roll(ids, number, axis=1))
        assert image.distance_m is None
        assert image.metadata == {"half": "synthetic", "number": number}


def test_inexact_colours_give_the_nearest_class(tmp_path, ids):
    publish(tmp_path, ids, values=False)
    for path in (tmp_path / "synthetic_label_class_colorscale").iterdir():
        rgb = np.array(Image.open(path)).astype(int)
        rng = np.random.default_rng(1)
        Image.fromarray(np.clip(rgb + rng.integers(-9, 10, rgb.shape), 0, 255).astype(np.uint8)).save(path)
    np.testing.assert_array_equal(open_images(tmp_path)[2].classes, np.roll(ids, 10, axis=1))


def test_depth_code_becomes_metres(tmp_path, ids):
    publish(tmp_path, ids, numbers=(1,))
    metres = np.linspace(0.2, 2.1, 48).reshape(SIZE)
    # The published names of these files are unknown: only the number counts.
    save(tmp_path, "synthetic_label_depth_grayscale/whatever_1.png", distance_code(metres))
    image = open_images(tmp_path)[0]
    assert image.distance_m.dtype == np.float32
    assert np.abs(image.distance_m - metres).max() <= 0.00425 + 1e-6


def test_two_halves_require_a_choice(tmp_path, ids):
    publish(tmp_path, ids)
    publish(tmp_path, ids, half="empirical", numbers=(5,))
    with pytest.raises(InputError, match="holds synthetic and empirical; choose one"):
        open_images(tmp_path)
    assert open_images(tmp_path, half="empirical").names() == ("5",)
    with pytest.raises(InputError, match="must be one of synthetic, empirical"):
        open_images(tmp_path, half="both")


def test_rejects_missing_and_invalid_published_labels(tmp_path, ids):
    # Labels may contain void.
    ids[0, 0] = VOID
    publish(tmp_path, ids, colours=False)
    labels = tmp_path / "synthetic_label_class_grayscale" / "synthetic_label_class_all_grayscale"
    (labels / "synthetic_label_class_all_grayscale_2.png").unlink()
    save(labels, "synthetic_label_class_all_grayscale_1.png", np.where(ids == 3, np.uint8(9), ids))
    images = open_images(tmp_path)
    with pytest.raises(InputError, match="has no file for image number 2"):
        images[1]
    with pytest.raises(InputError, match="has the class id 9; allowed are 0 to 7"):
        images[0]
    np.testing.assert_array_equal(images[2].classes, np.roll(ids, 10, axis=1))


def test_natural_sort_key_sorts_numbers_by_value():
    names = ["img10", "img9", "img1", "a", "img02", "10", "2"]
    assert sorted(names, key=natural_sort_key) == ["2", "10", "a", "img1", "img02", "img9", "img10"]


@pytest.mark.parametrize(
    ("image_name", "mask_name"),
    [
        ("img{}.png", "mask{}.png"),
        ("row-{}.png", "row-{}.label.png"),
        ("IMG_00{}.JPG", "IMG_00{}_seg.tif"),
        ("img00{}.png", "mask{}.png"),
        ("JPEGImages/{}.jpg", "SegmentationClass/{}.png"),
        ("images/train/{}.png", "labels/train/{}_mask.png"),
        ("{}.png", "masks/{}.png"),
    ],
)
def test_pairs_images_with_masks(tmp_path, image_name, mask_name):
    for number in (10, 2, 1, 33):
        save(tmp_path, mask_name.format(number), grey(number))
    for number in (2, 33, 10, 1):
        save(tmp_path, image_name.format(number), photo(number))
    images = open_images(tmp_path, labels={1: "leaf", 2: "pepper", 10: "stem", 33: "wire"})
    assert isinstance(images, FolderSet)
    for image, number, organ in zip(images, (1, 2, 10, 33), (1, 2, 4, 6), strict=True):
        assert (image.colour == number).all()
        assert (image.classes == organ).all()
    assert images.names() == tuple(sorted(images.names(), key=natural_sort_key))
    assert len(set(images.names())) == 4


def test_image_without_mask_has_no_classes_and_other_files_are_ignored(tmp_path):
    for name in ("img1.png", "img2.png"):
        save(tmp_path, name, photo())
    save(tmp_path, "img2_mask.png", grey(1))
    save(tmp_path, "img1_instance.png", grey(1))
    (tmp_path / "notes.txt").write_text("taken on Monday")
    (tmp_path / "._img1.png").write_bytes(b"\0")
    first, second = open_images(tmp_path, labels=FRUIT)
    assert first.classes is None
    assert second.classes is not None


STRIPES = np.indices(SIZE).sum(0) % 2
STRIPED_PNG = png_bytes(STRIPES.astype(np.uint8), [(9, 9, 9), (128, 0, 0)])
UNKNOWN_COLOUR = np.full((*SIZE, 3), (120, 120, 60), np.uint8)


@pytest.mark.parametrize(
    ("files", "labels", "message"),
    [
        ({}, None, "holds no images"),
        ({"img1.png": photo(), "mask2.png": grey(1)}, None, r"mask2.png: is a mask without an image of the"),
        ({"img1.png": photo(), "img01.png": photo()}, None, "has a name too similar to img01.png"),
        ({"a.png": grey(900, np.uint16)}, None, "must be a photograph with 8 bits per channel"),
        ({"a.png": photo(), "a_mask.jpg": photo(255)}, None, "is a JPEG, which changes the values of a mask"),
        ({"a.png": photo(), "a_mask.png": grey(1)[:3, :4]}, FRUIT, "has 4x3 pixels, but its image a.png has"),
        ({"a.png": photo(), "a_mask.png": grey(17)}, FRUIT, "a_mask.png: has the value 17, for which labels"),
        ({"a.png": photo(), "a_mask.png": UNKNOWN_COLOUR}, None, "has the colour #78783c, for which"),
        ({"a.png": photo(), "a_mask.png": UNKNOWN_COLOUR}, FRUIT, "has colours, but labels defines no"),
    ],
)
def test_rejects_images_and_masks(tmp_path, files, labels, message):
    for name, pixels in files.items():
        save(tmp_path, name, pixels)
    with pytest.raises(InputError, match=message):
        list(open_images(tmp_path, labels=labels))


def test_rejects_missing_folder_and_damaged_file(tmp_path):
    with pytest.raises(InputError, match="must be a folder"):
        open_images(tmp_path / "none")
    path = save(tmp_path, "a.png", photo())
    path.write_bytes(path.read_bytes()[:45])
    with pytest.raises(InputError, match=r"a.png: cannot be read as an image"):
        open_images(tmp_path)[0]


def test_a_jpeg_of_several_images_is_no_mask(tmp_path):
    save(tmp_path, "a.png", photo())
    image = Image.fromarray(photo(255))
    image.save(tmp_path / "a_mask.jpg", format="MPO", save_all=True, append_images=[image])
    with pytest.raises(InputError, match=r"a_mask.jpg: is a JPEG"):
        open_images(tmp_path, labels=FRUIT)[0]


def classes_of(folder, mask, labels=None):
    """The classes of a mask, an array or the content of a PNG, for an image of its size."""
    path = folder / "a_mask.png"
    if isinstance(mask, bytes):
        path.write_bytes(mask)
    else:
        save(folder, path.name, mask)
    with Image.open(path) as image:
        save(folder, "a.png", photo(size=(image.height, image.width)))
    return open_images(folder, labels=labels)[0].classes


def test_class_images_and_published_colours_need_no_table(tmp_path, ids):
    for mask in (png_bytes(ids, CLASS_COLOURS), class_colour(ids)):
        np.testing.assert_array_equal(classes_of(tmp_path, mask), ids)


@pytest.mark.parametrize("mode", ["L", "RGB", "P"])
def test_grey_values_require_a_table(tmp_path, ids, mode):
    save(tmp_path, "a.png", photo())
    Image.fromarray(ids).convert(mode).save(tmp_path / "a_mask.png")
    images = open_images(tmp_path)
    assert images.select("colour")[0].colour is not None
    with pytest.raises(InputError, match=r"has values \(0, 1, 2.*\) without defined classes.*classes.toml"):
        images[0]
    np.testing.assert_array_equal(open_images(tmp_path, labels="published")[0].classes, ids)


def test_folder_can_define_its_classes(tmp_path):
    (tmp_path / "classes.toml").write_text('0 = "background"\n3 = "pepper"\n9 = "stem"\notherwise = "void"\n')
    classes = classes_of(tmp_path, np.array([[0, 3, 9, 200]] * 3, np.uint8))
    np.testing.assert_array_equal(classes, [[0, 2, 4, VOID]] * 3)


@pytest.mark.parametrize(
    ("mask", "labels", "expected"),
    [
        # 1 and 16 bits.
        (STRIPES == 1, FRUIT, 2 * STRIPES),
        (grey(4001, np.uint16), {4001: "pepper"}, np.full(SIZE, 2)),
        # Colours match with a small tolerance.
        (
            np.array([[[250, 2, 3], [0, 0, 0], [1, 128, 0]]], np.uint8),
            {"#ff0000": OrganClass.PEPPER, (0, 0, 0): None, "#008000": "leaf"},
            [[2, VOID, 1]],
        ),
        # Indices of a palette take precedence over its colours.
        (STRIPED_PNG, FRUIT, 2 * STRIPES),
        (STRIPED_PNG, {"#090909": "stem", "#800000": "cut"}, np.where(STRIPES, 7, 4)),
    ],
)
def test_table_gives_classes_to_values_or_colours(tmp_path, mask, labels, expected):
    np.testing.assert_array_equal(classes_of(tmp_path, mask, labels), expected)


def test_transparent_pixels_of_a_mask_are_void(tmp_path):
    rgba = np.zeros((*SIZE, 4), np.uint8)
    rgba[:, :4] = (*CLASS_COLOURS[OrganClass.PEPPER], 255)
    rgba[:, 4:] = (13, 77, 200, 0)
    expected = np.full(SIZE, OrganClass.PEPPER)
    expected[:, 4:] = VOID
    np.testing.assert_array_equal(classes_of(tmp_path, rgba), expected)


def test_montoya2021_labels_only_fruit_and_peduncles():
    # Its background contains leaves and stems.
    values = np.array([0, 1, 2, 3, 4, 5, 6, 255])
    classes = KNOWN_LABELS["montoya2021"].map_values(values, "mask1.png")
    assert classes.tolist() == [VOID, 2, 2, 3, 2, 3, 3, VOID]
    # With merged classes, leaves and stems belong to the same class as the background.
    classes = KNOWN_LABELS["montoya2021_background"].map_values(values, "mask1.png")
    assert classes.tolist() == [0, 2, 2, 3, 2, 3, 3, VOID]


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"otherwise": "void"}, "must give a class to at least one mask value"),
        ({1: "peper"}, r"1 = 'peper': must be one of background, leaf, .*, void"),
        ({1: True}, r"1 = True: must be one of"),
        ({-1: "leaf"}, r"-1: must be a mask value, a colour"),
        ({"red": "leaf"}, r"red: must be a mask value, a colour"),
    ],
)
def test_rejects_invalid_table(table, message):
    with pytest.raises(InputError, match=message):
        parse_labels(table, "labels")


def test_grey_and_transparent_photographs_become_rgb(tmp_path):
    save(tmp_path, "a.png", grey(90))
    assert (open_images(tmp_path)[0].colour == 90).all()
    rgba = np.full((*SIZE, 4), 200, np.uint8)
    rgba[..., 3] = 0
    rgba[0, :, 3] = 255
    save(tmp_path, "a.png", rgba)
    colour = open_images(tmp_path)[0].colour
    # Transparent pixels are black.
    assert (colour[0] == 200).all()
    assert (colour[1:] == 0).all()


def test_rejects_arguments_of_another_layout(tmp_path, small):
    with pytest.raises(InputError, match="apply only to a folder of images"):
        open_images(small.folder, labels="published")
    with pytest.raises(InputError, match="applies only to the published data set"):
        open_images(small.folder, half="synthetic")
    save(tmp_path, "photos/a.png", photo())
    with pytest.raises(InputError, match=r"must be a table or one of published, montoya2021, .*, not 'voc'"):
        open_images(tmp_path / "photos", labels="voc")
