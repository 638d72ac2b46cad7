from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from pepperscene.cultivar.organs import USUAL
from pepperscene.geometry import mesh_plant
from pepperscene.grammar.plant import Organ, Plant

DOWN = np.array([[0.0, 0, 0], [0.0, 0.0, -0.09]])
UP = np.array([0.0, 0.0, 1.0])


def fruit(parent=-1, **measures):
    shape = {
        "length_m": 0.09,
        "diameter_m": 0.08,
        "lobes": 4,
        "lobe_depth": 0.9,
        "shoulder": 0.55,
        "taper": 0.83,
    }
    return Organ("fruit", parent, 0, DOWN, np.array([1.0, 0.0, 0.0]), shape | {"seed": 0.3} | measures)


def mesh_of(*organs, detail=1.0):
    return mesh_plant(Plant("hand-made", organs, USUAL), detail)


def calliper(points):
    """Greatest distance of two points, seen along z."""
    flat = points[:, :2].astype(float)
    angle = np.linspace(0.0, np.pi, 180)
    shadow = flat @ np.stack([np.cos(angle), np.sin(angle)])
    return np.ptp(shadow, axis=0).max()


@settings(max_examples=30, deadline=None)
@given(
    length=st.floats(0.01, 0.3),
    slimness=st.floats(0.5, 4.0),
    point=st.floats(0.0, 1.0),
    lobes=st.integers(2, 5),
    depth=st.floats(0.0, 1.8),
    shoulder=st.floats(0.0, 1.0),
    taper=st.floats(0.6, 1.0),
    seed=st.floats(0.0, 0.999),
)
def test_length_and_diameter_are_those_asked_for(
    length, slimness, point, lobes, depth, shoulder, taper, seed
):
    points = mesh_of(
        fruit(
            length_m=length, diameter_m=length / slimness, lobes=lobes, lobe_depth=depth, shoulder=shoulder,
            taper=taper, point=point, seed=seed,
        )
    ).vertices  # fmt: skip
    # The curve of the hand-made fruit is 90 mm long whatever its length: sizes come from the measures.
    np.testing.assert_allclose(np.ptp(points[:, 2]), length, rtol=1e-5)
    np.testing.assert_allclose(calliper(points), length / slimness, rtol=0.003)


def test_the_stalk_sits_in_a_cavity_and_the_blossom_end_has_a_dimple():
    points = mesh_of(fruit()).vertices
    # The first vertex is where the stalk meets the fruit: the curve's base.
    np.testing.assert_allclose(points[0], DOWN[0], atol=1e-6)
    assert points[:, 2].max() > 0.003
    assert points[-1, 2] > points[:, 2].min() + 0.002
    shallow = mesh_of(fruit(shoulder=0.0)).vertices
    assert shallow[:, 2].max() < points[:, 2].max()


@pytest.mark.parametrize("lobes", [3, 4])
def test_the_cross_section_has_as_many_lobes_as_told(lobes):
    mesh = mesh_of(fruit(lobes=lobes, lobe_depth=1.5, seed=0.2), detail=2.0)
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces)
    section = solid.section(plane_origin=[0, 0, -0.07], plane_normal=[0, 0, 1])
    outline = max(section.discrete, key=len)[:-1, :2]
    angle, radius = np.arctan2(outline[:, 1], outline[:, 0]), np.linalg.norm(outline, axis=1)
    even = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    wave = np.abs(np.fft.rfft(np.interp(even, np.sort(angle), radius[np.argsort(angle)], period=2 * np.pi)))
    # The strongest harmonic above the oval of an uneven fruit is the lobes'.
    assert 3 + np.argmax(wave[3:8]) == lobes


def test_ripeness_is_smooth_across_the_seam_and_has_its_mean_and_spread():
    spreads, means = [], []
    for seed in np.linspace(0.0, 0.95, 12):
        mesh = mesh_of(fruit(seed=seed, ripeness=0.5, ripeness_spread=0.12))
        _, first, number = np.unique(mesh.vertices, axis=0, return_index=True, return_inverse=True)
        np.testing.assert_allclose(mesh.state[first][number.ravel()], mesh.state, atol=1e-6)
        step = np.abs(mesh.state[mesh.faces[:, 0]] - mesh.state[mesh.faces[:, 1]])
        assert step.max() < 0.2
        means.append(mesh.state.mean())
        spreads.append(mesh.state.std())
    np.testing.assert_allclose(means, 0.5, atol=0.03)
    np.testing.assert_allclose(spreads, 0.12, atol=0.02)


