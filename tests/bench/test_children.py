"""Processes that time frames by stage, and the tables made of what they find."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from pepperscene.bench import SCENES, measure_scaling, profile_frames
from pepperscene.bench.frames_child import Asked, quartered
from pepperscene.bench.profile import in_child, in_children
from pepperscene.cultivar import load_cultivar
from pepperscene.errors import SetupError
from pepperscene.geometry import mesh_plant
from pepperscene.grammar import grow

SMALL = Asked(
    "barth2018",
    {"row.plants_front": 1, "row.plants_back": 0, "cultivar": "kaite_february"},
    index=125,
    size=(32, 24),
    frames=2,
    quality="draft",
)


@pytest.fixture(scope="module")
def found():
    return in_child(SMALL)


def test_every_stage_is_told(found):
    assert set(found["scene"]) == {
        "import", "start Mitsuba", "plants", "place and settle row", "leave out what is not seen",
        "surfaces and sky", "kernel scene",
    }  # fmt: skip
    assert set(found["plants"]) == {"grow", "mesh", "twine", "settle plants"}
    assert [set(one) for one in found["frames"]] == [{"trace", "denoise", "develop", "labels", "encode"}] * 3
    assert (found["size"], len(found["peaks_mib"])) == ([32, 24], 3)


def test_stages_neither_overlap_nor_leave_much_out(found):
    stages = [*found["scene"].values(), *(seconds for one in found["frames"] for seconds in one.values())]
    assert min(stages) >= 0.0
    # What they add up to lies within the process's own clock.
    assert 0.5 * found["whole_s"] < sum(stages) < found["whole_s"]
    # One process makes a single plant; its steps fill the making of it.
    assert 0.5 * found["scene"]["plants"] < sum(found["plants"].values()) <= found["scene"]["plants"]
    assert sorted(found["peaks_mib"]) == found["peaks_mib"]


def test_labels_alone_trace_no_light():
    labels = in_child(replace(SMALL, outputs=("class",), encode=False))
    assert "kernel scene" not in labels["scene"]
    assert [set(one) for one in labels["frames"]] == [{"labels"}] * 3


def test_a_process_that_fails_is_told_in_one_sentence():
    with pytest.raises(SetupError, match="nothing_like_it"):
        in_children([replace(SMALL, recipe="nothing_like_it")])


def test_four_times_the_triangles_are_the_same_body():
    mesh = mesh_plant(grow(load_cultivar("kaite_february"), np.random.default_rng(0)), 0.3)
    finer = quartered(mesh)
    assert len(finer.faces) == 4 * len(mesh.faces)
    bodies = [trimesh.Trimesh(one.vertices, one.faces, process=False) for one in (mesh, finer)]
    assert bodies[1].area == pytest.approx(bodies[0].area, rel=1e-5)
    np.testing.assert_allclose(bodies[1].bounds, bodies[0].bounds, atol=1e-7)
    # Each part faces as its whole does, and belongs to the same organ and surface.
    for name in ("face_instance", "face_surface"):
        np.testing.assert_array_equal(getattr(finer, name), np.repeat(getattr(mesh, name), 4))
    large = bodies[0].area_faces > 1e-9
    whole, parts = bodies[0].face_normals[large], bodies[1].face_normals.reshape(-1, 4, 3)[large]
    assert (whole[:, None] * parts).sum(axis=-1).min() > 0.99
    np.testing.assert_array_equal(finer.instance_vertices[:, 0] == 0, mesh.instance_vertices[:, 0] == 0)
    np.testing.assert_allclose(np.linalg.norm(finer.normals, axis=1), 1.0, atol=1e-4)


def test_profile_and_scaling_fill_their_tables(tmp_path, monkeypatch):
    scene = replace(SCENES["near"], changes={**SCENES["near"].changes, **SMALL.changes})
    asked = []

    def quickly(wanted, environment=None):
        asked.extend(wanted)
        return [
            {
                "scene": {"import": 0.2, "start Mitsuba": 0.1, "plants": 1.0, "kernel scene": 0.5},
                "plants": {"grow": 0.4, "mesh": 0.5},
                "frames": [{"trace": 3.0, "denoise": 0.1, "develop": 0.05, "labels": 0.02, "encode": 0.03}]
                + [{"trace": 1.0, "denoise": 0.1, "develop": 0.05, "labels": 0.02, "encode": 0.03}]
                * one.frames,
                "peaks_mib": [100.0] * (one.frames + 1),
                "triangles": 1000,
                "size": [32, 24],
                "variant": "made up",
            }
            for one in wanted
        ]

    monkeypatch.setattr("pepperscene.bench.profile.in_children", quickly)
    monkeypatch.setattr("pepperscene.bench.scaling.in_children", quickly)
    monkeypatch.setattr("pepperscene.bench.profile.seconds_of", lambda command: 0.01)

    done = profile_frames(tmp_path, [scene], (32, 24), runs=2, quick=True)
    assert [path.name for path in done.files] == ["profile.json", "profile.md"]
    # What the first frame's tracing takes longer than the next ones' is the kernels'.
    assert "| first frame, on top of a next one: trace | 2,000 ms |" in done.markdown
    assert "| new scene: all of that, without import and start | 3,500 ms |" in done.markdown
    assert "| next frames: all of it | 1,200 ms | 1,200 ms | 1,200 ms | 4 |" in done.markdown
    assert "| all plants in one process: grow | 400 ms |" in done.markdown
    assert {one.quality for one in asked} == {"draft"}

    done = measure_scaling(tmp_path, [scene], (32, 24), runs=2, quick=True)
    told = json.loads((tmp_path / "scaling.json").read_text())["scenes"]["near"]
    assert set(told) == {"plants", "triangles", "pixels", "frames", "workers"}
    # Eight frames of 1.2 s, the first 2 s longer, and a scene of 1.8 s.
    assert told["frames"][-1]["together_s"] == pytest.approx(8 * 1.2 + 2.0 + 1.8)
    assert told["workers"][1]["frames_per_s"] == pytest.approx(2 / 1.2)
    assert [row["pixels"] for row in told["pixels"]] == ["8x6", "16x12", "32x24"]
    for block in done.markdown.split("\n\n"):
        assert len({line.count("|") for line in block.splitlines()}) == 1
