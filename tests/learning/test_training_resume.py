"""A training that was killed and resumed ends with the same bytes as one that was not."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from shapes import write_shapes

pytest.importorskip("torch")

from pepperscene.errors import EXIT_BAD_INPUT
from pepperscene.learning.training.checkpoint import STATE_FILE
from pepperscene.learning.training.loop import LOG_FILE

FILES = ("model.safetensors", STATE_FILE, LOG_FILE)
STEPS = 40
# Sums depend on the number of threads, which is the same here whatever runs the test.
ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": "1"}


@pytest.fixture(scope="module")
def sets(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sets")
    return write_shapes(folder / "train", 6), write_shapes(folder / "validation", 2, seed=1)


def command(sets, out, *options):
    words = [
        sys.executable, "-m", "pepperscene", "train", str(sets[0]), "--out", str(out),
        "--validation", str(sets[1]), "--labels", "published", "--model", "deeplab_vgg16,width=0.05",
        "--steps", str(STEPS), "--batch", "2", "--size", "48x32", "--width", "0", "--validate", "2",
        "--learning-rate", "0.001", *options,
    ]  # fmt: skip
    return subprocess.Popen(
        words,
        env=ENVIRONMENT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def finish(process):
    output, errors = process.communicate(timeout=600)
    return process.returncode, output, errors


def content(folder):
    return {name: (folder / name).read_bytes() for name in FILES}


def steps_in(folder: Path) -> int:
    try:
        return len((folder / LOG_FILE).read_text().splitlines())
    except OSError:
        return 0


@pytest.fixture(scope="module")
def undisturbed(sets, tmp_path_factory):
    folder = tmp_path_factory.mktemp("models") / "undisturbed"
    code, output, errors = finish(command(sets, folder))
    assert code == 0, errors
    assert output.startswith("trained, step ")
    return folder


def test_three_kills_at_random_change_nothing(sets, undisturbed, tmp_path):
    rng, out = np.random.default_rng(7), tmp_path / "killed"
    for _ in range(3):
        process, lines = command(sets, out, "--resume"), steps_in(out)
        # Wait for another checkpoint, then for a random time, so that kills fall anywhere between two.
        while steps_in(out) == lines and process.poll() is None:
            time.sleep(0.005)
        time.sleep(rng.uniform(0, 0.15))
        os.killpg(process.pid, signal.SIGKILL)
        assert finish(process)[0] == -signal.SIGKILL, "the training ended before it was killed"
    code, _, errors = finish(command(sets, out, "--resume"))
    assert code == 0, errors
    assert content(out) == content(undisturbed)
    assert steps_in(out) == STEPS // 2


def test_a_finished_training_is_not_taken_up_again(sets, undisturbed):
    before = content(undisturbed)
    code, output, errors = finish(command(sets, undisturbed, "--resume"))
    assert code == 0, errors
    assert output.startswith("trained, step ")
    assert content(undisturbed) == before


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ((), "holds a training; resume it with --resume, or choose another folder"),
        (("--resume", "--seed", "5"), "holds another training: options"),
        (("--resume", "--classes", "background,leaf,pepper,stem"), "holds another training: options"),
    ],
)
def test_another_training_is_not_overwritten(sets, undisturbed, options, message):
    before = content(undisturbed)
    code, output, errors = finish(command(sets, undisturbed, *options))
    assert (code, output) == (EXIT_BAD_INPUT, "")
    assert errors.startswith("error: ")
    assert message in errors
    assert errors.count("\n") == 1
    assert content(undisturbed) == before


def test_a_damaged_state_is_an_error(sets, undisturbed, tmp_path):
    for name, data in content(undisturbed).items():
        (tmp_path / name).write_bytes(data[: len(data) // 2] if name == STATE_FILE else data)
    code, _, errors = finish(command(sets, tmp_path, "--resume"))
    assert code == EXIT_BAD_INPUT
    assert "cannot be read as safetensors" in errors


def test_log_lines_are_json(undisturbed):
    entries = [json.loads(line) for line in (undisturbed / LOG_FILE).read_text().splitlines()]
    assert [entry["step"] for entry in entries] == list(range(2, STEPS + 1, 2))
    assert entries[-1]["loss"] < entries[0]["loss"]
