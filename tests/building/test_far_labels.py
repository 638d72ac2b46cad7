"""Labels of far rows in whole data sets: as organs, ignored, as background; exports, readers, checks."""

from __future__ import annotations

import contextlib
import io
import json
import shutil

import numpy as np
import pytest
from data_sets import set_without_plants
from painted_set import SIZE, Painter
from PIL import Image

from pepperscene.building.execution.build import build
from pepperscene.building.execution.job import BuildOptions
from pepperscene.classes import IGNORE_CLASS, IGNORE_COLOUR, OrganClass
from pepperscene.dataset.readers import open_images
from pepperscene.dataset.store.images import read_image
from pepperscene.errors import InputError
from pepperscene.export import export_dataset
from pepperscene.frame import Frame
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.review.check import check_dataset
from pepperscene.review.report import write_report
from pepperscene.truth import class_colour, class_from_colour, class_pixel_counts

FRAMES = (0, 3, 5)
FAR_ROW = 60_002
REGION = (slice(150, 175), slice(20, 200))
"""Rows and columns of the ignored region, as painted."""


class IgnoringPainter(Painter):
    """Paints a region that is ignored, as a far row is, over what `Painter` paints."""

    def render(self, camera, outputs=(), quality="standard", seed=0, **others):
        frame = super().render(camera, ("colour", "class", "instance", "distance"), quality, seed, **others)
        images, entries = dict(frame.images), dict(frame.metadata["instances"])
        images["class"][REGION], images["instance"][REGION] = IGNORE_CLASS, FAR_ROW
        images["distance"][REGION] = 2.0
        images["class_colour"] = class_colour(images["class"])
        counts = np.bincount(images["instance"].ravel(), minlength=65536)
        entries = {key: {**entry, "pixels": int(counts[int(key)])} for key, entry in entries.items()}
        entries = {key: entry for key, entry in entries.items() if entry["pixels"]}
        area = int(counts[FAR_ROW])
        entries[str(FAR_ROW)] = {
            "class": IGNORE_CLASS, "kind": "far_row", "plant": -1, "phytomer": -1, "parent": 0,
            "pixels": area, "far": True,
        }  # fmt: skip
        size = dict(zip(("height", "width"), SIZE, strict=True))
        metadata = {"camera": {**frame.metadata["camera"], **size}, "instances": entries}
        return Frame({name: images[name] for name in outputs}, metadata)


OUTPUTS = ("colour", "class", "class_colour", "instance", "distance")


def make_set(folder, labelled_as):
    changes = {"greenhouse": {"far_rows_as": labelled_as}}
    return set_without_plants(folder, FRAMES, OUTPUTS, IgnoringPainter, changes)


@pytest.fixture(scope="module")
def ignoring(tmp_path_factory):
    return make_set(tmp_path_factory.mktemp("set") / "set", "ignore")


@pytest.fixture(scope="module")
def region():
    mask = np.zeros(SIZE, bool)
    mask[REGION] = True
    return mask


def test_ignored_pixels_are_of_no_class_in_the_json_and_survive_the_file(ignoring, region):
    for index in FRAMES:
        classes = ignoring.image(index, "class")
        np.testing.assert_array_equal(classes == IGNORE_CLASS, region)
        counts = ignoring.metadata(index)["class_pixels"]
        assert sum(counts.values()) == classes.size - region.sum()
        assert counts == {o.name.lower(): int((classes == o).sum()) for o in OrganClass}
        # A viewer shows the palette's colours, those of the coloured copy.
        with Image.open(ignoring.path(index, "class")) as image:
            shown = np.asarray(image.convert("RGB"))
        np.testing.assert_array_equal(shown, ignoring.image(index, "class_colour"))


def test_colours_and_counts_of_ignored_pixels():
    ids = np.array([[0, 7, IGNORE_CLASS]], np.uint8)
    assert class_colour(ids)[0, 2].tolist() == list(IGNORE_COLOUR)
    np.testing.assert_array_equal(class_from_colour(class_colour(ids)), ids)
    assert sum(class_pixel_counts(ids).values()) == 2
    for function in (class_colour, class_pixel_counts):
        with pytest.raises(ValueError, match="255"):
            function(np.array([[8]], np.uint8))


def test_check_accepts_ignored_pixels_only_if_the_recipe_says_so(ignoring, tmp_path):
    # Nothing is wrong but that the painted organs are not on the edges of noise.
    assert {finding.kind for finding in check_dataset(ignoring.folder).findings} <= {"edges"}
    other = make_set(tmp_path / "other", "labels")
    found = check_dataset(other.folder)
    wrong = [finding for finding in found.findings if finding.kind == "label"]
    assert [finding.index for finding in wrong] == list(FRAMES)
    assert "class 255" in wrong[0].problem
    with pytest.raises(InputError, match="not 255"):
        open_images(other.folder)[0]


