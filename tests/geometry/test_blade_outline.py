"""Outline, triangles, normals and texture coordinates of blades."""

from itertools import pairwise

import numpy as np
import pytest
from blade_meshes import (
    FLAT,
    LENGTH,
    LOBED,
    WIDTH,
    areas,
    blade,
    droop,
    edges,
    margin,
    organ,
    polygon_area,
    random_organ,
    signed_areas,
)
from hypothesis import given
from hypothesis import strategies as st
from organ_meshes import check_mesh, mesh_organs

from pepperscene.geometry.batch import vertex_normals
from pepperscene.geometry.blade.blades import mesh_blades
from pepperscene.geometry.blade.grid import blade_grid
from pepperscene.grammar.plant import Organ


def distance(points, polygon):
    """Distance of each point from a closed polygon."""
    start, step = polygon, np.roll(polygon, -1, axis=0) - polygon
    offset = points[:, None] - start
    fraction = np.clip((offset * step).sum(axis=2) / (step * step).sum(axis=1), 0.0, 1.0)
    return np.linalg.norm(offset - fraction[..., None] * step, axis=2).min(axis=1)


def outline(batch, k=0):
    return margin(batch.vertices[k], batch.faces)[:, :2]


def hausdorff(one, other):
    return max(distance(one, other).max(), distance(other, one).max())


@pytest.mark.parametrize("seed", [0.0, 0.21])
@pytest.mark.parametrize("asymmetry", [-0.1, 0.1])
@pytest.mark.parametrize("detail", [0.3, 1.0])
def test_flat_blade_has_the_stated_sizes(seed, asymmetry, detail):
    x, y, z = blade(seed=seed, asymmetry=asymmetry, detail=detail).vertices[0].T
    np.testing.assert_allclose(np.ptp(y), LENGTH, rtol=1e-9)
    # The width is that of the curve; its polygon stays within it.
    assert WIDTH * 0.99 < np.ptp(x) <= WIDTH * (1.0 + 1e-9)
    np.testing.assert_allclose(x.max() / np.ptp(x), 0.5 * (1.0 + asymmetry), atol=0.004)
    np.testing.assert_allclose(z, 0.0, atol=1e-12)


def test_outline_is_ovate_with_a_drawn_out_tip():
    x, y, _ = blade(detail=2.0).vertices[0].T
    bands = np.array([np.ptp(x[np.abs(y / LENGTH - v) < 0.03]) for v in (0.1, 0.37, 0.75, 0.93)]) / WIDTH
    assert bands[1] > 0.98
    assert 0.5 < bands[0] < 0.8
    assert bands[2] < 0.6
    assert bands[3] < 0.25


@pytest.mark.parametrize("widest", [0.25, 0.35, 0.45])
@pytest.mark.parametrize("base", [0.5, 0.8])
def test_blade_is_widest_at_the_stated_place(widest, base):
    x, y, _ = blade(detail=2.0, widest=widest, base=base).vertices[0].T
    assert y[x.argmax()] / LENGTH == pytest.approx(widest, abs=0.02)


@pytest.mark.parametrize(("measures", "tolerance", "rel"), [({}, 0.004, 0.004), (LOBED, 0.045, 0.01)])
def test_outline_is_the_same_at_every_detail(measures, tolerance, rel):
    """The polygons differ by half a millimetre on a pepper's leaf; slits between lobes may be cut short."""
    *coarser, finest = (
        outline(blade(detail=detail, seed=0.6, **measures)) for detail in (0.3, 0.5, 1.0, 2.0)
    )
    for line in coarser:
        assert hausdorff(line, finest) < tolerance * LENGTH
        assert polygon_area(line) == pytest.approx(polygon_area(finest), rel=rel)


def test_lobes_point_to_the_tip():
    """Each half has several notches; the lobes between them lean forward."""
    line = outline(blade(detail=2.0, widest=0.3, **LOBED))
    right = line[: line[:, 1].argmax()]
    x = right[:, 0]
    tops = np.flatnonzero((x[1:-1] > x[:-2]) & (x[1:-1] > x[2:])) + 1
    notches = [a + x[a:b].argmin() for a, b in pairwise(tops)]
    assert len(tops) >= 2
    assert max(x[a] - x[b] for a, b in zip(tops, notches, strict=False)) > 0.03 * WIDTH
    for top, notch in zip(tops, notches, strict=False):
        below = top - 1 - np.argmax((x[:top] <= x[notch])[::-1]) if (x[:top] <= x[notch]).any() else 0
        assert right[notch, 1] - right[top, 1] < right[top, 1] - right[below, 1]


