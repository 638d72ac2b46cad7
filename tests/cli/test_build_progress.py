"""Progress of a build: JSON lines, plain lines, a progress bar, and signals."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

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


def test_notices_are_reported(capsys):
    ProgressReporter().notice("a worker was lost")
    assert "a worker was lost" in capsys.readouterr().err
    JsonReporter().notice("a worker was lost")
    assert json.loads(capsys.readouterr().out) == {"event": "notice", "text": "a worker was lost"}


def test_terminal_shows_a_bar_with_the_latest_picture(monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setenv("TERM", "xterm")
    with progress_reporter(False) as reporter:
        assert isinstance(reporter, BarReporter)
        reporter.frame(progress(2))
        reporter.notice("[red]brackets stay")
    out = capsys.readouterr().err
    assert "000007.png" in out
    assert "12.5 frames/s" in out
    assert "[red]brackets stay" in out


@pytest.mark.skipif(os.name != "posix", reason="needs SIGTERM")
def test_sigterm_interrupts_a_build(tmp_path):
    stand_in = Path(__file__).resolve().parents[1] / "support"
    script = (
        "import pepperscene.building.scenes.frame_renderer as frame_renderer, stand_in\n"
        "frame_renderer.mitsuba_renderer = stand_in.StandIn\n"
        "from pepperscene.cli import main; main()\n"
    )
    search_path = os.pathsep.join((str(stand_in), os.environ.get("PYTHONPATH", "")))
    environment = {**os.environ, "PYTHONPATH": search_path, "STAND_IN_S": "0.3"}
    process = subprocess.Popen(
        [sys.executable, "-c", script, "build", "barth2018", "--out", str(tmp_path / "set"), "--json",
         *SMALL, "--set", "plan.frames=200"],
        env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert json.loads(process.stdout.readline())["event"] == "frame"
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 143
    assert "run the same command again" in errors
    assert (tmp_path / "set" / "manifest.parquet").is_file()
