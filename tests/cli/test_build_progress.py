"""Progress of a build: JSON lines, plain lines, a progress bar, and signals."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from pepperscene.building.execution.build import BuildProgress
from pepperscene.cli.progress import BarReporter, JsonReporter, ProgressReporter, progress_reporter

SMALL = (
    "--set", "plan.sets=1", "--set", "plan.rotations=2", "--set", "plan.frames=2", "--set",
    "row={plants_front=1, plants_back=0}", "--set", "cultivar=kaite_february", "--outputs", "class,distance",
)  # fmt: skip


def progress(done, total=3):
    return BuildProgress(7, done, total, True, 12.5, 75.0, Path("set/class/000007.png"))


def test_json_lines_report_each_frame_and_the_end(command, tmp_path):
    folder = tmp_path / "set"
    result = command("build", "barth2018", "--out", folder, *SMALL, "--json")
    assert result.exit_code == 0, result.stderr
    lines = [json.loads(line) for line in result.stdout.splitlines()]
    assert [line["event"] for line in lines] == ["frame"] * 4 + ["end"]
    assert [(line["index"], line["done"], line["total"], line["made"]) for line in lines[:-1]] == [
        (index, index + 1, 4, True) for index in range(4)
    ]
    assert all(Path(line["picture"]).is_file() for line in lines[:-1])
    assert (lines[-1]["made"], lines[-1]["kept"], lines[-1]["folder"]) == (4, 0, str(folder))
    assert result.stderr == ""
    again = command("build", "barth2018", "--out", folder, *SMALL, "--json")
    assert json.loads(again.stdout.splitlines()[-1])["kept"] == 4


def test_plain_lines_have_rate_and_time_left(capsys):
    ProgressReporter().frame(progress(2))
    assert capsys.readouterr().err == "frame 000007 built (2 of 3, 12.5 frames/s, 1 min 15 s left)\n"


def test_lines_are_throttled_for_many_frames(capsys):
    reporter = ProgressReporter()
    for done in range(1, 5001):
        reporter.frame(progress(done, 5000))
    lines = capsys.readouterr().err.splitlines()
    assert 2 <= len(lines) < 50
    assert "5000 of 5000" in lines[-1]


def test_reporters_are_chosen_and_report_notices(monkeypatch, capsys):
    with progress_reporter(False) as reporter:
        assert type(reporter) is ProgressReporter
        reporter.notice("a worker was lost")
    assert "a worker was lost" in capsys.readouterr().err
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("TERM", "xterm")
    with progress_reporter(False) as reporter:
        assert isinstance(reporter, BarReporter)
    JsonReporter().notice("a worker was lost")
    assert json.loads(capsys.readouterr().out.splitlines()[-1]) == {
        "event": "notice",
        "text": "a worker was lost",
    }
