"""A Slurm of three shell scripts, whose only node is this machine."""

from __future__ import annotations

import os
import shutil

import pytest
from stand_in import PYTHONPATH

REQUIRED_KEYS = """
jobs = 2
cores = 1
memory = "1 GB"
walltime = "10:00"
interface = "lo"
local_directory = "scratch"
"""

SBATCH = """#!/bin/sh
# Like Slurm's: --test-only checks a script; otherwise the job starts at once, in its own session.
if [ "$1" = --test-only ]; then
    cp "$2" "$FAKE_SLURM/tested.sh"
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


def install(folder, monkeypatch):
    """Put the commands into the search path; returns the folder where each job has a folder of its number."""
    if os.name != "posix" or shutil.which("setsid") is None:
        pytest.skip("the scripts need Linux")
    programs, jobs = folder / "bin", folder / "slurm"
    programs.mkdir()
    jobs.mkdir()
    for name, text in (("sbatch", SBATCH), ("scancel", SCANCEL), ("squeue", SQUEUE)):
        (programs / name).write_text(text)
        (programs / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{programs}:{os.environ['PATH']}")
    monkeypatch.setenv("FAKE_SLURM", str(jobs))
    monkeypatch.setenv("PYTHONPATH", PYTHONPATH)
    return jobs