@pytest.mark.parametrize(
    "changes",
    [
        {"greenhouse": {"far_rows_as": {"in_turn": ["labels", "ignore"]}}},
        {"greenhouse": {}, "twins": {"greenhouse.far_rows_as": ["labels", "ignore"]}},
    ],
)
def test_ignored_pixels_of_some_frames_are_accepted(tmp_path, region, changes):
    dataset = set_without_plants(tmp_path / "set", [0], OUTPUTS, IgnoringPainter, changes)
    assert {finding.kind for finding in check_dataset(dataset.folder).findings} <= {"edges"}
    np.testing.assert_array_equal(open_images(dataset.folder)[0].classes == IGNORE_CLASS, region)


def test_torch_masks_have_the_class_that_losses_leave_out(ignoring, region):
    pytest.importorskip("torch")
    from pepperscene.dataset.readers.torch_images import torch_images

    np.testing.assert_array_equal(torch_images(ignoring.folder)[0]["mask"].numpy() == IGNORE_CLASS, region)


@pytest.fixture(scope="module")
def coco(ignoring, tmp_path_factory):
    pytest.importorskip("pycocotools.mask", reason="the extra `export` installs pycocotools")
    return export_dataset(ignoring.folder, "coco", tmp_path_factory.mktemp("coco") / "out").folder


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
def test_ignored_pixels_of_coco_are_crowds_of_every_class(coco, region):
    """COCO's evaluation ignores detections in a crowd of their class."""
    from pycocotools.coco import COCO

    with contextlib.redirect_stdout(io.StringIO()):
        truth = COCO(coco / "annotations" / "instances_train.json")
    ids = [annotation["id"] for annotation in truth.dataset["annotations"]]
    assert len(set(ids)) == len(ids)
    crowds = [one for one in truth.anns.values() if one["iscrowd"] and one["area"] == region.sum()]
    expected = [(index, organ) for index in FRAMES for organ in range(1, len(OrganClass))]
    assert sorted((one["image_id"], one["category_id"]) for one in crowds) == expected
    for crowd in crowds:
        np.testing.assert_array_equal(truth.annToMask(crowd).astype(bool), region)
        assert crowd["bbox"] == [20, 150, 180, 25]


@pytest.mark.parametrize("classes", [None, "pepper"])
def test_ignored_pixels_of_a_coco_export_are_read_as_void(ignoring, region, tmp_path, classes):
    pytest.importorskip("pycocotools.mask", reason="the extra `export` installs pycocotools")
    out = export_dataset(ignoring.folder, "coco", tmp_path / "out", classes=classes).folder
    for image in open_images(out):
        truth = ignoring.image(int(image.name), "class")
        # With fewer classes, the rest of the image may be of any of the others.
        expected = truth if classes is None else np.where(truth == OrganClass.PEPPER, truth, IGNORE_CLASS)
        np.testing.assert_array_equal(image.classes, expected)
        assert not image.instances[region].any()


def test_ignored_pixels_are_void_in_panoptic_images(coco, region):
    panoptic = json.loads((coco / "annotations" / "panoptic_train.json").read_text())
    for record in panoptic["annotations"]:
        image = read_image(coco / "annotations" / "panoptic_train" / record["file_name"]).astype(np.uint32)
        ids = image @ np.array([1, 256, 65536], np.uint32)
        np.testing.assert_array_equal(ids == 0, region)
        assert {*np.unique(ids).tolist()} - {0} == {one["id"] for one in record["segments_info"]}


@pytest.mark.parametrize("form", ["yolo", "yolo_detect"])
def test_yolo_writes_masks_of_ignored_pixels_and_no_objects_there(ignoring, painted, region, tmp_path, form):
    pytest.importorskip("cv2")
    out = export_dataset(ignoring.folder, form, tmp_path / "out").folder
    for index in FRAMES:
        mask = read_image(out / "ignore" / "train" / f"{index:06d}.png")
        np.testing.assert_array_equal(mask, np.where(region, 255, 0))
        if form == "yolo":
            for line in (out / "labels" / "train" / f"{index:06d}.txt").read_text().splitlines():
                x, y = np.array(line.split()[1:], float).reshape(-1, 2).T
                columns, rows = (x * SIZE[1]).astype(int), (y * SIZE[0]).astype(int)
                assert not region[rows, columns].any()
    # A set without ignored pixels has no masks.
    assert not (export_dataset(painted.folder, form, tmp_path / "all").folder / "ignore").exists()


@pytest.mark.parametrize(
    "options", [{}, {"classes": "other=background+leaf,fruit=pepper"}, {"smallest_px": 9}]
)
def test_semantic_masks_ignore_them(ignoring, region, tmp_path, options):
    out = export_dataset(ignoring.folder, "semantic", tmp_path / "out", **options).folder
    for index in FRAMES:
        mask = read_image(out / "masks" / "train" / f"{index:06d}.png")
        assert (mask[region] == IGNORE_CLASS).all()
        if not options:
            np.testing.assert_array_equal(mask, ignoring.image(index, "class"))


