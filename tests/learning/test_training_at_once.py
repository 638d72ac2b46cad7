"""Two trainings into one folder: the second is refused while the first runs."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest
from painted_bands import write_bands

from pepperscene.atomic import sole_writer
from pepperscene.errors import OutputError

pytest.importorskip("torch", reason="the extra `learn` installs torch")
pytest.importorskip("safetensors", reason="the extra `learn` installs safetensors")
pytest.importorskip("fcntl", reason="folders have no locks on this system")

OPTIONS = (
    "--model", "small,width=0.3", "--steps", "4", "--batch", "1", "--size", "32x32", "--width", "0",
    "--validate", "1",
)  # fmt: skip


def start(data, out, *options):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-m", "pepperscene", "train", str(data), "--out", str(out), *OPTIONS, *options]
    return subprocess.Popen(
        command, env=environment, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )


@pytest.mark.slow
def test_of_two_trainings_into_one_new_folder_one_is_refused(tmp_path):
    data, out = write_bands(tmp_path / "set", 2), tmp_path / "out"
    processes = [start(data, out), start(data, out)]
    results = [(process.communicate(timeout=200)[1], process.returncode) for process in processes]
    assert sorted(code for _, code in results) == [0, 2], results
    message = next(text for text, code in results if code == 2)
    assert message.startswith("error: ")
    assert message.count("\n") == 1
    assert "another process is writing to it" in message or "holds a training" in message
    lines = [json.loads(line) for line in (out / "training.jsonl").read_text().splitlines()]
    assert [line["step"] for line in lines] == [1, 2, 3, 4]


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
