"""A journal whose lines are damaged, hostile, removed, or written by several processes."""

from __future__ import annotations

import errno
import json
import os
import resource
import shutil

import pytest

from pepperscene.dataset.store import journal as journal_module
from pepperscene.dataset.store.dataset import Dataset, open_dataset
from pepperscene.dataset.store.journal import JOURNAL, Journal
from pepperscene.errors import InputError, OutputError
from pepperscene.review.check import check_dataset

pytestmark = pytest.mark.usefixtures("empty_scenes")

HOSTILE = {
    "requests too large": b'{"wanted": [[0, 3000000000]]',
    "requests without end": b'{"wanted": ' + json.dumps([[0, 1]] * 50_000).encode()[:-1] + b", [5, 0]]",
    "nested": b'{"wanted": ' + b"[" * 200_000,
    "text for a number": b'{"index": "one", "checksum": "0"',
    "number beyond 64 bits": b'{"bytes": 1e999, "index": 1e999, "checksum": "0"',
    "no object": b'["wanted"',
    "no JSON": b"\xff\xfe\x00",
    "very long": b'{"wanted": "' + b"x" * (1 << 21),
}


@pytest.fixture
def make(build_small, tmp_path):
    def run(frames="0:4", **arguments):
        build_small("set", frames, ("class", "distance"), **arguments)
        return tmp_path / "set"

    return run


def signed(body):
    """A line with a right checksum, as only somebody who knows the format can write it."""
    return body + journal_module._SUFFIX % journal_module._checksum(body) + b"\n"


@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.parametrize("has_checksum", [False, True])
def test_bad_lines_are_skipped_and_named(make, name, has_checksum):
    folder = make()
    before = open_dataset(folder).manifest()
    body = HOSTILE[name]
    with (folder / JOURNAL).open("ab") as file:
        file.write(signed(body) if has_checksum else body + b"}\n")
    # The reader survives, check names the line, and the next build skips it for good.
    limit = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert Journal(folder).damaged
    assert Journal(folder).wanted == {0, 1, 2, 3}
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < limit + 200_000
    findings = [finding for finding in check_dataset(folder, workers=1).findings if finding.file == JOURNAL]
    assert findings
    assert {finding.kind for finding in findings} == {"damaged"}
    notices = []
    make(on_notice=notices.append)
    assert any(JOURNAL in notice for notice in notices)
    assert Journal(folder).damaged == ()
    assert open_dataset(folder).manifest().equals(before)


@pytest.mark.parametrize("value", ["much", 1 << 70, [1.0, "x"], {"a": 1}, True])
def test_value_that_does_not_fit_its_column_is_read_from_the_frame(make, value):
    folder = make("0:2")
    expected = open_dataset(folder).manifest().to_pylist()
    first, second = [json.loads(line) for line in (folder / JOURNAL).read_text().splitlines()][1:3]
    del first["line_sha256"], second["line_sha256"]
    (folder / JOURNAL).write_bytes(
        b"".join(
            signed(json.dumps({**row, "bytes": value}, sort_keys=True).encode()[:-1])
            for row in (first, second)
        )
    )
    (folder / "manifest.parquet").unlink()
    rows = open_dataset(folder).manifest().to_pylist()
    assert [row["bytes"] for row in rows] == [row["bytes"] for row in expected]
    assert [row["render_s"] for row in rows] == [None, None]


def test_changed_value_of_a_line_does_not_reach_the_manifest(make):
    folder = make()
    expected = open_dataset(folder).manifest().to_pylist()
    lines = (folder / JOURNAL).read_bytes()
    (folder / JOURNAL).write_bytes(lines.replace(b'"set": 0', b'"set": 5'))
    (folder / "manifest.parquet").unlink()
    assert [row["set"] for row in open_dataset(folder).manifest().to_pylist()] == [
        row["set"] for row in expected
    ]


