"""Triangles without area, duplicate, thin or coplanar; meshes that are empty or not finite."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import EVEN_SKY, axis_camera, card, sheet
from greenhouse import camera as greenhouse_camera
from greenhouse import greenhouse
from strain import OUTPUTS, grey, render, surface, triangles, with_faces

from pepperscene.camera import Camera
from pepperscene.geometry import Mesh, concatenate_meshes
from pepperscene.render import Renderer
from pepperscene.render.reference.path_tracer import path_traced
from pepperscene.scene import Scene, assemble_scene


@pytest.mark.long
def test_triangles_without_area_change_nothing():
    # Coincident and collinear corners all over the plants.
    scene, camera = greenhouse(), greenhouse_camera(columns=40, rows=30)
    mesh, rng = scene.mesh, np.random.default_rng(0)
    pairs = rng.integers(0, len(mesh.vertices), (200, 2))
    vertices = {"vertices": mesh.vertices[pairs].mean(axis=1)}
    vertices |= {name: getattr(mesh, name)[pairs[:, 0]] for name in ("normals", "uv", "state")}
    extended = replace(mesh, **{k: np.concatenate([getattr(mesh, k), more]) for k, more in vertices.items()})
    coincident = np.concatenate([pairs[:, [0, 0, 0]], pairs[:, [0, 1, 0]]])
    collinear = np.column_stack([pairs, len(mesh.vertices) + np.arange(200)])
    result = render(replace(scene, mesh=with_faces(extended, coincident)), camera)
    expected = render(scene, camera)
    for name in OUTPUTS:
        assert np.array_equal(result[name], expected[name]), name
    # Midpoints are rounded, so these have an area of 1e-8 m times their length: a pixel in 10^9.
    result = render(replace(scene, mesh=with_faces(extended, collinear)), camera)
    assert (result["class"] != expected["class"]).mean() <= 0.001
    assert result["electrons"].mean() == pytest.approx(expected["electrons"].mean(), rel=0.01)


def test_duplicate_triangles_count_once():
    # Rays are offset from all of them at once: no light is lost between the copies of a translucent leaf.
    mesh = concatenate_meshes([card(0.01, 0.0, 0.02, 0.2, "front", 0.4), sheet(0.2, 0.2, 0.5, "back")])
    surfaces = {name: surface(name, 0.4, 0.5, 1.4) for name in mesh.surfaces}
    names = ("faces", "face_instance", "face_surface", "face_appearance")
    repeated = replace(mesh, **{name: np.concatenate([getattr(mesh, name)] * 3) for name in names})
    camera = axis_camera(24, 18)
    result, expected = (
        render(assemble_scene(one, surfaces, EVEN_SKY), camera, "standard") for one in (repeated, mesh)
    )
    for name in ("class", "instance", "distance"):
        assert np.array_equal(result[name], expected[name])
    assert result["electrons"] == pytest.approx(expected["electrons"], rel=1e-3)


def strips(heights: list[float]) -> Mesh:
    """A square of 20 cm, 40 cm ahead, cut into strips at these heights."""
    y = np.array([-0.1, *heights, 0.1])
    x, y, z = (part.ravel() for part in np.broadcast_arrays([-0.1, 0.1], y[:, None], 0.4))
    corners = np.column_stack([x, y, z])
    first = 2 * np.arange(len(heights) + 1)[:, None]
    faces = np.concatenate([first + np.array([0, 2, 1]), first + np.array([1, 2, 3])])
    mesh = triangles(corners[faces], corners[faces].reshape(-1, 3)[:, :2] * 5.0 + 0.5)
    return replace(mesh, normals=np.tile(np.array([0, 0, -1], np.float32), (len(mesh.vertices), 1)))


def electrons(tracer: str, scene: Scene, camera: Camera) -> np.ndarray:
    if tracer == "ours":
        return render(scene, camera, "standard")["electrons"]
    result = path_traced(scene, camera, spp=16, bounces=2)
    assert np.isfinite(result).all()
    assert result.min() >= 0.0
    return result


@pytest.mark.parametrize("tracer", ["ours", pytest.param("path", marks=pytest.mark.long)])
def test_thin_strips_of_a_leaf_are_invisible(tracer):
    # A leaf with relief, whole and with strips of 20 cm by 2e-7 m: 200 side by side, and a few others. The
    # light differs by rounding only, except for rays that hit an edge.
    heights = [*(1e-3 + 2e-7 * np.arange(200)), 0.01, 0.01 + 2e-7, 0.02, 0.02 + 4e-7]
    waves = np.sin(np.linspace(0.0, 40.0, 64))[:, None] * np.ones((64, 64))
    leaf = replace(surface("leaf", 0.4, 0.4, 1.4), relief_mm=waves.astype(np.float32)[None])
    result, expected = (
        electrons(tracer, assemble_scene(strips(cuts), {"leaf": leaf}, EVEN_SKY), axis_camera(16, 48))
        for cuts in (heights, [])
    )
    assert (np.abs(result - expected) > 0.01 * expected).mean() < 0.02
    assert result.mean((0, 1)) == pytest.approx(expected.mean((0, 1)), rel=0.002)


@pytest.mark.long
@pytest.mark.parametrize("tracer", ["ours", "path"])
def test_hair_thin_triangles_hardly_change_the_light(tracer):
    # A thousand triangles a metre long and a micrometre wide in random directions: too thin for normal
    # equations in single precision. Together they cover a thousandth of the image.
    rng = np.random.default_rng(1)
    start = rng.uniform(-0.2, 0.2, (1000, 3)) + np.array([0.0, 0.0, 0.5])
    along = rng.normal(size=(1000, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along, rng.normal(size=(1000, 3)))
    across *= 1e-6 / np.linalg.norm(across, axis=1, keepdims=True)
    corners = np.stack([start, start + along, start + along / 2 + across], axis=1)
    surfaces = {"leaf": surface("leaf", 0.4, 0.4, 1.4), "back": surface("back", 0.5)}
    back = sheet(0.4, 0.4, 0.8, "back")
    result, expected = (
        electrons(tracer, assemble_scene(mesh, surfaces, EVEN_SKY), axis_camera(40, 30))
        for mesh in (concatenate_meshes([triangles(corners), back]), back)
    )
    assert result.mean((0, 1)) == pytest.approx(expected.mean((0, 1)), rel=0.01)


@pytest.mark.parametrize("arrays", [("face",), ("face", "vert", "normals", "uv", "state")])
def test_rejects_empty_meshes(arrays):
    mesh = sheet(0.2, 0.2, 0.5, "leaf")
    empty = {k: v[:0] for k, v in vars(mesh).items() if k.startswith(arrays) and isinstance(v, np.ndarray)}
    with pytest.raises(ValueError, match="the mesh has no triangles"):
        Renderer(grey(replace(mesh, **empty), sky=EVEN_SKY)).render(axis_camera(4, 4), ["class"])


@pytest.mark.parametrize("bad", [np.nan, -np.inf])
@pytest.mark.parametrize("name", ["vertices", "normals", "uv", "state"])
def test_rejects_non_finite_meshes(name, bad):
    mesh = sheet(0.2, 0.2, 0.5, "leaf")
    broken = getattr(mesh, name).copy()
    broken.flat[-1] = bad
    with pytest.raises(ValueError, match=rf"the mesh's {name} must be"):
        Renderer(grey(replace(mesh, **{name: broken}))).render(axis_camera(4, 4), ["electrons"])


@pytest.mark.parametrize("far", [1.1e7, 1e30])
def test_rejects_too_large_meshes(far):
    with pytest.raises(ValueError, match="within 1e"):
        Renderer(grey(sheet(2 * far, 1.0, 0.5, "leaf"))).render(axis_camera(4, 4), ["class"])


@pytest.mark.parametrize("small", [1e-38, pytest.param(1e-45, marks=pytest.mark.long)])
def test_denormal_coordinates_are_zero(small):
    mesh, camera = sheet(0.2, 0.2, 0.5, "leaf"), axis_camera(16, 12)
    shifted = mesh.vertices.copy()
    shifted[:, 0] += np.array([small, -small, small, -small], np.float32)
    result, expected = (
        render(grey(one, sky=EVEN_SKY), camera, "standard")["electrons"]
        for one in (replace(mesh, vertices=shifted), mesh)
    )
    assert np.array_equal(result, expected)
    # A triangle of that size, alone and in front of a leaf.
    speck = triangles(np.array([[[0, 0, 0], [small, 0, 0], [0, small, 0]]]), name="speck")
    for one in (speck, concatenate_meshes([mesh, speck])):
        render(grey(one, sky=EVEN_SKY), camera, "standard")
