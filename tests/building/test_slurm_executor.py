"""Slurm: the file of jobs, the submitted script, and a build by a fake Slurm of three shell scripts."""

from __future__ import annotations

import os
import re
import signal
import sys
import tempfile
import tomllib
from pathlib import Path

import fake_slurm
import pytest
from data_sets import contents
from fake_slurm import REQUIRED_KEYS
from stand_in import process_fields, wait_for

from pepperscene.building.execution import slurm
from pepperscene.building.execution.slurm import SlurmJobs, read_slurm_file
from pepperscene.errors import InputError, SetupError, WorkerError

dask = pytest.importorskip("dask", reason="needs the extra `cluster`")
pytest.importorskip("dask_jobqueue", reason="needs the extra `cluster`")

ALL_KEYS = """
jobs = 2
cores = 4
memory = "6 GB"
walltime = "12:00:00"
workers = 2
partition = "closed"
account = "peppers"
directives = ["--qos=long", "--exclude=node7"]
prologue = ["module load python", "export PEPPERSCENE_VARIANT=llvm_ad_spectral"]
python = "/opt/python/bin/python"
interface = "lo"
local_directory = "scratch"
log_directory = "logs"
"""


@pytest.fixture
def commands(tmp_path, monkeypatch):
    """The folder of the jobs of a fake Slurm; the home folder is empty."""
    home = tmp_path / "home"
    home.mkdir(mode=0o700)
    monkeypatch.setenv("HOME", str(home))
    return fake_slurm.install(tmp_path, monkeypatch)


@pytest.fixture
def write_jobs(tmp_path):
    def write(text):
        path = tmp_path / "jobs.toml"
        path.write_text(text)
        return path

    return write


def submitted_script(build_small, commands, path):
    """The script that Slurm was asked to check, and rejects."""
    with pytest.raises(InputError, match=r"Slurm refuses such a job: .*closed"):
        build_small(slurm=path)
    return (commands / "tested.sh").read_text()


def test_script_has_all_settings(build_small, commands, write_jobs, tmp_path):
    script = submitted_script(build_small, commands, write_jobs(ALL_KEYS))
    options = ("-J pepperscene", "-p closed", "-A peppers", "-n 1", "--cpus-per-task=4", "--mem=6G")
    options += ("-t 12:00:00", "--qos=long", "--exclude=node7", f"-o {tmp_path}/logs/pepperscene-%J.out")
    for option in options:
        assert f"#SBATCH {option}\n" in script
    lines = script.splitlines()
    command = lines[-1]
    assert lines.index("module load python") < lines.index("export PEPPERSCENE_VARIANT=llvm_ad_spectral")
    assert lines.index("export PEPPERSCENE_VARIANT=llvm_ad_spectral") < lines.index(command)
    assert command.startswith("/opt/python/bin/python -m distributed.cli.dask_worker tls://127.0.0.1:")
    for argument in ("--nworkers 2 --nanny", "--nthreads 2", "--interface lo", "--protocol tls://"):
        assert argument in command
    assert f"$(mktemp -d -- {tmp_path}/scratch/pepperscene-XXXXXXXXXX)" in script
    assert '--local-directory "$pepperscene_folder"' in command
    # Each of the two workers has half of the memory.
    limit = re.search(r"--memory-limit ([\d.]+)GiB", command)
    assert float(limit[1]) == pytest.approx(3e9 / 2**30, abs=0.01)
    # Nothing is written, and the key is gone.
    assert not (tmp_path / "set").exists()
    assert [path.name for path in commands.iterdir()] == ["tested.sh"]
    assert not list((tmp_path / "home").iterdir())


