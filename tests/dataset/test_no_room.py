"""What the system refuses: too large a file, as a full disk would, met by a build of its own process."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from pepperscene.dataset import open_dataset

pytestmark = pytest.mark.skipif(os.name != "posix", reason="files are limited by setrlimit")

SCRIPT = """
import resource, sys
from stand_in import StandIn
from pepperscene.dataset import build, load_recipe
from pepperscene.errors import OutputError
recipe = load_recipe("barth2018")
plan = recipe.plan.model_copy(update={"sets": 1, "rotations": 1, "frames": 4})
row = recipe.row.model_copy(update={"plants_front": 1, "plants_back": 0})
recipe = recipe.model_copy(update={"plan": plan, "row": row, "cultivar": "kaite_february"})
output, limit, workers = sys.argv[2], int(sys.argv[3]), int(sys.argv[4]) or None
build(recipe, sys.argv[1], "0:2", ("class",), renderer=StandIn)
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
try:
    build(recipe, sys.argv[1], outputs=("class", output), renderer=StandIn, workers=workers)
except OutputError as fault:
    print(fault)
"""


@pytest.mark.parametrize(("output", "limit"), [("colour", 100), ("distance", 300), ("normal", 700)])
@pytest.mark.parametrize("workers", [0, 1])
def test_a_file_that_cannot_grow_is_named_and_leaves_nothing(tmp_path, output, limit, workers):
    folder = tmp_path / "set"
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(folder), output, str(limit), str(workers)],
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parent)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "cannot be written" in done.stdout
    assert len(done.stdout.splitlines()) == 1
    # What was whole still is, and the frame that failed has left nothing.
    dataset = open_dataset(folder)
    assert dataset.indices() == (0, 1)
    assert all(set(dataset.intact(index).outputs) == {"class"} for index in (0, 1))
    assert not [path for path in folder.rglob("*") if path.name.endswith(".tmp")]
    assert not list((folder / output).iterdir())
