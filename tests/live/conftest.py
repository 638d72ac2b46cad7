"""A small scene that is opened once for all tests of a module; each edits a copy."""

from __future__ import annotations

from pathlib import Path

import pytest
import row_cache

import pepperscene as ps

SMALL = {
    "plan.sets": 1, "plan.rotations": 1, "plan.frames": 3, "row.plants_front": 1, "row.plants_back": 1,
    "camera.width": 96, "camera.height": 72, "camera.baseline_mm": 60,
}  # fmt: skip


@pytest.fixture(scope="session")
def small_recipe() -> ps.Recipe:
    return ps.load_recipe("barth2018", SMALL)


@pytest.fixture(scope="session")
def opened(small_recipe: ps.Recipe, rows: Path) -> ps.LiveScene:
    with row_cache.rows_from(rows):
        return ps.open_scene(small_recipe, 1)


@pytest.fixture
def scene(opened: ps.LiveScene) -> ps.LiveScene:
    return opened.copy()
