"""Shards of samples, read by webdataset."""

from __future__ import annotations

import gc
import json
import tarfile

import numpy as np
import pytest
from data_sets import HARVEST

from pepperscene.export import export_dataset

webdataset = pytest.importorskip("webdataset", reason="the extra `export` installs webdataset")

# webdataset leaves it to the garbage collector to close the shards that it has read.
pytestmark = [
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


@pytest.fixture(scope="module")
def out(small, tmp_path_factory):
    return export_dataset(small.folder, "webdataset", tmp_path_factory.mktemp("shards") / "out").folder


def read(shards, decoder="rgb8"):
    """The samples by key, as a user of webdataset gets them."""
    urls = [str(path) for path in sorted(shards)]
    samples = webdataset.WebDataset(urls, shardshuffle=False, empty_check=False).decode(decoder)
    by_key = {sample["__key__"]: sample for sample in samples}
    del samples
    gc.collect()
    return by_key


@pytest.mark.parametrize("decoder", ["rgb8", "rgb"])
def test_webdataset_reads_every_sample(out, small, decoder):
    samples = read(out.glob("train-*.tar"), decoder)
    assert sorted(samples) == [f"{index:06d}" for index in small.indices()]
    for index in small.indices():
        sample = samples[f"{index:06d}"]
        colour = np.asarray(sample["colour.png"])
        if decoder == "rgb":
            colour = np.rint(255 * colour).astype(np.uint8)
        np.testing.assert_array_equal(colour, small.image(index, "colour"))
        # Labels do not depend on the decoder of images.
        for output in ("class", "instance", "distance"):
            array, expected = sample[f"{output}.npy.gz"], small.image(index, output)
            assert array.dtype == expected.dtype
            np.testing.assert_array_equal(array, expected)
        assert sample["json"]["index"] == index
        assert sample["json"]["camera"] == small.metadata(index)["camera"]
        assert sample["harvest.json"] == HARVEST


def test_shards_have_limited_size_and_whole_samples(tmp_path, out, small, monkeypatch):
    (single,) = out.glob("*.tar")
    limit = 2 * single.stat().st_size // 9 + 2048
    monkeypatch.setattr("pepperscene.export.webdataset.SHARD_BYTES", limit)
    result = export_dataset(small.folder, "webdataset", tmp_path / "out")
    shards = sorted((tmp_path / "out").glob("*.tar"))
    assert [path.name for path in shards] == [f"train-{number:06d}.tar" for number in range(len(shards))]
    assert len(shards) >= 4
    # The padding of a tar file to 10,240 bytes does not count.
    assert all(path.stat().st_size <= limit + 10240 for path in shards)
    for path in shards:
        with tarfile.open(path) as tar:
            keys = [name.partition(".")[0] for name in tar.getnames()]
        assert all(keys.count(key) == 6 for key in keys)
    assert read(shards).keys() == read([single]).keys()
    assert (result.frames, result.files) == (9, len(shards) + 1)


def test_every_split_has_its_shards(tmp_path, small):
    export_dataset(small.folder, "webdataset", tmp_path / "out", "train=0:6,val=7:9")
    assert sorted(read((tmp_path / "out").glob("train-*"))) == [f"{index:06d}" for index in range(6)]
    assert sorted(read((tmp_path / "out").glob("val-*"))) == ["000007", "000008"]
    content = json.loads((tmp_path / "out" / "shards.json").read_text())
    assert content["splits"]["val"] == [{"file": "val-000000.tar", "samples": 2}]
    assert content["dataset"]["recipe_sha256"] == small.info["recipe_sha256"]


def test_frames_are_shuffled_and_members_have_no_times_or_owners(out):
    with tarfile.open(next(out.glob("*.tar"))) as tar:
        order = list(dict.fromkeys(name.partition(".")[0] for name in tar.getnames()))
        assert order != sorted(order)
        assert {(member.mtime, member.uid, member.uname) for member in tar} == {(0, 0, "")}


def test_outputs_that_a_frame_lacks_are_left_out(tmp_path, copied, small):
    folder = copied(small).folder
    (folder / "harvest" / "000003.json").unlink()
    export_dataset(folder, "webdataset", tmp_path / "out")
    assert "harvest.json" not in read((tmp_path / "out").glob("*.tar"))["000000"]
