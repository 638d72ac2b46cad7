"""The table of calls in the architecture page describes what a build does."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from source_trees import PACKAGE

PAGE = Path(__file__).resolve().parents[2] / "docs" / "explanation" / "architecture.md"
ROW = re.compile(r"^\| (\d+) \| `(\w+)` \| `([\w/]+\.py)` \| .+ \|$", re.MULTILINE)

MODULE = re.compile(r"`([\w/]+\.py)`")
NAMES = re.compile(r"((?:`[\w.]+`(?:,| and) )*`[\w.]+`) in `([\w/]+\.py)`")
"""Names, and the module that has them."""

RECORD_CALLS = """
import json, sys, threading
from pepperscene.cli import app

numbers = {(file, name): number for number, name, file in json.loads(sys.argv[1])}
calls = []

def record(frame, event, _):
    number = numbers.get((frame.f_code.co_filename, frame.f_code.co_name))
    if event == "call" and number is not None and number not in calls:
        calls.append(number)

threading.setprofile(record)
sys.setprofile(record)
app(sys.argv[2:], standalone_mode=False)
sys.setprofile(None)
print(json.dumps(calls))
"""
"""Records the first call of each function in any thread, in a process that makes all plants itself."""


def test_modules_and_names_of_the_architecture_page_exist() -> None:
    page = PAGE.read_text(encoding="utf-8")
    modules = [name for name in MODULE.findall(page) if not name.startswith("tests/")]
    assert len(modules) > 50
    assert [name for name in modules if not (PACKAGE / name).is_file()] == []
    pairs = NAMES.findall(page)
    assert len(pairs) > 20
    for names, module in pairs:
        source = (PACKAGE / module).read_text(encoding="utf-8")
        for name in re.findall(r"\w+", names.replace(" and ", " ")):
            assert re.search(rf"^ *(class |def )?{name}\b", source, re.MULTILINE), f"{name} in {module}"


@pytest.mark.long
def test_a_build_makes_the_calls_of_the_architecture_page(tmp_path: Path) -> None:
    rows = ROW.findall(PAGE.read_text(encoding="utf-8"))
    assert [int(number) for number, _, _ in rows] == list(range(1, len(rows) + 1))
    assert 10 <= len(rows) <= 15
    functions = [(int(number), name, str(PACKAGE / file)) for number, name, file in rows]
    command = [
        "build", "barth2018", "--out", str(tmp_path / "set"), "--frames", "5:6", "--quality", "draft",
        "--set", "row.plants_front=2", "--set", "row.plants_back=0",
    ]  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-c", RECORD_CALLS, json.dumps(functions), *command],
        env={**os.environ, "PEPPERSCENE_PROCESSES": "1"},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1]) == list(range(1, len(rows) + 1))
