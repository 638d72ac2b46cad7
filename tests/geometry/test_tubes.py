from itertools import pairwise

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from organ_meshes import check_solid, merged, mesh_organs

from pepperscene.cultivar import load_cultivar
from pepperscene.geometry import mesh_plant
from pepperscene.grammar import grow
from pepperscene.grammar.plant import Organ

UPRIGHT = np.array([[0.0, 0, 0], [0.0, 0, 0.05], [0.0, 0.0, 0.1]])
NODE_AXIS = np.array([[0.0, 0, 0], [0.0, 0, 0.0075], [0.0, 0.0, 0.015]])
RISING_UP = (-np.sin(0.4), 0.0, np.cos(0.4))  # the upper side of a curve that starts with slope 0.4
SIZES = {
    "internode": {"radius_m": 0.005, "radius_tip_m": 0.0045, "groove_m": 5e-4},
    "node": {"radius_m": 0.008, "radius_end_m": 0.0045},
    "stalk": {"radius_m": 0.002, "radius_tip_m": 0.0013},
    "peduncle": {"radius_m": 0.0035, "radius_tip_m": 0.0045},
    "cut": {"radius_m": 0.004},
}


def tube(form, curve=UPRIGHT, up=(0.0, -1.0, 0.0), detail=1.0, **measures):
    return mesh_organs(Organ(form, -1, 0, curve, np.array(up), SIZES[form] | measures), detail=detail)


def arc(bend, length=0.1, points=12, slope=0.4):
    """A curve in the plane of x and z that turns down by `bend` radians."""
    angle = slope - bend * (np.arange(400) + 0.5) / 400
    steps = np.stack([np.cos(angle), 0.0 * angle, np.sin(angle)], axis=1) * length / 400
    fine = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    return fine[np.linspace(0, 400, points).round().astype(int)]


def rings(mesh):
    """Rings `(r, c, 3)` from base to tip, without those of the caps and the repeated vertex of each."""
    once = mesh.uv[:, 0] < 1.0
    levels = np.unique(mesh.uv[:, 1])[2:-2]
    return np.stack([mesh.vertices[once & (mesh.uv[:, 1] == level)] for level in levels]).astype(float)


def diameters(mesh):
    """Twice the greatest distance of each ring from its middle."""
    points = rings(mesh)
    return 2.0 * np.linalg.norm(points - points.mean(axis=1, keepdims=True), axis=2).max(axis=1)


@pytest.mark.parametrize("detail", [0.4, 2.0])
@pytest.mark.parametrize(
    ("form", "curve"), [("internode", UPRIGHT), ("stalk", arc(1.2)), ("peduncle", arc(1.7, length=0.046))]
)
def test_length_along_the_rings_is_that_of_the_curve(form, curve, detail):
    mesh = tube(form, curve, RISING_UP if form != "internode" else (0, -1, 0), detail, seed=0.37)
    middle = rings(mesh).mean(axis=1)
    np.testing.assert_allclose(middle[[0, -1]], curve[[0, -1]], atol=1e-6)
    # A polyline with few pieces cuts corners; a chord falls short by a 24th of its squared turn.
    chords = np.diff(middle, axis=0)
    step = np.linalg.norm(chords, axis=1)
    turn = np.arccos(np.clip(np.sum(chords[1:] * chords[:-1], axis=1) / (step[1:] * step[:-1]), -1, 1))
    rate = np.pad(turn / (0.5 * (step[1:] + step[:-1])), 1, mode="edge")
    measured = np.sum(step * (1.0 + (0.5 * (rate[1:] + rate[:-1]) * step) ** 2 / 24.0))
    length = np.linalg.norm(np.diff(curve, axis=0), axis=1).sum()
    assert measured == pytest.approx(length, rel=0.005)


@pytest.mark.parametrize("seed", [0.0, 0.68])
def test_internode_has_the_stated_radius_over_its_ridges(seed):
    mesh = tube("internode", seed=seed, groove_m=8e-4)
    fraction = rings(mesh).mean(axis=1)[:, 2] / 0.1
    np.testing.assert_allclose(diameters(mesh), 2.0 * (0.005 - 0.0005 * fraction), rtol=1e-4)