def test_settings_of_the_site_are_kept_but_do_not_open_the_scheduler(build_small, commands, write_jobs):
    site = {
        "worker-extra-args": ["--lifetime", "1h"],
        "job-script-prologue": ["module load site"],
        "local-directory": "$SCRATCH/dask",
        "scheduler-options": {"host": "127.0.0.1", "protocol": "tcp://", "dashboard": True, "security": None},
    }
    lines = REQUIRED_KEYS.replace('interface = "lo"', "").replace('local_directory = "scratch"', "")
    path = write_jobs(lines + 'partition = "closed"\n')
    with dask.config.set({f"jobqueue.slurm.{key}": value for key, value in site.items()}):
        script = submitted_script(build_small, commands, path)
    assert "\nmodule load site\n" in script
    assert "$(mktemp -d -- $SCRATCH/dask/pepperscene-XXXXXXXXXX)" in script
    command = script.splitlines()[-1]
    assert "distributed.cli.dask_worker tls://127.0.0.1:" in command
    assert "--lifetime 1h" in command
    assert "--no-dashboard" in command
    assert "--interface" not in command
    # Without options, defaults are left to the site.
    assert "#SBATCH -A" not in script
    assert "#SBATCH -o" not in script
    assert command.startswith(f"{sys.executable} -m distributed")
    assert "--nworkers" not in command


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("nodes = 3", "nodes: is not a known key"),
        ("jobs = 0", "jobs = 0: must be greater than or equal to 1"),
        ('memory = "much"', "memory = 'much': must be a number with a unit, such as \"16 GB\""),
        ('walltime = "noon"', "walltime = 'noon': must be a time in Slurm's format"),
        ('partition = "open;touch$IFS$HOME"', "must be a word without blanks, quotes and other special"),
        *(
            (f"{key} = {value!r}", "must be a word without blanks, quotes and other special characters")
            for key in ("account", "python", "local_directory", "log_directory", "credentials_directory")
            for value in ("/a/b;touch injected", "/a/$HOME", "/a/`x`", "/with blank", '/a"b')
        ),
        ('prologue = ["a\\nb"]', "prologue.0 = 'a\\nb': must be a line of text"),
        ("workers = 5", "workers = 5 must not be more than cores = 1"),
        *((f"-{key}", f"{key}: is required but missing") for key in ("jobs", "cores", "memory", "walltime")),
    ],
)
def test_rejects_invalid_file(write_jobs, change, message):
    key = change.removeprefix("-").split(" ")[0]
    lines = [line for line in REQUIRED_KEYS.splitlines() if not line.startswith(f"{key} ")]
    path = write_jobs("\n".join([*lines, *([] if change.startswith("-") else [change])]))
    with pytest.raises(InputError) as caught:
        read_slurm_file(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert message in str(caught.value)


def test_every_key_is_documented():
    page = (Path(__file__).parents[2] / "docs" / "how-to" / "cluster.md").read_text(encoding="utf-8")
    rows = "".join(line.split("|")[1] for line in page.splitlines() if line.startswith("| `"))
    assert set(re.findall(r"`(\w+)`", rows)) == set(SlurmJobs.model_fields)
    example = re.search(r"```toml\n(.+?)```", page, re.DOTALL)[1]
    assert SlurmJobs.model_validate(tomllib.loads(example)).workers == 32


def test_folder_for_the_key_that_others_may_write_to_is_refused(build_small, commands, write_jobs, tmp_path):
    exposed = tmp_path / "exposed"
    exposed.mkdir()
    exposed.chmod(0o777)
    for folder, problem in (("exposed", "can be written to by other users"), ("missing", "No such file")):
        path = write_jobs(REQUIRED_KEYS + f'credentials_directory = "{folder}"\n')
        with pytest.raises(InputError, match=f"credentials_directory: must be a folder .*{problem}"):
            build_small(slurm=path)
    assert not list(exposed.iterdir())
    assert not (tmp_path / "set").exists()


@pytest.mark.long
def test_jobs_make_the_same_files(build_small, commands, write_jobs, tmp_path, monkeypatch):
    notices, modes = [], set()
    monkeypatch.setenv("STAND_IN_S", "0.1")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))

    def on_frame(_):
        """The key is readable by this user only, and its content is in no script."""
        (folder,) = (tmp_path / "home").iterdir()
        modes.update(path.stat().st_mode & 0o777 for path in (folder, *folder.iterdir()))
        assert "PRIVATE KEY" not in (commands / "1" / "job.sh").read_text()

    path = write_jobs(REQUIRED_KEYS)
    result = build_small(slurm=path, on_notice=notices.append, on_frame=on_frame)
    assert modes == {0o700, 0o600}
    assert not list((tmp_path / "home").iterdir())
    build_small("serial")
    assert result.made == tuple(range(24))
    assert notices == ["2 jobs were submitted to Slurm; frames are made once one of them runs"]
    assert contents(tmp_path / "set") == contents(tmp_path / "serial")
    # Both jobs ran, and ended with the build.
    jobs = sorted(path.name for path in commands.iterdir() if path.is_dir())
    assert jobs == ["1", "2"]
    assert all((commands / job / "cancelled").exists() for job in jobs)
    sessions = {int((commands / job / "session").read_text()) for job in jobs}
    wait_for(
        lambda: not any(session in sessions and state != "Z" for _, state, *_, session in process_fields())
    )


@pytest.mark.long
def test_job_that_ends_is_submitted_again(build_small, commands, write_jobs, monkeypatch):
    monkeypatch.setattr(slurm, "_RENEW_S", 1.0)
    monkeypatch.setenv("STAND_IN_S", "0.1")
    notices = []

    def end_job(progress):
        if progress.done == 2:
            os.killpg(int((commands / "1" / "session").read_text()), signal.SIGKILL)

    path = write_jobs(REQUIRED_KEYS.replace("jobs = 2", "jobs = 1"))
    with dask.config.set({"distributed.deploy.lost-worker-timeout": "1s"}):
        result = build_small(slurm=path, on_frame=end_job, on_notice=notices.append)
    assert sorted((*result.made, *result.kept)) == list(range(24))
    assert sorted(path.name for path in commands.iterdir() if path.is_dir()) == ["1", "2"]
    assert len(notices) == 2
    assert "a worker was lost over frame 0000" in notices[1]


def test_jobs_that_end_before_a_worker_starts(build_small, commands, write_jobs, tmp_path, monkeypatch):
    monkeypatch.setattr(slurm, "_QUEUE_CHECK_S", 0.1)
    monkeypatch.setattr(slurm, "_QUEUE_CHECKS", 2)
    path = write_jobs(REQUIRED_KEYS + 'prologue = ["exit 1"]\n')
    with pytest.raises(WorkerError, match="Slurm has none of the jobs any more"):
        build_small(slurm=path)
    assert not (tmp_path / "set").exists()


@pytest.mark.parametrize("time", ["90", "90:00", "1:30:00", "2-0", "2-12:30"])
def test_accepts_the_time_formats_of_the_manual(time):
    assert SlurmJobs(jobs=1, cores=1, memory="2G", walltime=time).walltime == time


def test_machines_without_the_interface_or_slurm(build_small, commands, write_jobs, tmp_path, monkeypatch):
    path = write_jobs(REQUIRED_KEYS.replace('"lo"', '"ib77"'))
    with pytest.raises(InputError, match=r"jobs\.toml: cannot be used on this machine: .*ib77"):
        build_small(slurm=path)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(SetupError, match="cannot submit jobs to Slurm: it has no command sbatch"):
        build_small(slurm=write_jobs(REQUIRED_KEYS))
    assert not (tmp_path / "set").exists()
