"""Builds that do not fit into memory are refused before anything is written, in one sentence."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from stand_in import PYTHONPATH, StandIn

from pepperscene.building.execution.executor import MAX_LOSSES_ALONE
from pepperscene.building.execution.job import BuildJob, BuildOptions
from pepperscene.building.execution.memory import (
    MEMORY,
    format_size,
    group_limits,
    memory_limits,
    report_memory_errors,
)
from pepperscene.building.execution.memory_check import check_memory, check_worker_memory
from pepperscene.building.scenes.plant_export import export_plant
from pepperscene.errors import ArgumentError, InputError, SetupError, WorkerError
from pepperscene.recipe.resolve.load import resolve_recipe


class CrashingRenderer(StandIn):
    """Ends its process by the signal `KILL_SIGNAL`."""

    def render(self, *_args, **_kwargs):
        os.kill(os.getpid(), int(os.environ["KILL_SIGNAL"]))


LIMITED = pytest.mark.skipif(sys.platform != "linux", reason="needs `ulimit -v`")


@pytest.fixture
def sensor_file(tmp_path):
    """Writes a sensor with other numbers of pixels and the same field of view."""
    shipped = Path(__file__).parents[2] / "materials" / "sensors"

    def write(columns, rows):
        text = (shipped / "ueye_ui5250re.toml").read_text(encoding="utf-8")
        for old, new in {
            "columns = 800": f"columns = {columns}",
            "rows = 600": f"rows = {rows}",
            "binning = 2": "binning = 1",
            "pitch_um = 4.5": f"pitch_um = {2 * 4.5 * 800 / columns}",
            '"spectra/': f'"{shipped}/spectra/',
        }.items():
            text = text.replace(old, new)
        path = tmp_path / "sensor.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def pepperscene(*arguments, ulimit_kb=None, **environment):
    """The finished process of a command."""
    limit = [] if ulimit_kb is None else ["sh", "-c", f'ulimit -v {ulimit_kb}; exec "$0" "$@"']
    return subprocess.run(
        [*limit, sys.executable, "-m", "pepperscene", *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": PYTHONPATH, **environment},
        capture_output=True,
        text=True,
        timeout=120,
    )


def is_refused(process):
    """Whether a command ended with one sentence and exit code 2."""
    lines = process.stderr.strip().splitlines()
    return process.returncode == 2 and len(lines) == 1 and lines[0].startswith("error: ")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("size", "outputs", "workers"),
    [
        ((12000, 9000), "colour", ()),
        ((12000, 9000), "colour", ("--workers", "1")),
        ((20000, 20000), "class,instance,distance", ()),
    ],
)
def test_huge_images_are_refused_in_one_sentence(sensor_file, tmp_path, size, outputs, workers):
    change = f"camera.sensor={sensor_file(*size)}"
    process = pepperscene(
        *("build", "demo", "--out", tmp_path / "set", "--frames", "0:2", "--outputs", outputs),
        *("--set", change, *workers),
        **{MEMORY: "6 GB"},
    )
    assert is_refused(process), process.stderr
    assert f"{size[0]} x {size[1]} pixels" in process.stderr
    assert "6.0 GB are allowed by PEPPERSCENE_MEMORY" in process.stderr
    assert not (tmp_path / "set").exists()


@LIMITED
@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "outputs", "ulimit_kb"), [("build", "class", 700_000), ("render", "colour", 1_000_000)]
)
def test_too_small_an_address_space_is_refused_before_rendering(tmp_path, command, outputs, ulimit_kb):
    # More would be reserved by the threads of a machine with many cores.
    threads = dict.fromkeys(("PEPPERSCENE_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), "2")
    process = pepperscene(
        command, "demo", "--out", tmp_path / "set", "--outputs", outputs, ulimit_kb=ulimit_kb, **threads
    )
    assert is_refused(process), process.stderr
    assert f"{ulimit_kb * 1024 / 1e9:.1f} GB are allowed by `ulimit -v`" in process.stderr
    assert not (tmp_path / "set").exists()


def job(tmp_path, changes=None, outputs=("colour",), **options):
    resolved = resolve_recipe("barth2018", changes or {})
    return BuildJob.create(resolved, tmp_path / "set", outputs, BuildOptions(**options))


def test_the_number_of_workers_that_fit_is_given(tmp_path, monkeypatch):
    # A worker takes 1.5 GB.
    monkeypatch.setenv(MEMORY, "3.4 GB")
    with pytest.raises(ArgumentError, match=r"8 need about .* GB each, and 3\.4 GB .* use at most 2"):
        check_memory(job(tmp_path), 8, 8)
    check_memory(job(tmp_path), 2, 8)
    # More workers than frames are never started.
    check_memory(job(tmp_path), 8, 2)


def test_a_worker_of_a_cluster_checks_what_it_is_allowed(tmp_path, monkeypatch):
    monkeypatch.delenv(MEMORY, raising=False)
    with pytest.raises(SetupError, match=r"0\.5 GB are allowed for this worker"):
        check_worker_memory(job(tmp_path), 500_000_000)


def test_many_plants_and_far_rows_are_refused(tmp_path, monkeypatch):
    monkeypatch.setenv(MEMORY, "2 GB")
    check_memory(job(tmp_path, outputs=("class",)))
    with pytest.raises(SetupError, match="100 plants"):
        check_memory(job(tmp_path, {"row.plants_front": 50, "row.plants_back": 50}, outputs=("class",)))


def test_a_fine_plant_is_refused_before_it_grows(tmp_path, monkeypatch):
    monkeypatch.setenv(MEMORY, "2 GB")
    with pytest.raises(SetupError, match=r"a plant of detail 8 needs about .* GB"):
        export_plant("tomato", tmp_path / "plant.glb", detail=8.0, picture=False)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("text", ["off", " OFF "])
def test_the_check_can_be_switched_off(tmp_path, monkeypatch, text):
    monkeypatch.setenv(MEMORY, text)
    assert memory_limits() == ()
    camera = job(tmp_path).recipe.camera
    huge = replace(camera, sensor=replace(camera.sensor, columns=20000, rows=20000, pitch_m=1e-7))
    small = job(tmp_path)
    check_memory(replace(small, recipe=replace(small.recipe, camera=huge)))


@pytest.mark.parametrize(
    ("text", "size"), [("40 GB", 40e9), ("512M", 512e6), ("1.5 GiB", 1.5 * 2**30), ("1000", 1000)]
)
def test_the_memory_can_be_given(monkeypatch, text, size):
    monkeypatch.setenv(MEMORY, text)
    assert [limit.size for limit in memory_limits()] == [int(size)]


@pytest.mark.parametrize("text", ["much", "40 XB", "-1", "0", "1e9", "9" * 400, "nan"])
def test_other_texts_are_errors(monkeypatch, text):
    monkeypatch.setenv(MEMORY, text)
    with pytest.raises(InputError, match="must be a size"):
        memory_limits()


def write_groups(folder, kind, groups, path, root="/"):
    """A process and its control groups: limit, usage and cached files by the group's path."""
    mount, names = (
        folder / "mount",
        {"cgroup2": ("max", "current"), "cgroup": ("limit_in_bytes", "usage_in_bytes")},
    )
    for name, (limit, usage, cached) in groups.items():
        group = mount / name
        group.mkdir(parents=True, exist_ok=True)
        prefix = "total_" if kind == "cgroup" else ""
        for file, value in zip(names[kind], (limit, usage), strict=True):
            (group / f"memory.{file}").write_text(f"{value}\n")
        (group / "memory.stat").write_text(f"anon 5\n{prefix}inactive_file {cached}\n{prefix}active_file 0\n")
    proc = folder / "proc"
    proc.mkdir()
    controllers = "memory" if kind == "cgroup" else ""
    (proc / "cgroup").write_text(f"7:cpu:/other\n4:{controllers}:{path}\n")
    options = "rw,memory" if kind == "cgroup" else "rw"
    (proc / "mountinfo").write_text(f"35 31 0:32 {root} {mount} rw - {kind} cgroup {options}\n")
    return [limit.size for limit in group_limits(proc)]


