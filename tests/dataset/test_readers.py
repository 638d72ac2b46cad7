"""Rendered and published data sets, and folders of images with masks, read as the same type."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from pepperscene.classes import CLASS_COLOURS, OrganClass
from pepperscene.dataset import BuildOptions, build
from pepperscene.dataset.export import export_dataset
from pepperscene.dataset.readers import FolderSet, PublishedSet, RenderedSet, open_images
from pepperscene.dataset.readers.folder import natural_sort_key, pairs
from pepperscene.dataset.readers.image_set import VOID
from pepperscene.dataset.readers.labels import KNOWN_LABELS, labels_of
from pepperscene.dataset.store.images import png_bytes
from pepperscene.errors import InputError
from pepperscene.truth import class_colour, distance_code, distance_from_code

SIZE = (6, 8)
FRUIT = {0: "background", 1: "pepper", 255: "void"}


@pytest.fixture
def ids():
    """Every class somewhere."""
    return np.random.default_rng(5).permutation(np.arange(48) % 8).astype(np.uint8).reshape(SIZE)


def grey(folder, name, value=7, size=SIZE):
    """An image of one grey, which tells which one was read."""
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.full((*size, 3), value, np.uint8)).save(path)
    return path


def mask(folder, name, value=1, size=SIZE):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.full(size, value, np.uint8)).save(path)
    return path


# Rendered sets


@pytest.fixture
def built(tmp_path, recipe, fake_renderer, empty_scenes):
    outputs = ("colour", "class", "instance", "distance")
    return build(recipe, tmp_path / "set", [0, 3, 9], outputs, BuildOptions(renderer=fake_renderer)).dataset


def test_a_data_set_of_ours_is_read_as_it_is(built):
    images = open_images(built.folder)
    assert isinstance(images, RenderedSet)
    assert images.names() == ("000000", "000003", "000009")
    assert images.name == "set"
    for index, picture in zip(built.indices(), images, strict=True):
        np.testing.assert_array_equal(picture.colour, built.image(index, "colour"))
        np.testing.assert_array_equal(picture.classes, built.image(index, "class"))
        np.testing.assert_array_equal(picture.instances, built.image(index, "instance"))
        np.testing.assert_array_equal(picture.distance_m, built.image(index, "distance"))
        assert picture.facts["index"] == index
        assert [array.dtype.name for array in (picture.classes, picture.instances, picture.distance_m)] == [
            "uint8", "uint16", "float32",
        ]  # fmt: skip


def test_fields_are_read_from_what_there_is(tmp_path, recipe, fake_renderer, empty_scenes):
    outputs = ("class_colour", "distance_code")
    made = build(recipe, tmp_path / "set", [0], outputs, BuildOptions(renderer=fake_renderer)).dataset
    picture = open_images(made.folder)[0]
    code = made.image(0, "distance_code")
    np.testing.assert_array_equal(picture.distance_m, distance_from_code(code))
    assert picture.classes.max() < len(OrganClass)
    assert picture.colour is None
    assert picture.instances is None


def test_only_selected_files_are_opened(built):
    for path in (built.folder / "distance").iterdir():
        path.unlink()
    images = open_images(built.folder)
    assert images.select("colour", "classes")[0].facts == {}
    with pytest.raises(InputError, match=r"distance/000000.exr"):
        images[0]


def test_a_data_set_without_frames_is_refused(built):
    for path in (built.folder / "frames").iterdir():
        path.unlink()
    with pytest.raises(InputError, match="holds no frames"):
        open_images(built.folder)


# The published layout


def publish(folder, classes, half="synthetic", numbers=(1, 2, 10), grey_labels=True, colours=True):
    """The published layout, written here from its description alone."""
    for number in numbers:
        grey(folder, f"{half}_image_color/{half}_image_color_{number}.png", number)
        if grey_labels:
            under = f"{half}_label_class_grayscale/{half}_label_class_all_grayscale"
            path = folder / under / f"{half}_label_class_all_grayscale_{number}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(np.roll(classes, number, axis=1)).save(path)
        if colours:
            path = folder / f"{half}_label_class_colorscale/{half}_label_class_colorscale_{number}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(class_colour(np.roll(classes, number, axis=1))).save(path)


def test_the_published_set_is_read_by_number(tmp_path, ids):
    publish(tmp_path, ids)
    images = open_images(tmp_path)
    assert isinstance(images, PublishedSet)
    # Not 1, 10, 2.
    assert images.names() == ("1", "2", "10")
    for number, picture in zip((1, 2, 10), images, strict=True):
        assert (picture.colour == number).all()
        np.testing.assert_array_equal(picture.classes, np.roll(ids, number, axis=1))
        assert picture.distance_m is None
        assert picture.facts == {"half": "synthetic", "number": number}


def test_an_export_to_the_layout_is_read_as_the_data_set(tmp_path, built):
    export_dataset(built.folder, "published", tmp_path / "out")
    there, back = open_images(built.folder), open_images(tmp_path / "out")
    assert back.names() == ("1", "2", "3")
    for ours, theirs in zip(there, back, strict=True):
        np.testing.assert_array_equal(theirs.colour, ours.colour)
        np.testing.assert_array_equal(theirs.classes, ours.classes)
        # To half a step of the code; the corner without anything stays without.
        seen = np.isfinite(ours.distance_m)
        np.testing.assert_array_equal(np.isfinite(theirs.distance_m), seen)
        assert np.abs(theirs.distance_m[seen] - ours.distance_m[seen]).max() <= 0.00425 + 1e-6


def test_colours_of_other_readers_are_the_nearest_class(tmp_path, ids):
    publish(tmp_path, ids, grey_labels=False)
    for path in (tmp_path / "synthetic_label_class_colorscale").iterdir():
        rgb = np.array(Image.open(path)).astype(int)
        rng = np.random.default_rng(1)
        Image.fromarray(np.clip(rgb + rng.integers(-9, 10, rgb.shape), 0, 255).astype(np.uint8)).save(path)
    np.testing.assert_array_equal(open_images(tmp_path)[2].classes, np.roll(ids, 10, axis=1))


def test_the_depth_code_becomes_metres(tmp_path, ids):
    publish(tmp_path, ids, numbers=(1,))
    metres = np.linspace(0.2, 2.1, 48).reshape(SIZE)
    (tmp_path / "synthetic_label_depth_grayscale").mkdir()
    # The names inside are not known: the number decides.
    path = tmp_path / "synthetic_label_depth_grayscale" / "whatever_1.png"
    Image.fromarray(distance_code(metres)).save(path)
    picture = open_images(tmp_path)[0]
    assert picture.distance_m.dtype == np.float32
    assert np.abs(picture.distance_m - metres).max() <= 0.00425 + 1e-6


def test_two_halves_have_to_be_told_apart(tmp_path, ids):
    publish(tmp_path, ids)
    publish(tmp_path, ids, half="empirical", numbers=(5,))
    with pytest.raises(InputError, match="holds synthetic and empirical: say which"):
        open_images(tmp_path)
    assert open_images(tmp_path, half="empirical").names() == ("5",)
    with pytest.raises(InputError, match="must be one of synthetic, empirical"):
        open_images(tmp_path, half="both")


def test_a_missing_or_impossible_label_is_one_sentence(tmp_path, ids):
    publish(tmp_path, ids, colours=False)
    labels = tmp_path / "synthetic_label_class_grayscale" / "synthetic_label_class_all_grayscale"
    (labels / "synthetic_label_class_all_grayscale_2.png").unlink()
    wrong = np.where(ids == 3, np.uint8(9), ids)
    Image.fromarray(wrong).save(labels / "synthetic_label_class_all_grayscale_1.png")
    images = open_images(tmp_path)
    with pytest.raises(InputError, match="has no file of the number 2, which its image has"):
        images[1]
    with pytest.raises(InputError, match="has the class id 9; allowed are 0 to 7"):
        images[0]


def test_a_published_label_may_leave_pixels_out(tmp_path, ids):
    ids[0, 0] = VOID
    publish(tmp_path, ids, numbers=(8,), colours=False)
    np.testing.assert_array_equal(open_images(tmp_path)[0].classes, ids)


# Folders: which mask belongs to which image


def test_names_sort_by_their_numbers():
    names = ["img10", "img9", "img1", "a", "img02", "10", "2"]
    assert sorted(names, key=natural_sort_key) == ["2", "10", "a", "img1", "img02", "img9", "img10"]


@pytest.mark.parametrize(
    ("image", "masked"),
    [
        ("img{}.png", "mask{}.png"),
        ("{}.jpg", "{}_mask.png"),
        ("row-{}.png", "row-{}.label.png"),
        ("IMG_00{}.JPG", "IMG_00{}_seg.tif"),
        ("img00{}.png", "mask{}.png"),
        ("images/a{}.png", "masks/a{}.png"),
        ("JPEGImages/{}.jpg", "SegmentationClass/{}.png"),
        ("images/train/{}.png", "labels/train/{}_mask.png"),
        ("{}.png", "masks/{}.png"),
    ],
)
def test_masks_find_their_images(tmp_path, image, masked):
    # Written in an order that no name tells.
    for number in (10, 2, 1, 33):
        mask(tmp_path, masked.format(number), number)
    for number in (2, 33, 10, 1):
        grey(tmp_path, image.format(number), number)
    images = open_images(tmp_path, labels={1: "leaf", 2: "pepper", 10: "stem", 33: "wire"})
    assert isinstance(images, FolderSet)
    for picture, number, organ in zip(images, (1, 2, 10, 33), (1, 2, 4, 6), strict=True):
        assert (picture.colour == number).all()
        assert (picture.classes == organ).all()
    assert images.names() == tuple(sorted(images.names(), key=natural_sort_key))
    assert len(set(images.names())) == 4


def test_an_image_without_a_mask_is_not_labelled(tmp_path):
    grey(tmp_path, "a.png")
    grey(tmp_path, "b.png")
    mask(tmp_path, "b_mask.png")
    first, second = open_images(tmp_path, labels=FRUIT)
    assert first.classes is None
    assert second.classes is not None


def test_a_mask_without_an_image_is_refused(tmp_path):
    grey(tmp_path, "img1.png")
    mask(tmp_path, "mask2.png")
    with pytest.raises(InputError, match=r"mask2.png: is a mask without an image of the same name"):
        open_images(tmp_path)


def test_names_that_cannot_be_told_apart_are_refused(tmp_path):
    grey(tmp_path, "img1.png")
    grey(tmp_path, "img01.png")
    with pytest.raises(InputError, match=r"cannot be told from img01.png by name"):
        open_images(tmp_path)


def test_what_is_no_picture_is_left_alone(tmp_path):
    grey(tmp_path, "img1.png")
    mask(tmp_path, "img1_instance.png")
    (tmp_path / "notes.txt").write_text("seen on Monday")
    (tmp_path / "._img1.png").write_bytes(b"\0")
    assert [pair.name for pair in pairs(tmp_path)] == ["img1"]


def test_folders_without_images_are_refused(tmp_path):
    with pytest.raises(InputError, match="holds no images"):
        open_images(tmp_path)
    with pytest.raises(InputError, match="must be a folder"):
        open_images(tmp_path / "none")


# Folders: what masks mean


def test_our_own_class_images_need_no_telling(tmp_path, ids):
    grey(tmp_path, "a.png")
    (tmp_path / "a_mask.png").write_bytes(png_bytes(ids, CLASS_COLOURS))
    np.testing.assert_array_equal(open_images(tmp_path)[0].classes, ids)


def test_published_colours_need_no_telling(tmp_path, ids):
    grey(tmp_path, "a.png")
    Image.fromarray(class_colour(ids)).save(tmp_path / "a_mask.png")
    np.testing.assert_array_equal(open_images(tmp_path)[0].classes, ids)


def test_other_colours_are_not_guessed(tmp_path, ids):
    grey(tmp_path, "a.png")
    rgb = class_colour(ids)
    rgb[0, 0] = (120, 120, 60)
    Image.fromarray(rgb).save(tmp_path / "a_mask.png")
    with pytest.raises(InputError, match="has the colour #78783c, of which the published colour scale says"):
        open_images(tmp_path)[0]


@pytest.mark.parametrize("mode", ["L", "RGB", "P"])
def test_grey_values_mean_nothing_until_told(tmp_path, ids, mode):
    grey(tmp_path, "a.png")
    Image.fromarray(ids).convert(mode).save(tmp_path / "a_mask.png")
    images = open_images(tmp_path)
    assert images.select("colour")[0].colour is not None
    with pytest.raises(
        InputError, match=r"has values \(0, 1, 2.*\) whose classes nobody tells.*classes.toml"
    ):
        images[0]
    np.testing.assert_array_equal(open_images(tmp_path, labels="published")[0].classes, ids)


def test_a_folder_can_tell_by_itself(tmp_path):
    grey(tmp_path, "a.png")
    values = np.array([[0, 3, 9, 200]], np.uint8).repeat(3, axis=0)
    Image.fromarray(np.ones((3, 4, 3), np.uint8)).save(tmp_path / "a.png")
    Image.fromarray(values).save(tmp_path / "a_mask.png")
    (tmp_path / "classes.toml").write_text('0 = "background"\n3 = "pepper"\n9 = "stem"\notherwise = "void"\n')
    classes = open_images(tmp_path)[0].classes
    np.testing.assert_array_equal(classes, [[0, 2, 4, VOID]] * 3)


def test_told_colours_are_matched_with_little_tolerance(tmp_path):
    grey(tmp_path, "a.png", size=(1, 3))
    Image.fromarray(np.array([[[250, 2, 3], [0, 0, 0], [1, 128, 0]]], np.uint8)).save(tmp_path / "a_mask.png")
    told = {"#ff0000": OrganClass.PEPPER, (0, 0, 0): None, "#008000": "leaf"}
    np.testing.assert_array_equal(open_images(tmp_path, labels=told)[0].classes, [[2, VOID, 1]])
    # A table of values has nothing to say of colours.
    with pytest.raises(InputError, match="has colours, but labels tells nothing of colours"):
        open_images(tmp_path, labels=FRUIT)[0]


def test_a_value_without_meaning_is_named(tmp_path):
    grey(tmp_path, "a.png")
    mask(tmp_path, "a_mask.png", 17)
    with pytest.raises(InputError, match=r"a_mask.png: has the value 17, of which labels says nothing"):
        open_images(tmp_path, labels=FRUIT)[0]


def test_values_of_16_bits_are_read_whole(tmp_path):
    grey(tmp_path, "a.png")
    Image.fromarray(np.full(SIZE, 4001, np.uint16)).save(tmp_path / "a_mask.png")
    assert (open_images(tmp_path, labels={4001: "pepper"})[0].classes == 2).all()


def test_a_mask_of_one_bit_has_values_0_and_1(tmp_path):
    grey(tmp_path, "a.png")
    bits = np.indices(SIZE).sum(0) % 2 == 0
    Image.fromarray(bits).save(tmp_path / "a_mask.png")
    np.testing.assert_array_equal(open_images(tmp_path, labels=FRUIT)[0].classes, np.where(bits, 2, 0))


def test_palette_indices_count_before_palette_colours(tmp_path):
    grey(tmp_path, "a.png")
    values = (np.indices(SIZE).sum(0) % 2).astype(np.uint8)
    (tmp_path / "a_mask.png").write_bytes(png_bytes(values, [(9, 9, 9), (128, 0, 0)]))
    np.testing.assert_array_equal(open_images(tmp_path, labels=FRUIT)[0].classes, 2 * values)
    colours = {"#090909": "stem", "#800000": "cut"}
    np.testing.assert_array_equal(open_images(tmp_path, labels=colours)[0].classes, np.where(values, 7, 4))


def test_transparent_pixels_of_a_mask_are_void(tmp_path):
    grey(tmp_path, "a.png")
    rgba = np.zeros((*SIZE, 4), np.uint8)
    rgba[:, :4] = (*CLASS_COLOURS[OrganClass.PEPPER], 255)
    rgba[:, 4:] = (13, 77, 200, 0)
    Image.fromarray(rgba).save(tmp_path / "a_mask.png")
    classes = open_images(tmp_path)[0].classes
    assert (classes[:, :4] == OrganClass.PEPPER).all()
    assert (classes[:, 4:] == VOID).all()


def test_a_mask_is_never_resized(tmp_path):
    grey(tmp_path, "a.png")
    mask(tmp_path, "a_mask.png", size=(3, 4))
    with pytest.raises(InputError, match=r"is 4x3 pixels large, but its image a.png 8x6; labels are never"):
        open_images(tmp_path, labels=FRUIT)[0]


def test_a_mask_with_losses_is_refused(tmp_path):
    grey(tmp_path, "a.png")
    Image.fromarray(np.full((*SIZE, 3), 255, np.uint8)).save(tmp_path / "a_mask.jpg")
    with pytest.raises(InputError, match="is a JPEG, which changes the values of a mask; save it as PNG"):
        open_images(tmp_path)[0]


def test_a_photograph_is_turned_as_its_camera_was(tmp_path):
    upright = np.random.default_rng(3).integers(0, 256, (6, 8, 3)).astype(np.uint8)
    exif = Image.Exif()
    exif[0x0112] = 6  # to be turned by a quarter to the right
    Image.fromarray(np.rot90(upright, 1)).save(tmp_path / "a.png", exif=exif)
    mask(tmp_path, "a_mask.png", 1)
    picture = open_images(tmp_path, labels=FRUIT)[0]
    np.testing.assert_array_equal(picture.colour, upright)
    assert picture.size == (6, 8)


def test_transparency_of_a_photograph_lies_over_black(tmp_path):
    rgba = np.full((*SIZE, 4), 200, np.uint8)
    rgba[..., 3] = 0
    rgba[0, :, 3] = 255
    Image.fromarray(rgba).save(tmp_path / "a.png")
    colour = open_images(tmp_path)[0].colour
    assert (colour[0] == 200).all()
    assert (colour[1:] == 0).all()


def test_grey_photographs_have_three_equal_channels(tmp_path):
    Image.fromarray(np.full(SIZE, 90, np.uint8)).save(tmp_path / "a.png")
    assert (open_images(tmp_path)[0].colour == 90).all()
    Image.fromarray(np.full(SIZE, 900, np.uint16)).save(tmp_path / "a.png")
    with pytest.raises(InputError, match="must be a photograph of 8 bits a channel"):
        open_images(tmp_path)[0]


def test_a_damaged_file_is_one_sentence(tmp_path):
    path = grey(tmp_path, "a.png")
    path.write_bytes(path.read_bytes()[:45])
    with pytest.raises(InputError, match=r"a.png: cannot be read as an image"):
        open_images(tmp_path)[0]


def test_real_photographs_tell_fruit_and_stalks_alone():
    labels = KNOWN_LABELS["montoya2021"]
    values = np.array([0, 1, 2, 3, 4, 5, 255])
    found = labels.of_values(values, "mask1.png")
    # Their background is whatever is neither: leaves and stems as well.
    assert found.tolist() == [VOID, 2, 2, 3, 2, 3, VOID]


@pytest.mark.parametrize(
    ("told", "message"),
    [
        ({}, "must give a class to at least one mask value"),
        ({"otherwise": "void"}, "must give a class to at least one mask value"),
        ({1: "peper"}, r"1 = 'peper': must be one of background, leaf, .*, void"),
        ({1: 9}, r"1 = 9: must be one of"),
        ({1: True}, r"1 = True: must be one of"),
        ({-1: "leaf"}, r"-1: must be a mask value, a colour"),
        ({"red": "leaf"}, r"red: must be a mask value, a colour"),
    ],
)
def test_a_table_that_makes_no_sense_is_one_sentence(told, message):
    with pytest.raises(InputError, match=message):
        labels_of(told, "labels")


def test_arguments_go_with_their_layout_only(tmp_path, built):
    with pytest.raises(InputError, match="go only with a folder of images"):
        open_images(built.folder, labels="published")
    with pytest.raises(InputError, match="goes only with the layout of the published data set"):
        open_images(built.folder, half="synthetic")
    grey(tmp_path, "photos/a.png")
    with pytest.raises(InputError, match="must be a table or one of published, montoya2021, not 'voc'"):
        open_images(tmp_path / "photos", labels="voc")
