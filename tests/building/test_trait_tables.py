"""Traits of plants: against trimesh, closed forms, and the scenes that frames show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from pyarrow import csv, parquet
from scipy.spatial import ConvexHull

import pepperscene as ps
from pepperscene.building.scenes.trait_tables import TABLES, scene_traits
from pepperscene.cli import app
from pepperscene.errors import ArgumentError, InputError, OutputError
from pepperscene.geometry import concatenate_meshes, mesh_plant, rectangle, sphere
from pepperscene.geometry.sizes import organ_sizes
from pepperscene.grammar import Organ
from pepperscene.grammar.plant import Plant
from pepperscene.scene import assemble_scene, build_skeleton

CHANGES = {
    "cultivar": "kaite_february", "plan.sets": 1, "plan.rotations": 2, "plan.frames": 3,
    "row.plants_front": 2, "row.plants_back": 1,
}  # fmt: skip
FRAME = 4  # of the second rotation
SHEETS = ("lamina", "flower", "twine")


@pytest.fixture(scope="module")
def recipe():
    return ps.load_recipe("greenhouse", {**CHANGES, "greenhouse.far_rows": 0})


@pytest.fixture(scope="module")
def scene(recipe):
    return ps.FrameRenderer(recipe, culled=False).scene(recipe.plan.frame(FRAME), traced=False)


@pytest.fixture(scope="module")
def traits(recipe):
    return ps.plant_traits(recipe, FRAME)


def body(mesh, instance):
    """A value of the instance image as a mesh of trimesh, closed at the seams."""
    faces = mesh.faces[mesh.face_instance == instance - 1]
    found = trimesh.Trimesh(mesh.vertices.astype(float), faces, process=False)
    found.merge_vertices(merge_tex=True, merge_norm=True)
    return found


def position(row):
    return [row["x_m"], row["y_m"], row["z_m"]]


def test_leaves_have_the_areas_of_the_mesh(scene, traits):
    rows = traits.leaves.to_pylist()
    names = [item.kind for item in scene.mesh.instances]
    assert len(rows) == sum("lamina" in name for name in names) > 60
    for row in rows:
        blade = body(scene.mesh, row["instance"])
        assert names[row["instance"] - 1] == row["kind"]
        # A single sheet: every edge belongs to one or two triangles, and no triangle has a twin behind it.
        assert len(np.unique(np.sort(blade.faces, axis=1), axis=0)) == len(blade.faces)
        assert row["area_m2"] == pytest.approx(blade.area, rel=1e-9)
        np.testing.assert_allclose(position(row), blade.centroid, atol=1e-9)
        slope = np.degrees(np.arccos(np.abs(blade.face_normals[:, 2])))
        assert row["inclination_deg"] == pytest.approx(np.average(slope, weights=blade.area_faces), abs=1e-4)


def test_fruit_has_the_volumes_of_the_mesh(scene, traits):
    rows = traits.fruit.to_pylist()
    assert len(rows) == sum(item.kind == "fruit" for item in scene.mesh.instances) > 3
    for row in rows:
        fruit = body(scene.mesh, row["instance"])
        assert fruit.is_watertight
        assert row["volume_m3"] == pytest.approx(fruit.volume, rel=1e-7)
        np.testing.assert_allclose(position(row), fruit.center_mass, atol=1e-8)
        # A bounding box of the size as grown holds the body.
        assert 0.3 < row["volume_m3"] / (row["length_m"] * row["diameter_m"] ** 2) < 0.9


def test_plants_are_the_sums_of_their_organs(recipe, scene, traits):
    leaves, fruit = traits.leaves.to_pylist(), traits.fruit.to_pylist()
    plants = traits.plants.to_pylist()
    assert [row["plant"] for row in plants] == [0, 1, 2]
    for row in plants:
        own_leaves, own_fruit = (
            [entry for entry in rows if entry["plant"] == row["plant"]] for rows in (leaves, fruit)
        )
        assert (row["leaf_count"], row["fruit_count"]) == (len(own_leaves), len(own_fruit))
        assert row["leaf_area_m2"] == pytest.approx(sum(leaf["area_m2"] for leaf in own_leaves))
        assert row["fruit_volume_m3"] == pytest.approx(sum(one["volume_m3"] for one in own_fruit))
        assert row["ripe_fruit_count"] == sum(one["ripeness"] >= 0.5 for one in own_fruit)
        instances = [i for i, item in enumerate(scene.mesh.instances) if item.plant == row["plant"]]
        solid = [i for i in instances if not any(word in scene.mesh.instances[i].kind for word in SHEETS)]
        volume = sum(body(scene.mesh, index + 1).volume for index in solid)
        assert row["fresh_volume_m3"] == pytest.approx(volume, rel=1e-6)
        organs = [i for i in instances if scene.mesh.instances[i].kind != "twine"]
        points = scene.mesh.vertices[scene.mesh.faces[np.isin(scene.mesh.face_instance, organs)].ravel()]
        assert row["height_m"] == pytest.approx(points[:, 2].max() - row["z_m"], abs=1e-6)
        assert row["nodes"] == sum(scene.mesh.instances[i].kind == "node" for i in instances) == 13
        assert row["cultivar"] == "Kaite in February"
    # A double row: half of the aisle and half of the gap for each plant.
    floor = recipe.row.spacing_m * (recipe.greenhouse.aisle_m + recipe.row.gap_m) / 2
    assert [row["ground_area_m2"] for row in plants] == pytest.approx([floor] * 3)
    assert [row["leaf_area_index"] * floor for row in plants] == pytest.approx(
        [row["leaf_area_m2"] for row in plants]
    )


def test_ages_count_the_phytomers_above(scene, traits):
    for row in [*traits.leaves.to_pylist(), *traits.fruit.to_pylist()]:
        item = scene.mesh.instances[row["instance"] - 1]
        assert (row["plant"], row["phytomer"]) == (item.plant, item.phytomer)
        above = {
            other.phytomer
            for other in scene.mesh.instances
            if other.plant == item.plant and other.kind == "internode" and other.phytomer > item.phytomer
        }
        assert row["age_phytomers"] == len(above)


def test_far_rows_change_nothing(recipe, traits):
    greenhouse = replace(recipe.greenhouse, far_rows=2)
    found = ps.plant_traits(recipe.model_copy(update={"greenhouse": greenhouse}), FRAME)
    assert all(getattr(found, name).equals(getattr(traits, name)) for name in TABLES)


def test_organs_without_triangles_have_no_row(scene, traits):
    first = traits.fruit["instance"][0].as_py()
    picked = replace(scene, mesh=scene.mesh.without_triangles(np.array([first - 1])))
    found = scene_traits(picked, traits.plants["ground_area_m2"][0].as_py())
    assert found.fruit["instance"].to_pylist() == traits.fruit["instance"].to_pylist()[1:]
    assert found.leaves["area_m2"].to_pylist() == traits.leaves["area_m2"].to_pylist()
    assert found.plants["frame"].null_count == 3
    moved = replace(scene, mesh=replace(scene.mesh, vertices=scene.mesh.vertices + np.float32(0.1)))
    with pytest.raises(ArgumentError, match="did not move with them"):
        scene_traits(moved, 1.0)
    with pytest.raises(ArgumentError, match="needs a skeleton"):
        scene_traits(replace(scene, skeleton=None), 1.0)


@pytest.mark.parametrize("tilt", [0.0, 0.3, 1.2, np.pi / 2])
def test_a_flat_sheet_has_its_closed_form(tilt):
    up = 0.2 * np.array([0.0, np.cos(tilt), np.sin(tilt)])
    mesh = concatenate_meshes(
        [
            sphere((1, 2, 3), 0.04, subdivisions=5),
            rectangle((0.3, 0, 1), (0.1, 0, 0), up),
            sphere((0, 0, 0), 1),
        ]
    ).without_triangles(np.array([2]))
    sizes = organ_sizes(mesh, np.arange(3))
    assert sizes.area_m2[1] == pytest.approx(0.02, rel=1e-6)
    assert sizes.tilt_rad[1] == pytest.approx(tilt, abs=1e-6)
    np.testing.assert_allclose(sizes.surface_centre_m[1], [0.3, 0, 1], atol=1e-7)
    assert sizes.top_m[1] == pytest.approx(1 + 0.1 * np.sin(tilt))
    assert sizes.volume_m3[0] == pytest.approx(4 / 3 * np.pi * 0.04**3, rel=1e-3)
    assert sizes.area_m2[0] == pytest.approx(4 * np.pi * 0.04**2, rel=1e-3)
    np.testing.assert_allclose(sizes.body_centre_m[0], [1, 2, 3], atol=1e-6)
    # The mean of arccos |z| over a sphere is one radian.
    assert sizes.tilt_rad[0] == pytest.approx(1.0, abs=1e-3)
    assert (sizes.area_m2[2], sizes.volume_m3[2], sizes.top_m[2]) == (0, 0, -np.inf)


def test_a_flat_blade_has_the_area_of_its_outline(kaite):
    """A level blade without folds and waves, whose area follows from its border alone."""
    line = np.linspace([0.0, 0.0, 1.0], [0.12, 0.0, 1.0], 14)
    up, radii = np.array([0, -1.0, 0]), {"radius_m": 0.004, "radius_tip_m": 0.004}
    stem = Organ("internode", -1, 0, np.array([[0, 0, 0], [0, 0, 1.0]]), up, radii)
    radii = {"radius_m": 0.008, "radius_start_m": 0.004, "radius_end_m": 0.004}
    node = Organ("node", 0, 0, np.array([[0, 0, 1.0], [0, 0, 1.01], [0, 0, 1.02]]), up, radii)
    blade = Organ("lamina", 1, 0, line, np.array([0, 0, 1.0]), {"length_m": 0.12, "width_m": 0.09})
    plant = Plant("kaite", (stem, node, blade), kaite.kinds)
    scene = assemble_scene(mesh_plant(plant), skeleton=build_skeleton([plant]))
    (row,) = scene_traits(scene, 0.5).leaves.to_pylist()
    outline = body(scene.mesh, 3)
    edges = outline.edges[trimesh.grouping.group_rows(outline.edges_sorted, require_count=1)]
    a, b = outline.vertices[edges[:, 0]], outline.vertices[edges[:, 1]]
    assert np.ptp(outline.vertices[:, 2]) < 1e-6
    assert row["area_m2"] == pytest.approx(abs(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])) / 2, rel=1e-6)
    assert row["area_m2"] <= ConvexHull(outline.vertices[:, :2]).volume
    np.testing.assert_allclose(np.ptp(outline.vertices[:, :2], axis=0), [0.12, 0.09], rtol=0.02)
    assert (row["length_m"], row["width_m"]) == (0.12, 0.09)
    assert row["inclination_deg"] == pytest.approx(0, abs=1e-3)
    assert (row["leaf_age"], row["age_phytomers"]) == (0, 0)


def test_a_growth_series_has_rows_of_each_date(write_recipe):
    path = write_recipe(
        extends="season",
        plan={"sets": 1, "rotations": 1, "frames": 2},
        row={"plants_front": 1, "plants_back": 0},
        greenhouse={"far_rows": 0},
        twins={
            "growth.date": ["2016-02-20", "2016-03-15", "2016-02-20"],
            "daylight.sun_elevation_deg": [27, 36, 40],
            "daylight.illuminance_lx": [18000, 24000, 30000],
        },
    )
    text = path.read_text(encoding="utf-8")
    for date in ("2016-02-20", "2016-03-15"):
        text = text.replace(f'"{date}"', date)
    path.write_text(text, encoding="utf-8")
    traits = ps.plant_traits(path, 3)
    rows = traits.plants.to_pylist()
    # The third twin has the plants of the first.
    assert [(row["frame"], row["twin"], row["date"]) for row in rows] == [
        (1, 0, "2016-02-20"), (3, 1, "2016-03-15"),
    ]  # fmt: skip
    first, second = rows
    assert first["nodes"] < second["nodes"]
    assert first["height_m"] < second["height_m"]
    for row in rows:
        areas = [leaf["area_m2"] for leaf in traits.leaves.to_pylist() if leaf["date"] == row["date"]]
        assert row["leaf_area_m2"] == pytest.approx(sum(areas))


def test_files_hold_the_tables(traits, tmp_path):
    paths = ps.write_traits(traits, tmp_path / "a")
    assert [path.name for path in paths] == ["plants.parquet", "leaves.parquet", "fruit.parquet"]
    for path, name in zip(paths, TABLES, strict=True):
        table, expected = parquet.read_table(path), getattr(traits, name)
        assert table.equals(expected)
        assert table.column_names == list(TABLES[name])
    for path, name in zip(ps.write_traits(traits, tmp_path / "b", "csv"), TABLES, strict=True):
        rows, expected = csv.read_csv(path).to_pylist(), getattr(traits, name).to_pylist()
        assert [{**row, "date": str(row["date"])} for row in rows] == expected


def test_mistakes_are_refused_before_plants_grow(recipe, traits, tmp_path, monkeypatch):
    with pytest.raises(ArgumentError, match="parquet or csv, not 'xlsx'"):
        ps.write_traits(traits, tmp_path / "out", "xlsx")
    with pytest.raises(InputError, match="frame 6 does not exist"):
        ps.plant_traits(recipe, 6)
    (tmp_path / "out" / "fruit.csv").mkdir(parents=True)
    with pytest.raises(OutputError, match=r"fruit\.csv"):
        ps.write_traits(traits, tmp_path / "out", "csv")
    monkeypatch.chdir(tmp_path)
    assert app(["traits", "greenhouse", "--out", "new", "--format", "xlsx"], standalone_mode=False) == 2
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["fruit.csv"]
    assert not (tmp_path / "new").exists()


def test_command_writes_what_python_returns(traits, tmp_path, capsys):
    words = [
        "traits",
        "greenhouse",
        "--frame",
        str(FRAME),
        "--out",
        str(tmp_path),
        "--set",
        "greenhouse.far_rows=0",
    ]
    for key, value in CHANGES.items():
        words += ["--set", f"{key}={value}"]
    assert not app(words, standalone_mode=False)
    counts = [getattr(traits, name).num_rows for name in TABLES]
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "{} plants, {} leaves, {} fruit".format(*counts)
    assert lines[1:] == [str(tmp_path / f"{name}.parquet") for name in TABLES]
    assert parquet.read_table(tmp_path / "leaves.parquet").equals(traits.leaves)