@pytest.mark.parametrize("channel", [0.0, 1.0])
def test_stalk_has_the_stated_radius_beyond_its_foot(channel):
    mesh = tube("stalk", arc(0.8), RISING_UP, channel=channel)
    measured, middle = diameters(mesh), rings(mesh).mean(axis=1)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(middle, axis=0), axis=1))])
    beyond = along > 0.01
    np.testing.assert_allclose(measured[beyond], 2.0 * (0.002 - 0.0007 * along[beyond] / 0.1), rtol=0.01)
    assert measured[-1] == pytest.approx(2 * 0.0013, rel=1e-3)


@pytest.mark.parametrize("foot", [1.0, 1.6, 2.2])
def test_stalk_has_a_foot_of_the_stated_width(foot):
    # Its first ring is slanted, so it is measured across the curve.
    radius = np.linalg.norm(rings(tube("stalk", foot=foot))[0][:, :2], axis=1)
    assert radius.max() == pytest.approx(0.002 * foot, rel=1e-3)


@pytest.mark.parametrize("detail", [0.4, 1.0, 2.3])
def test_node_has_the_stated_radii(detail):
    axis = np.array([[0.0, 0, 0], [0.0, 0, 0.0075], [0.001, 0.0, 0.015]])
    measured = diameters(tube("node", axis, radius_start_m=0.005, seed=0.6, detail=detail))
    assert measured.max() == pytest.approx(0.016, rel=1e-4)
    assert measured[0] == pytest.approx(0.010, rel=1e-4)
    assert measured[-1] == pytest.approx(0.009, rel=1e-4)
    assert diameters(tube("node", axis, detail=detail))[0] == pytest.approx(0.009, rel=1e-4)