NONE = {"cgroup2": "max", "cgroup": 2**63 - 4096}


@pytest.mark.parametrize("kind", NONE)
def test_limits_of_control_groups_and_their_parents_are_found(tmp_path, kind):
    groups = {"": (NONE[kind], 9, 0), "job": (8_000, 3_000, 1_000), "job/step": (NONE[kind], 3_000, 0)}
    assert write_groups(tmp_path, kind, groups, "/job/step") == [6_000]


@pytest.mark.parametrize("kind", NONE)
def test_the_limit_of_a_container_is_found_under_its_path_on_the_host(tmp_path, kind):
    groups = {"": (5_000, 6_000, 0)}
    assert write_groups(tmp_path, kind, groups, "/docker/one", root="/docker/one") == [0]


def test_a_process_without_control_groups_has_no_such_limit(tmp_path):
    assert group_limits(tmp_path / "missing") == ()


@pytest.mark.parametrize(
    "error", [MemoryError(), RuntimeError("jit_malloc(): out of memory!"), RuntimeError("std::bad_alloc")]
)
def test_missing_memory_is_an_error_in_one_sentence(error):
    with pytest.raises(SetupError, match="memory ran out"), report_memory_errors():
        raise error


def test_other_errors_are_passed_on():
    with pytest.raises(RuntimeError, match="defect"), report_memory_errors():
        raise RuntimeError("defect")


def test_sizes_have_a_unit():
    assert [format_size(size) for size in (1.24e9, 123.4e9)] == ["1.2 GB", "123 GB"]


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="needs signals")
@pytest.mark.parametrize("name", ["SIGKILL", "SIGSEGV"])
def test_a_frame_that_kills_the_only_worker_ends_the_build(build_small, monkeypatch, name):
    monkeypatch.setenv("KILL_SIGNAL", str(getattr(signal, name).value))
    notices = []
    with pytest.raises(WorkerError, match=f"frame 000000 ended {MAX_LOSSES_ALONE} workers.*killed by {name}"):
        build_small(renderer=CrashingRenderer, workers=1, frames="0:2", on_notice=notices.append)
    assert len(notices) == MAX_LOSSES_ALONE - 1
