"""Trainings that are killed and resumed."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from commands import rejected, run
from painted_bands import CLASSES, write_bands
from PIL import Image

import pepperscene
from pepperscene.atomic import sole_writer
from pepperscene.errors import OutputError

torch = pytest.importorskip("torch", reason="the extra `learn` installs torch")
safetensors = pytest.importorskip("safetensors.torch", reason="the extra `learn` installs safetensors")

FILES = ("model.safetensors", "state.safetensors", "training.jsonl")
OPTIONS = (
    "--classes", CLASSES, "--model", "deeplab_vgg16,width=0.03", "--steps", "60", "--validate", "3",
    "--batch", "2", "--size", "48x32", "--width", "0", "--learning-rate", "1e-3",
)  # fmt: skip
"""A network with dropout."""
SHORT = (*OPTIONS, "--steps", "4", "--validate", "2")


@pytest.fixture(scope="module")
def sets(tmp_path_factory):
    """Folders of training and validation."""
    folder = tmp_path_factory.mktemp("sets")
    return write_bands(folder / "some", 5), write_bands(folder / "others", 2, seed=3)


def arguments(sets, out, *options):
    return ["train", str(sets[0]), "--validation", str(sets[1]), "--out", str(out), *options]


def start_process(sets, out, *options):
    # One thread, as the undisturbed run: the order of sums depends on their number.
    environment = {
        **os.environ, "PYTHONPATH": str(Path(pepperscene.__file__).parents[1]), "OMP_NUM_THREADS": "1",
    }  # fmt: skip
    return subprocess.Popen(
        [sys.executable, "-m", "pepperscene", *arguments(sets, out, *options)],
        env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def finish(process):
    output, errors = process.communicate(timeout=300)
    assert process.returncode == 0, errors
    return output


def last_step(out):
    """Step of the last line of the log; 0 if there is none."""
    log = out / "training.jsonl"
    lines = log.read_text().splitlines() if log.is_file() else []
    return json.loads(lines[-1])["step"] if lines else 0


def digests(folder):
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(folder.iterdir())}


def kill_after(process, out, step, delay_s):
    """Kill a training some time after a step is logged; returns whether it was still running."""
    end = time.monotonic() + 240
    while last_step(out) < step and process.poll() is None and time.monotonic() < end:
        time.sleep(0.005)
    time.sleep(delay_s)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    return process.returncode == -signal.SIGKILL


@pytest.mark.long
def test_a_training_that_is_killed_three_times_ends_with_the_same_bytes(sets, tmp_path):
    finish(start_process(sets, tmp_path / "undisturbed", *OPTIONS))
    rng, out = np.random.default_rng(8), tmp_path / "killed"
    for step in (3, 18, 36):
        process = start_process(sets, out, *OPTIONS, "--resume")
        assert kill_after(process, out, step, float(rng.uniform(0, 0.3)))
        assert step <= last_step(out) < 60
    assert "trained, step" in finish(start_process(sets, out, *OPTIONS, "--resume"))
    assert sorted(path.name for path in out.iterdir()) == sorted([*FILES, "model_card.md"])
    assert digests(out) == digests(tmp_path / "undisturbed")


@pytest.fixture(scope="module")
def done(sets, tmp_path_factory):
    """Folder of a finished training."""
    out = tmp_path_factory.mktemp("done") / "model"
    result = run(*arguments(sets, out, *SHORT))
    assert result.exit_code == 0, result.output
    return out


@pytest.fixture
def copy(done, tmp_path):
    return Path(shutil.copytree(done, tmp_path / "copy"))


def rejects(message, sets, out, *options):
    before = digests(out)
    assert message in rejected(*arguments(sets, out, *options))
    assert digests(out) == before


def test_every_moment_at_a_checkpoint_can_be_resumed(sets, done, copy):
    """Files appear in the order network, log, state; a kill leaves the first one or two of them."""
    complete = digests(done)
    # A finished training stays as it is, also with a line that was not written to its end.
    for remaining in ((), FILES[:1], (FILES[0], FILES[2]), FILES):
        for name in set(FILES) - set(remaining):
            (copy / name).unlink(missing_ok=True)
        if remaining == FILES:
            with (copy / "training.jsonl").open("a") as log:
                log.write('{"loss": 1.0, "mean')
        (copy / ".model.safetensors.some-host.1.00ff.tmp").write_bytes(b"half of a net")
        os.utime(copy / ".model.safetensors.some-host.1.00ff.tmp", (0, 0))
        result = run(*arguments(sets, copy, *SHORT, "--resume"))
        assert result.exit_code == 0, result.output
        assert digests(copy) == complete


def test_other_trainings_are_named(sets, copy, tmp_path, monkeypatch):
    resumed = (*SHORT, "--resume")
    for message, *changes in (
        ("options.steps is 4 there and 5 here", "--steps", "5"),
        ("options.learning_rate is 0.001 there and 0.002 here", "--learning-rate", "0.002"),
        ("options.seed is 0 there and 1 here", "--seed", "1"),
        ("options.size is [32, 48] there and [48, 48] here", "--size", "48x48"),
        ("options.balance is 0.0 there and 0.5 here", "--model", "small,width=0.3"),
        ("number of sets is 1 there and 2 here", str(sets[0])),
    ):
        rejects(f"state.safetensors: holds another training: {message}", sets, copy, *resumed, *changes)
    more = Path(shutil.copytree(sets[0], tmp_path / "some"))
    Image.new("RGB", (96, 64)).save(more / "image9.png")
    rejects("sets.0.images is 5 there and 6 here", (more, sets[1]), copy, *resumed)
    (more / "image3.png").unlink()
    (more / "image3_mask.png").unlink()
    rejects("sets.0.names_sha256 is", (more, sets[1]), copy, *resumed)
    rejects("validation.0.images is 2 there and 5 here", (sets[0], sets[0]), copy, *resumed)
    with monkeypatch.context() as patch:
        patch.setattr("pepperscene.learning.training.run.__version__", "0.0.1")
        rejects("versions.pepperscene is '", sets, copy, *resumed)
    # Also where the state is missing because the training was killed at its first checkpoint.
    (copy / "state.safetensors").unlink()
    rejects("options.seed is 0 there and 1 here", sets, copy, *resumed, "--seed", "1")


def test_folders_of_other_files_and_trainings_are_refused(sets, copy, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    for options in ((), ("--resume",)):
        rejects("out: is not empty and holds no training", sets, out, *SHORT, *options)
    rejects("holds a training; resume it with --resume, or choose another folder", sets, copy, *SHORT)
    (copy / "state.safetensors").unlink()
    rejects("holds a training; resume it with --resume", sets, copy, *SHORT)


def test_a_folder_has_one_writer_at_a_time(tmp_path):
    """Two trainings into one folder: the second is refused; a folder that stays empty is removed."""
    pytest.importorskip("fcntl", reason="folders have no locks on this system")
    out = tmp_path / "a" / "out"
    with sole_writer(out):
        assert out.is_dir()
        with pytest.raises(OutputError, match="another process is writing to it"), sole_writer(out):
            pytest.fail("two writers")
    assert not (tmp_path / "a").exists()
    with sole_writer(out):
        (out / "file").touch()
    assert (out / "file").exists()


def test_damaged_states_are_refused(sets, copy):
    state = copy / "state.safetensors"
    content, resumed = state.read_bytes(), (*SHORT, "--resume")
    state.write_bytes(content[:-100])
    rejects("state.safetensors: cannot be read as safetensors", sets, copy, *resumed)
    tensors = safetensors.load(content)
    header = json.loads(content[8 : 8 + int.from_bytes(content[:8], "little")])["__metadata__"]
    second = next(name for name in tensors if name.startswith("second_moment."))
    weight = next(name for name in tensors if name.startswith("model."))
    for missing, message in ((second, f"lacks '{second}'"), (weight, "holds weights of another model")):
        rest = {name: value for name, value in tensors.items() if name != missing}
        state.write_bytes(safetensors.save(rest, header))
        rejects(f"state.safetensors: {message}", sets, copy, *resumed)
    shutil.copyfile(copy / "model.safetensors", state)
    rejects("state.safetensors: is not of the format", sets, copy, *resumed)