def test_internode_has_four_or_five_ridges_that_fade_into_the_nodes():
    counts = set()
    for seed in np.linspace(0.0, 0.9, 10):
        ring = rings(tube("internode", radius_tip_m=0.005, groove_m=0.0008, seed=seed, detail=3.0))
        radius = np.linalg.norm((ring - ring.mean(axis=1, keepdims=True))[..., :2], axis=2)
        assert np.ptp(radius[0]) < 1e-6
        assert np.ptp(radius[-1]) < 1e-6
        middle = radius[len(radius) // 2]
        assert 0.0007 < np.ptp(middle) < 0.0009
        counts.add(1 + int(np.argmax(np.abs(np.fft.rfft(middle))[1:10])))
    assert counts == {4, 5}


def test_node_is_widest_above_its_middle_and_has_a_brown_collar():
    mesh = tube("node", NODE_AXIS, detail=4.0)
    ring = rings(mesh)
    height = ring[:, :, 2].mean(axis=1) / 0.015
    width = np.linalg.norm(ring[..., :2], axis=2).max(axis=1)
    assert 0.52 < height[np.argmax(width)] < 0.7
    assert np.interp(0.25, height, width) > np.interp(0.75 + 0.04, height, width)
    # Wide enough below and above for organs that start at four fifths of its radius.
    assert np.all(np.interp([0.35, 0.55, 0.7], height, width) > 0.8 * 0.008)
    states = [mesh.state[np.abs(mesh.uv[:, 1] - place) < 0.03].mean() for place in (0.05, 0.62)]
    assert states[1] < states[0] - 0.08


@pytest.mark.parametrize(("channel", "least", "most"), [(1.0, 0.15 * 0.0016, 0.6 * 0.0016), (0.0, 0.0, 1e-9)])
def test_petiole_has_a_channel_above_and_a_side_shoot_none(channel, least, most):
    ring = rings(tube("stalk", channel=channel, detail=3.0))
    ring = ring[np.argmin(np.abs(ring[:, :, 2].mean(axis=1) - 0.05))]
    # The upper side is -y, where a ring starts: depth of its middle below its shoulders.
    assert least <= ring[0, 1] - ring[:, 1].min() < most


@pytest.mark.parametrize("ribs", [4.0, 5.0, 6.0])
def test_peduncle_has_the_stated_number_of_ribs(ribs):
    ring = rings(tube("peduncle", ribs=ribs, detail=3.0))[-3]
    radius = np.linalg.norm((ring - ring.mean(axis=0))[:, :2], axis=1)
    assert np.argmax(np.abs(np.fft.rfft(radius))[2:10]) + 2 == ribs


def test_scar_is_slanted_and_its_face_dries():
    """The face is pith in the middle, state 1/3, and green at its rim, 2/3; it dries towards 0."""
    curve, middles = np.array([[0.0, 0, 0], [0.0, 0.0, 0.005]]), []
    for seed in np.linspace(0.02, 0.98, 25):
        mesh = tube("cut", curve, radius_m=0.004, seed=seed)
        face = mesh.uv[:, 1] > 0.55
        radius = np.linalg.norm(mesh.vertices[face, :2], axis=1)
        assert np.corrcoef(radius, mesh.state[face])[0, 1] > 0.9
        assert mesh.state[mesh.uv[:, 1] < 0.15].min() > 0.95
        assert mesh.state[face].max() < 0.7
        middles.append(mesh.state[-1])
        # The middle is deeper than the mean height of the rim, and faces outwards.
        rim = rings(mesh)[3][:, 2]
        assert mesh.vertices[-1, 2] < rim.mean() - 0.0005
        assert mesh.normals[-1, 2] > 0.95
        assert 1e-5 < np.ptp(rim) < 0.0021
    assert min(middles) < 0.08
    assert 0.25 < max(middles) < 0.36
    assert np.median(middles) < 0.2


@pytest.fixture(scope="module")
def grown():
    """A plant and the mesh of each of its tubes, by index."""
    plant = grow(load_cultivar("kaite"), np.random.default_rng(5))
    mesh = mesh_plant(plant)
    forms = [plant.kinds[organ.kind].form for organ in plant.organs]
    return forms, {i: mesh.select_instances([i]) for i, form in enumerate(forms) if form in SIZES}


def test_internodes_and_nodes_join_without_a_step(grown):
    forms, meshes = grown
    stem = [mesh for index, mesh in meshes.items() if forms[index] in ("internode", "node")]
    for below, above in pairwise(map(rings, stem)):
        np.testing.assert_allclose(below[-1].mean(axis=0), above[0].mean(axis=0), atol=2e-5)
        # The frames may rotate a little about the axis from one organ to the next.
        assert np.linalg.norm(below[-1] - above[0], axis=1).max() < 3e-4
    assert max(np.ptp(mesh.state) for mesh in stem) < 0.9


@pytest.mark.parametrize(("offset", "slope"), [(-0.3, -0.2), (-0.3, 1.2), (0.4, -0.2), (0.4, 1.2)])
@pytest.mark.parametrize("form", ["stalk", "peduncle", "cut"])
def test_feet_are_covered_by_their_node(form, slope, offset):
    # The joint must not gape: the part of the foot's first ring outside the node is less than its cap bulges,
    # and the base's point is inside.
    node = merged(tube("node", NODE_AXIS, seed=0.2))
    start = np.array([0.8 * 0.008, 0.0, 0.0075 + offset * 0.0075])
    ahead = np.array([np.cos(slope), 0.0, np.sin(slope)])
    length = {"stalk": 0.09, "peduncle": 0.045, "cut": 0.006}[form]
    mesh = tube(
        form, start + np.linspace(0.0, length, 6)[:, None] * ahead, (-np.sin(slope), 0.0, np.cos(slope))
    )
    assert node.contains(mesh.vertices[[0, -1]].astype(float)).tolist() == [True, False]
    cap = mesh.vertices[(mesh.uv[:, 1] > 0.0) & (mesh.uv[:, 1] < 0.009)].astype(float)
    assert trimesh.proximity.signed_distance(node, cap).min() > -1.2e-3


def test_tip_of_a_petiole_continues_flat_below_the_midrib():
    curve = arc(0.4, slope=0.0)
    mesh = tube("stalk", curve, (0.0, 0.0, 1.0), channel=1.0)
    end, ahead = curve[-1], np.array([np.cos(0.4), 0.0, -np.sin(0.4)])
    over = np.cross(ahead, [0.0, -1.0, 0.0])
    over *= np.sign(over[2])
    ring = rings(mesh)[-1]
    # Flatter than wide, and drawn out beyond the curve's end on its lower side, never above the blade.
    assert np.ptp((ring - end) @ over) < 0.8 * np.ptp(ring[:, 1])
    point = mesh.vertices[-1] - end
    assert point @ ahead > 2.0 * 0.0013
    assert -0.0013 < point @ over < 0.0


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
    mesh = tube(form, arc(bend, length, points), (-0.4, 0.0, 0.9), detail, **sizes)
    check_solid(mesh)
    assert mesh.uv.min() == 0.0
    assert mesh.uv.max() == 1.0
