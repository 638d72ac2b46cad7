"""Triangles without area, twice the same, thin as hairs, in one plane; meshes of nothing, of no numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bodies import bench_camera, card, sheet
from greenhouse import camera as greenhouse_camera
from greenhouse import greenhouse
from strain import (
    DAYLIGHT,
    OUTPUTS,
    assert_sound,
    grey,
    picture,
    point_flash_camera,
    surface,
    triangles,
    with_faces,
)

from pepperscene.geometry import Mesh, concatenate_meshes
from pepperscene.render import Renderer
from pepperscene.render.reference.path_tracer import path_traced
from pepperscene.scene import assemble_scene


def test_triangles_without_area_change_nothing():
    # Corners that coincide, and corners in a line, at places all over the plants.
    scene, camera = greenhouse(), greenhouse_camera(columns=40, rows=30)
    rng = np.random.default_rng(0)
    some = rng.integers(0, len(scene.mesh.vertices), (200, 2))
    ends = scene.mesh.vertices[some]
    middle = len(scene.mesh.vertices)
    pricked = replace(
        scene.mesh,
        vertices=np.concatenate([scene.mesh.vertices, ends.mean(axis=1)]),
        **{
            name: np.concatenate([getattr(scene.mesh, name), getattr(scene.mesh, name)[some[:, 0]]])
            for name in ("normals", "uv", "state")
        },
    )
    points = some[:, [0, 0, 0]]
    folded = some[:, [0, 1, 0]]
    lines = np.column_stack([some, middle + np.arange(200)])
    found = picture(replace(scene, mesh=with_faces(pricked, np.concatenate([points, folded]))), camera)
    expected = picture(scene, camera)
    for name in OUTPUTS:
        assert np.array_equal(found[name], expected[name]), name
    # A middle is rounded, so these have an area of 1e-8 m times their length: a pixel in a thousand million.
    lined = picture(replace(scene, mesh=with_faces(pricked, lines)), camera)
    assert (lined["class"] != expected["class"]).mean() <= 0.001
    assert lined["electrons"].mean() == pytest.approx(expected["electrons"].mean(), rel=0.01)


@pytest.mark.parametrize("times", [2, 5])
def test_triangles_that_are_there_several_times_count_once(times):
    # Rays are lifted off all of them at once: no light is lost between the copies of a translucent leaf.
    mesh = concatenate_meshes([card(0.01, 0.0, 0.02, 0.2, "front", 0.4), sheet(0.2, 0.2, 0.5, "back")])
    surfaces = {name: surface(name, 0.4, 0.5, 1.4) for name in mesh.surfaces}
    several = replace(
        mesh,
        **{
            name: np.concatenate([getattr(mesh, name)] * times)
            for name in ("faces", "face_instance", "face_surface")
        },
    )
    camera = bench_camera(columns=24, rows=18)
    found = picture(assemble_scene(several, surfaces, DAYLIGHT), camera, "standard")
    expected = picture(assemble_scene(mesh, surfaces, DAYLIGHT), camera, "standard")
    for name in ("class", "instance", "distance"):
        assert np.array_equal(found[name], expected[name])
    assert found["electrons"] == pytest.approx(expected["electrons"], rel=1e-3)


def strips(heights: list[float]) -> Mesh:
    """A sheet of 20 x 20 cm, 40 cm ahead, cut into strips that end at these heights."""
    rows = np.array([-0.1, *heights, 0.1])
    places = np.array([[x, y, 0.4] for y in rows for x in (-0.1, 0.1)], np.float32)
    first = 2 * np.arange(len(rows) - 1)[:, None]
    faces = np.concatenate([first + np.array([0, 2, 1]), first + np.array([1, 2, 3])])
    return Mesh(
        vertices=places,
        normals=np.tile(np.array([0, 0, -1], np.float32), (len(places), 1)),
        uv=(places[:, :2] * 5.0 + 0.5).astype(np.float32),
        state=np.full(len(places), 0.5, np.float32),
        faces=faces.astype(np.uint32),
        face_instance=np.zeros(len(faces), np.uint32),
        face_surface=np.zeros(len(faces), np.uint8),
        surfaces=("leaf",),
        instances=sheet(1, 1, 1, "leaf").instances,
    )


@pytest.mark.parametrize("tracer", ["ours", "path"])
def test_needles_in_a_leaf_are_not_seen(tracer):
    # A leaf with relief, whole and with strips of 20 cm by 2e-7 m in it, one to a million, 200 of them side
    # by side and others here and there. Of light there is no more difference than of rounding, but for rays
    # that come to lie on an edge.
    needles = [*(1e-3 + 2e-7 * np.arange(200)), 0.01, 0.01 + 2e-7, 0.02, 0.02 + 4e-7]
    waves = np.sin(np.linspace(0.0, 40.0, 64))[:, None] * np.ones((64, 64))
    leaf = replace(surface("leaf", 0.4, 0.4, 1.4), relief_mm=waves.astype(np.float32))
    camera = bench_camera(columns=16, rows=48)
    scenes = [assemble_scene(strips(heights), {"leaf": leaf}, DAYLIGHT) for heights in (needles, [])]
    if tracer == "ours":
        found, expected = (picture(scene, camera, "standard")["electrons"] for scene in scenes)
    else:
        found, expected = (path_traced(scene, camera, spp=16, bounces=2) for scene in scenes)
        assert np.isfinite(found).all()
    assert (np.abs(found - expected) > 0.01 * expected).mean() < 0.02
    assert found.mean((0, 1)) == pytest.approx(expected.mean((0, 1)), rel=0.002)


@pytest.mark.parametrize("tracer", ["ours", "path"])
def test_a_heap_of_hairs(tracer):
    # A thousand triangles a metre long and a micrometre wide, any way about: as thin as no single precision
    # normal equations can solve.
    rng = np.random.default_rng(1)
    start = rng.uniform(-0.2, 0.2, (1000, 3)) + np.array([0.0, 0.0, 0.5])
    along = rng.normal(size=(1000, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    beside = np.cross(along, rng.normal(size=(1000, 3)))
    beside *= 1e-6 / np.linalg.norm(beside, axis=1, keepdims=True)
    corners = np.stack([start, start + along, start + along / 2 + beside], axis=1)
    mesh = concatenate_meshes([triangles(corners), sheet(0.4, 0.4, 0.8, "back")])
    scene = assemble_scene(
        mesh, {"leaf": surface("leaf", 0.4, 0.4, 1.4), "back": surface("back", 0.5)}, DAYLIGHT
    )
    camera = bench_camera(columns=40, rows=30)
    alone = assemble_scene(sheet(0.4, 0.4, 0.8, "back"), {"back": surface("back", 0.5)}, DAYLIGHT)
    if tracer == "ours":
        found, expected = (picture(one, camera, "standard")["electrons"] for one in (scene, alone))
    else:
        found, expected = (path_traced(one, camera, spp=16, bounces=2) for one in (scene, alone))
        assert np.isfinite(found).all()
        assert found.min() >= 0.0
    # All together cover a thousandth of the picture.
    assert found.mean((0, 1)) == pytest.approx(expected.mean((0, 1)), rel=0.01)


@pytest.mark.parametrize("tilt", [0.0, 0.4])
def test_leaves_in_one_plane_show_one_or_the_other(tilt):
    # A dark and a pale leaf in the same plane: each pixel shows one of them, and is as bright as a leaf of
    # one of both kinds or a mixture, whichever is hit.
    cosine, sine = np.cos(tilt), np.sin(tilt)
    turn = np.array([[1, 0, 0], [0, cosine, -sine], [0, sine, cosine]])
    centre = np.array([0.0, 0.0, 0.5])
    dark, pale = (
        sheet(0.3, size, 0.5, name).moved(turn, centre - turn @ centre)
        for name, size in (("dark", 0.3), ("pale", 0.35))
    )
    surfaces = {"dark": surface("dark", 0.1), "pale": surface("pale", 0.8)}
    camera = point_flash_camera(columns=24, rows=18)
    both = picture(assemble_scene(concatenate_meshes([dark, pale]), surfaces), camera)
    lower, upper = (picture(assemble_scene(one, surfaces), camera)["electrons"] for one in (dark, pale))
    assert set(np.unique(both["instance"])) <= {1, 2}
    # Single scattering, so that nothing but the leaf hit decides; samples of a pixel may hit either.
    assert (both["electrons"] >= lower * 0.999).all()
    assert (both["electrons"] <= upper * 1.001).all()


# --- next to nothing -------------------------------------------------------------------------------------


@pytest.mark.parametrize("outputs", [("electrons",), ("class",)])
def test_a_mesh_of_nothing_is_refused(outputs):
    mesh = sheet(0.2, 0.2, 0.5, "leaf")
    no_faces = replace(
        mesh, faces=mesh.faces[:0], face_instance=mesh.face_instance[:0], face_surface=mesh.face_surface[:0]
    )
    nothing = replace(
        no_faces, vertices=mesh.vertices[:0], normals=mesh.normals[:0], uv=mesh.uv[:0], state=mesh.state[:0]
    )
    for empty in (no_faces, nothing):
        with pytest.raises(ValueError, match="the mesh has no triangles"):
            Renderer(grey(empty, sky=DAYLIGHT)).render(bench_camera(columns=4, rows=4), outputs)


def test_one_triangle_is_enough():
    corners = np.array([[[-1.0, -1.0, 0.5], [0.0, 1.0, 0.5], [1.0, -1.0, 0.5]]])
    one = picture(grey(triangles(corners), sky=DAYLIGHT), point_flash_camera(), "standard")
    whole = picture(grey(sheet(2.0, 2.0, 0.5, "leaf"), sky=DAYLIGHT), point_flash_camera(), "standard")
    assert (one["class"] > 0).all()
    assert one["electrons"] == pytest.approx(whole["electrons"], rel=0.2)
    assert one["electrons"].mean() == pytest.approx(whole["electrons"].mean(), rel=0.01)


@pytest.mark.parametrize("quality", ["draft", "standard"])
def test_with_all_things_behind_the_camera_there_is_only_the_sky(quality):
    scene = grey(sheet(0.2, 0.2, -0.5, "leaf"), sky=DAYLIGHT)
    frame = picture(scene, bench_camera(columns=16, rows=12), quality)
    assert not frame["class"].any()
    open_sky = picture(
        grey(sheet(1e-3, 1e-3, -5e3, "leaf"), sky=DAYLIGHT),
        bench_camera(columns=16, rows=12, flash=False),
        quality,
    )
    assert frame["electrons"] == pytest.approx(open_sky["electrons"], rel=1e-3)


def test_at_night_with_all_things_behind_the_camera_there_is_nothing():
    frame = picture(grey(sheet(0.2, 0.2, -0.5, "leaf")), bench_camera(columns=16, rows=12), "standard")
    assert frame["electrons"].max() == 0.0


# --- numbers that are none, and hardly any ----------------------------------------------------------------


@pytest.mark.parametrize("outputs", [("electrons",), ("distance",)])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ["vertices", "normals", "uv", "state"])
def test_meshes_of_no_numbers_are_refused(name, bad, outputs):
    mesh = sheet(0.2, 0.2, 0.5, "leaf")
    broken = getattr(mesh, name).copy()
    broken.flat[-1] = bad
    with pytest.raises(ValueError, match=rf"the mesh's {name} must be"):
        Renderer(grey(replace(mesh, **{name: broken}))).render(bench_camera(columns=4, rows=4), outputs)


@pytest.mark.parametrize("far", [1.1e7, 1e30])
def test_meshes_that_reach_beyond_all_measure_are_refused(far):
    with pytest.raises(ValueError, match="within 1e"):
        Renderer(grey(sheet(2 * far, 1.0, 0.5, "leaf"))).render(bench_camera(columns=4, rows=4), ["class"])


@pytest.mark.parametrize("small", [1e-20, 1e-38, 1e-45])
def test_denormal_vertices_are_zero(small):
    # As a share of a leaf's corners, and as a whole triangle's size.
    mesh = sheet(0.2, 0.2, 0.5, "leaf")
    x = mesh.vertices.copy()
    x[:, 0] += np.array([small, -small, small, -small], np.float32)
    camera = bench_camera(columns=16, rows=12)
    found = picture(grey(replace(mesh, vertices=x), sky=DAYLIGHT), camera, "standard")
    assert np.array_equal(
        found["electrons"], picture(grey(mesh, sky=DAYLIGHT), camera, "standard")["electrons"]
    )
    speck = np.array([[[0, 0, 0], [small, 0, 0], [0, small, 0]]])
    picture(grey(triangles(speck), sky=DAYLIGHT), camera, "standard")
    beside = concatenate_meshes([mesh, triangles(speck, name="speck")])
    assert_sound(picture(grey(beside, sky=DAYLIGHT), camera, "standard"))
