"""Two trainings into one folder: the second is refused while the first runs."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from pepperscene.atomic import sole_writer
from pepperscene.errors import OutputError

pytest.importorskip("torch", reason="the extra `learn` installs torch")
pytest.importorskip("safetensors", reason="the extra `learn` installs safetensors")
pytest.importorskip("fcntl", reason="folders have no locks on this system")


def test_a_folder_has_one_writer_at_a_time(tmp_path):
    script = (
        "import sys, time\n"
        "from pathlib import Path\n"
        "from pepperscene.atomic import sole_writer\n"
        "with sole_writer(Path(sys.argv[1])):\n"
        "    print('inside', flush=True)\n"
        "    time.sleep(60)\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    out = tmp_path / "a" / "out"
    with subprocess.Popen(
        [sys.executable, "-c", script, str(out)], env=environment, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout.readline() == "inside\n"
        with pytest.raises(OutputError, match="another process is writing to it"), sole_writer(out):
            pytest.fail("two writers")
        assert out.is_dir()
        # A lock ends with its process.
        other.kill()
        other.wait()
    with sole_writer(out):
        pass


def test_a_folder_that_stays_empty_is_removed(tmp_path):
    with sole_writer(tmp_path / "a" / "b"):
        assert (tmp_path / "a" / "b").is_dir()
    assert not (tmp_path / "a").exists()
    with sole_writer(tmp_path / "a" / "b"):
        (tmp_path / "a" / "b" / "file").touch()
    assert (tmp_path / "a" / "b" / "file").exists()
