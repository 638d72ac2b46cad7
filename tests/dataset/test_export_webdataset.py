"""Shards of samples, read back by webdataset."""

from __future__ import annotations

import gc
import hashlib
import json
import tarfile

import numpy as np
import pytest
from small_set import HARVEST

from pepperscene.dataset.export import FORMATS, Splits, export_dataset
from pepperscene.dataset.export.webdataset import export_webdataset
from pepperscene.errors import InputError, OutputError

webdataset = pytest.importorskip("webdataset", reason="the extra `export` brings webdataset")

# webdataset leaves the shards that it has read to the garbage collector to close.
pytestmark = [
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]

ARRAYS = ("class", "instance", "distance")


@pytest.fixture(scope="module")
def made(small):
    return small


@pytest.fixture
def built(made, copied):
    """A copy, to be damaged at will."""
    return copied(made)


def read(shards, how="rgb8"):
    """The samples by their key, as a user of webdataset gets them."""
    urls = [str(path) for path in sorted(shards)]
    samples = webdataset.WebDataset(urls, shardshuffle=False, empty_check=False).decode(how)
    found = {sample["__key__"]: sample for sample in samples}
    del samples
    gc.collect()
    return found


@pytest.mark.parametrize("how", ["rgb8", "rgb", "pil"])
def test_webdataset_reads_every_sample_whole(tmp_path, built, how):
    export_webdataset(built, tmp_path / "out", Splits())
    found = read((tmp_path / "out").glob("train-*.tar"), how)
    assert sorted(found) == [f"{index:06d}" for index in built.indices()]
    for index in built.indices():
        sample = found[f"{index:06d}"]
        colour = np.asarray(sample["colour.png"])
        if how == "rgb":
            colour = np.rint(255 * colour).astype(np.uint8)
        np.testing.assert_array_equal(colour, built.image(index, "colour"))
        # Labels come out the same, however pictures are decoded.
        for output in ARRAYS:
            array, wanted = sample[f"{output}.npy.gz"], built.image(index, output)
            assert array.dtype == wanted.dtype
            np.testing.assert_array_equal(array, wanted)
        assert sample["json"]["index"] == index
        assert sample["json"]["camera"] == built.metadata(index)["camera"]
        assert sample["harvest.json"] == HARVEST


def test_shards_keep_to_their_size_and_samples_stay_together(tmp_path, built):
    whole = export_webdataset(built, tmp_path / "whole", Splits())
    (single,) = (tmp_path / "whole").glob("*.tar")
    sample = single.stat().st_size // 9
    made = export_webdataset(built, tmp_path / "out", Splits(), shard_bytes=2 * sample + 2048)
    shards = sorted((tmp_path / "out").glob("*.tar"))
    assert [path.name for path in shards] == [f"train-{number:06d}.tar" for number in range(len(shards))]
    assert len(shards) >= 4
    # The last blocks of a tar file, which fill it up to 10,240 bytes, are not counted.
    assert all(path.stat().st_size <= 2 * sample + 2048 + 10240 for path in shards)
    for path in shards:
        with tarfile.open(path) as tar:
            keys = [name.partition(".")[0] for name in tar.getnames()]
        assert all(keys.count(key) == 6 for key in keys)
    assert read(shards).keys() == read([single]).keys()
    assert (made.frames, made.files) == (9, len(shards) + 1)
    assert (whole.frames, whole.files) == (9, 2)


def test_splits_have_shards_of_their_own(tmp_path, built):
    splits = Splits((("train", range(6)), ("val", range(7, 9))))
    told = []
    export_webdataset(built, tmp_path / "out", splits, on_frame=lambda *step: told.append(step))
    assert sorted(read((tmp_path / "out").glob("train-*"))) == [f"{index:06d}" for index in range(6)]
    assert sorted(read((tmp_path / "out").glob("val-*"))) == ["000007", "000008"]
    listed = json.loads((tmp_path / "out" / "shards.json").read_text())
    assert listed["splits"]["val"] == [{"file": "val-000000.tar", "samples": 2}]
    assert listed["dataset"]["recipe_sha256"] == built.info["recipe_sha256"]
    assert [done for _, done, _ in told] == list(range(1, 9))
    assert {total for _, _, total in told} == {8}


def test_the_same_data_set_gives_the_same_bytes(tmp_path, built):
    digests = []
    for name in ("one", "two"):
        export_webdataset(built, tmp_path / name, Splits())
        files = sorted((tmp_path / name).iterdir())
        digests.append([hashlib.sha256(path.read_bytes()).hexdigest() for path in files])
    assert digests[0] == digests[1]
    with tarfile.open(next((tmp_path / "one").glob("*.tar"))) as tar:
        assert {(member.mtime, member.uid, member.uname) for member in tar} == {(0, 0, "")}


def test_neighbours_on_the_path_are_not_neighbours_in_a_shard(tmp_path, built):
    export_webdataset(built, tmp_path / "out", Splits())
    order = list(read((tmp_path / "out").glob("*.tar")))
    assert order != sorted(order)


def test_what_not_every_frame_has_is_left_out(tmp_path, built):
    (built.folder / "harvest" / "000003.json").unlink()
    export_webdataset(built, tmp_path / "out", Splits())
    assert "harvest.json" not in read((tmp_path / "out").glob("*.tar"))["000000"]


def test_faults_leave_nothing_behind(tmp_path, built):
    (built.folder / "class" / "000004.png").write_bytes(b"broken")
    with pytest.raises(InputError, match=r"class/000004.png"):
        export_webdataset(built, tmp_path / "out", Splits())
    assert [path.name for path in tmp_path.iterdir()] == ["set"]
    (built.folder / "class" / "000004.png").unlink()
    with pytest.raises(InputError, match=r"frame 000004 has no output 'class'"):
        export_webdataset(built, tmp_path / "out", Splits())
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("do not touch")
    with pytest.raises(OutputError, match=r"holds 'mine\.txt'"):
        export_webdataset(built, tmp_path / "full", Splits(), indices=(0, 1))
    with pytest.raises(ValueError, match="shard_bytes must be positive"):
        export_webdataset(built, tmp_path / "out", Splits(), shard_bytes=0)


def test_it_is_one_of_the_formats(tmp_path, built):
    assert "webdataset" in FORMATS
    made = export_dataset(built.folder, "webdataset", tmp_path / "out", "train=.5,val=.5")
    assert made.frames == 9