def test_hugging_face_has_no_class_for_ignored_instances(ignoring, region, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    out = export_dataset(ignoring.folder, "huggingface", tmp_path / "out").folder
    (file,) = out.rglob("*.parquet")
    for row in parquet.read_table(file).to_pylist():
        with Image.open(io.BytesIO(row["mask"]["bytes"])) as image:
            np.testing.assert_array_equal(np.asarray(image) == IGNORE_CLASS, region)
        far = [organ for organ in row["organs"] if organ["far"]]
        assert [(organ["instance"], organ["class"]) for organ in far] == [(FAR_ROW, None)]
        assert all(organ["class"] is not None for organ in row["organs"] if not organ["far"])


@pytest.mark.parametrize("name", ["webdataset", "published"])
def test_other_formats_keep_the_class_id(ignoring, region, tmp_path, name):
    out = export_dataset(ignoring.folder, name, tmp_path / "out").folder
    if name == "published":
        classes = open_images(out)[0].classes
    else:
        import gzip
        import tarfile

        with tarfile.open(out / "train-000000.tar") as tar:
            member = next(one for one in tar.getnames() if one.endswith("class.npy.gz"))
            classes = np.load(io.BytesIO(gzip.decompress(tar.extractfile(member).read())))
    np.testing.assert_array_equal(classes == IGNORE_CLASS, region)


def test_the_report_names_ignored_pixels_if_the_recipe_has_them(ignoring, painted, tmp_path):
    for dataset, expected in ((ignoring, True), (painted, False)):
        folder = shutil.copytree(dataset.folder, tmp_path / dataset.folder.parent.name)
        page = write_report(folder).page.read_text()
        assert (">ignored<" in page) == expected


SMALL = {
    "plan.sets": 1, "plan.rotations": 1, "plan.frames": 1, "plan.select": [0],
    "row.plants_front": 3, "row.plants_back": 2, "greenhouse.far_rows": 1, "greenhouse.far_reach_mm": 2500,
}  # fmt: skip


@pytest.mark.long
def test_fruit_of_far_rows_are_labelled_in_a_daylight_photograph(tmp_path):
    sets = {}
    for labelled_as in ("labels", "ignore", "background"):
        recipe = load_recipe("greenhouse", {**SMALL, "greenhouse.far_rows_as": labelled_as})
        # Light does not depend on labels: the photograph with ignored rows is left out to save time.
        outputs = ["class", "instance", "coverage"] + (["colour"] if labelled_as != "ignore" else [])
        options = BuildOptions(quality="draft")
        sets[labelled_as] = build(recipe, tmp_path / labelled_as, [0], outputs, options).dataset
        assert {finding.kind for finding in check_dataset(sets[labelled_as].folder).findings} <= {"drift"}
    assert sets["labels"].path(0, "colour").read_bytes() == sets["background"].path(0, "colour").read_bytes()

    # Ripe fruit is yellow to red: hardly any of its pixels is left without a label.
    red, green, blue = np.moveaxis(sets["labels"].image(0, "colour").astype(int), -1, 0)
    is_red = (red >= 60) & (red >= 1.2 * green) & (red >= 2 * blue)
    classes = {name: one.image(0, "class") for name, one in sets.items()}
    shares = {name: (image[is_red] == OrganClass.BACKGROUND).mean() for name, image in classes.items()}
    assert is_red.sum() > 500
    assert shares["background"] > 0.05
    assert max(shares["labels"], shares["ignore"]) < 0.005

    # Far fruit have a class, an instance and a box; plants that the camera comes near to are grown in full.
    instance, entries = sets["labels"].image(0, "instance"), sets["labels"].metadata(0)["instances"]
    own_plants = SMALL["row.plants_front"] + SMALL["row.plants_back"]
    far = {int(key): entry for key, entry in entries.items() if entry["plant"] >= own_plants}
    fruit = [key for key, entry in far.items() if entry["class"] == OrganClass.PEPPER]
    assert len(fruit) > 10
    for key in fruit:
        rows, columns = np.nonzero(instance == key)
        assert far[key]["box"] == [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
        assert far[key]["pixels"] == rows.size
        assert (classes["labels"][rows, columns] == OrganClass.PEPPER).all()
    is_far = np.isin(instance, list(far))
    np.testing.assert_array_equal(classes["ignore"] == IGNORE_CLASS, is_far)
    # Nothing is lost of the pixels' area but what is ignored.
    areas = {name: one.image(0, "coverage").astype(float).sum() for name, one in sets.items()}
    assert areas["labels"] == areas["background"] == is_far.size
    assert is_far.size - areas["ignore"] == pytest.approx(is_far.sum(), rel=0.02)
