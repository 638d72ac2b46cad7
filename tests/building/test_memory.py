"""Frames and plants that cannot fit into memory are refused in one sentence, before anything is computed."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from stand_in import PYTHONPATH, StandIn

from pepperscene.building.execution.executor import MAX_LOSSES_ALONE
from pepperscene.building.execution.job import BuildJob, BuildOptions
from pepperscene.building.memory import (
    MEMORY,
    check_fits,
    control_group_limits,
    frame_memory,
    memory_limits,
    report_memory_errors,
)
from pepperscene.building.scenes.plant_export import export_plant
from pepperscene.building.scenes.plants import grow_plant
from pepperscene.building.scenes.scene_builder import SceneBuilder
from pepperscene.errors import ArgumentError, InputError, SetupError, WorkerError
from pepperscene.geometry import mesh_plant
from pepperscene.geometry.triangle_counts import max_triangles
from pepperscene.grammar import build_plant, draw_parameters
from pepperscene.outputs import DEFAULT_OUTPUTS, OUTPUTS
from pepperscene.recipe.resolve.load import resolve_recipe

SMALL = {"row.plants_front": 1, "row.plants_back": 0}


class CrashingRenderer(StandIn):
    """Ends its process by the signal `KILL_SIGNAL`."""

    def render(self, *_args, **_kwargs):
        os.kill(os.getpid(), int(os.environ["KILL_SIGNAL"]))


def make_job(tmp_path, changes=None, outputs=("colour",)):
    return BuildJob.create(
        resolve_recipe("barth2018", changes or {}), tmp_path / "set", outputs, BuildOptions()
    )


def resized(camera, columns, rows, **changes):
    """The camera with other numbers of pixels and the same field of view."""
    sensor = replace(camera.sensor, columns=columns, rows=rows, **changes)
    pitch_m = sensor.pitch_m * camera.sensor.columns / columns * camera.sensor.binning / sensor.binning
    return replace(camera, sensor=replace(sensor, pitch_m=pitch_m))


# The bound.


@pytest.fixture(scope="module")
def camera():
    return resolve_recipe("barth2018").camera


def test_memory_grows_with_the_image(camera):
    # Images that are computed as a whole, and those that are computed in strips, which can take less.
    for sizes in ([(400, 300), (800, 600), (1600, 1200)], [(3840, 2160), (6000, 4000), (12000, 9000)]):
        cameras = [resized(camera, *size) for size in sizes]
        for output in OUTPUTS:
            needed = [frame_memory(one, [output], 2_000_000) for one in cameras]
            assert needed == sorted(set(needed)) or not OUTPUTS[output].is_image, output


# Peaks of processes that rendered a frame of `demo` or `barth2018`.
@pytest.mark.parametrize(
    ("size", "outputs", "measured_mb"),
    [
        ((1600, 1200), ("colour",), 2711),
        ((3840, 2160), DEFAULT_OUTPUTS, 1799),
        ((6000, 4000), DEFAULT_OUTPUTS, 2176),
        ((6000, 4000), DEFAULT_OUTPUTS[1:], 1226),
        ((3840, 2160), ("normal", "position", "depth_z"), 1278),
        ((3840, 2160), ("flow",), 1010),
    ],
)
def test_bound_is_near_measured_peaks(camera, size, outputs, measured_mb):
    binning = {} if size == (1600, 1200) else {"binning": 1}
    bound = frame_memory(resized(camera, *size, **binning), outputs, 2_300_000)
    assert 0.9 <= bound / (measured_mb * 1e6) <= 1.6


def test_memory_grows_with_triangles_photosites_channels_and_disparities(camera):
    traced = frame_memory(camera, ["colour"], 1_000_000)
    assert frame_memory(camera, ["colour"], 2_000_000) - traced == pytest.approx(200e6)
    finer = resized(camera, 800, 600, binning=16)
    assert frame_memory(finer, ["raw"], 0) > frame_memory(camera, ["raw"], 0) + 4 * 480_000 * (256 - 4)
    bands = resolve_recipe("line_scanner").camera
    assert frame_memory(bands, ["reflectance"], 0) > 2 * frame_memory(bands, ["class"], 0)
    whole = frame_memory(resized(camera, 6000, 4000), ["colour"], 0, in_strips=False)
    assert whole > frame_memory(resized(camera, 6000, 4000), ["colour"], 0) + 10e9
    depth = resolve_recipe("realsense_depth")
    without = frame_memory(depth.camera, ["depth_sensor"], 0)
    matching = frame_memory(depth.camera, ["depth_sensor"], 0, depth.depth_camera) - without
    assert matching > 4 * 1280 * 720 * depth.depth_camera.matching.disparities


def test_far_rows_and_plants_are_counted():
    def triangles(name, **changes):
        resolved = resolve_recipe(name, {f"greenhouse.{key}": value for key, value in changes.items()})
        return SceneBuilder(resolved.recipe, resolved.cultivar, 1).estimate_triangles()

    few, more = triangles("greenhouse"), triangles("greenhouse", far_rows=5, far_reach_mm=20000.0)
    assert more > 3 * few
    single = resolve_recipe("barth2018", SMALL)
    alone = SceneBuilder(single.recipe, single.cultivar, 1).estimate_triangles()
    assert triangles("barth2018") == 13 * alone


# Limits and sentences.


def test_the_number_of_workers_that_fit_is_given(tmp_path, monkeypatch):
    monkeypatch.setenv(MEMORY, "3.4 GB")
    job = make_job(tmp_path)
    with pytest.raises(ArgumentError, match=r"8 need about .* GB each, and 3\.4 GB .* use at most 2"):
        job.check_memory(8)
    job.check_memory(2)
    with pytest.raises(SetupError, match=r"100 plants with the outputs class needs about .* use a smaller"):
        make_job(tmp_path, {"row.plants_front": 50, "row.plants_back": 50}, outputs=("class",)).check_memory()


def test_what_does_not_fit_writes_nothing(build_small, tmp_path, monkeypatch):
    monkeypatch.setenv(MEMORY, "100 MB")
    with pytest.raises(SetupError, match=r"0\.1 GB are allowed by PEPPERSCENE_MEMORY"):
        build_small(renderer=None)
    monkeypatch.setenv(MEMORY, "2 GB")
    with pytest.raises(SetupError, match=r"a plant of detail 8 needs about .* GB"):
        export_plant("tomato", tmp_path / "plant.glb", detail=8.0, picture=False)
    assert list(tmp_path.iterdir()) == []


def test_the_memory_can_be_given(monkeypatch):
    for text, size in (("40 GB", 40e9), ("512M", 512e6), ("1.5 GiB", 1.5 * 2**30), ("1000", 1000)):
        monkeypatch.setenv(MEMORY, text)
        assert [limit.size for limit in memory_limits()] == [size]
    monkeypatch.setenv(MEMORY, " OFF ")
    check_fits(1e18, "everything", "less")
    for text in ("much", "40 XB", "-1", "0", "1e9", "9" * 400, "nan"):
        monkeypatch.setenv(MEMORY, text)
        with pytest.raises(InputError, match="must be a size"):
            memory_limits()


def test_limits_of_the_machine_and_of_the_address_space(monkeypatch):
    monkeypatch.delenv(MEMORY, raising=False)
    monkeypatch.setattr(resource, "getrlimit", lambda _: (3e9, 3e9))
    limits = {limit.reason: limit for limit in memory_limits()}
    assert limits["left by `ulimit -v`"].size == 2e9
    assert not limits["left by `ulimit -v`"].is_shared
    assert limits["available on this machine"].size > 0


@pytest.mark.parametrize(
    ("line", "name", "none"),
    [
        ("0::/job/step", "memory.max", "max"),
        ("4:cpu,memory:/job/step", "memory/memory.limit_in_bytes", 2**63 - 4096),
    ],
)
def test_limits_of_control_groups_and_their_parents_are_found(tmp_path, line, name, none):
    root, file = (tmp_path / name).parent, (tmp_path / name).name
    (root / "job" / "step").mkdir(parents=True)
    for folder, value in {root: 9_000, root / "job": 8_000, root / "job" / "step": none}.items():
        (folder / file).write_text(f"{value}\n")
    groups = tmp_path / "cgroup"
    groups.write_text(f"7:cpu:/other\n{line}\n")
    assert [limit.size for limit in control_group_limits(groups, tmp_path)] == [8_000, 9_000]
    # In a container the path is that of the host.
    groups.write_text(line.replace("job/step", "docker/one"))
    assert [limit.size for limit in control_group_limits(groups, tmp_path)] == [9_000]
    assert control_group_limits(tmp_path / "missing") == []


@pytest.mark.parametrize(
    "error", [MemoryError(), RuntimeError("jit_malloc(): out of memory!"), RuntimeError("std::bad_alloc")]
)
def test_missing_memory_is_an_error_in_one_sentence(error):
    with pytest.raises(SetupError, match="memory ran out"), report_memory_errors():
        raise error
    with pytest.raises(RuntimeError, match="defect"), report_memory_errors():
        raise RuntimeError("defect")


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="needs signals")
@pytest.mark.parametrize("name", ["SIGKILL", pytest.param("SIGSEGV", marks=pytest.mark.long)])
def test_a_frame_that_kills_the_only_worker_ends_the_build(build_small, monkeypatch, name):
    monkeypatch.setenv("KILL_SIGNAL", str(getattr(signal, name).value))
    notices = []
    with pytest.raises(WorkerError, match=f"frame 000000 ended {MAX_LOSSES_ALONE} workers.*killed by {name}"):
        build_small(renderer=CrashingRenderer, workers=1, frames="0:2", on_notice=notices.append)
    assert len(notices) == MAX_LOSSES_ALONE - 1


# Plants, whatever multiplies.


def bearing(kind, positions, count="twelve", **keys):
    """The changes of a recipe whose petioles bear organs of a kind, `count` at each of some positions."""
    slot = {
        "name": "many",
        "what": {kind: 1.0, "chosen": "a test"},
        "count": {count: 1.0, "chosen": "a test"},
    }
    slot |= {"at": np.linspace(0, 1, positions).tolist(), "spread": {"value_deg": 20.0, "chosen": "a test"}}
    return {"override": {"organs": {"petiole": {"bears": [slot | keys]}}}}


def shape(**values):
    """The changes of a recipe whose laminae have some plain numbers."""
    chosen = {name: {"value": number, "chosen": "a test"} for name, number in values.items()}
    return {"override": {"organs": {"lamina": chosen}}}


@pytest.mark.parametrize(
    "changes",
    [bearing("lamina", 100), bearing("pedicel", 50), shape(lobes=100_000.0, lobe_depth=0.2)],
    ids=["laminae on stalks", "stalks on stalks", "lobes"],
)
def test_a_build_is_refused_by_the_size_of_its_plants(changes, tmp_path, monkeypatch):
    monkeypatch.setenv(MEMORY, "1 GB")
    resolved = resolve_recipe("demo", {**SMALL, **changes})
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(SetupError, match=r"demo: a frame of .* needs about .* GB of memory, and 1\.0 GB"):
        BuildJob.create(resolved, tmp_path / "set", ("class",), BuildOptions()).check_memory()
    # So is a scene that is built without such a check, and a single plant.
    with pytest.raises(SetupError, match=r"a plant of .* organs and up to .* triangles needs about"):
        SceneBuilder(resolved.recipe, resolved.cultivar, processes=1).scene(0, 0)
    with pytest.raises(SetupError, match="let its organs bear fewer"):
        grow_plant(resolved.cultivar, 1)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 400_000


def test_items_are_counted_before_they_are_drawn():
    # Most of them become nothing.
    changes = bearing("lamina", 30_000)
    slot = changes["override"]["organs"]["petiole"]["bears"][0]
    slot["what"] = {"lamina": 0.001, "none": 0.999, "chosen": "a test"}
    cultivar = resolve_recipe("demo", {**SMALL, **changes}).cultivar
    with pytest.raises(InputError, match=r"organs\.petiole\.bears\.\d: draws up to .* organs .* 2,000,000"):
        draw_parameters(cultivar, np.random.default_rng(1))


TEETH = {"override": {"organs": {"lamina": {"palmate": True, "teeth": {"value": 400.0, "chosen": "a test"}}}}}


@pytest.mark.parametrize(
    ("changes", "seed", "detail", "factor"),
    [
        ({}, 5, 0.3, np.inf),
        ({"cultivar": "tomato"}, 5, 1.0, 1.3),
        ({"cultivar": "eggplant"}, 5, 2.2, 1.3),
        pytest.param(bearing("lamina", 5), 2, 1.0, 1.4, marks=pytest.mark.long),
        (bearing("pedicel", 3), 2, 1.0, 1.4),
        (bearing("fruit", 2, "two"), 2, 1.0, 1.4),
        (shape(lobes=40.0, lobe_depth=0.2), 2, 1.0, 1.4),
        (TEETH, 2, 1.0, 1.4),
    ],
    ids=["kaite", "tomato", "eggplant", "laminae", "stalks", "fruit", "lobes", "teeth"],
)
def test_the_bound_of_triangles_holds_and_is_close(changes, seed, detail, factor):
    cultivar = resolve_recipe("demo", changes).cultivar
    parameters = draw_parameters(cultivar, np.random.default_rng(seed))
    triangles = len(mesh_plant(build_plant(parameters), detail).faces)
    assert triangles <= max_triangles(parameters, detail) <= factor * triangles


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="needs `ulimit -v`")
def test_too_small_an_address_space_is_refused_before_rendering(tmp_path):
    out = str(tmp_path / "set")
    for limit_kb, *words in ((1_200_000, "build", "class"), (1_800_000, "render", "colour")):
        command = (
            f'ulimit -v {limit_kb}; exec "$0" -m pepperscene {words[0]} demo --outputs {words[1]} --out "$1"'
        )
        process = subprocess.run(
            ["sh", "-c", command, sys.executable, out],
            env={**os.environ, "PYTHONPATH": PYTHONPATH}, capture_output=True, text=True, timeout=120,
        )  # fmt: skip
        assert process.returncode == 2, process.stderr
        assert process.stderr.startswith("error: demo: a frame of")
        assert process.stderr.count("\n") == 1
        assert "left by `ulimit -v`" in process.stderr
        assert not (tmp_path / "set").exists()
