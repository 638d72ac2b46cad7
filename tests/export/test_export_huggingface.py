"""Hugging Face's layout, read by its library `datasets` without a network."""

from __future__ import annotations

import numpy as np
import pytest
from data_sets import FRUIT
from PIL import Image

from pepperscene.dataset.store.manifest import FRUIT_COLUMNS
from pepperscene.export import export_dataset
from pepperscene.export.columns import CLASS_NAMES, frame_columns
from pepperscene.export.huggingface import SplitSize, card_front_matter

MODULE = "pepperscene.export.huggingface"
SPLITS = "train=0:5,test=6:8"


@pytest.fixture(scope="module")
def out(small, tmp_path_factory):
    return export_dataset(small.folder, "huggingface", tmp_path_factory.mktemp("hf") / "out", SPLITS).folder


@pytest.fixture(scope="module")
def splits(hub, out, tmp_path_factory):
    return hub.load_dataset(str(out), cache_dir=str(tmp_path_factory.mktemp("cache")))


def test_datasets_reads_every_pixel(splits, small):
    assert {name: len(rows) for name, rows in splits.items()} == {"train": 5, "test": 2}
    for name, indices in (("train", range(5)), ("test", range(6, 8))):
        for row, index in zip(splits[name].with_format("numpy"), indices, strict=True):
            assert row["index"] == index
            for column, output in (("image", "colour"), ("mask", "class"), ("instances", "instance")):
                expected = small.image(index, output)
                np.testing.assert_array_equal(row[column], expected)
                assert row[column].dtype == expected.dtype
            np.testing.assert_array_equal(row["distance"], small.image(index, "distance"))
    image = splits["train"][1]["mask"]
    assert isinstance(image, Image.Image)
    np.testing.assert_array_equal(np.asarray(image), small.image(1, "class"))


def test_metadata_are_columns(splits, small):
    row, metadata = splits["train"][3], small.metadata(3)
    assert row["pixels"] == metadata["class_pixels"]
    assert all(row[key] == metadata[key] for key in ("set", "rotation", "step"))
    assert row["pose"] == metadata["camera"]["pose"]
    camera = {**metadata["camera"], **metadata["camera"]["distortion"]}
    known = row["camera"].keys() & camera.keys()
    assert known >= {"fx", "fy", "cx", "cy"}
    assert {key: row["camera"][key] for key in known} == {key: camera[key] for key in known}
    assert [(organ["instance"], organ["kind"]) for organ in row["organs"]] == [
        (int(number), entry["kind"]) for number, entry in metadata["instances"].items()
    ]
    first, second = row["fruit"]
    assert set(first) == set(FRUIT_COLUMNS) - {"index"}
    assert [first["cut_u"], first["cut_v"]] == FRUIT["peduncle"]["cut"]["px"]
    assert [first[f"box_{edge}"] for edge in ("x0", "y0", "x1", "y1")] == FRUIT["box"]
    assert first["ripeness"] == FRUIT["ripeness"]
    assert second["box_x0"] is None
    assert second["cut_u"] is None
    assert second["visible_fraction"] == 0.0


def test_large_splits_are_several_files(hub, tmp_path, small, monkeypatch):
    monkeypatch.setattr(f"{MODULE}._ROWS", 2)
    monkeypatch.setattr(f"{MODULE}.SHARD_BYTES", 1)
    result = export_dataset(small.folder, "huggingface", tmp_path / "out", SPLITS)
    assert sorted(path.name for path in (tmp_path / "out" / "data").iterdir()) == [
        "test-00000-of-00001.parquet",
        *(f"train-{number:05d}-of-00003.parquet" for number in range(3)),
    ]
    assert (result.frames, result.files) == (7, 6)
    rows = hub.load_dataset(str(tmp_path / "out"), cache_dir=str(tmp_path / "cache"))["train"]
    assert rows["index"][:] == list(range(5))


def test_card_describes_the_files(hub, splits, out, small):
    from huggingface_hub import DatasetCard

    card = DatasetCard.load(out / "README.md")
    front = card.data.to_dict()
    assert front["license"] == "mit"
    assert front["size_categories"] == ["n<1K"]
    assert front["task_categories"] == ["image-segmentation", "depth-estimation", "object-detection"]
    features = hub.Features._from_yaml_list(front["dataset_info"]["features"])
    assert features == splits["train"].features
    assert features["organs"].feature["class"].names == list(CLASS_NAMES)
    assert [split["num_examples"] for split in front["dataset_info"]["splits"]] == [5, 2]
    sizes = [path.stat().st_size for path in (out / "data").iterdir()]
    assert front["dataset_info"]["download_size"] == sum(sizes)
    info = small.info
    assert all(text in card.text for text in (info["recipe_sha256"], info["version"], info["quality"]))
    assert "5 images" in card.text
    assert (out / "dataset.json").read_bytes() == (small.folder / "dataset.json").read_bytes()


@pytest.mark.parametrize(
    ("frames", "size"), [(999, "n<1K"), (1000, "1K<n<10K"), (10500, "10K<n<100K"), (10**6, "1M<n<10M")]
)
def test_sizes_have_the_names_of_the_hub(frames, size):
    columns = frame_columns(("colour", "class"), (6, 8))
    front = card_front_matter("title", columns, {"train": SplitSize(frames)})
    assert front["size_categories"] == [size]
    assert front["task_categories"] == ["image-segmentation"]


def test_outputs_that_a_frame_lacks_are_not_columns(tmp_path, copied, small):
    from pyarrow import parquet

    folder = copied(small).folder
    (folder / "distance" / "000003.exr").unlink()
    (folder / "harvest" / "000001.json").unlink()
    export_dataset(folder, "huggingface", tmp_path / "out")
    names = parquet.read_schema(tmp_path / "out" / "data" / "train-00000-of-00001.parquet").names
    assert "instances" in names
    assert not {"distance", "fruit"} & set(names)