def test_a_fruit_without_spread_is_of_one_ripeness():
    np.testing.assert_allclose(mesh_of(fruit(ripeness=0.3)).state, 0.3, atol=1e-6)


def test_shading_normals_meet_at_the_seam():
    mesh = mesh_of(fruit())
    _, first, number = np.unique(mesh.vertices, axis=0, return_index=True, return_inverse=True)
    np.testing.assert_allclose(mesh.normals[first][number.ravel()], mesh.normals, atol=1e-6)


@pytest.mark.parametrize("parent_of_fruit", [0, -1])
@pytest.mark.parametrize("seed", [0.1, 0.5, 0.9])
def test_a_calyx_hugs_the_fruit_below_it(parent_of_fruit, seed):
    axis = np.array([[0.0, 0, 0.004], [0.0, 0.0, 0.0]])
    measures = {"radius_m": 0.018, "seed": seed}
    calyx = Organ("calyx", -1, 0, axis, np.array([1.0, 0.0, 0.0]), measures)
    mesh = mesh_of(calyx, fruit(parent=parent_of_fruit, seed=seed))
    plate = np.unique(mesh.faces[mesh.face_instance == 0])
    body = trimesh.Trimesh(mesh.vertices, mesh.faces[mesh.face_instance == 1])
    points = mesh.vertices[plate].astype(float)
    height = trimesh.proximity.signed_distance(body, points)  # positive inside
    outer = np.linalg.norm(points[:, :2], axis=1) > 0.007
    # The plate is no thicker than some millimetres, its lower side is in the fruit and its upper side out.
    assert np.abs(height[outer]).max() < 0.003
    assert (height[outer] > 0).any()
    assert (height[outer] < -0.0008).any()
    # It reaches as far as it says, and up around the stalk's end.
    reach = np.linalg.norm(points[:, :2], axis=1).max()
    assert 0.8 * 0.018 < reach <= 0.018 + 1e-6
    assert points[:, 2].max() > 0.004


def rim_of(mesh):
    """Distance from the axis, z, of a calyx' outermost points, in order around it."""
    angle = np.arctan2(mesh.vertices[:, 1], mesh.vertices[:, 0])
    radius = np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 1])
    # One point in each of the narrow sectors that a column of the mesh falls into.
    order = np.argsort(angle)
    groups = np.split(order, 1 + np.flatnonzero(np.diff(angle[order]) > 1e-3))
    return np.array([radius[group].max() for group in groups if len(group) > 5])


@pytest.mark.parametrize("tooth", [0.1, 0.28, 0.75])
def test_a_calyx_has_five_to_seven_teeth_as_deep_as_told(tooth):
    counts = set()
    for seed in np.linspace(0.0, 0.95, 24):
        axis = np.array([[0.0, 0, 0.004], [0.0, 0.0, 0.0]])
        measures = {"radius_m": 0.018, "seed": seed, "tooth": tooth}
        mesh = mesh_of(Organ("calyx", -1, 0, axis, np.array([1.0, 0, 0]), measures))
        rim = rim_of(mesh)
        peaks = (rim > np.roll(rim, 1)) & (rim > np.roll(rim, -1)) & (rim > (1.0 - 0.7 * tooth) * 0.018)
        counts.add(int(peaks.sum()))
        assert rim.max() == pytest.approx(0.018, rel=1e-3)
        assert rim.min() == pytest.approx((1.0 - tooth) * 0.018, rel=0.3 * tooth)
    assert counts == {5, 6, 7}


