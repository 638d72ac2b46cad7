"""The journal and the tables: they tell what the files tell, and can be lost."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest

from pepperscene.classes import OrganClass
from pepperscene.dataset import build, open_dataset
from pepperscene.dataset.store.journal import JOURNAL, Journal
from pepperscene.dataset.store.manifest import FRAME_COLUMNS, MANIFEST
from pepperscene.errors import InputError, OutputError

pytestmark = pytest.mark.usefixtures("empty_scenes")
OUTPUTS = ("colour", "class", "distance")
TIMED = ("render_s", "write_s", "worker")


@pytest.fixture
def folder(recipe, fake_renderer, tmp_path):
    def run(frames="0:6", out="set", **arguments):
        build(recipe, tmp_path / out, frames, OUTPUTS, renderer=fake_renderer, **arguments)
        return tmp_path / out

    return run


def rows(folder):
    return open_dataset(folder).manifest().to_pylist()


def test_a_row_for_each_frame_tells_what_its_files_tell(folder, recipe):
    dataset = open_dataset(folder("2:9"))
    told = rows(dataset.folder)
    assert list(told[0]) == list(FRAME_COLUMNS)
    assert [row["index"] for row in told] == list(range(2, 9))
    for row in told:
        facts, shot = dataset.metadata(row["index"]), recipe.plan.frame(row["index"])
        assert (row["set"], row["rotation"], row["step"]) == (shot.set, shot.rotation, shot.step)
        assert [row["x_m"], row["y_m"], row["z_m"]] == [line[3] for line in facts["camera"]["pose"][:3]]
        assert np.reshape(row["pose"], (4, 4)).tolist() == facts["camera"]["pose"]
        assert row["recipe_seed"] == recipe.seed
        counted = np.bincount(dataset.image(row["index"], "class").ravel(), minlength=8)
        assert [row[f"pixels_{one.name.lower()}"] for one in OrganClass] == counted.tolist()
        assert row["class_sha256"] == facts["outputs"]["class"]["sha256"]
        assert row["instance_sha256"] is None
        assert row["checksum"] == facts["checksum"]
        assert row["bytes"] == sum(entry["bytes"] for entry in facts["outputs"].values())
        assert row["render_s"] >= 0
        assert row["write_s"] > 0
        assert row["worker"]


def test_a_lost_manifest_comes_out_of_the_journal(folder):
    where = folder()
    before = rows(where)
    (where / MANIFEST).unlink()
    assert rows(where) == before
    (where / MANIFEST).write_bytes(b"no table")
    assert rows(where) == before


def test_lost_tables_come_out_of_the_files_but_for_timings(folder):
    where = folder()
    before = rows(where)
    (where / MANIFEST).unlink()
    (where / JOURNAL).unlink()
    assert rows(where) == [{**row, **dict.fromkeys(TIMED)} for row in before]


def test_another_build_adds_rows_and_keeps_timings(folder):
    where = folder("3:5")
    before = {row["index"]: row for row in rows(where)}
    folder("0:6")
    after = {row["index"]: row for row in rows(where)}
    assert sorted(after) == list(range(6))
    assert {index: after[index] for index in before} == before


def test_frames_that_were_there_add_no_line(folder):
    where = folder()
    lines = (where / JOURNAL).read_bytes()
    folder()
    assert (where / JOURNAL).read_bytes() == lines


def test_a_frame_that_was_made_again_is_told_as_it_is_now(folder, recipe, fake_renderer):
    where = folder("0:2")
    build(recipe, where, "0:1", ("normal",), renderer=fake_renderer)
    first, second = rows(where)
    assert first["normal_sha256"]
    assert first["class_sha256"]
    assert second["normal_sha256"] is None


def test_a_frame_taken_away_leaves_the_table(folder):
    where = folder()
    (where / "frames" / "000002.json").unlink()
    assert [row["index"] for row in rows(where)] == [0, 1, 3, 4, 5]


@pytest.mark.parametrize("cut", [1, 20, 200])
def test_a_torn_line_is_skipped_and_ended(folder, cut):
    where = folder("0:3")
    whole = (where / JOURNAL).read_bytes()
    (where / JOURNAL).write_bytes(whole[:-cut])
    (where / MANIFEST).unlink()
    assert [row["index"] for row in rows(where)] == [0, 1, 2]
    folder("0:4")
    # Whatever was added stands on lines of its own.
    added = (where / JOURNAL).read_bytes().splitlines()[-2:]
    assert all({"checksum", "wanted"} & set(json.loads(line)) for line in added)
    assert [row["index"] for row in rows(where)] == [0, 1, 2, 3]


def test_the_journal_knows_which_frames_are_wanted(folder, tmp_path):
    where = folder("3:5")
    assert Journal(where).wanted == {3, 4}
    lines = (where / JOURNAL).read_bytes()
    folder("4:5")
    assert (where / JOURNAL).read_bytes() == lines
    build_of = {3, 4, *range(6, 9)}
    folder("6:9")
    assert Journal(where).wanted == build_of


def test_the_last_line_of_a_frame_counts(tmp_path):
    with Journal(tmp_path) as journal:
        journal.add({"index": 7, "checksum": "a", "bytes": 1})
        journal.add({"index": 7, "checksum": "b", "bytes": 2})
        journal.add({"index": 7, "checksum": "b", "bytes": 3})
    again = Journal(tmp_path)
    assert list(again.rows(iter([7, 8]))) == [(7, {"index": 7, "checksum": "b", "bytes": 2}), (8, None)]


def test_no_fruit_table_without_harvest(folder):
    with pytest.raises(InputError, match="harvest"):
        open_dataset(folder("0:1")).fruit()


def test_a_full_disk_under_the_journal_is_told(folder, monkeypatch):
    def full(*_args):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(sys.modules["pepperscene.dataset.store.journal"].Journal, "add", full)
    with pytest.raises(OutputError, match="No space left on device"):
        folder("0:2")
