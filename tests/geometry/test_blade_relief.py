"""Folds, curls, waves, bulges, veins and random variation of blades."""

import numpy as np
import pytest
from blade_meshes import KAITE, LENGTH, WIDTH, areas, blade, droop, edges, margin, organ, random_organ
from scipy.spatial.transform import Rotation

from pepperscene.geometry.blade.blades import mesh_blades
from pepperscene.geometry.blade.grid import origin_of_vein_at, vein_number, vein_origin, vein_rise
from pepperscene.materials.leaf_textures import SIGMAS_MM
from pepperscene.materials.venation import BladeGrid, FieldTile, grow_veins


def width_over_surface(batch, v, k=0):
    """Length along the surface from margin to margin at a texture coordinate v, metres."""
    height = batch.uv[k, :, 1] - v
    total = 0.0
    for face in batch.faces:
        ends = []
        for a, b in ((face[0], face[1]), (face[1], face[2]), (face[2], face[0])):
            if (height[a] < 0.0) != (height[b] < 0.0):
                fraction = height[a] / (height[a] - height[b])
                ends.append(batch.vertices[k, a] * (1.0 - fraction) + batch.vertices[k, b] * fraction)
        total += np.linalg.norm(ends[1] - ends[0]) if ends else 0.0
    return total


def midrib_lengths(batch):
    """`(n,)` lengths of the polylines where u is one half."""
    middle = np.flatnonzero(np.all(batch.uv[..., 0] == 0.5, axis=0))
    middle = middle[np.argsort(batch.uv[0, middle, 1])]
    return np.linalg.norm(np.diff(batch.vertices[:, middle], axis=1), axis=2).sum(axis=1)


@pytest.mark.parametrize("detail", [0.4, 1.0, 2.0])
def test_midribs_keep_their_length(detail):
    rng = np.random.default_rng(5)
    batch = mesh_blades([random_organ(rng) for _ in range(20)], detail)
    np.testing.assert_allclose(midrib_lengths(batch), LENGTH, rtol=0.01)


@pytest.mark.parametrize(
    "measures",
    [
        {"fold_rad": 0.6},
        {"curl_rad": 0.6},
        {"curl_rad": -0.6},
        {"blister_m": 0.0016},
        {"blister_m": 0.003, "vein_m": 5e-4},
    ],
    ids=str,
)
def test_widths_are_kept_over_folds_curls_and_bulges(measures):
    assert width_over_surface(blade(seed=0.7, **measures), 0.36) == pytest.approx(WIDTH, rel=0.02)


@pytest.mark.parametrize(
    ("curve", "measures", "error"),
    [
        (None, {"fold_rad": 0.5}, 0.05),
        (None, {"curl_rad": 1.0}, 0.05),
        (None, {"curl_rad": -0.8, "fold_rad": 0.3}, 0.05),
        (None, {"twist_rad": 0.6}, 0.05),
        (droop(1.2), {}, 0.01),
    ],
)
def test_bending_keeps_the_area(curve, measures, error):
    np.testing.assert_allclose(areas(blade(curve, **measures)).sum(), areas(blade()).sum(), rtol=error)


def test_halves_rise_by_the_fold_most_at_the_midrib():
    fold, ratios = 0.4, []
    for seed in np.linspace(0.05, 0.95, 10):
        x, y, z = blade(fold_rad=fold, seed=seed, detail=2.0).vertices[0].T
        for side in (-1.0, 1.0):
            across, middle = side * x, np.abs(y / LENGTH - 0.4) < 0.2
            inner, outer = middle & (across > 0.002) & (across < 0.008), middle & (across > 0.045)
            steep, mean = (np.arctan2(z[rows], across[rows]).mean() for rows in (inner, outer))
            # Each half may fold by a quarter more or less, and again along its length.
            assert 0.55 * fold < mean < 1.55 * fold
            ratios.append(steep / mean)
    assert 1.1 < np.mean(ratios) < 1.5


def test_midrib_follows_the_curve():
    curve = droop(1.0)
    plain = blade(curve, fold_rad=0.3)
    np.testing.assert_allclose(plain.vertices[0, [0, -1]], curve[[0, -1]], atol=2e-4)
    # Wavy blades bend their tips, by some millimetres, mostly down.
    rng = np.random.default_rng(9)
    tips = np.array([blade(seed=rng.random(), margin_wave_m=0.004).vertices[0, -1] for _ in range(30)])
    assert tips[:, 2].mean() < -0.001
    assert np.abs(tips - [0.0, LENGTH, 0.0]).max() < 0.2 * LENGTH


@pytest.mark.parametrize("seed", [0.1, 0.37, 0.7])
def test_margins_of_folded_wavy_blades_are_smooth_between_the_rows(seed):
    # A wave is at right angles to the folded half, at the points between the rows as at those of the rows.
    batch = blade(seed=seed, detail=2.0, fold_rad=0.9, margin_wave_m=0.004, margin_waves=4.0)
    across = margin(batch.vertices[0], batch.faces)[:, 0]
    bend = across - 0.5 * (np.roll(across, 1) + np.roll(across, -1))
    assert np.abs(bend[3:-3]).max() < 0.0025


