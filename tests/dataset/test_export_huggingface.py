"""Hugging Face's layout, read back by its library `datasets` without a network."""

from __future__ import annotations

import json
import os
import sys

import numpy as np
import pytest
from small_set import FRUIT

from pepperscene.dataset.export import Splits, export_dataset
from pepperscene.dataset.export.columns import CLASS_NAMES, columns
from pepperscene.dataset.export.huggingface import Card, export_huggingface
from pepperscene.dataset.store.rows import FRUIT_COLUMNS
from pepperscene.errors import InputError

SPLITS = Splits((("train", range(5)), ("test", range(6, 8))))


@pytest.fixture(scope="session")
def hub(tmp_path_factory):
    """The library, kept from the network and from the user's cache."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("HF_HUB_OFFLINE", "HF_DATASETS_OFFLINE", "HF_HUB_DISABLE_TELEMETRY"):
            patch.setenv(name, "1")
        patch.setenv("HF_HOME", str(tmp_path_factory.mktemp("hub")))
        yield pytest.importorskip("datasets", reason="the extra `test` brings datasets")


@pytest.fixture(scope="module")
def made(small):
    return small


@pytest.fixture
def built(made, copied):
    """A copy, to be damaged at will."""
    return copied(made)


def load(hub, folder, cache):
    return hub.load_dataset(str(folder), cache_dir=str(cache))


def test_datasets_reads_every_pixel(hub, tmp_path, built):
    made = export_huggingface(built, tmp_path / "out", SPLITS)
    found = load(hub, tmp_path / "out", tmp_path / "cache")
    assert {name: len(rows) for name, rows in found.items()} == {"train": 5, "test": 2}
    assert (made.frames, made.files) == (7, 4)
    for rows, indices in ((found["train"], range(5)), (found["test"], range(6, 8))):
        for row, index in zip(rows.with_format("numpy"), indices, strict=True):
            assert row["index"] == index
            for column, output in (("image", "colour"), ("mask", "class"), ("instances", "instance")):
                wanted = built.image(index, output)
                np.testing.assert_array_equal(row[column], wanted)
                assert row[column].dtype == wanted.dtype
            np.testing.assert_array_equal(row["distance"], built.image(index, "distance"))


def test_pictures_come_as_pictures(hub, tmp_path, built):
    from PIL import Image

    export_huggingface(built, tmp_path / "out", SPLITS)
    row = load(hub, tmp_path / "out", tmp_path / "cache")["train"][1]
    for column in ("image", "mask", "instances"):
        assert isinstance(row[column], Image.Image)
    np.testing.assert_array_equal(np.asarray(row["mask"]), built.image(1, "class"))


def test_facts_are_columns(hub, tmp_path, built):
    export_huggingface(built, tmp_path / "out", SPLITS)
    rows = load(hub, tmp_path / "out", tmp_path / "cache")["train"]
    row, facts = rows[3], built.metadata(3)
    assert row["pixels"] == facts["class_pixels"]
    assert (row["set"], row["rotation"], row["step"]) == (facts["set"], facts["rotation"], facts["step"])
    assert row["pose"] == facts["camera"]["pose"]
    assert row["camera"]["fx"] == facts["camera"]["fx"]
    assert [(organ["instance"], organ["kind"]) for organ in row["organs"]] == [
        (int(number), told["kind"]) for number, told in facts["instances"].items()
    ]
    first, second = row["fruit"]
    assert set(first) == set(FRUIT_COLUMNS) - {"index"}
    assert [first["cut_u"], first["cut_v"]] == FRUIT["peduncle"]["cut"]["px"]
    assert [first[f"box_{edge}"] for edge in ("x0", "y0", "x1", "y1")] == FRUIT["box"]
    assert first["ripeness"] == FRUIT["ripeness"]
    assert second["box_x0"] is None
    assert second["cut_u"] is None
    assert second["visible_fraction"] == 0.0


def test_large_splits_lie_in_several_files(hub, tmp_path, built, monkeypatch):
    monkeypatch.setattr(sys.modules[export_huggingface.__module__], "_ROWS", 2)
    made = export_huggingface(built, tmp_path / "out", SPLITS, shard_bytes=1)
    names = sorted(path.name for path in (tmp_path / "out" / "data").iterdir())
    assert names == [
        "test-00000-of-00001.parquet",
        *(f"train-{number:05d}-of-00003.parquet" for number in range(3)),
    ]
    assert made.files == 6
    assert load(hub, tmp_path / "out", tmp_path / "cache")["train"]["index"][:] == list(range(5))


def test_the_card_is_what_the_library_understands(hub, tmp_path, built):
    from huggingface_hub import DatasetCard

    export_huggingface(built, tmp_path / "out", SPLITS, licence="cc-by-4.0")
    card = DatasetCard.load(tmp_path / "out" / "README.md")
    told = card.data.to_dict()
    assert told["license"] == "cc-by-4.0"
    assert told["size_categories"] == ["n<1K"]
    assert told["task_categories"] == ["image-segmentation", "depth-estimation", "object-detection"]
    # The features of the card are those of the files.
    listed = hub.Features._from_yaml_list(told["dataset_info"]["features"])
    assert listed == load(hub, tmp_path / "out", tmp_path / "cache")["train"].features
    assert listed["organs"].feature["class"].names == list(CLASS_NAMES)
    assert [split["num_examples"] for split in told["dataset_info"]["splits"]] == [5, 2]
    files = (tmp_path / "out" / "data").iterdir()
    assert told["dataset_info"]["download_size"] == sum(path.stat().st_size for path in files)
    for said in (built.info["recipe_sha256"], built.info["version"], built.info["quality"], "5 images"):
        assert said in card.text


@pytest.mark.parametrize(
    ("frames", "size"), [(999, "n<1K"), (1000, "1K<n<10K"), (10500, "10K<n<100K"), (10**6, "1M<n<10M")]
)
def test_sizes_have_the_names_of_the_hub(built, frames, size):
    class Split:
        held = packed = 0

    Split.frames = frames
    card = Card(built.info, columns(("colour", "class"), (6, 8)), {"train": Split()}, "mit")
    assert card.front()["size_categories"] == [size]
    assert card.front()["task_categories"] == ["image-segmentation"]


def test_what_not_every_frame_has_is_no_column(hub, tmp_path, built):
    (built.folder / "distance" / "000003.exr").unlink()
    (built.folder / "harvest" / "000001.json").unlink()
    export_huggingface(built, tmp_path / "out", SPLITS)
    names = load(hub, tmp_path / "out", tmp_path / "cache")["train"].column_names
    assert "instances" in names
    assert not {"distance", "fruit"} & set(names)


def test_faults_leave_nothing_behind(tmp_path, built):
    (built.folder / "colour" / "000004.png").write_bytes(b"broken")
    with pytest.raises(InputError, match=r"colour/000004.png"):
        export_huggingface(built, tmp_path / "out", SPLITS)
    assert [path.name for path in tmp_path.iterdir()] == ["set"]
    with pytest.raises(ValueError, match="shard_bytes must be positive"):
        export_huggingface(built, tmp_path / "out", SPLITS, shard_bytes=0)


def test_it_is_one_of_the_formats(tmp_path, built):
    assert export_dataset(built.folder, "huggingface", tmp_path / "out").frames == 9
    assert json.loads((tmp_path / "out" / "dataset.json").read_text()) == built.info
    assert os.listdir(tmp_path / "out" / "data") == ["train-00000-of-00001.parquet"]
