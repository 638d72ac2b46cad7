"""Slurm: what its file may say, what is asked for, and a build by a Slurm that is three small scripts."""

from __future__ import annotations

import os
import re
import shutil
import signal
import sys
import tomllib
from pathlib import Path

import pytest
from stand_in import StandIn

from pepperscene.dataset import build
from pepperscene.dataset.execution import slurm
from pepperscene.dataset.execution.slurm import SlurmJobs, read_slurm_file
from pepperscene.errors import InputError, SetupError, WorkerError

dask = pytest.importorskip("dask", reason="needs the extra `cluster`")
pytest.importorskip("dask_jobqueue", reason="needs the extra `cluster`")

OUTPUTS = ("class", "distance")
HERE = str(Path(__file__).parent)
WHOLE = """
jobs = 2
cores = 4
memory = "6 GB"
walltime = "12:00:00"
workers = 2
partition = "regular"
account = "peppers"
directives = ["--qos=long", "--exclude=node7"]
prologue = ["module load python", "export PEPPERSCENE_VARIANT=llvm_ad_spectral"]
python = "/opt/python/bin/python"
interface = "lo"
local_directory = "scratch"
log_directory = "logs"
"""
LEAST = """
jobs = 2
cores = 1
memory = "1 GB"
walltime = "10:00"
interface = "lo"
local_directory = "scratch"
"""

SBATCH = """#!/bin/sh
# Like Slurm's: --test-only judges a script; otherwise the job starts at once, in a session of its own.
if [ "$1" = --test-only ]; then
    if grep -q 'SBATCH -p closed' "$2"; then
        echo 'sbatch: error: invalid partition specified: closed' >&2
        exit 1
    fi
    exit 0
fi
number=1
while ! mkdir "$FAKE_SLURM/$number" 2>/dev/null; do number=$((number + 1)); done
cp "$1" "$FAKE_SLURM/$number/job.sh"
setsid bash "$FAKE_SLURM/$number/job.sh" >"$FAKE_SLURM/$number/out" 2>&1 </dev/null &
echo $! >"$FAKE_SLURM/$number/session"
echo "Submitted batch job $number"
"""
SCANCEL = """#!/bin/sh
touch "$FAKE_SLURM/$1/cancelled"
kill -KILL -- "-$(cat "$FAKE_SLURM/$1/session")" 2>/dev/null
exit 0
"""
SQUEUE = """#!/bin/sh
for word in "$@"; do
    case "$word" in --jobs=*) jobs=$(echo "${word#--jobs=}" | tr ',' ' ') ;; esac
done
for number in $jobs; do
    kill -0 -- "-$(cat "$FAKE_SLURM/$number/session")" 2>/dev/null && echo "$number"
done
exit 0
"""


