"""The tables and the log of timings: they agree with the frames' files, and are restored if lost."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from pepperscene.classes import OrganClass
from pepperscene.dataset.store.dataset import open_dataset
from pepperscene.dataset.store.journal import JOURNAL
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


@pytest.mark.long
def test_processes_that_read_a_table_last_end_without_an_abort(make):
    # A thread of Arrow that holds a Python file while the interpreter ends aborts the process. Before tables
    # were opened without one, that happened in half of the processes on a busy machine.
    code = f"from pepperscene import open_dataset; open_dataset({str(make())!r}).manifest()"
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
    for content in (None, b"no table"):
        (folder / MANIFEST).unlink() if content is None else (folder / MANIFEST).write_bytes(content)
        assert rows(folder) == before
    # Nothing but the timings depends on the journal.
    (folder / MANIFEST).unlink()
    (folder / JOURNAL).unlink()
    assert rows(folder) == [{**row, **dict.fromkeys(TIMINGS)} for row in before]


def test_second_build_adds_rows_and_keeps_timings(make):
    folder = make("3:5")
    before = rows(folder)
    (folder / JOURNAL).unlink()
    make("0:6")
    after = rows(folder)
    assert [row["index"] for row in after] == list(range(6))
    assert after[3:5] == before
    assert all(row["worker"] for row in after)
    # Existing frames are not logged again.
    journal = (folder / JOURNAL).read_bytes()
    make("0:6")
    assert (folder / JOURNAL).read_bytes() == journal


def test_row_of_an_extended_frame_is_replaced(make):
    folder = make("0:2")
    table = (folder / MANIFEST).read_bytes()
    make("0:1", ("normal",))
    # A build that is killed leaves the old table.
    for content in (None, table):
        if content is not None:
            (folder / MANIFEST).write_bytes(content)
            os.utime(folder / MANIFEST, ns=(0, 0))
        first, second = rows(folder)
        assert first["normal_sha256"]
        assert first["class_sha256"]
        assert first["render_s"] >= 0
        assert second["normal_sha256"] is None


def test_removed_or_damaged_frame_has_no_row_until_it_is_built_again(make):
    folder = make("0:3")
    before, path = rows(folder), folder / "frames" / "000001.json"
    content = path.read_bytes()
    path.unlink()
    assert row_indices(folder) == [0, 2]
    path.write_bytes(content.replace(b'"set": 0', b'"set": 5'))
    (folder / MANIFEST).unlink()
    assert row_indices(folder) == [0, 2]
    make("0:3")
    assert [{**row, **dict.fromkeys(TIMINGS)} for row in rows(folder)] == [
        {**row, **dict.fromkeys(TIMINGS)} for row in before
    ]


def test_bad_lines_of_the_journal_are_skipped(make):
    folder = make("0:2")
    before, journal = rows(folder), (folder / JOURNAL).read_bytes()
    lines = (
        b"\xff\xfe\x00\n",
        b"[" * 200_000,
        b'{"checksum": ["CHECKSUM"], "render_s": 1}\n',
        b'["checksum"]\n',
        b'{"checksum": "CHECKSUM", "render_s": 1e999, "write_s": "x", "worker": 5}\n',
        b'{"index": 0, "checks',
    )
    for line in lines:
        (folder / MANIFEST).unlink(missing_ok=True)
        content = line.replace(b"CHECKSUM", before[0]["checksum"].encode())
        (folder / JOURNAL).write_bytes(journal + content)
        assert rows(folder) == before
    # New lines are added.
    make("0:3")
    assert row_indices(folder) == [0, 1, 2]


def test_journal_that_cannot_be_written_is_an_error_with_its_name(make, tmp_path):
    (make("0:1") / JOURNAL).unlink()
    (tmp_path / "set" / JOURNAL).mkdir()
    with pytest.raises(OutputError, match=JOURNAL):
        make("0:2")
    assert open_dataset(tmp_path / "set").manifest()["render_s"].to_pylist()[0] is not None


def test_fruit_table_needs_harvest(make):
    with pytest.raises(InputError, match="harvest"):
        open_dataset(make("0:1")).fruit()


def test_fruit_has_world_positions(rendered):
    rows = rendered.fruit().to_pylist()
    assert any(row["cut_x_m"] is not None for row in rows)
    for row in rows:
        pose = np.array(rendered.metadata(row["index"])["camera"]["pose"])
        (truth,) = (
            one
            for one in rendered.image(row["index"], "harvest")["fruit"]
            if one["instance"] == row["instance"]
        )

        def values(name, row=row):
            return [row[name.format(axis)] for axis in "xyz"]

        np.testing.assert_allclose(
            pose[:3, :3] @ values("foot_{}_m") + pose[:3, 3], values("foot_world_{}_m"), atol=2e-6
        )
        assert values("blossom_world_{}_m") == truth["blossom_end"]["world_m"]
        if row["cut_x_m"] is not None:
            found = pose[:3, :3] @ values("cut_{}_m") + pose[:3, 3]
            np.testing.assert_allclose(found, values("cut_world_{}_m"), atol=2e-6)
        if row["approach_x"] is not None:
            found = pose[:3, :3] @ values("approach_{}")
            np.testing.assert_allclose(found, values("approach_world_{}"), atol=1e-8)