def test_long_sepals_lift_their_tips_and_small_teeth_lie_flat():
    def lift(tooth):
        axis = np.array([[0.0, 0, 0.004], [0.0, 0.0, 0.0]])
        measures = {"radius_m": 0.018, "seed": 0.4, "tooth": tooth}
        points = mesh_of(Organ("calyx", -1, 0, axis, np.array([1.0, 0, 0]), measures)).vertices
        return np.median(points[np.hypot(points[:, 0], points[:, 1]) > 0.016][:, 2])

    assert 0.001 < lift(0.75) < 0.004
    assert abs(lift(0.2)) < 0.0008


def test_a_calyx_closes_round_the_end_of_its_stalk():
    tip = 0.0045
    curve = np.array([[-0.02, 0.0, 0.03], [-0.005, 0.0, 0.022], [0.0, 0.0, 0.005]])
    stalk = Organ("peduncle", -1, 0, curve, UP, {"radius_m": 0.0035, "radius_tip_m": tip, "seed": 0.2})
    axis = np.array([curve[-1], [0.0, 0.0, 0.0]])
    calyx = Organ("calyx", 0, 0, axis, np.array([1.0, 0.0, 0.0]), {"radius_m": 0.018, "seed": 0.3})
    mesh = mesh_of(stalk, calyx, fruit(parent=1))
    parts = [trimesh.Trimesh(mesh.vertices, mesh.faces[mesh.face_instance == i]) for i in range(3)]
    # The stalk's end lies within the calyx, which is sunk in the fruit by less than a millimetre.
    into = unit(curve[-1] - curve[-2])
    side = np.cross(into, [0.0, 1.0, 0.0])
    for turn in np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False):
        out = np.cos(turn) * side + np.sin(turn) * np.array([0.0, 1.0, 0.0])
        rim = curve[-1] + tip * out
        assert trimesh.proximity.signed_distance(parts[1], [rim])[0] > -1e-4
    sunk = trimesh.proximity.signed_distance(parts[2], parts[1].vertices)
    assert 0.0 < sunk.max() < 0.001


def unit(vector):
    return vector / np.linalg.norm(vector)


@pytest.mark.parametrize("point", [0.0, 0.5, 1.0])
def test_a_drawn_out_fruit_runs_to_a_point(point):
    points = mesh_of(fruit(length_m=0.15, diameter_m=0.05, point=point, seed=0.4)).vertices
    # Widths of slices at 40 and 90 per cent of the length.
    depth = (points[:, 2].max() - points[:, 2]) / np.ptp(points[:, 2])
    wide, narrow = (calliper(points[np.abs(depth - at) < 0.06]) for at in (0.4, 0.9))
    assert narrow / wide == pytest.approx({0.0: 0.8, 0.5: 0.55, 1.0: 0.33}[point], abs=0.12)


def test_a_bent_axis_moves_the_tip_and_not_the_shoulders():
    straight, bent = (
        mesh_of(fruit(length_m=0.15, diameter_m=0.05, point=1.0, bend_rad=b)) for b in (0.0, 0.6)
    )
    depth = straight.vertices[:, 2].max() - straight.vertices[:, 2]
    moved = np.linalg.norm(bent.vertices - straight.vertices, axis=1)
    assert moved[depth < 0.03].max() < 1e-6
    # An arc over seven tenths of the length that ends .6 rad off leaves its tangent by a third of that.
    assert moved[np.argmax(depth)] == pytest.approx(0.7 * 0.148 * (1.0 - np.cos(0.6)) / 0.6, rel=0.1)
    assert trimesh.Trimesh(bent.vertices, bent.faces).volume == pytest.approx(
        trimesh.Trimesh(straight.vertices, straight.faces).volume, rel=0.01
    )


def test_a_fruit_without_furrows_is_round_and_a_lobed_one_fills_more_of_its_box():
    def filled(depth):
        mesh = mesh_of(fruit(length_m=0.06, diameter_m=0.07, lobe_depth=depth, shoulder=0.15, taper=0.97))
        return trimesh.Trimesh(mesh.vertices, mesh.faces).volume / (0.06 * 0.07**2)

    # An ellipsoid fills pi / 6 = .524, a cylinder pi / 4.
    assert filled(0.03) == pytest.approx(np.pi / 6.0, rel=0.06)
    assert 1.01 * filled(0.03) < filled(0.9) < np.pi / 4.0