@pytest.fixture
def commands(tmp_path, monkeypatch):
    """A Slurm of which this machine is the only node; its jobs leave a folder each."""
    if os.name != "posix" or shutil.which("setsid") is None:
        pytest.skip("the scripts are for Linux")
    programs, jobs = tmp_path / "bin", tmp_path / "slurm"
    programs.mkdir()
    jobs.mkdir()
    for name, text in (("sbatch", SBATCH), ("scancel", SCANCEL), ("squeue", SQUEUE)):
        (programs / name).write_text(text)
        (programs / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{programs}:{os.environ['PATH']}")
    monkeypatch.setenv("FAKE_SLURM", str(jobs))
    monkeypatch.setenv("PYTHONPATH", HERE)
    return jobs


@pytest.fixture
def written(tmp_path):
    def write(text):
        path = tmp_path / "jobs.toml"
        path.write_text(text)
        return path

    return write


def test_the_script_holds_what_was_asked_for(written, tmp_path):
    script = slurm.script(written(WHOLE))
    for option in (
        "-J pepperscene",
        "-p regular",
        "-A peppers",
        "-n 1",
        "--cpus-per-task=4",
        "--mem=6G",
        "-t 12:00:00",
        "--qos=long",
        "--exclude=node7",
        f"-o {tmp_path}/logs/pepperscene-%J.out",
    ):
        assert f"#SBATCH {option}\n" in script
    lines = script.splitlines()
    command = lines[-1]
    assert lines.index("module load python") < lines.index("export PEPPERSCENE_VARIANT=llvm_ad_spectral")
    assert lines.index("export PEPPERSCENE_VARIANT=llvm_ad_spectral") < lines.index(command)
    assert command.startswith("/opt/python/bin/python -m distributed.cli.dask_worker tcp://127.0.0.1:")
    assert "--nworkers 2 --nanny" in command
    assert "--nthreads 2" in command
    assert "--interface lo" in command
    assert f"--local-directory {tmp_path}/scratch" in command
    # Each of the two workers has half of the memory.
    limit = re.search(r"--memory-limit ([\d.]+)GiB", command)
    assert float(limit[1]) == pytest.approx(3e9 / 2**30, abs=0.01)


def test_what_is_not_said_is_left_to_the_site(written):
    script = slurm.script(written(LEAST))
    assert "#SBATCH -p" not in script
    assert "#SBATCH -A" not in script
    assert "#SBATCH -o" not in script
    assert script.splitlines()[-1].startswith(f"{sys.executable} -m distributed")
    assert "--nworkers" not in script


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("nodes = 3", "nodes: is not a known key"),
        ("jobs = 0", "jobs = 0: must be greater than or equal to 1"),
        ("jobs = 2.5", "jobs = 2.5: must be a valid integer"),
        ('memory = "much"', "memory = 'much': must be a number with a unit, such as \"16 GB\""),
        ("memory = 16", "memory = 16: must be a valid string"),
        ('walltime = "noon"', "walltime = 'noon': must be a time as Slurm writes it"),
        ('partition = "two words"', "partition = 'two words': must be a word without blanks"),
        ('prologue = ["a\\nb"]', "prologue.0 = 'a\\nb': must be a line of text"),
        ("workers = 5", "workers = 5 must not be more than cores = 1"),
    ],
)
def test_a_wrong_file_is_told(written, change, words):
    key = change.split(" ")[0]
    text = "".join(line + "\n" for line in LEAST.splitlines() if not line.startswith(f"{key} "))
    path = written(text + change + "\n")
    with pytest.raises(InputError) as fault:
        read_slurm_file(path)
    assert str(fault.value).startswith(f"{path}: ")
    assert words in str(fault.value)


@pytest.mark.parametrize("key", ["jobs", "cores", "memory", "walltime"])
def test_what_must_be_said(written, key):
    text = "".join(line + "\n" for line in LEAST.splitlines() if not line.startswith(key))
    with pytest.raises(InputError, match=f"{key}: is required but missing"):
        read_slurm_file(written(text))


@pytest.mark.parametrize("time", ["90", "90:00", "1:30:00", "2-0", "2-12:30", "7-00:00:00"])
def test_times_as_the_manual_has_them(time):
    assert SlurmJobs(jobs=1, cores=1, memory="2G", walltime=time).walltime == time


def test_every_key_is_told():
    page = (Path(__file__).parents[2] / "docs" / "how-to" / "cluster.md").read_text(encoding="utf-8")
    rows = "".join(line.split("|")[1] for line in page.splitlines() if line.startswith("| `"))
    assert set(re.findall(r"`(\w+)`", rows)) == set(SlurmJobs.model_fields)
    example = re.search(r"```toml\n(.+?)```", page, re.DOTALL)[1]
    assert SlurmJobs.model_validate(tomllib.loads(example)).workers == 32


