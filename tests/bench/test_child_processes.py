"""Child processes that time frames by stage, and the tables of their measurements."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from pepperscene.bench import SCENES, measure_scaling, profile_frames
from pepperscene.bench.frames_child import FramesTask, subdivide_mesh
from pepperscene.bench.profile import run_child, run_children
from pepperscene.bench.scaling import fit_slope
from pepperscene.cultivar import load_cultivar
from pepperscene.errors import SetupError
from pepperscene.geometry import mesh_plant
from pepperscene.grammar import grow

SMALL = FramesTask(
    "barth2018",
    {"row.plants_front": 1, "row.plants_back": 0, "cultivar": "kaite_february"},
    index=125,
    size=(32, 24),
    frames=2,
    quality="draft",
)


@pytest.fixture(scope="module")
def measured():
    return run_child(SMALL)


@pytest.mark.long
def test_every_stage_is_timed_and_stages_are_disjoint_and_nearly_complete(measured):
    assert set(measured["scene"]) == {
        "import", "start Mitsuba", "plants", "place row and resolve contacts", "cull hidden geometry",
        "surfaces and sky", "kernel scene",
    }  # fmt: skip
    assert set(measured["plants"]) == {"grow", "mesh", "twine", "resolve contacts"}
    stages = {"trace", "denoise", "develop", "labels", "encode"}
    assert [set(frame) for frame in measured["frames"]] == [stages] * 3
    assert (measured["size"], len(measured["peaks_mib"])) == ([32, 24], 3)
    frames = [seconds for frame in measured["frames"] for seconds in frame.values()]
    times = [*measured["scene"].values(), *frames]
    assert min(times) >= 0.0
    assert 0.5 * measured["whole_s"] < sum(times) < measured["whole_s"]
    # One process makes a single plant, and its stages are most of the time for plants.
    plants = measured["scene"]["plants"]
    assert 0.5 * plants < sum(measured["plants"].values()) <= plants
    assert sorted(measured["peaks_mib"]) == measured["peaks_mib"]


def test_failure_of_a_process_is_reported():
    with pytest.raises(SetupError, match="nothing_like_it"):
        run_children([replace(SMALL, recipe="nothing_like_it")])


def test_subdivision_does_not_change_the_surface():
    mesh = mesh_plant(grow(load_cultivar("kaite_february"), np.random.default_rng(0)), 0.3)
    fine = subdivide_mesh(mesh)
    assert len(fine.faces) == 4 * len(mesh.faces)
    before, after = (trimesh.Trimesh(one.vertices, one.faces, process=False) for one in (mesh, fine))
    assert after.area == pytest.approx(before.area, rel=1e-5)
    np.testing.assert_allclose(after.bounds, before.bounds, atol=1e-7)
    # Each part has the orientation, organ and surface of its triangle.
    for name in ("face_instance", "face_surface"):
        np.testing.assert_array_equal(getattr(fine, name), np.repeat(getattr(mesh, name), 4))
    large = before.area_faces > 1e-9
    normals, parts = before.face_normals[large], after.face_normals.reshape(-1, 4, 3)[large]
    assert (normals[:, None] * parts).sum(axis=-1).min() > 0.99
    assert fine.vertex_runs.order is None
    np.testing.assert_allclose(np.linalg.norm(fine.normals, axis=1), 1.0, atol=1e-4)
    for name in ("vertices", "normals", "uv", "state"):
        assert getattr(fine, name).dtype == getattr(mesh, name).dtype
        assert len(getattr(fine, name)) == len(fine.vertices)


@pytest.fixture
def simulated_children(monkeypatch):
    """Child processes that report fixed times; returns the list of their tasks."""
    tasks = []
    frame = {"trace": 1.0, "denoise": 0.1, "develop": 0.05, "labels": 0.02, "encode": 0.03}

    def run_simulated(group, environment=None):
        tasks.extend(group)
        return [
            {
                "scene": {"import": 0.2, "start Mitsuba": 0.1, "plants": 1.0, "kernel scene": 0.5},
                "plants": {"grow": 0.4, "mesh": 0.5},
                "frames": [{**frame, "trace": 3.0}] + [frame] * task.frames,
                "peaks_mib": [100.0] * (task.frames + 1),
                "triangles": 1000 * 4**task.divided,
                "size": [32, 24],
                "variant": "simulated",
            }
            for task in group
        ]

    monkeypatch.setattr("pepperscene.bench.profile.run_children", run_simulated)
    monkeypatch.setattr("pepperscene.bench.scaling.run_children", run_simulated)
    monkeypatch.setattr("pepperscene.bench.profile.time_command", lambda command: 0.01)
    return tasks


def test_profile_has_the_times_of_all_stages(tmp_path, simulated_children):
    result = profile_frames(tmp_path, [SCENES["near"]], (32, 24), runs=2, quick=True)
    assert [path.name for path in result.files] == ["profile.json", "profile.md"]
    # The additional tracing time of the first frame is for its kernels.
    assert "| first frame, in addition to a next one: trace | 2,000 ms |" in result.markdown
    assert "| new scene: total, without import and start | 3,500 ms |" in result.markdown
    assert "| next frames: total | 1,200 ms | 1,200 ms | 1,200 ms | 4 |" in result.markdown
    assert "| all plants in one process: grow | 400 ms |" in result.markdown
    assert {task.quality for task in simulated_children} == {"draft"}


def test_slopes_of_power_laws():
    plants = [{"plants": count, "frame_s": 0.3 * count**0.7} for count in (1, 3, 7, 13)]
    assert fit_slope(plants, "plants") == pytest.approx(0.7)
    pixels = [{"pixels": f"{4 * n}x{3 * n}", "frame_s": 2.0 * (12 * n * n) ** 0.93} for n in (1, 2, 4)]
    assert fit_slope(pixels, "pixels") == pytest.approx(0.93)


def test_scaling_has_one_table_for_each_quantity(tmp_path, simulated_children):
    result = measure_scaling(tmp_path, [SCENES["near"]], (32, 24), runs=2, quick=True)
    tables = json.loads((tmp_path / "scaling.json").read_text())["scenes"]["near"]
    assert set(tables) == {"plants", "triangles", "pixels", "frames", "workers"}
    # Eight frames of 1.2 s, the first 2 s longer, and a scene of 1.8 s.
    assert tables["frames"][-1]["together_s"] == pytest.approx(8 * 1.2 + 2.0 + 1.8)
    assert tables["workers"][1]["frames_per_s"] == pytest.approx(2 / 1.2)
    assert [row["pixels"] for row in tables["pixels"]] == ["8x6", "16x12", "32x24"]
    # All frames take the same time.
    assert result.markdown.count("The time of a frame grows as ") == 3
    slopes = json.loads((tmp_path / "scaling.json").read_text())["slopes"]["near"]
    for quantity in ("plants", "triangles", "pixels"):
        assert f"The time of a frame grows as {quantity}^0.00." in result.markdown
        assert slopes[quantity] == pytest.approx(0.0, abs=1e-12)
    for block in result.markdown.split("\n\n"):
        assert len({line.count("|") for line in block.splitlines()}) == 1
