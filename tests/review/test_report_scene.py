"""The 3D view of a report: plants and cameras of the data set's scene, and why a page has none."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import shutil
from datetime import date

import numpy as np
import pytest
from hostile_set import edit_frame, edit_json
from report_page import Page
from typer.testing import CliRunner

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.building.scenes.scene_builder import SceneBuilder
from pepperscene.classes import OrganClass
from pepperscene.cli import app
from pepperscene.dataset.store.dataset import open_dataset
from pepperscene.geometry import concatenate_meshes
from pepperscene.recipe.recipe import digest
from pepperscene.recipe.resolve.frame_setups import FrameSetups
from pepperscene.recipe.resolve.load import resolve_recipe
from pepperscene.review.report import scene_view as module
from pepperscene.review.report import write_report
from pepperscene.review.report.label_regions import unpack
from pepperscene.review.report.scene_view import (
    MissingSceneError,
    grow_row,
    organ_triangles,
    resolve_recorded,
    three_js,
)
from pepperscene.shipped import shipped_folder
from pepperscene.version import __version__


@pytest.fixture(scope="module")
def page(grown, tmp_path_factory):
    folder = shutil.copytree(grown.folder, tmp_path_factory.mktemp("scene") / "set")
    return Page(write_report(folder, limit=2, scene=True).page)


@pytest.fixture(scope="module")
def data(page):
    (section,) = page.of("section", id="scene")
    return unpack(section["data-scene"])


@pytest.fixture
def folder(grown, tmp_path):
    return shutil.copytree(grown.folder, tmp_path / "set")


def test_cameras_are_those_of_the_scene(grown, data):
    # Frames 0 to 2 are of the first scene, 3 of the second.
    assert [camera["index"] for camera in data["cameras"]] == [0, 1, 2]
    for camera in data["cameras"]:
        metadata = grown.metadata(camera["index"])["camera"]
        pose = np.array(metadata["pose"])
        points = np.array(camera["points"]) / 1e3
        np.testing.assert_allclose(points[0], pose[:3, 3], atol=5.1e-4)
        # The corners project to the corners of the image; half a millimetre at 0.15 m is a few pixels.
        corners = (points[1:] - pose[:3, 3]) @ pose[:3, :3]
        pixels = corners[:, :2] / corners[:, 2:] * [metadata["fx"], metadata["fy"]]
        pixels += [metadata["cx"], metadata["cy"]]
        width, height = metadata["width"], metadata["height"]
        expected = [(0, 0), (width, 0), (width, height), (0, height)]
        np.testing.assert_allclose(pixels, expected, atol=0.01 * width)


def test_cameras_link_to_the_shown_frames(page, data):
    cards = [camera["card"] for camera in data["cameras"]]
    assert cards == ["a-000000", None, None]
    assert page.of("article", id="a-000000")


def test_plants_are_those_of_the_frames_simplified(grown_recipe, data):
    renderer = FrameRenderer(grown_recipe, culled=False)
    mesh = renderer.scene(grown_recipe.plan.frame(0), traced=False).mesh
    assert set(data["organs"]) >= {str(int(organ)) for organ in (OrganClass.LEAF, OrganClass.STEM)}
    for number, organ in data["organs"].items():
        own = mesh.faces[mesh.face_class == int(number)]
        vertices = np.unique(np.rint(1e3 * mesh.vertices[own].reshape(-1, 3).astype(float)), axis=0)
        positions = np.reshape(organ["positions"], (-1, 3))
        assert {tuple(row) for row in positions} <= {tuple(row) for row in vertices}
        assert 0 < len(organ["faces"]) < own.size
        assert set(organ["faces"]) == set(range(len(positions)))
        if int(number) == OrganClass.LEAF:
            assert (np.ptp(positions, axis=0) > 0.8 * np.ptp(vertices, axis=0)).all()


def test_plants_do_not_depend_on_the_rows_that_the_view_leaves_out():
    changes = {"row.plants_front": 1, "row.plants_back": 0, "cultivar": "kaite_february"}
    resolved = resolve_recipe("greenhouse", {**changes, "greenhouse.far_rows": 1})
    spec = resolved.recipe.plan.frame(0)
    builder = SceneBuilder(resolved.recipe, resolved.cultivar)
    row, complete = grow_row(resolved, spec), builder.scene(spec.set, spec.rotation).mesh
    assert len(row.instances) < len(complete.instances)

    def corners(mesh):
        is_plant = np.array([one.plant >= 0 and one.far_row < 0 for one in mesh.instances])
        return mesh.vertices[mesh.faces[is_plant[mesh.face_instance]]]

    np.testing.assert_array_equal(corners(row), corners(complete))


def test_page_needs_no_network(page):
    # Of three.js: the namespace of XHTML and a comment.
    urls = set(re.findall(r"\w+://[^\"'\s)]+", page.text))
    assert urls == {"http://www.w3.org/1999/xhtml", "https://github.com/mrdoob/three.js/pull/23228"}
    assert "default-src 'none'" in page.text
    digests = [hashlib.sha256(text.encode()).digest() for text in page.scripts()]
    assert len(digests) == 2
    expected = [f"'sha256-{base64.b64encode(digest).decode()}'" for digest in digests]
    assert page.policy()["script-src"] == expected


def test_three_js_is_the_library_with_its_licence():
    library = three_js()
    assert "SPDX-License-Identifier: MIT" in library[:200]
    assert all(name in library for name in ("WebGLRenderer", "MeshLambertMaterial", "GridHelper"))
    # Not the viewer of trimesh.
    assert "GLTFLoader" not in library


def test_page_without_a_view_grows_nothing(folder, monkeypatch):
    def refuse(*_arguments, **_options):
        raise AssertionError("a plant was grown")

    monkeypatch.setattr(SceneBuilder, "plants", refuse)
    files = write_report(folder)
    page = Page(files.page)
    assert files.missing_scene == ""
    assert not page.of("section", id="scene")
    assert len(page.scripts()) == 1


def missing_with(folder, **changes):
    edit_json(folder / "dataset.json", lambda content: {**content, **changes})
    return module.scene_view(open_dataset(folder), [0]).missing


def test_missing_views_have_a_reason(folder, monkeypatch):
    info = open_dataset(folder).info
    reason = "the recipe names files that are not shipped with this version"
    files = {**info["files"], "cultivar": {**info["files"]["cultivar"], "sha256": "0" * 64}}
    assert missing_with(folder, files=files, recipe_sha256="0" * 64) == reason
    recipe = {**info["recipe"], "cultivar": "my_cultivar"}
    assert missing_with(folder, **{**info, "recipe": recipe}) == reason
    monkeypatch.setattr(module, "three_js", lambda: None)
    assert missing_with(folder, **info) == "it needs three.js r140 of trimesh 4.8.3 or later"


def test_cameras_without_a_focal_length_are_a_reason(folder):
    edit_frame(folder, 1, lambda content: content | {"camera": {**content["camera"], "fx": 0.0}})
    missing = module.scene_view(open_dataset(folder), [0]).missing
    assert missing == "the camera of frame 1 has no focal length above 0"


def test_page_says_why_it_has_no_view(folder):
    edit_json(folder / "dataset.json", lambda content: {**content, "version": "0.0.1"})
    reason = "the data set was built by version 0.0.1, and this is "
    result = CliRunner().invoke(app, ["report", str(folder), "--scene"])
    assert result.exit_code == 0, result.output
    page = Page(folder / "index.html")
    assert f"There is no 3D view: {reason}" in page.text
    assert "data-scene" not in page.of("section", id="scene")[0]
    assert len(page.scripts()) == 1
    assert f"note: the page has no 3D view: {reason}" in result.stderr


@pytest.mark.parametrize("name", [path.stem for path in sorted(shipped_folder("recipes").glob("*.toml"))])
def test_shipped_recipes_are_the_same_from_their_data_sets(name):
    resolved = resolve_recipe(name)
    content = {"recipe_sha256": digest(dict(resolved.identity)), **resolved.identity}
    info = json.loads(json.dumps({"version": __version__, **content}))
    again = resolve_recorded(info)
    assert again.identity == resolved.identity
    for index in (0, resolved.recipe.plan.count - 1):
        spec = resolved.recipe.plan.frame(index)
        assert FrameSetups(again).at(spec).plants == FrameSetups(resolved).at(spec).plants


def test_drawn_dates_are_a_reason():
    growth = {"until": "kaite_september", "date": {"uniform": [date(2016, 3, 1), date(2016, 5, 1)]}}
    identity = resolve_recipe("greenhouse", {"cultivar": "kaite_february", "growth": growth}).identity
    info = json.loads(
        json.dumps({"version": __version__, "recipe_sha256": digest(dict(identity)), **identity})
    )
    with pytest.raises(MissingSceneError, match="draws dates"):
        resolve_recorded(info)


def test_nearest_plants_are_kept_where_they_are_many(grown_recipe, monkeypatch):
    mesh = FrameRenderer(grown_recipe, culled=False).scene(grown_recipe.plan.frame(0), traced=False).mesh
    row = concatenate_meshes(
        [mesh.with_plant(number).moved(np.eye(3), (float(number), 0, 0)) for number in range(3)]
    )
    organs, plants, total = organ_triangles(row, np.array([[2.1, -0.4, 1.0], [2.0, -0.4, 1.0]]))
    assert (plants, total) == (3, 3)
    triangles = sum(len(organ["faces"]) for organ in organs.values()) // 3
    monkeypatch.setattr(module, "_MAX_TRIANGLES", triangles // 3 + 5)
    organs, plants, total = organ_triangles(row, np.array([[2.1, -0.4, 1.0], [2.0, -0.4, 1.0]]))
    assert (plants, total) == (1, 3)
    x = np.concatenate([organ["positions"][::3] for organ in organs.values()])
    assert abs(x.mean() - 2000) < 300


def test_damaged_frames_are_errors(folder):
    (folder / "frames" / "000001.json").write_text("{", encoding="utf-8")
    result = CliRunner().invoke(app, ["report", str(folder), "--scene"])
    assert result.exit_code == 2
    assert not (folder / "index.html").exists()
    assert open_dataset(folder).indices()
