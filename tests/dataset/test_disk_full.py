"""The system refuses a file that is too large, as a full disk does, in a build of its own process."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from stand_in import PYTHONPATH

from pepperscene.dataset import open_dataset

pytestmark = pytest.mark.skipif(os.name != "posix", reason="files are limited by setrlimit")

SCRIPT = """
import resource, sys
from stand_in import StandIn
from pepperscene.dataset import BuildOptions, build, load_recipe
from pepperscene.errors import OutputError
recipe = load_recipe("barth2018", {"plan.sets": 1, "plan.rotations": 1, "plan.frames": 4,
    "row.plants_front": 1, "row.plants_back": 0, "cultivar": "kaite_february"})
output, limit, workers = sys.argv[2], int(sys.argv[3]), int(sys.argv[4]) or None
build(recipe, sys.argv[1], "0:2", ("class",), BuildOptions(renderer=StandIn))
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
try:
    build(recipe, sys.argv[1], None, ("class", output), BuildOptions(renderer=StandIn, workers=workers))
except OutputError as error:
    print(error)
"""


@pytest.mark.parametrize(
    ("output", "limit", "workers"),
    [("colour", 100, 0), ("distance", 300, 0), ("normal", 700, 0), ("distance", 300, 1)],
)
def test_a_file_that_cannot_grow_is_named_and_leaves_nothing(tmp_path, output, limit, workers):
    folder = tmp_path / "set"
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(folder), output, str(limit), str(workers)],
        env={**os.environ, "PYTHONPATH": PYTHONPATH},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "cannot be written" in done.stdout
    assert len(done.stdout.splitlines()) == 1
    # Complete frames are kept, and the one that failed leaves nothing.
    dataset = open_dataset(folder)
    assert dataset.indices() == (0, 1)
    assert all(set(dataset.intact(index).outputs) == {"class"} for index in (0, 1))
    assert not [path for path in folder.rglob("*") if path.name.endswith(".tmp")]
    assert not list((folder / output).iterdir())