def test_a_machine_without_slurm(recipe, written, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(SetupError, match="cannot submit jobs to Slurm: it has no command sbatch"):
        build(recipe, tmp_path / "set", slurm=written(LEAST))
    assert not (tmp_path / "set").exists()


def test_an_interface_that_this_machine_lacks(recipe, commands, written, tmp_path):
    path = written(LEAST.replace('"lo"', '"ib77"'))
    with pytest.raises(InputError, match=r"jobs\.toml: cannot be done here: .*ib77"):
        build(recipe, tmp_path / "set", slurm=path, renderer=StandIn, outputs=OUTPUTS)
    assert not (tmp_path / "set").exists()


def test_slurm_says_no(recipe, commands, written, tmp_path):
    path = written(LEAST + 'partition = "closed"\n')
    with pytest.raises(InputError, match=r"Slurm refuses such a job: .*invalid partition specified: closed"):
        build(recipe, tmp_path / "set", slurm=path, renderer=StandIn, outputs=OUTPUTS)
    assert not (tmp_path / "set").exists()
    assert not list(commands.iterdir())


def test_a_build_by_jobs(recipe, commands, written, tmp_path, monkeypatch):
    notices = []
    monkeypatch.setenv("STAND_IN_S", "0.1")
    shared = build(
        recipe,
        tmp_path / "shared",
        slurm=written(LEAST),
        renderer=StandIn,
        outputs=OUTPUTS,
        on_notice=notices.append,
    )
    alone = build(recipe, tmp_path / "alone", renderer=StandIn, outputs=OUTPUTS)
    assert shared.made == alone.made == tuple(range(24))
    assert notices == ["Slurm is asked for 2 jobs; frames are made once one of them runs"]
    for index in alone.dataset.indices():
        there, wanted = shared.dataset.intact(index), alone.dataset.intact(index)
        assert there.checksum == wanted.checksum
        for name in OUTPUTS:
            assert (
                shared.dataset.path(index, name).read_bytes() == alone.dataset.path(index, name).read_bytes()
            )
    # Both jobs ran here, and both are gone with the build.
    jobs = sorted(path.name for path in commands.iterdir())
    assert jobs == ["1", "2"]
    assert all((commands / job / "cancelled").exists() for job in jobs)
    assert not any(_lives(int((commands / job / "session").read_text())) for job in jobs)


def test_a_job_whose_time_is_over_is_asked_for_again(recipe, commands, written, tmp_path, monkeypatch):
    monkeypatch.setattr(slurm, "_RENEW_S", 1.0)
    monkeypatch.setenv("STAND_IN_S", "0.1")
    notices = []

    def end(progress):
        if progress.done == 2:
            os.killpg(int((commands / "1" / "session").read_text()), signal.SIGKILL)

    path = written(LEAST.replace("jobs = 2", "jobs = 1"))
    with dask.config.set({"distributed.deploy.lost-worker-timeout": "1s"}):
        done = build(
            recipe,
            tmp_path / "set",
            slurm=path,
            renderer=StandIn,
            outputs=OUTPUTS,
            on_frame=end,
            on_notice=notices.append,
        )
    assert sorted((*done.made, *done.kept)) == list(range(24))
    assert sorted(path.name for path in commands.iterdir()) == ["1", "2"]
    assert len(notices) == 2
    assert "a worker was lost over frame 0000" in notices[1]


def test_jobs_that_end_before_a_worker_begins(recipe, commands, written, tmp_path, monkeypatch):
    monkeypatch.setattr(slurm, "_LOOK_S", 0.1)
    monkeypatch.setattr(slurm, "_LOOKS", 2)
    path = written(LEAST + 'prologue = ["exit 1"]\n')
    with pytest.raises(WorkerError, match="Slurm has none of the jobs any more"):
        build(recipe, tmp_path / "set", slurm=path, renderer=StandIn, outputs=OUTPUTS)
    assert not (tmp_path / "set").exists()


def _lives(session):
    """Whether a process of a session is there that has not ended."""
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = status.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[3]) == session and fields[0] != "Z":
            return True
    return False
