from __future__ import annotations

import numpy as np
import pytest

from pepperscene.geometry import mesh_plant
from pepperscene.geometry.lamina import vein_start
from pepperscene.grammar.plant import Organ, Plant
from pepperscene.materials.venation import ARC, BASE_COT, TIP_COT

LENGTH, WIDTH = 0.135, 0.085
FLAT = {"length_m": LENGTH, "width_m": WIDTH, "seed": 0.37, "state_mean": 0.6, "state_spread": 0.1}


def blade(curve=None, detail=1.0, **measures):
    """A blade that lies in the xy plane and points along y, upper side up, unless told otherwise."""
    line = np.array([[0.0, 0, 0], [0.0, LENGTH, 0.0]]) if curve is None else curve
    organ = Organ("lamina", -1, 0, line, np.array([0.0, 0.0, 1.0]), FLAT | measures)
    return mesh_plant(Plant("hand-made", (organ,)), detail)


def areas(mesh):
    a, b, c = (mesh.vertices[mesh.faces[:, corner]].astype(float) for corner in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def droop(angle, points=14):
    """A midrib that bends down evenly by `angle` from base to tip."""
    slope = angle * (np.arange(points - 1) + 0.5) / (points - 1)
    steps = np.stack([0.0 * slope, np.cos(slope), -np.sin(slope)], axis=1) * LENGTH / (points - 1)
    return np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


@pytest.mark.parametrize("seed", [0.0, 0.21, 0.55, 0.93])
@pytest.mark.parametrize("uneven", [-0.1, 0.0, 0.1])
def test_a_flat_blade_measures_what_it_says(seed, uneven):
    mesh = blade(seed=seed, asymmetry=uneven)
    x, y, z = mesh.vertices.T
    np.testing.assert_allclose(np.ptp(y), LENGTH, rtol=1e-5)
    # Callipers find the width but for the sideways bend of the tip and the steps of the margin.
    np.testing.assert_allclose(np.ptp(x), WIDTH, rtol=0.02)
    np.testing.assert_allclose(z, 0.0, atol=1e-7)
    assert (x.max() + x.min() > 0) == (uneven > 0) or uneven == 0.0


@pytest.mark.parametrize("seed", [0.1, 0.6])
def test_the_outline_is_ovate_with_a_drawn_out_tip(seed):
    mesh = blade(seed=seed, detail=2.0)
    x, y, _ = mesh.vertices.T
    bands = np.array([np.ptp(x[np.abs(y / LENGTH - v) < 0.03]) for v in (0.1, 0.37, 0.75, 0.93)]) / WIDTH
    assert bands[1] > 0.95
    assert 0.4 < bands[0] < 0.8
    assert bands[2] < 0.6
    assert bands[3] < 0.25


@pytest.mark.parametrize("aspect", [0.3, 0.83, 1.4])
@pytest.mark.parametrize("seed", [0.05, 0.5, 0.77])
def test_no_triangle_of_a_flat_blade_is_turned_over(aspect, seed):
    mesh = blade(width_m=aspect * LENGTH, seed=seed)
    a, b, c = (mesh.vertices[mesh.faces[:, corner], :2].astype(float) for corner in range(3))
    turn = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    assert turn.min() > 0.0


def test_normals_leave_the_upper_side():
    assert blade().normals[:, 2].min() > 0.99
    upside_down = Organ(
        "lamina", -1, 0, np.array([[0.0, 0, 0], [0, LENGTH, 0]]), np.array([0, 0, -1.0]), FLAT
    )
    assert mesh_plant(Plant("hand-made", (upside_down,))).normals[:, 2].max() < -0.99


def test_uv_are_the_flat_leaf():
    mesh = blade(droop(1.0), fold_rad=0.4, curl_rad=0.5, margin_wave_m=0.003, margin_waves=4.0)
    flat = blade()
    np.testing.assert_allclose(mesh.uv, flat.uv, atol=1e-6)
    np.testing.assert_allclose(flat.vertices[:, 1], flat.uv[:, 1] * LENGTH, atol=1e-6)
    np.testing.assert_allclose(flat.vertices[:, 0], (flat.uv[:, 0] - 0.5) * WIDTH, atol=1e-6)


@pytest.mark.parametrize(
    "measures", [{"fold_rad": 0.5}, {"curl_rad": 1.0}, {"curl_rad": -0.8, "fold_rad": 0.3}]
)
def test_folding_and_curling_keep_the_area(measures):
    np.testing.assert_allclose(areas(blade(**measures)).sum(), areas(blade()).sum(), rtol=0.01)


def test_bending_and_twisting_roughly_keep_the_area():
    np.testing.assert_allclose(areas(blade(droop(1.2))).sum(), areas(blade()).sum(), rtol=0.01)
    np.testing.assert_allclose(areas(blade(twist_rad=0.6)).sum(), areas(blade()).sum(), rtol=0.05)


def test_the_halves_rise_by_the_fold():
    fold = 0.4
    x, _, z = blade(fold_rad=fold).vertices.T
    # Each half may fold by a quarter more or less, by the seed.
    for half in (x < -0.01, x > 0.01):
        angle = np.arctan2(z[half], np.abs(x[half]))
        np.testing.assert_allclose(angle, angle[0], atol=0.12)
        assert 0.75 * fold <= np.median(angle) <= 1.25 * fold


def test_a_positive_curl_lifts_the_margins():
    assert blade(curl_rad=0.6).vertices[:, 2].min() > -1e-7
    assert blade(curl_rad=-0.6).vertices[:, 2].max() < 1e-7


def test_the_midrib_follows_the_curve():
    curve = droop(1.0)
    mesh = blade(curve, fold_rad=0.3)
    base, tip = mesh.vertices[0], mesh.vertices[-1]
    np.testing.assert_allclose(base, curve[0], atol=1e-6)
    # The tip is bent to one side by at most a twentieth of the length.
    assert np.linalg.norm(tip - curve[-1]) < 0.051 * LENGTH


def test_waves_and_bulges_have_their_amplitude():
    waves = blade(margin_wave_m=0.004, margin_waves=4.0).vertices[:, 2]
    assert 0.0025 < np.abs(waves).max() < 0.0041
    bulges = blade(blister_m=0.002).vertices[:, 2]
    assert 0.001 < bulges.max() < 0.005


@pytest.mark.parametrize("seed", [0.2, 0.5])
def test_bulges_rise_between_the_veins_of_the_material(seed):
    mesh = blade(blister_m=0.002, detail=3.0, seed=seed)
    # Away from midrib and margin: which vein a place belongs to, by the law of `materials.venation`.
    out, y = np.abs(mesh.uv[:, 0] - 0.5) * WIDTH, mesh.uv[:, 1] * LENGTH
    inner = (out > 0.008) & (out < 0.025) & (mesh.uv[:, 1] > 0.3) & (mesh.uv[:, 1] < 0.8)
    bend = ARC * WIDTH / 6.0 * (2.0 * out / WIDTH) ** 3
    start = (y - BASE_COT * out - bend) / (LENGTH + (TIP_COT - BASE_COT) * out)
    starts = vein_start(np.arange(8.0))
    off = np.abs(start[:, None] - starts).min(axis=1)
    on_vein, between = inner & (off < 0.012), inner & (off > 0.045)
    assert between.sum() > 20
    height = mesh.vertices[:, 2]
    # Most of the 2 mm; smooth unevenness lifts veins and bulges alike.
    assert height[between].mean() > height[on_vein].mean() + 0.0006


def test_state_has_its_mean_and_spread():
    spreads, means = [], []
    for seed in np.linspace(0.0, 0.95, 20):
        state = blade(seed=seed).state
        means.append(state.mean())
        spreads.append(state.std())
    assert abs(np.mean(means) - 0.6) < 0.04
    assert 0.05 < np.mean(spreads) < 0.12


def test_every_seed_gives_another_blade():
    shapes = [blade(seed=seed).vertices for seed in (0.1, 0.11, 0.5)]
    for one, other in ((0, 1), (1, 2), (0, 2)):
        assert np.abs(shapes[one] - shapes[other]).max() > 5e-4
