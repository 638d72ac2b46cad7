"""The table of calls in the architecture page describes what a build does."""

from __future__ import annotations

import re
import sys
import threading
from pathlib import Path
from types import FrameType

import pytest

import pepperscene
from pepperscene.cli import app

PACKAGE = Path(pepperscene.__file__).parent
PAGE = Path(__file__).resolve().parents[2] / "docs" / "explanation" / "architecture.md"
ROW = re.compile(r"^\| (\d+) \| `(\w+)` \| `([\w/]+\.py)` \| .+ \|$", re.MULTILINE)


def test_a_build_makes_the_calls_of_the_architecture_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = ROW.findall(PAGE.read_text(encoding="utf-8"))
    assert [int(number) for number, _, _ in rows] == list(range(1, len(rows) + 1))
    assert 10 <= len(rows) <= 15
    wanted = {(str(PACKAGE / file), name): int(number) for number, name, file in rows}

    # Record the first call of each function, in any thread. Plants are made in this process.
    calls: list[int] = []

    def record(frame: FrameType, event: str, _: object) -> None:
        if event == "call":
            number = wanted.get((frame.f_code.co_filename, frame.f_code.co_name))
            if number is not None and number not in calls:
                calls.append(number)

    monkeypatch.setenv("PEPPERSCENE_PROCESSES", "1")
    threading.setprofile(record)
    sys.setprofile(record)
    try:
        settings = ["row.plants_front=2", "row.plants_back=0"]
        options = [word for setting in settings for word in ("--set", setting)]
        command = ["build", "barth2018", "--out", str(tmp_path / "set"), "--frames", "5:6", *options]
        app([*command, "--quality", "draft"], standalone_mode=False)
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
    assert calls == sorted(wanted.values())
