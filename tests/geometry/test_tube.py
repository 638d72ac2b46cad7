from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from pepperscene.cultivar import load_cultivar
from pepperscene.cultivar.organs import USUAL
from pepperscene.geometry import mesh_plant
from pepperscene.grammar import grow
from pepperscene.grammar.plant import Organ, Plant

UPRIGHT = np.array([[0.0, 0, 0], [0.0, 0, 0.05], [0.0, 0.0, 0.1]])
SIZES = {
    "internode": {"radius_m": 0.005, "radius_tip_m": 0.0045, "groove_m": 5e-4},
    "node": {"radius_m": 0.008, "radius_end_m": 0.0045},
    "stalk": {"radius_m": 0.002, "radius_tip_m": 0.0013},
    "peduncle": {"radius_m": 0.0035, "radius_tip_m": 0.0045},
    "cut": {"radius_m": 0.004},
}


def tube(form, curve=UPRIGHT, up=(0.0, -1.0, 0.0), detail=1.0, parent=-1, **measures):
    organ = Organ(form, parent, 0, curve, np.array(up), SIZES[form] | measures)
    return mesh_plant(Plant("hand-made", (organ,), USUAL), detail)


def arc(bend, length=0.1, points=12, slope=0.4):
    """A curve of some length that turns down by `bend` radians, in the plane of x and z."""
    angle = slope - bend * (np.arange(400) + 0.5) / 400
    steps = np.stack([np.cos(angle), 0.0 * angle, np.sin(angle)], axis=1) * length / 400
    fine = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    return fine[np.linspace(0, 400, points).round().astype(int)]


def rings(mesh):
    """Rings `(r, c, 3)` from base to tip, without the caps' and without the point that closes each."""
    once = mesh.uv[:, 0] < 1.0
    levels = np.unique(mesh.uv[:, 1])[2:-2]
    return np.stack([mesh.vertices[once & (mesh.uv[:, 1] == level)] for level in levels]).astype(float)


def diameters(mesh):
    """Callipers over each ring: twice the greatest distance from its middle."""
    found = rings(mesh)
    return 2.0 * np.linalg.norm(found - found.mean(axis=1, keepdims=True), axis=2).max(axis=1)


def closed(mesh):
    points, number = np.unique(mesh.vertices, axis=0, return_inverse=True)
    return trimesh.Trimesh(points.astype(float), number.ravel()[mesh.faces], process=False)


def assert_sound(mesh):
    body = closed(mesh)
    assert body.is_watertight
    assert body.is_winding_consistent
    assert body.volume > 0.0
    assert body.area_faces.min() > 0.0
    assert len(np.unique(np.sort(body.faces, axis=1), axis=0)) == len(body.faces)
    for values in (mesh.vertices, mesh.normals, mesh.uv, mesh.state):
        assert np.isfinite(values).all()
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-5)
    assert mesh.uv.min() == 0.0
    assert mesh.uv.max() == 1.0
    assert mesh.state.min() >= 0.0
    assert mesh.state.max() <= 1.0


# --- measured back on the triangles -----------------------------------------------------------------------


@pytest.mark.parametrize("detail", [0.4, 1.0, 2.0])
@pytest.mark.parametrize(
    ("form", "curve"),
    [
        ("internode", UPRIGHT),
        ("stalk", arc(1.2)),
        ("stalk", arc(-0.6, length=0.03, slope=0.9)),
        ("peduncle", arc(1.7, length=0.046)),
    ],
)
def test_the_length_along_the_rings_is_the_curves(form, curve, detail):
    mesh = tube(form, curve, up=(-np.sin(0.4), 0.0, np.cos(0.4)) if form != "internode" else (0, -1, 0),
                detail=detail, seed=0.37)  # fmt: skip
    middle = rings(mesh).mean(axis=1)
    np.testing.assert_allclose(middle[[0, -1]], curve[[0, -1]], atol=1e-6)
    # A polyline with few pieces cuts corners; a chord falls short by a 24th of its squared turn.
    chords = np.diff(middle, axis=0)
    step = np.linalg.norm(chords, axis=1)
    turn = np.arccos(np.clip(np.sum(chords[1:] * chords[:-1], axis=1) / (step[1:] * step[:-1]), -1, 1))
    rate = np.pad(turn / (0.5 * (step[1:] + step[:-1])), 1, mode="edge")
    found = np.sum(step * (1.0 + (0.5 * (rate[1:] + rate[:-1]) * step) ** 2 / 24.0))
    length = np.linalg.norm(np.diff(curve, axis=0), axis=1).sum()
    assert found == pytest.approx(length, rel=0.005)


