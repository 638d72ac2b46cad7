"""Scanned fruit, from files of synthetic meshes."""

import os
import sys

import numpy as np
import pytest
import trimesh
from organ_meshes import KINDS, merged, mesh_organs

from pepperscene.camera.image.colorimetry import srgb_encode
from pepperscene.classes import OrganClass
from pepperscene.cultivar.organs import FruitScans, OrganKind
from pepperscene.errors import InputError
from pepperscene.geometry import concatenate_meshes, sphere, write_mesh
from pepperscene.geometry.fruit.scan import choose_scans, load_scan
from pepperscene.geometry.fruit.scan_clean import MAX_TRIANGLES
from pepperscene.geometry.fruit.scan_file import read_triangles
from pepperscene.geometry.mesh import PIGMENTS
from pepperscene.grammar.plant import Organ

CURVE = np.array([[0.1, 0.2, 1.0], [0.11, 0.18, 0.92]])
AXIS = (CURVE[1] - CURVE[0]) / np.linalg.norm(CURVE[1] - CURVE[0])
UP = np.array([1.0, 0.0, 0.0])


def apple(subdivisions=4):
    """A body like an apple, in millimetres and off the origin: lobes, a hollow on top."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    x, y, z = np.asarray(ball.vertices).T
    angle = np.arctan2(y, x)
    swell = 1.0 + 0.06 * np.cos(3.0 * angle) * (1.0 - z**2) - 0.55 * np.exp(-((1.0 - z) ** 2) / 0.08)
    points = np.stack([x, y, 1.3 * z], axis=1) * swell[:, None]
    return trimesh.Trimesh(40.0 * points + [300.0, -70.0, 12.0], ball.faces, process=False)


def save(body, path):
    path.parent.mkdir(exist_ok=True)
    body.export(path)
    return path


def scanned_fruit(*paths, calyx=False, scans=None, **measures):
    """The mesh of a fruit that uses one of the scans, after a calyx if there is one."""
    scans = FruitScans(paths, **(scans or {}))
    kinds = {**KINDS, "berry": OrganKind("fruit", OrganClass.PEPPER, "fruit", scans)}
    shape = {"length_m": 0.09, "diameter_m": 0.07, "seed": 0.3} | measures
    organs = [Organ("berry", 0 if calyx else -1, 4, CURVE, UP, shape)]
    if calyx:
        stub = np.array([CURVE[0] - 0.05 * (CURVE[1] - CURVE[0]), CURVE[0]])
        organs.insert(0, Organ("calyx", -1, 4, stub, UP, {"radius_m": 0.018, "seed": 0.4}))
    return mesh_organs(*organs, kinds=kinds)


def test_scan_gets_the_size_and_pose_of_its_fruit(tmp_path):
    mesh = scanned_fruit(save(apple(), tmp_path / "fruit.obj"), ripeness=0.6, ripeness_spread=0.1)
    body = merged(mesh)
    assert body.is_watertight
    assert body.is_winding_consistent
    assert body.volume > 0.0
    along = (mesh.vertices - CURVE[0]) @ AXIS
    assert np.ptp(along) == pytest.approx(0.09, rel=1e-4)
    across = np.linalg.svd(AXIS[None])[2][1:]
    angle = np.linspace(0.0, np.pi, 360)
    projection = (mesh.vertices @ across.T) @ np.stack([np.cos(angle), np.sin(angle)])
    assert np.ptp(projection, axis=0).max() == pytest.approx(0.07, rel=1e-3)
    # The stalk's foot is on the surface, in the hollow between the shoulders: that end is the file's top.
    assert trimesh.proximity.closest_point(body, CURVE[:1])[1][0] < 1e-4
    assert along.min() < -0.004
    assert mesh.state.mean() == pytest.approx(0.6, abs=0.01)
    assert mesh.state.std() == pytest.approx(0.1, abs=0.01)


def test_calyx_follows_the_surface_of_a_scan(tmp_path):
    mesh = scanned_fruit(save(apple(), tmp_path / "fruit.obj"), calyx=True)
    plate = mesh.vertices[mesh.vertex_runs.rows(0)].astype(float)
    inside = trimesh.proximity.signed_distance(merged(mesh, 1), plate)
    out = np.linalg.norm(plate - CURVE[0] - ((plate - CURVE[0]) @ AXIS)[:, None] * AXIS, axis=1)
    assert np.abs(inside[out > 0.008]).max() < 0.002
    assert 0.0 < inside.max() < 0.001


def test_dirty_meshes_are_cleaned(tmp_path):
    clean = apple(3)
    # Debris, a small hole, faces inside out, duplicate and degenerate triangles; STL merges no vertices.
    debris = trimesh.creation.icosphere(subdivisions=1, radius=2.0).apply_translation([380.0, -70.0, 12.0])
    faces = np.array(clean.faces)[:-4][:, ::-1]
    faces = np.concatenate([faces, faces[:5], np.repeat(faces[:3, :1], 3, axis=1)])
    dirty = trimesh.Trimesh(clean.vertices, faces, process=False)
    path = save(trimesh.util.concatenate([dirty, debris]), tmp_path / "fruit.stl")
    body = merged(scanned_fruit(path))
    assert body.is_watertight
    assert body.body_count == 1
    expected = merged(scanned_fruit(save(clean, tmp_path / "clean" / "fruit.stl"))).volume
    assert body.volume == pytest.approx(expected, rel=0.01)


def open_on_one_side():
    ball = apple(3)
    return trimesh.Trimesh(ball.vertices, ball.faces[ball.triangles_center[:, 0] < 320.0], process=False)


def with_a_vertex_of_nan():
    ball = apple(2)
    points = np.array(ball.vertices)
    points[7] = np.nan
    return trimesh.Trimesh(points, ball.faces, process=False)


@pytest.mark.parametrize(
    ("body", "problem"),
    [
        (open_on_one_side(), "hole"),
        (apple(3) + apple(3).apply_translation([150.0, 0.0, 0.0]), "several parts"),
        (with_a_vertex_of_nan(), "finite"),
        (trimesh.creation.box(extents=[1.0, 1.0, 0.001]), "flat"),
        (trimesh.creation.torus(major_radius=2.0, minor_radius=0.8), "over its middle"),
    ],
)
def test_raises_on_meshes_that_are_not_one_closed_body(tmp_path, body, problem):
    path = save(body, tmp_path / "fruit.ply")
    with pytest.raises(InputError, match=problem) as error:
        load_scan(path)
    assert str(path) in str(error.value)
    assert "closed surface" in str(error.value)


def test_raises_on_other_formats_and_missing_files(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        load_scan(tmp_path / "nowhere.ply")
    with pytest.raises(InputError, match="OBJ, PLY or STL"):
        load_scan(tmp_path / "fruit.blend")
    folder = tmp_path / "folder.ply"
    folder.mkdir()
    with pytest.raises(InputError):
        load_scan(folder)


def test_scan_with_many_triangles_is_simplified(tmp_path):
    pytest.importorskip("fast_simplification")
    path = save(apple(6), tmp_path / "fruit.stl")
    fine, coarse = load_scan(path), load_scan(save(apple(5), tmp_path / "coarse.stl"))
    assert 0.9 * MAX_TRIANGLES < len(fine.faces) <= MAX_TRIANGLES
    # The same body: its points are on the surface of the other one.
    surface = trimesh.Trimesh(coarse.points, coarse.faces)
    distance = np.abs(trimesh.proximity.signed_distance(surface, fine.points[::50]))
    assert distance.max() < 2e-3
    body = trimesh.Trimesh(fine.points, fine.faces)
    body.merge_vertices(merge_tex=True, merge_norm=True)
    assert body.volume == pytest.approx(surface.volume, rel=2e-3)


def test_scan_with_many_triangles_needs_the_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "fast_simplification", None)
    path = save(apple(6), tmp_path / "fruit.ply")
    with pytest.raises(
        InputError, match=r"has 81,920 triangles, and 25,000 are used; `pip install 'pepperscene\[scan\]'`"
    ):
        load_scan(path)


@pytest.mark.parametrize(("up", "axis"), [("x", 0), ("y", 1), ("z", 2), ("-x", 0), ("-y", 1), ("-z", 2)])
def test_any_axis_of_the_file_can_be_up(tmp_path, up, axis):
    body = apple(3)
    upright = load_scan(save(body, tmp_path / "upright.ply"))
    # Turn z to the axis; only the turn about it is free.
    direction = np.eye(3)[axis] * (-1.0 if up.startswith("-") else 1.0)
    turned = body.copy()
    turned.apply_transform(trimesh.geometry.align_vectors([0.0, 0.0, 1.0], direction))
    scan = load_scan(save(turned, tmp_path / "turned.ply"), up)
    for one in (scan, upright):
        assert one.points[:, 2].min() < 0.0 < one.points[:, 2].max()
    # Distances from the axis, and along it, are those of the upright body.
    for one in (0.0, 0.1, 0.5, 0.9, 1.0):
        for values in (lambda points: points[:, 2], lambda points: np.hypot(*points.T[:2])):
            assert np.quantile(values(scan.points), one) == pytest.approx(
                np.quantile(values(upright.points), one), abs=5e-3
            )
    # And they are as many different ones along it.
    different = [len(np.unique(np.round(one.points[:, 2], 4))) for one in (scan, upright)]
    assert abs(different[0] - different[1]) < 0.1 * different[1]


def test_scan_is_loaded_again_after_its_file_changes(tmp_path):
    path = save(apple(3), tmp_path / "fruit.ply")
    first = load_scan(path)
    assert load_scan(path) is first
    save(apple(2), path)
    os.utime(path, ns=(1, 1))
    assert len(load_scan(path).faces) < len(first.faces)


def test_scan_is_chosen_by_weight_and_by_the_seed_of_the_fruit(tmp_path):
    paths = tuple(save(apple(2), tmp_path / f"{name}.ply") for name in "abc")
    seeds = np.random.default_rng(5).random(4000)
    fruit = [Organ("berry", -1, 0, CURVE, UP, {"seed": seed}) for seed in seeds]
    chosen = choose_scans(fruit, FruitScans(paths, (2.0, 1.0, 5.0)))
    # Four standard deviations of a binomial count.
    for path, share in zip(paths, (0.25, 0.125, 0.625), strict=True):
        count, deviation = chosen.count(path), np.sqrt(4000 * share * (1.0 - share))
        assert count == pytest.approx(4000 * share, abs=4.0 * deviation)
    assert chosen[::-1] == choose_scans(fruit[::-1], FruitScans(paths, (2.0, 1.0, 5.0)))
    # Without weights all are as frequent.
    even = choose_scans(fruit, FruitScans(paths))
    assert min(even.count(path) for path in paths) > 4000 / 3 - 4.0 * np.sqrt(4000 * 2 / 9)


def test_fruit_of_several_scans_have_the_mesh_of_the_chosen_one(tmp_path):
    scans = save(apple(2), tmp_path / "a.ply"), save(apple(3), tmp_path / "b.ply")
    alone = [scanned_fruit(path) for path in scans]
    for seed in (0.1, 0.95):
        mesh = scanned_fruit(*scans, seed=seed)
        expected = alone[len(mesh.faces) == len(alone[1].faces)]
        np.testing.assert_array_equal(mesh.vertices, expected.vertices)


@pytest.mark.parametrize(("unit", "scale"), [("m", 1e-3), ("cm", 0.1), ("mm", 1.0), ("in", 1.0 / 25.4)])
def test_unit_of_a_scan_is_checked(tmp_path, unit, scale):
    # An apple of 80 mm, in each unit.
    path = save(apple(2).apply_scale(scale), tmp_path / "fruit.obj")
    size = {"diameter_m": 0.08}
    right = scanned_fruit(path, scans={"unit": unit, **size})
    np.testing.assert_array_equal(right.vertices, scanned_fruit(path).vertices)
    wrong = "mm" if unit == "m" else "m"
    expected = f'it is probably in {unit}, 8[0-9.]+ mm: set scan_unit = "{unit}"'
    with pytest.raises(InputError, match=f"{wrong}, and fruit of this kind 80 mm on average; {expected}"):
        scanned_fruit(path, scans={"unit": wrong, **size})


def painted(body):
    """A body whose linear colour is its position in its box."""
    place = (body.vertices - body.bounds[0]) / np.ptp(body.bounds, axis=0)
    body.visual.vertex_colors = np.round(255.0 * srgb_encode(place)).astype(np.uint8)
    return body


@pytest.mark.parametrize(("suffix", "subdivisions"), [("ply", 4), ("obj", 6)])
def test_points_have_the_colours_of_the_scan(tmp_path, suffix, subdivisions):
    # The finer one is simplified.
    body = painted(apple(subdivisions))
    mesh = scanned_fruit(save(body, tmp_path / f"fruit.{suffix}"), scans={"colour": True}, residue=0.4)
    assert mesh.colour.shape == (len(mesh.vertices), 3)
    # Up, right and along of the fruit are x, -y and -z of the file, in the box of the body.
    right = np.cross(AXIS, UP) / np.linalg.norm(np.cross(AXIS, UP))
    axes = np.stack([np.cross(right, AXIS), -right, -AXIS])
    place = (mesh.vertices - CURVE[0]) @ axes.T
    place = (place - place.min(axis=0)) / np.ptp(place, axis=0)
    # Half a code at the bright end is 0.5 %; where points are merged, their mean is half an edge away.
    assert np.abs(mesh.colour - place).max() < 0.03
    assert np.abs(mesh.colour - place).mean() < 0.006
    # The colours hold its scars.
    assert mesh.appearances[0].residue == 0.0


def test_colours_do_not_change_the_shape(tmp_path):
    path = save(painted(apple(3)), tmp_path / "fruit.ply")
    plain, coloured = scanned_fruit(path), scanned_fruit(path, scans={"colour": True})
    assert plain.colour is None
    for name in ("vertices", "normals", "uv", "state", "faces"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(coloured, name))


def test_organs_without_a_scan_keep_their_pigments(tmp_path):
    path = save(painted(apple(3)), tmp_path / "fruit.ply")
    mesh = scanned_fruit(path, calyx=True, scans={"colour": True})
    fruit = mesh.vertex_instance == 1
    assert np.all(mesh.colour[fruit] >= 0.0)
    assert np.all(mesh.colour[~fruit] == PIGMENTS)
    # Colours follow their vertices into parts of the mesh, and out of meshes without any.
    assert np.all(mesh.select_instances([0]).colour == PIGMENTS)
    np.testing.assert_array_equal(mesh.without_triangles(np.array([0])).colour, mesh.colour[fruit])
    joined = concatenate_meshes([sphere([0.0, 0.0, 0.0], 0.1), mesh])
    np.testing.assert_array_equal(joined.colour[-len(mesh.vertices) :], mesh.colour)
    assert np.all(joined.colour[: -len(mesh.vertices)] == PIGMENTS)


def test_mesh_file_of_a_plant_has_the_colours_of_the_scan(tmp_path):
    scan = save(painted(apple(3)), tmp_path / "fruit.ply")
    mesh = scanned_fruit(scan, calyx=True, scans={"colour": True})
    write_mesh(mesh, tmp_path / "plant.glb", {"fruit": np.zeros((2, 3)), "calyx": np.zeros((2, 3))})
    found = read_triangles(tmp_path / "plant.glb", colour=True)
    # The node of the fruit is below that of the calyx, which is black.
    fruit = mesh.vertex_instance == 1
    calyx = np.count_nonzero(~fruit)
    assert np.all(found.colours[:calyx] == 0.0)
    np.testing.assert_allclose(found.colours[calyx:], mesh.colour[fruit], atol=0.51 / 255)


def test_scan_without_colours_cannot_give_any(tmp_path):
    for suffix in ("stl", "obj", "ply", "glb"):
        path = save(apple(2), tmp_path / f"fruit.{suffix}")
        with pytest.raises(InputError, match="has no colours, which scan_colour asks for"):
            load_scan(path, colour=True)
