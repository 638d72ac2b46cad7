"""Surfaces made by another process, beside the row of a scene."""

from __future__ import annotations

import dataclasses
import sys
from dataclasses import replace

import numpy as np
import pytest

from pepperscene.building.scenes import optics
from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.building.scenes.optics import SurfaceFactory, make_surfaces
from pepperscene.building.scenes.plants import MIN_SHARED_PLANTS, PROCESSES
from pepperscene.building.subprocess_rpc import FunctionWorker
from pepperscene.cultivar import load_cultivar

RANGE_NM = (500.0, 520.0)


@pytest.fixture(scope="module")
def kaite():
    return load_cultivar("kaite")


@pytest.fixture(scope="module")
def expected(kaite):
    return make_surfaces(kaite, *RANGE_NM)


def assert_equal(made, expected):
    assert list(made) == list(expected)
    for name, surface in made.items():
        for field in dataclasses.fields(surface):
            np.testing.assert_equal(getattr(surface, field.name), getattr(expected[name], field.name))


@pytest.mark.long
def test_without_a_working_process_they_are_made_here(kaite, expected, monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "executable", str(tmp_path / "missing"))
    with FunctionWorker() as worker:
        assert_equal(SurfaceFactory().surfaces(kaite, *RANGE_NM, worker), expected)


def test_another_process_makes_the_same_surfaces(kaite, expected, started):
    with FunctionWorker() as worker:
        assert_equal(SurfaceFactory().surfaces(kaite, *RANGE_NM, worker), expected)
    (process,) = started
    assert (process.returncode, process.stdin.closed, process.stdout.closed) == (0, True, True)


def test_surfaces_of_the_last_cultivar_are_kept(kaite, monkeypatch):
    calls = []
    monkeypatch.setattr(optics, "make_surfaces", lambda *key: calls.append(key) or {"leaf": len(calls)})
    factory, other = SurfaceFactory(), kaite.model_copy(update={"name": "another"})
    for cultivar, first_nm in (
        (kaite, 400.0),
        (kaite, 400.0),
        (kaite, 410.0),
        (other, 410.0),
        (kaite, 410.0),
    ):
        factory.surfaces(cultivar, first_nm, 700.0)
    assert [call[:2] for call in calls] == [(kaite, 400.0), (kaite, 410.0), (other, 410.0), (kaite, 410.0)]


@pytest.mark.long
@pytest.mark.parametrize(
    ("processes", "plants"), [("2", MIN_SHARED_PLANTS), ("1", MIN_SHARED_PLANTS), ("2", 1)]
)
def test_scenes_of_few_plants_or_one_process_start_none(processes, plants, recipe, monkeypatch):
    asked = []

    def surfaces(_self, _cultivar, _first_nm, _last_nm, worker, *_):
        asked.append(worker is not None)
        return {}

    monkeypatch.setenv(PROCESSES, processes)
    monkeypatch.setattr(SurfaceFactory, "surfaces", surfaces)
    monkeypatch.setattr("pepperscene.scene.assemble_scene", lambda *_args, **_kwargs: None)
    row = replace(recipe.row, plants_front=plants, plants_back=0)
    varied = recipe.model_copy(update={"row": row})
    FrameRenderer(varied).scene(varied.plan.frame(0))
    assert asked == [processes == "2" and plants > 1]


@pytest.mark.long
def test_one_process_makes_plants_and_surfaces_of_a_scene(recipe, started, monkeypatch):
    monkeypatch.setenv(PROCESSES, "2")
    row = replace(recipe.row, plants_front=MIN_SHARED_PLANTS, plants_back=0)
    varied = recipe.model_copy(update={"row": row})
    prepared = []
    assembled = FrameRenderer(varied).assemble(
        varied.plan.frame(0), prepare=lambda surfaces: prepared.extend(surface.name for surface in surfaces)
    )
    (process,) = started
    assert (process.returncode, process.stdin.closed, process.stdout.closed) == (0, True, True)
    assert {surface.name for surface in assembled.scene.surfaces} <= set(prepared)
    monkeypatch.setenv(PROCESSES, "1")
    alone = FrameRenderer(varied).assemble(varied.plan.frame(0))
    for name in ("vertices", "normals", "faces", "face_instance", "state"):
        expected = getattr(alone.scene.mesh, name)
        np.testing.assert_array_equal(getattr(assembled.scene.mesh, name), expected)
    pairs = zip(assembled.scene.surfaces, alone.scene.surfaces, strict=True)
    assert_equal(*({surface.name: surface for surface in side} for side in zip(*pairs, strict=True)))
