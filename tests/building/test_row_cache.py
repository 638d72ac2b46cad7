"""Grown rows in a folder: taken from there by another builder, never damaged, never code, within a limit."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path

import numpy as np
import pytest

import pepperscene as ps
from pepperscene.building.scenes import row_cache, scene_builder
from pepperscene.building.scenes.row_cache import RowCache
from pepperscene.building.scenes.scene_builder import SceneBuilder
from pepperscene.classes import OrganClass
from pepperscene.geometry import ContactCounts

CHANGES = {"row.plants_front": 1, "row.plants_back": 0, "cultivar": "kaite_february"}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(row_cache.CACHE, str(tmp_path / "rows"))
    return tmp_path / "rows"


def builder(**changes):
    recipe = ps.load_recipe("barth2018", CHANGES | changes)
    return SceneBuilder(recipe, ps.load_cultivar(recipe.cultivar))


def files(folder):
    return sorted(path.name for path in folder.glob("*"))


@pytest.fixture
def no_growth(monkeypatch):
    def refuse(*_):
        raise AssertionError("plants are grown")

    monkeypatch.setattr(scene_builder, "make_plants", refuse)


def assert_equal_rows(one, two):
    for name in ("vertices", "normals", "uv", "state", "faces", "face_instance", "face_appearance"):
        np.testing.assert_array_equal(getattr(one.mesh, name), getattr(two.mesh, name))
    assert one.mesh.instances == two.mesh.instances
    assert one.contacts == two.contacts
    for first, second in zip(one.skeleton.plants, two.skeleton.plants, strict=True):
        assert first.kinds == second.kinds
        for organ, other in zip(first.organs, second.organs, strict=True):
            np.testing.assert_array_equal(organ.curve, other.curve)


def test_another_builder_takes_a_row_from_the_folder(folder, request):
    grown = builder().scene(0, 0)
    before = files(folder)
    assert len(before) == 2
    request.getfixturevalue("no_growth")
    other = builder()
    assert_equal_rows(other.scene(0, 0), grown)
    assert len(other.plants(0)) == 1
    assert other.scene(0, 0).mesh.cultivars[0] is other.cultivar
    assert files(folder) == before


def test_a_stored_row_needs_no_plants(folder, monkeypatch):
    first = builder()
    row, leaf_area = first.scene(0, 0), first.leaf_area_index(0)
    assert leaf_area > 0.0

    def refuse(*_):
        raise AssertionError("plants are read")

    monkeypatch.setattr(SceneBuilder, "plants", refuse)
    other = builder()
    assert_equal_rows(other.scene(0, 0), row)
    assert other.leaf_area_index(0) == leaf_area


def test_the_work_of_a_row_is_shared_until_it_is_stored(folder):
    recipe = ps.load_recipe("barth2018", CHANGES | {"row.plants_front": scene_builder.MIN_SHARED_PLANTS})
    one = SceneBuilder(recipe, ps.load_cultivar(recipe.cultivar), processes=2)
    assert one.shares_work(0, 0)
    one.scene(0, 0)
    assert not one.shares_work(0, 0)
    assert one.shares_work(0, 1)


def test_values_of_all_kinds_are_stored(folder):
    cultivar = ps.load_cultivar("kaite_february")
    content = {
        "empty": ((), [], {}, np.empty((0, 3))),
        "mixed": [1, 2.5, None, True, "text", Path("a/b"), (1, (2, [3])), {"x": {}, "y": {"z": 1.5}}],
        "arrays": [np.arange(6).reshape(2, 3), np.float32([0.1]), np.array(4.0), np.array([True, False])],
        "classes": (OrganClass.STEM, OrganClass.LEAF, ContactCounts(1, 2, 3, 4), cultivar),
    }
    for _ in range(2):
        stored = RowCache(cultivar, (), (OrganClass, ContactCounts)).get(lambda: content, "kinds")
    assert stored is not content
    assert stored["classes"][3] is cultivar
    for name in ("mixed", "classes"):
        assert stored[name] == content[name]
        assert list(map(type, stored[name])) == list(map(type, content[name]))
    for got, given in zip(
        stored["arrays"] + [stored["empty"][3]], [*content["arrays"], content["empty"][3]], strict=True
    ):
        np.testing.assert_array_equal(got, given, strict=True)
        assert got.flags.writeable
    assert stored["empty"][:3] == content["empty"][:3]


@pytest.mark.parametrize("change", [{"seed": 7}, {"row.spacing_mm": 300}, {"cultivar": "kaite"}])
def test_rows_of_other_recipes_are_others(folder, no_growth, change):
    with pytest.raises(AssertionError, match="plants are grown"):
        builder(**change).scene(0, 0)


def test_no_rows_are_kept_where_that_is_switched_off(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv(row_cache.CACHE, "None")
    builder().scene(0, 0)
    assert files(tmp_path) == []
    monkeypatch.setenv(row_cache.CACHE, "")
    assert tmp_path in (row_cache.cache_folder() or tmp_path / "x").parents


@pytest.mark.parametrize("damage", ["cut", "changed", "empty"])
def test_damaged_files_are_replaced(folder, damage):
    grown = builder().scene(0, 0)
    whole = {path: path.read_bytes() for path in folder.glob("*")}
    for path, content in whole.items():
        half = len(content) // 2
        changed = content[:half] + bytes([content[half] ^ 1]) + content[half + 1 :]
        path.write_bytes({"cut": content[:half], "changed": changed, "empty": b""}[damage])
    assert_equal_rows(builder().scene(0, 0), grown)
    assert {path: path.read_bytes() for path in folder.glob("*")} == whole


@pytest.mark.parametrize(
    "content", [["subprocess.run", ["values", "true"]], ["arrays", "|O", [[1]]], ["Renderer", ["values", 1]]]
)
def test_files_hold_only_what_rows_consist_of(folder, content):
    grown = builder().scene(0, 0)
    text = json.dumps(content).encode()
    body = len(text).to_bytes(8, "little") + text + bytes(64)
    for path in folder.glob("*"):
        path.write_bytes(body + hashlib.blake2b(body, digest_size=32).digest())
    assert_equal_rows(builder().scene(0, 0), grown)


def test_the_oldest_files_go_first(folder, monkeypatch):
    builder().scene(0, 0)
    sizes = [path.stat().st_size for path in folder.glob("*")]
    for path in folder.glob("*"):
        os.utime(path, (1, 1))
    old = files(folder)
    monkeypatch.setattr(row_cache, "MOST_BYTES", int(1.5 * sum(sizes)))
    builder(seed=7).scene(0, 0)
    assert sum(path.stat().st_size for path in folder.glob("*")) <= 1.5 * sum(sizes)
    assert not set(old) <= set(files(folder))


def test_a_folder_that_cannot_be_used_is_no_error(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(row_cache.CACHE, str(tmp_path / "file"))
    assert len(builder().scene(0, 0).mesh.faces) > 0