def test_journal_that_cannot_be_read_is_an_error_with_its_name(make):
    folder = make("0:1")
    (folder / JOURNAL).unlink()
    (folder / JOURNAL).mkdir()
    with pytest.raises(InputError, match=JOURNAL):
        make("0:2")
    with pytest.raises(InputError, match=JOURNAL):
        check_dataset(folder)


@pytest.mark.parametrize("moment", ["write", "short write", "close"])
def test_full_disk_under_the_journal_is_one_sentence(make, monkeypatch, moment):
    """Network file systems report a full disk on closing."""
    real_open = journal_module.Journal._open

    class FullDisk:
        def __init__(self, file):
            self._file = file

        def __getattr__(self, name):
            return getattr(self._file, name)

        def write(self, content):
            if moment == "write":
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return self._file.write(content[:7] if moment == "short write" else content)

        def close(self):
            self._file.close()
            if moment == "close":
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def full(self):
        if not isinstance(self._file, FullDisk):
            self._file = FullDisk(real_open(self))
        return self._file

    monkeypatch.setattr(journal_module.Journal, "_open", full)
    with pytest.raises(OutputError, match=r"No space left on device"):
        make("0:2")
    monkeypatch.undo()


@pytest.mark.parametrize("name", ["dataset.json", JOURNAL, "both"])
def test_what_is_removed_during_a_build_and_known_is_written_again(make, tmp_path, name):
    names = ("dataset.json", JOURNAL) if name == "both" else (name,)

    def remove(progress):
        if progress.done == 3:
            for path in names:
                (tmp_path / "set" / path).unlink()

    folder = make("0:5", on_frame=remove)
    assert check_dataset(folder, workers=1, frames="0:5").counts().keys() <= {"shape"}
    assert Journal(folder).wanted == set(range(5))


@pytest.mark.parametrize("name", ["frames/000001.json", "class/000000.png"])
def test_frames_that_are_removed_during_a_build_are_named(make, tmp_path, name):
    def remove(progress):
        if progress.done == 3:
            (tmp_path / "set" / name).unlink()

    with pytest.raises(OutputError, match=r"1 of 5 frames were removed during the build, the first is 00000"):
        make("0:5", on_frame=remove)
    # Everything else is as it should be, and the same command repairs the rest.
    assert check_dataset(make("0:5"), workers=1).counts().keys() <= {"shape"}


def test_folder_that_is_removed_during_a_build_is_an_error(make, tmp_path):
    def remove(progress):
        if progress.done == 2:
            shutil.rmtree(tmp_path / "set")

    with pytest.raises(OutputError):
        make("0:5", on_frame=remove)


def test_folders_that_another_interrupted_build_removes_are_made_again(make, monkeypatch, tmp_path):
    """A build that is interrupted before its first frame removes what it made, if there is no frame."""
    folder, commit, removed = tmp_path / "set", Dataset.commit, []

    def remove_once(self, *arguments):
        if not removed:
            removed.extend(path for path in folder.iterdir() if path.is_dir())
            for path in removed:
                path.rmdir()
        return commit(self, *arguments)

    monkeypatch.setattr(Dataset, "commit", remove_once)
    make("0:3")
    assert len(removed) == 3
    assert check_dataset(folder, workers=1, frames="0:3").counts().keys() <= {"shape"}


def test_folder_whose_name_is_not_text(build_small, tmp_path):
    name = os.fsdecode(b"caf\xe9")
    folder = build_small(name, "0:2").dataset.folder
    assert os.fsencode(folder.name) == b"caf\xe9"
    assert open_dataset(folder).manifest()["index"].to_pylist() == [0, 1]
    assert check_dataset(folder, workers=1).counts().keys() <= {"shape"}


def test_manifest_of_a_build_that_was_killed_after_it_extended_a_frame(make, build_small):
    folder = make("0:2")
    table = (folder / "manifest.parquet").read_bytes()
    build_small("set", "0:1", ("normal",))
    (folder / "manifest.parquet").write_bytes(table)
    os.utime(folder / "manifest.parquet", ns=(0, 0))
    assert open_dataset(folder).manifest()["normal_sha256"].to_pylist()[0] is not None