@pytest.mark.parametrize("detail", [0.1, 0.45, 1.0, 2.0])
@pytest.mark.parametrize("lobes", [0.0, 8.0])
def test_grid_is_one_disc(detail, lobes):
    """Every edge has one or two faces of the same winding; Euler's number is that of a disc."""
    faces = blade_grid(detail, lobes).faces
    directed, counts = np.unique(edges(faces), axis=0, return_counts=True)
    assert counts.max() == 1
    assert len(directed) == 3 * len(faces)
    assert len(np.unique(np.sort(faces, axis=1), axis=0)) == len(faces)
    edge_count = len(np.unique(np.sort(edges(faces), axis=1), axis=0))
    point_count = len(np.unique(faces))
    assert point_count == faces.max() + 1 == blade(detail=detail, lobes=lobes).vertices.shape[1]
    assert point_count - edge_count + len(faces) == 1


@pytest.mark.parametrize("aspect", [0.3, 1.4])
@pytest.mark.parametrize("base", [0.5, 0.9])
@pytest.mark.parametrize("detail", [0.3, 1.0])
def test_no_triangle_of_a_flat_blade_is_inverted(aspect, base, detail):
    for widest in (0.25, 0.35, 0.45):
        flat = blade(width_m=aspect * LENGTH, base=base, widest=widest, asymmetry=0.05, detail=detail)
        assert signed_areas(flat.uv, flat.faces).min() > 0.0


@pytest.mark.parametrize("seed", [0.05, 0.5, 0.77])
def test_lobes_invert_hardly_any_triangle(seed):
    batch = blade(seed=seed, base=0.7, widest=0.32, **LOBED)
    area = signed_areas(batch.uv, batch.faces)
    assert area[area < 0.0].sum() > -0.001 * area.sum()


@given(
    seed=st.integers(0, 2**20),
    factor=st.sampled_from([0.0, 1.0, 10.0]),
    length=st.sampled_from([0.001, 0.05, 0.135, 0.3]),
    aspect=st.floats(0.1, 1.5),
    asymmetry=st.floats(-1.0, 1.0),
    lobes=st.sampled_from([0.0, 4.0]),
    detail=st.floats(0.1, 2.0),
)
def test_any_blade_is_sound(seed, factor, length, aspect, asymmetry, lobes, detail):
    drawn = random_organ(np.random.default_rng(seed), factor, lobes=lobes, lobe_depth=0.3)
    scale = length / LENGTH
    sizes = {name: scale * drawn.measures[name] for name in ("margin_wave_m", "blister_m", "vein_m")}
    sizes |= {"length_m": length, "width_m": aspect * length, "asymmetry": asymmetry}
    scaled = Organ("blade", -1, 0, drawn.curve * scale, drawn.up, {**drawn.measures, **sizes})
    mesh = mesh_organs(scaled, detail=detail)
    check_mesh(mesh)
    assert len(np.unique(mesh.vertices, axis=0)) == len(mesh.vertices)
    area = areas(mesh_blades([scaled], detail))
    assert area.min() > 1e-9 * area.sum()


def test_normals_are_area_weighted_means_of_faces():
    rng = np.random.default_rng(8)
    batch = mesh_blades([random_organ(rng) for _ in range(2)], 0.5)
    for vertices, normals in zip(batch.vertices, batch.normals, strict=True):
        total = np.zeros_like(vertices)
        for a, b, c in batch.faces:
            total[[a, b, c]] += np.cross(vertices[b] - vertices[a], vertices[c] - vertices[a])
        np.testing.assert_allclose(normals, total / np.linalg.norm(total, axis=1, keepdims=True), atol=1e-9)
    # The normal of a vertex without faces is zero.
    triangle = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 5, 5]]])
    normals = vertex_normals(triangle, np.array([[0, 1, 2]]))
    np.testing.assert_array_equal(normals[0], [[0, 0, 1]] * 3 + [[0, 0, 0]])


def test_normals_point_out_of_the_upper_side():
    assert blade().normals[..., 2].min() > 0.99
    upside_down = Organ("lamina", -1, 0, organ().curve, np.array([0.0, 0.0, -1.0]), FLAT)
    assert mesh_blades([upside_down], 1.0).normals[..., 2].max() < -0.99


def test_uv_are_coordinates_of_the_flat_leaf():
    bent = blade(droop(1.0), fold_rad=0.4, curl_rad=0.5, margin_wave_m=0.003, margin_waves=4.0)
    flat = blade()
    np.testing.assert_array_equal(bent.uv, flat.uv)
    np.testing.assert_allclose(flat.vertices[..., 1], flat.uv[..., 1] * LENGTH, atol=1e-9)
    np.testing.assert_allclose(flat.vertices[..., 0], (flat.uv[..., 0] - 0.5) * WIDTH, atol=1e-9)