@pytest.mark.parametrize("seed", [0.0, 0.21, 0.43, 0.68, 0.91])
def test_an_internode_is_as_thick_over_its_ridges_as_told(seed):
    mesh = tube("internode", seed=seed, groove_m=8e-4)
    part = (rings(mesh).mean(axis=1)[:, 2]) / 0.1
    np.testing.assert_allclose(diameters(mesh), 2.0 * (0.005 - 0.0005 * part), rtol=1e-4)


def test_a_stalk_is_as_thick_as_told_beyond_its_foot():
    for channel in (0.0, 1.0):
        mesh = tube("stalk", arc(0.8), up=(-np.sin(0.4), 0.0, np.cos(0.4)), channel=channel)
        found, middle = diameters(mesh), rings(mesh).mean(axis=1)
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(middle, axis=0), axis=1))])
        beyond = along > 0.01
        told = 2.0 * (0.002 - 0.0007 * along / 0.1)
        np.testing.assert_allclose(found[beyond], told[beyond], rtol=0.01)
        assert found[-1] == pytest.approx(2 * 0.0013, rel=1e-3)


@pytest.mark.parametrize("foot", [1.0, 1.6, 2.2])
def test_a_stalks_foot_is_as_much_wider_as_told(foot):
    # Its first ring stands aslant, so it is measured across the curve.
    reach = np.linalg.norm(rings(tube("stalk", foot=foot))[0][:, :2], axis=1)
    assert reach.max() == pytest.approx(0.002 * foot, rel=1e-3)


