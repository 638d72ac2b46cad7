"""The journal and the tables: they agree with the frames' files, and are restored if lost."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

from pepperscene.classes import OrganClass
from pepperscene.dataset.store.dataset import open_dataset
from pepperscene.dataset.store.journal import JOURNAL, Journal
from pepperscene.dataset.store.manifest import FRAME_COLUMNS, MANIFEST
from pepperscene.errors import InputError, OutputError

pytestmark = pytest.mark.usefixtures("empty_scenes")
OUTPUTS = ("colour", "class", "distance")
TIMINGS = ("render_s", "write_s", "worker")


@pytest.fixture
def make(build_small, fake_renderer, tmp_path):
    def run(frames="0:6", outputs=OUTPUTS):
        build_small("set", frames, outputs, renderer=fake_renderer)
        return tmp_path / "set"

    return run


def rows(folder):
    return open_dataset(folder).manifest().to_pylist()


def row_indices(folder):
    return [row["index"] for row in rows(folder)]


def test_processes_that_read_a_table_last_end_without_an_abort(make):
    # A thread of Arrow that holds a Python file while the interpreter ends aborts the process. Before tables
    # were opened without one, that happened in half of the processes on a busy machine.
    code = f"from pepperscene.dataset import open_dataset; open_dataset({str(make())!r}).manifest()"
    processes = [
        subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE, text=True) for _ in range(8)
    ]
    ends = [(process.communicate(timeout=600)[1], process.returncode) for process in processes]
    assert ends == [("", 0)] * len(ends)


def test_rows_agree_with_the_frames_files(make, recipe):
    dataset = open_dataset(make("2:9"))
    table = rows(dataset.folder)
    assert list(table[0]) == list(FRAME_COLUMNS)
    assert [row["index"] for row in table] == list(range(2, 9))
    for row in table:
        metadata, spec = dataset.metadata(row["index"]), recipe.plan.frame(row["index"])
        assert (row["set"], row["rotation"], row["step"]) == (spec.set, spec.rotation, spec.step)
        pose = metadata["camera"]["pose"]
        assert [row["x_m"], row["y_m"], row["z_m"]] == [line[3] for line in pose[:3]]
        assert np.reshape(row["pose"], (4, 4)).tolist() == pose
        assert row["recipe_seed"] == recipe.seed
        counts = np.bincount(dataset.image(row["index"], "class").ravel(), minlength=8)
        assert [row[f"pixels_{organ.name.lower()}"] for organ in OrganClass] == counts.tolist()
        assert row["class_sha256"] == metadata["outputs"]["class"]["sha256"]
        assert row["instance_sha256"] is None
        assert row["checksum"] == metadata["checksum"]
        assert row["bytes"] == sum(entry["bytes"] for entry in metadata["outputs"].values())
        assert row["render_s"] >= 0
        assert row["write_s"] > 0
        assert row["worker"]


def test_lost_tables_are_restored(make):
    folder = make()
    before = rows(folder)
    # From the journal.
    (folder / MANIFEST).unlink()
    assert rows(folder) == before
    (folder / MANIFEST).write_bytes(b"no table")
    assert rows(folder) == before
    # From the frames, without timings.
    (folder / MANIFEST).unlink()
    (folder / JOURNAL).unlink()
    assert rows(folder) == [{**row, **dict.fromkeys(TIMINGS)} for row in before]


def test_second_build_adds_rows_and_keeps_timings(make):
    folder = make("3:5")
    before = rows(folder)
    make("0:6")
    after = rows(folder)
    assert [row["index"] for row in after] == list(range(6))
    assert after[3:5] == before
    journal = (folder / JOURNAL).read_bytes()
    make("0:6")
    assert (folder / JOURNAL).read_bytes() == journal


def test_row_of_an_extended_frame_is_replaced(make):
    folder = make("0:2")
    make("0:1", ("normal",))
    first, second = rows(folder)
    assert first["normal_sha256"]
    assert first["class_sha256"]
    assert second["normal_sha256"] is None


def test_removed_frame_has_no_row(make):
    folder = make()
    (folder / "frames" / "000002.json").unlink()
    assert row_indices(folder) == [0, 1, 3, 4, 5]


@pytest.mark.parametrize("cut", [1, 20, 200])
def test_truncated_line_is_skipped_and_new_entries_start_on_new_lines(make, cut):
    folder = make("0:3")
    (folder / JOURNAL).write_bytes((folder / JOURNAL).read_bytes()[:-cut])
    (folder / MANIFEST).unlink()
    assert row_indices(folder) == [0, 1, 2]
    make("0:4")
    added = (folder / JOURNAL).read_bytes().splitlines()[-2:]
    assert all({"checksum", "wanted"} & set(json.loads(line)) for line in added)
    assert row_indices(folder) == [0, 1, 2, 3]


def test_journal_lists_requested_frames(make):
    folder = make("3:5")
    assert Journal(folder).wanted == {3, 4}
    journal = (folder / JOURNAL).read_bytes()
    make("4:5")
    assert (folder / JOURNAL).read_bytes() == journal
    make([6, 7, 9])
    assert Journal(folder).wanted == {3, 4, 6, 7, 9}


def test_journal_holds_each_state_of_a_frame_once(tmp_path):
    with Journal(tmp_path) as journal:
        for checksum, size in (("a", 1), ("b", 2), ("b", 3)):
            journal.add({"index": 7, "checksum": checksum, "bytes": size})
    assert [*Journal(tmp_path).rows([(7, "a"), (7, "b"), (7, "c"), (8, "a")])] == [
        (7, {"index": 7, "checksum": "a", "bytes": 1}),
        (7, {"index": 7, "checksum": "b", "bytes": 2}),
        (7, None),
        (8, None),
    ]


def test_timings_of_the_build_that_made_a_frame_count(tmp_path):
    """Another build that finds the frame complete adds a line without timings, before or after."""
    without = {"index": 7, "checksum": "a", "bytes": 1}
    timed = {**without, "render_s": 1.5, "write_s": 0.5, "worker": "x"}
    for rows in ([without, timed], [timed, without], [timed, {**timed, "render_s": 9.0}]):
        journals = [Journal(tmp_path) for _ in rows]
        for journal, row in zip(journals, rows, strict=True):
            with journal:
                journal.add(row)
        assert [*Journal(tmp_path).rows([(7, "a")])] == [(7, timed)]
        (tmp_path / JOURNAL).unlink()


def test_fruit_table_needs_harvest(make):
    with pytest.raises(InputError, match="harvest"):
        open_dataset(make("0:1")).fruit()


def test_full_disk_under_the_journal_is_an_output_error(make, monkeypatch):
    def fail(*_args):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Journal, "add", fail)
    with pytest.raises(OutputError, match="No space left on device"):
        make("0:2")
