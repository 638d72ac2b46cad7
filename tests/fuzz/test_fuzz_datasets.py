"""Changed files of data sets, written by this package or published: each is read, refused or reported."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
from data_sets import HarvestRenderer, set_without_plants
from fuzzing import EDITS, EXAMPLES, attempt, attempt_file, mutated
from hypothesis import strategies as st
from PIL import Image

from pepperscene import open_images
from pepperscene.dataset.store.dataset import open_dataset
from pepperscene.dataset.store.frame_json import CHECKSUM, checksum_of
from pepperscene.dataset.store.images import read_image, write_image
from pepperscene.dataset.store.journal import JOURNAL, read_timings
from pepperscene.export import export_dataset
from pepperscene.review.check import check_dataset

OUTPUTS = ("colour", "class", "instance", "distance", "harvest")


@pytest.fixture(scope="module")
def small_set(tmp_path_factory):
    """Two frames with images of every kind, their journal and tables."""
    return set_without_plants(
        tmp_path_factory.mktemp("set") / "set", range(2), OUTPUTS, HarvestRenderer
    ).folder


@pytest.fixture
def folder(small_set, tmp_path):
    return shutil.copytree(small_set, tmp_path / "set")


@pytest.fixture
def image_files(small_set, tmp_path):
    """The content of an image of every format, by suffix."""
    write_image(tmp_path / "flow.exr", np.zeros((6, 8, 3), np.float32), "flow")
    write_image(tmp_path / "coverage.exr", np.zeros((6, 8, 8), np.float16), "coverage")
    contents = {"exr": [(tmp_path / f"{name}.exr").read_bytes() for name in ("flow", "coverage")]}
    for path in sorted((small_set / "frames").parent.rglob("*")):
        if path.suffix in {".png", ".exr", ".json"}:
            contents.setdefault(path.suffix[1:], []).append(path.read_bytes())
    return contents


@EXAMPLES
@pytest.mark.parametrize("suffix", ["png", "exr", "json"])
def test_image(examples, tmp_path, image_files, suffix):
    attempt_file(examples, tmp_path / f"file.{suffix}", image_files[suffix], read_image)


def read_set(folder):
    dataset = open_dataset(folder)
    assert dataset.indices() == (0, 1)
    assert len(dataset.manifest()) == 2


def read_frame(folder):
    dataset = open_dataset(folder)
    status = dataset.intact(0)
    assert status.checksum in {"", status.written_checksum}
    assert dataset.manifest().num_rows in {1, 2}
    dataset.metadata(0)


def read_journal(folder):
    dataset = open_dataset(folder)
    read_timings(folder, {dataset.written_checksum(index) for index in dataset.indices()})


@EXAMPLES
@pytest.mark.parametrize(
    ("name", "read"),
    [("dataset.json", read_set), ("frames/000000.json", read_frame), (JOURNAL, read_journal)],
)
def test_description(examples, folder, name, read):
    path = folder / name
    attempt_file(examples, path, [path.read_bytes()], lambda _: read(folder))


@EXAMPLES
@pytest.mark.parametrize("name", ["manifest", "fruit"])
def test_table(examples, folder, name):
    path = folder / f"{name}.parquet"
    content = path.read_bytes()

    def read(edits):
        path.write_bytes(mutated(content, edits))
        table = getattr(open_dataset(folder), name)()
        assert table.num_rows >= 0

    attempt(examples, EDITS, read)


FILES = (
    "dataset.json", "frames/000000.json", "manifest.parquet", "fruit.parquet", "colour", "class",
    "instance", "distance", "harvest",
)  # fmt: skip


def file_of(folder, name):
    """The file of that name or kind."""
    return folder / name if "." in name else open_dataset(folder).path(0, name)


@EXAMPLES
@pytest.mark.parametrize("name", FILES)
def test_check(examples, folder, name):
    path = file_of(folder, name)
    content = path.read_bytes()

    def check(edits):
        changed = mutated(content, edits)
        path.write_bytes(changed)
        result = check_dataset(folder, workers=1)
        if name != "dataset.json":
            assert result.findings or changed == content

    # Every example reads all files of both frames.
    attempt(examples // 10, EDITS, check)


@EXAMPLES
@pytest.mark.parametrize("name", ["colour", "class"])
def test_published_layout(examples, small_set, tmp_path, name):
    out = tmp_path / "published"
    export_dataset(small_set, "published", out)
    pattern = "image_color" if name == "colour" else "class_all_grayscale"
    path = next(path for path in sorted(out.rglob("*.png")) if pattern in path.name)

    def read(_):
        images = open_images(out)
        for item in range(len(images)):
            images[item]

    attempt_file(examples, path, [path.read_bytes()], read)


@EXAMPLES
def test_folder_with_a_table_of_labels(examples, tmp_path):
    Image.fromarray(np.full((6, 8, 3), 90, np.uint8)).save(tmp_path / "a.png")
    Image.fromarray(np.zeros((6, 8), np.uint8)).save(tmp_path / "a_mask.png")
    content = b"background = 0\nleaf = 1\npepper = [2, 3]\n"

    def read(edits):
        (tmp_path / "classes.toml").write_bytes(mutated(content, edits))
        open_images(tmp_path)[0]

    attempt(examples, EDITS, read)


@EXAMPLES
def test_any_object_as_the_description_of_a_frame(examples, folder):
    path = folder / "frames" / "000000.json"
    original = json.loads(path.read_bytes())
    numbers = st.integers() | st.floats(allow_nan=False, allow_infinity=False)
    leaf = st.none() | st.booleans() | numbers | st.text(max_size=5)
    value = st.recursive(
        leaf, lambda part: st.lists(part, max_size=3) | st.dictionaries(st.text(max_size=5), part)
    )
    change = st.tuples(st.sampled_from(sorted(original)), value)
    dataset = open_dataset(folder)

    def read(changes):
        content = {**original, **dict(changes)}
        # With a checksum that fits, the values themselves are examined.
        content.pop(CHECKSUM, None)
        content[CHECKSUM] = checksum_of(content)
        path.write_text(json.dumps(content), encoding="utf-8", errors="surrogatepass")
        dataset.intact(0)
        dataset.manifest()
        result = check_dataset(folder, workers=1)
        assert result.findings is not None

    attempt(examples // 10, st.lists(change, min_size=1, max_size=3), read)


def test_the_unchanged_set_is_correct(small_set):
    kinds = {finding.kind for finding in check_dataset(small_set, workers=1).findings}
    assert "damaged" not in kinds


@pytest.mark.parametrize("number", [b"Infinity", b"NaN", b"1e999"])
def test_infinite_number_in_the_description_of_a_frame(folder, number):
    path = folder / "frames" / "000000.json"
    path.write_bytes(path.read_bytes().replace(b'"index": 0', b'"other": %s, "index": 0' % number))
    assert number in path.read_bytes()
    assert "damaged" in {finding.kind for finding in check_dataset(folder, workers=1).findings}
    assert open_dataset(folder).intact(0).checksum == ""