def test_a_peduncle_widens_only_towards_the_calyx():
    found = diameters(tube("peduncle", radius_m=0.003, radius_tip_m=0.005))
    assert found[-1] == pytest.approx(0.01, rel=1e-3)
    assert found[len(found) // 2 : -2].max() < 0.0078


@pytest.mark.parametrize("detail", [0.4, 1.0, 2.3])
def test_a_nodes_widest_diameter_and_ends_are_as_told(detail):
    axis = np.array([[0.0, 0, 0], [0.0, 0, 0.0075], [0.001, 0.0, 0.015]])
    found = diameters(tube("node", axis, radius_start_m=0.005, seed=0.6, detail=detail))
    assert found.max() == pytest.approx(0.016, rel=1e-4)
    assert found[0] == pytest.approx(0.010, rel=1e-4)
    assert found[-1] == pytest.approx(0.009, rel=1e-4)
    without = diameters(tube("node", axis, detail=detail))
    assert without[0] == pytest.approx(0.009, rel=1e-4)


def test_a_scars_rim_is_as_wide_as_told():
    found = diameters(tube("cut", UPRIGHT * 0.06, seed=0.3))
    # Across the slant it is longer by up to 2 %.
    assert 0.008 < found[2] < 0.00817


# --- shapes -----------------------------------------------------------------------------------------------


def test_an_internode_has_four_or_five_ridges_that_fade_into_the_nodes():
    counts = set()
    for seed in np.linspace(0.0, 0.9, 10):
        ring = rings(tube("internode", radius_tip_m=0.005, groove_m=0.0008, seed=seed, detail=3.0))
        reach = np.linalg.norm((ring - ring.mean(axis=1, keepdims=True))[..., :2], axis=2)
        assert np.ptp(reach[0]) < 1e-6
        assert np.ptp(reach[-1]) < 1e-6
        middle = reach[len(reach) // 2]
        assert 0.0007 < np.ptp(middle) < 0.0009
        counts.add(1 + int(np.argmax(np.abs(np.fft.rfft(middle))[1:10])))
    assert counts == {4, 5}


def test_sections_and_nodes_join_without_a_step():
    # Of a grown plant: where one ends and the next begins, rings lie on each other, and so do normals.
    plant = grow(load_cultivar("kaite"), np.random.default_rng(5))
    mesh = mesh_plant(plant)
    stem = [
        i for i, organ in enumerate(plant.organs) if plant.kinds[organ.kind].form in ("internode", "node")
    ]
    parts = [mesh.select_instances([i]) for i in stem]
    bodies = [rings(part) for part in parts]
    for below, above in pairwise(bodies):
        np.testing.assert_allclose(below[-1].mean(axis=0), above[0].mean(axis=0), atol=2e-5)
        # The frames may have turned about the axis by a little from one organ to the next.
        assert np.linalg.norm(below[-1] - above[0], axis=1).max() < 3e-4
    spread = [np.ptp(one.state) for one in parts]
    assert max(spread) < 0.9


def test_a_node_is_not_the_same_upside_down():
    axis = np.array([[0.0, 0, 0], [0.0, 0, 0.0075], [0.0, 0.0, 0.015]])
    mesh = tube("node", axis, detail=4.0)
    ring = rings(mesh)
    height = ring[:, :, 2].mean(axis=1) / 0.015
    width = np.linalg.norm(ring[..., :2], axis=2).max(axis=1)
    assert 0.52 < height[np.argmax(width)] < 0.7
    assert np.interp(0.25, height, width) > np.interp(0.75 + 0.04, height, width)
    # Wide enough below and above for what starts four fifths of its radius out.
    assert np.all(np.interp([0.35, 0.55, 0.7], height, width) > 0.8 * 0.008)
    # Its collar is the brownest.
    states = [mesh.state[np.abs(mesh.uv[:, 1] - place) < 0.03].mean() for place in (0.05, 0.62)]
    assert states[1] < states[0] - 0.08


def test_the_state_of_a_section_runs_to_that_of_its_upper_end():
    mesh = tube("internode", state_mean=0.2, state_tip=0.7, state_spread=0.0, groove_m=0.0)
    levels = np.unique(mesh.uv[:, 1])
    ends = [mesh.state[mesh.uv[:, 1] == level].mean() for level in levels[[2, -3]]]
    np.testing.assert_allclose(ends, [0.2, 0.7], atol=0.01)


def test_a_petiole_has_a_channel_above_and_a_side_shoot_none():
    for channel, least in ((1.0, 0.15), (0.0, 0.0)):
        ring = rings(tube("stalk", channel=channel, detail=3.0))
        ring = ring[np.argmin(np.abs(ring[:, :, 2].mean(axis=1) - 0.05))]
        # The upper side is -y, where a ring starts: how far its middle lies below its shoulders.
        sunk = ring[0, 1] - ring[:, 1].min()
        assert sunk >= least * 0.0016
        assert sunk < (0.6 * 0.0016 if channel else 1e-9)


@pytest.mark.parametrize("ribs", [4.0, 5.0, 6.0])
def test_a_peduncle_has_as_many_ribs_as_told(ribs):
    ring = rings(tube("peduncle", ribs=ribs, detail=3.0))[-3]
    reach = np.linalg.norm((ring - ring.mean(axis=0))[:, :2], axis=1)
    assert np.argmax(np.abs(np.fft.rfft(reach))[2:10]) + 2 == ribs


def test_a_peduncle_has_a_collar_with_a_furrow_above_it():
    found = diameters(tube("peduncle", radius_tip_m=0.0035, ribs=0.0))
    assert found[1] > 1.05 * found[3]
    assert found[2] < found[3]


def test_a_cut_is_corky_inside_its_rim():
    axis = np.array([[0.0, 0, 0], [0.0, 0.0, 0.005]])
    mesh = tube("cut", axis, radius_m=0.004, seed=0.4)
    face = mesh.uv[:, 1] > 0.55
    reach = np.linalg.norm(mesh.vertices[face, :2], axis=1)
    assert np.corrcoef(reach, mesh.state[face])[0, 1] > 0.9
    assert mesh.state[face].min() < 0.15
    assert mesh.state[face].max() > 0.7
    # The middle lies deeper than the rim's mean height, and faces outwards.
    rim = rings(mesh)[3][:, 2]
    assert mesh.vertices[-1, 2] < rim.mean() - 0.0005
    assert mesh.normals[-1, 2] > 0.95
    # It was cut at a slant.
    assert 1e-5 < np.ptp(rim) < 0.0021


# --- joints -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lift", [-0.3, 0.1, 0.4])
@pytest.mark.parametrize("slope", [-0.2, 0.3, 0.8, 1.2])
@pytest.mark.parametrize("form", ["stalk", "peduncle", "cut"])
def test_feet_are_covered_by_the_node_that_they_start_in(form, slope, lift):
    # The joint must not gape: whatever of the foot's first ring sticks out of the node is less than its cap
    # bulges, and the base's point lies inside.
    axis = np.array([[0.0, 0, 0], [0.0, 0, 0.0075], [0.0, 0.0, 0.015]])
    node = closed(tube("node", axis, seed=0.2))
    start = np.array([0.8 * 0.008, 0.0, 0.0075 + lift * 0.0075])
    ahead = np.array([np.cos(slope), 0.0, np.sin(slope)])
    length = {"stalk": 0.09, "peduncle": 0.045, "cut": 0.006}[form]
    curve = start + np.linspace(0.0, length, 6)[:, None] * ahead
    mesh = tube(form, curve, up=(-np.sin(slope), 0.0, np.cos(slope)))
    assert node.contains(mesh.vertices[:1].astype(float)).all()
    assert node.contains(mesh.vertices[-1:].astype(float)).sum() == 0
    cap = mesh.vertices[(mesh.uv[:, 1] > 0.0) & (mesh.uv[:, 1] < 0.009)].astype(float)
    out = -trimesh.proximity.signed_distance(node, cap)
    assert out.max() < 1.2e-3


def test_a_petioles_tip_goes_on_flat_below_the_blades_midrib():
    mesh = tube("stalk", arc(0.4, slope=0.0), up=(0.0, 0.0, 1.0), channel=1.0)
    end, ahead = arc(0.4, slope=0.0)[-1], np.array([np.cos(0.4), 0.0, -np.sin(0.4)])
    over = np.cross(ahead, [0.0, -1.0, 0.0])
    over *= np.sign(over[2])
    ring = rings(mesh)[-1]
    # Flatter than wide, and drawn out beyond the curve's end on its lower side, never above the blade.
    assert np.ptp((ring - end) @ over) < 0.8 * np.ptp(ring[:, 1])
    point = mesh.vertices[-1] - end
    assert point @ ahead > 2.0 * 0.0013
    assert -0.0013 < point @ over < 0.0


def test_coordinates_run_around_and_along():
    mesh = tube("stalk", radius_m=0.003, radius_tip_m=0.002)
    order = np.argsort(mesh.vertices[:, 2], kind="stable")
    # A foot's first rings stand aslant.
    steady = order[mesh.vertices[order, 2] > 0.02]
    assert np.all(np.diff(mesh.uv[steady, 1]) > -1e-6)
    assert mesh.uv[:, 0].min() == 0.0
    assert mesh.uv[:, 0].max() == 1.0


# --- soundness --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", SIZES)
def test_shading_normals_agree_with_the_winding(form):
    curve = {"node": UPRIGHT * 0.15, "cut": UPRIGHT * 0.06}.get(form, arc(0.8))
    for detail in (0.3, 1.0, 2.0):
        mesh = tube(form, curve, up=(-np.sin(0.4), 0.0, np.cos(0.4)), detail=detail, seed=0.7)
        a, b, c = (mesh.vertices[mesh.faces[:, corner]].astype(float) for corner in range(3))
        flat = np.cross(b - a, c - a)
        flat /= np.linalg.norm(flat, axis=1, keepdims=True)
        assert np.all(np.sum(flat * mesh.normals[mesh.faces].mean(axis=1), axis=1) > 0.2)


@settings(max_examples=60, deadline=None)
@given(
    form=st.sampled_from(sorted(SIZES)),
    length=st.floats(0.001, 0.5),
    slimness=st.floats(0.005, 2.0),
    ratio=st.floats(0.1, 3.0),
    bend=st.floats(-2.5, 2.5),
    points=st.integers(2, 12),
    groove=st.floats(0.0, 3.0),
    foot=st.floats(0.5, 4.0),
    channel=st.sampled_from([0.0, 1.0]),
    ribs=st.integers(0, 12),
    spread=st.floats(0.0, 1.2),
    seed=st.floats(0.0, 0.999),
    detail=st.sampled_from([0.2, 1.0, 2.0]),
)
def test_any_tube_is_sound_and_closed(
    form, length, slimness, ratio, bend, points, groove, foot, channel, ribs, spread, seed, detail
):
    radius = slimness * length
    sizes = {
        "radius_m": radius, "radius_tip_m": ratio * radius, "radius_end_m": ratio * radius,
        "radius_start_m": radius / ratio, "groove_m": groove * radius, "foot": foot, "channel": channel,
        "ribs": float(ribs), "state_spread": spread, "seed": seed,
    }  # fmt: skip
    assert_sound(tube(form, arc(bend, length, points), (-0.4, 0.0, 0.9), detail, **sizes))


def test_all_tubes_of_a_plant_are_closed_and_alike_for_alike_seeds():
    plant = grow(load_cultivar("kaite"), np.random.default_rng(2))
    first, again = mesh_plant(plant), mesh_plant(replace(plant))
    np.testing.assert_array_equal(first.vertices, again.vertices)
    chosen = [i for i, o in enumerate(plant.organs) if plant.kinds[o.kind].form in SIZES]
    for index in chosen[:: max(1, len(chosen) // 25)]:
        assert_sound(first.select_instances([index]))