def test_waves_have_the_stated_amplitude():
    for seed in (0.1, 0.5, 0.9):
        height = np.abs(blade(seed=seed, margin_wave_m=0.004, margin_waves=4.0).vertices[..., 2])
        assert 0.002 < height.max() < 0.02


@pytest.mark.parametrize("height", [0.001, 0.003])
def test_bulges_have_the_stated_height(height):
    tops = [
        np.percentile(blade(seed=seed, blister_m=height, detail=2.0).vertices[..., 2], 98)
        for seed in (0.1, 0.5, 0.9)
    ]
    assert np.mean(tops) == pytest.approx(height, rel=0.4)


def test_vein_formulas_have_their_inverses():
    number, out = np.meshgrid(np.linspace(0.0, 7.0, 15), np.linspace(0.0, 1.0, 9))
    origin = vein_origin(number)
    np.testing.assert_allclose(origin_of_vein_at(origin + vein_rise(origin, out), out), origin, atol=1e-12)
    assert vein_number(float(vein_origin(np.array(3.5)))) == pytest.approx(3.5)


def test_bulges_rise_between_the_veins_of_the_material():
    """Veins as the material grows them on its own leaf, found on the mesh through uv."""
    grid = BladeGrid.build((112.0, 135.0), pixels=128)
    rng = np.random.default_rng(3)
    tile = FieldTile.build(grid, SIGMAS_MM, rng)
    distance_mm = np.mean([grow_veins(grid, tile, part).lateral_mm for part in rng.spawn(24)], axis=0)
    rows, columns = grid.shape
    differences = []
    for seed in np.linspace(0.03, 0.97, 12):
        batch = blade(blister_m=0.002, vein_m=0.0006, detail=3.0, seed=seed)
        (u, v), height = batch.uv[0].T, batch.vertices[0, :, 2]
        distance = distance_mm[(v * (rows - 0.01)).astype(int), (u * (columns - 0.01)).astype(int)]
        inner = (np.abs(u - 0.5) > 0.1) & (np.abs(u - 0.5) < 0.3) & (v > 0.3) & (v < 0.8)
        low, high = np.percentile(distance[inner], [20, 80])
        top, bottom = height[inner & (distance >= high)], height[inner & (distance <= low)]
        differences.append(top.mean() - bottom.mean())
    # Domes are .45 of the stated height; the rest are blisters, which average out.
    assert min(differences) > 0.0002
    assert np.mean(differences) > 0.0004


def test_veins_are_sunken():
    depth = blade(vein_m=0.001, detail=2.0).vertices[..., 2] - blade(detail=2.0).vertices[..., 2]
    assert -0.001 < depth.min() < -0.0004
    assert depth.max() < 1e-6


def test_state_has_its_mean_and_spread():
    batch = mesh_blades([organ(seed=seed) for seed in np.linspace(0.0, 0.95, 30)], 1.0)
    assert abs(batch.state.mean() - 0.6) < 0.03
    assert 0.05 < batch.state.std(axis=1).mean() < 0.12


def test_every_seed_gives_another_shape():
    """With the same measures, and compared after the best rigid alignment."""
    same = {name: mean for name, (mean, _) in KAITE.items()}
    batch = mesh_blades([organ(droop(0.6), **same, seed=seed) for seed in (0.1, 0.11, 0.5)], 1.0).vertices
    for one, other in ((0, 1), (1, 2), (0, 2)):
        a, b = (batch[k] - batch[k].mean(axis=0) for k in (one, other))
        rotation, _ = Rotation.align_vectors(a, b)
        assert np.sqrt(np.mean(np.sum((a - rotation.apply(b)) ** 2, axis=1))) > 0.001


@pytest.mark.parametrize(
    "measures", [{}, {"rolled_rad": 4.2}, {"rolled_rad": -4.2}, {"ageing": 1.0}], ids=str
)
def test_random_blades_do_not_intersect_themselves(measures):
    """Edges of the triangles against all others that share no vertex with them."""
    rng = np.random.default_rng(21)
    batch = mesh_blades([random_organ(rng, **measures) for _ in range(4)], 0.5)
    assert sum(self_intersections(vertices, batch.faces) for vertices in batch.vertices) == 0


def self_intersections(vertices, faces):
    """Number of pairs of an edge and a triangle that meet away from a vertex (Moeller & Trumbore 1997)."""
    sides = np.unique(np.sort(edges(faces), axis=1), axis=0)
    low, high = vertices[faces].min(axis=1), vertices[faces].max(axis=1)
    start, end = vertices[sides[:, 0]], vertices[sides[:, 1]]
    near = np.all(
        (np.minimum(start, end)[:, None] <= high) & (np.maximum(start, end)[:, None] >= low), axis=2
    )
    near &= ~(faces[None, :, :, None] == sides[:, None, None, :]).any(axis=(2, 3))
    side, face = np.nonzero(near)
    a, b, c = (vertices[faces[face, k]] for k in range(3))
    origin, way = start[side], end[side] - start[side]
    ab, ac = b - a, c - a
    p = np.cross(way, ac)
    determinant = np.sum(ab * p, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.sum((origin - a) * p, axis=1) / determinant
        q = np.cross(origin - a, ab)
        v = np.sum(way * q, axis=1) / determinant
        t = np.sum(ac * q, axis=1) / determinant
    return int(np.sum((u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t >= 0.0) & (t <= 1.0)))
