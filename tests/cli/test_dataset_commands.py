"""`pepperscene check`, `export` and `report`: output, exit codes and errors."""

from __future__ import annotations

import json
import re
import shutil
import sys

import numpy as np
import pytest

from pepperscene.cli import app
from pepperscene.dataset.store.images import write_image


@pytest.fixture
def folder(data_set, tmp_path):
    """A copy of the data set."""
    return shutil.copytree(data_set, tmp_path / "set")


def test_faults_give_a_table_and_exit_code_1(command, folder):
    result = command("check", folder, "--frames", "6137:6140")
    assert (result.exit_code, result.stdout) == (0, f"{folder}: 3 frames, no faults\n")
    result = command("check", folder, "--frames", "6137:6141")
    assert result.exit_code == 1
    assert "frames/006140.json" in result.stdout
    (folder / "class/006138.png").unlink()
    for name in "abcde":
        (folder / f"{name}.txt").write_bytes(b"")
    result = command("check", folder, "--rows", 2)
    assert result.exit_code == 1
    heading, *rows, end = result.stdout.splitlines()
    assert heading.split() == ["kind", "frame", "file", "problem"]
    assert [row.split()[0] for row in rows] == ["missing", "extra", "extra", "extra"]
    assert rows[0].split()[1:3] == ["006138", "class/006138.png"]
    assert rows[-1].split(maxsplit=1)[1] == "... and 3 more"
    assert end == f"{folder}: 3 frames, 6 faults: 1 missing, 5 extra"
    # Columns are aligned.
    place = heading.index("problem")
    assert all(row[place - 1] == " " and row[place] != " " for row in rows)


def test_check_prints_json(command, folder):
    assert json.loads(command("check", folder, "--json").stdout) == {
        "passed": True, "frames": 3, "counts": {}, "findings": [], "notes": [],
    }  # fmt: skip
    write_image(folder / "class/006139.png", np.full((4, 4), 8, np.uint8), "class")
    result = command("check", folder, "--json", "--workers", 1)
    assert result.exit_code == 1
    content = json.loads(result.stdout)
    assert content["counts"] == {"checksum": 1}
    assert {finding["index"] for finding in content["findings"]} == {6139}
    assert {"kind", "index", "file", "problem"} == set(content["findings"][0])


def test_terminal_does_not_interpret_markup_in_file_names(folder, monkeypatch, capsys):
    (folder / "[bold]x.txt").write_bytes(b"")
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setenv("TERM", "xterm")
    with pytest.raises(SystemExit) as end:
        app(["check", str(folder)])
    assert end.value.code == 1
    text = capsys.readouterr().out
    assert "[bold]x.txt" in text
    assert "┃" in text


@pytest.mark.parametrize("form", ["published", "yolo"])
def test_export_prints_progress_and_summary(form, data_set, command, tmp_path):
    out = tmp_path / form
    result = command("export", data_set, "--format", form, "--out", out, "--split", "train=:6139,val=6139:")
    assert result.exit_code == 0, result.stderr
    assert result.stdout == f"3 frames as {form} (2 train, 1 val): {out}\n"
    progress = "".join(f"frame {6137 + k:06d} ({k + 1} of 3)\n" for k in range(3))
    warning = "warning: train and val show the same plants from other places: 2 splits have 1 set of plants; "
    assert result.stderr == f"{progress}{warning}a plan with more sets keeps them apart\n"
    assert any(out.iterdir())
    more = ("--out", tmp_path / "one", "--frames", "6138:6139")
    assert command("export", data_set, "--format", form, *more).stdout.startswith(
        f"1 frame as {form} (1 train): "
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"--format": "coc"}, "--format: unknown format 'coc'; allowed are published, coco, yolo"),
        ({"--split": "a=0:10,b=9:6140"}, "--split: a and b overlap: frame 9 belongs to both"),
        ({"--frames": "0:5"}, "--frames: '0:5' holds none of the data set's frames"),
        ({"--smallest": "0"}, "--smallest: 0 must be at least 1"),
        ({"--ripe": "2"}, "--ripe: 2 must be 0 to 1"),
    ],
)
def test_export_rejects_invalid_options(change, message, data_set, rejects, tmp_path):
    options = {"--format": "coco", "--out": str(tmp_path / "out")} | change
    rejects(message, "export", data_set, *(word for pair in options.items() for word in pair))
    assert not (tmp_path / "out").exists()


def test_export_and_check_reject_invalid_folders(data_set, rejects, tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").touch()
    for source, out, message in (
        (tmp_path, tmp_path / "out", "holds no data set"),
        (data_set, tmp_path / "full", "holds 'mine'; choose an empty or a new folder"),
        (data_set, data_set / "coco", "is inside the data set"),
    ):
        rejects(message, "export", source, "--format", "coco", "--out", out)
    rejects("holds no data set", "check", tmp_path / "nowhere")


def test_report_compares_with_a_folder_of_photographs(command, folder, without_table):
    beside = ("--beside", without_table, "--labels", "montoya2021")
    result = command("report", folder, "--limit", 1, "--sample", 2, *beside)
    assert result.exit_code == 0, result.stderr
    first, *files = result.stdout.splitlines()
    assert "1 of 3 frames shown, 2 measured" in first
    assert files[:2] == [f"  {folder / 'contact_sheet.png'}", f"  {folder / 'index.html'}"]
    text = (folder / "index.html").read_text(encoding="utf-8")
    assert re.search(rf"{without_table.name}</span>, 2 images", text)
    # A quarter of the first photograph and half of the second are labelled.
    assert "37.50\u00a0%" in text


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--labels", "montoya2021"), "--labels: applies only with --beside"),
        (("--beside", "nowhere"), "nowhere"),
    ],
)
def test_report_rejects_options_that_do_not_apply(rejects, data_set, options, message):
    rejects(message, "report", data_set, *options)
