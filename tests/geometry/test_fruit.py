import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from organ_meshes import merged, mesh_organs, organ

from pepperscene.grammar.plant import Organ

SHAPE = {"length_m": 0.09, "diameter_m": 0.08, "lobes": 4, "lobe_depth": 0.9, "shoulder": 0.55, "taper": 0.83}


def fruit(parent=-1, **measures):
    return organ("fruit", tip=(0, 0, -0.09), up=(1, 0, 0), parent=parent, **SHAPE | {"seed": 0.3} | measures)


def calyx(parent=-1, stalk_end=(0, 0, 0.004), **measures):
    return organ("calyx", stalk_end, (0, 0, 0), up=(1, 0, 0), parent=parent, radius_m=0.018, **measures)


def greatest_width(points):
    """Greatest distance of two points, seen along z."""
    angle = np.linspace(0.0, np.pi, 180)
    return np.ptp(points[:, :2].astype(float) @ np.stack([np.cos(angle), np.sin(angle)]), axis=0).max()


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
def test_fruit_has_the_stated_length_and_diameter(
    length, slimness, point, lobes, depth, shoulder, taper, seed
):
    measures = {"lobes": lobes, "lobe_depth": depth, "shoulder": shoulder, "taper": taper, "point": point}
    one = fruit(length_m=length, diameter_m=length / slimness, seed=seed, **measures)
    points = mesh_organs(one).vertices
    # The curve is 90 mm long whatever the length: sizes come from the measures.
    np.testing.assert_allclose(np.ptp(points[:, 2]), length, rtol=1e-5)
    np.testing.assert_allclose(greatest_width(points), length / slimness, rtol=0.003)


@pytest.mark.parametrize("neck", [0.4, 0.7])
def test_a_neck_narrows_the_fruit_beside_its_stalk(neck):
    """By a parabola, up to the stated length of the neck; length and diameter stay as stated."""
    long = {"length_m": 0.3, "diameter_m": 0.04, "lobe_depth": 0.0, "shoulder": 0.0, "taper": 1.0}
    plain, necked = (
        merged(mesh_organs(fruit(**long, neck=value, neck_length=0.4), detail=4.0)) for value in (1.0, neck)
    )
    for points in (plain.vertices, necked.vertices):
        np.testing.assert_allclose(np.ptp(points[:, 2]), 0.3, rtol=1e-5)
        np.testing.assert_allclose(greatest_width(points), 0.04, rtol=0.003)

    def width_at(body, depth):
        section = body.section(plane_origin=[0, 0, -depth], plane_normal=[0, 0, 1])
        return 2 * np.linalg.norm(max(section.discrete, key=len)[:, :2], axis=1).mean()

    for depth in (0.03, 0.06, 0.09):
        expected = 1.0 - (1.0 - neck) * (1.0 - depth / (0.4 * 0.3)) ** 2
        assert width_at(necked, depth) / width_at(plain, depth) == pytest.approx(expected, abs=0.02)
    assert width_at(necked, 0.2) == pytest.approx(width_at(plain, 0.2), rel=0.01)


def test_fruit_has_a_stalk_cavity_and_a_dimple_at_the_blossom_end():
    points = mesh_organs(fruit()).vertices
    # The first vertex is where the stalk meets the fruit: the base of the curve.
    np.testing.assert_allclose(points[0], [0.0, 0.0, 0.0], atol=1e-6)
    assert points[:, 2].max() > 0.003
    assert points[-1, 2] > points[:, 2].min() + 0.002
    shallow = mesh_organs(fruit(shoulder=0.0)).vertices
    assert shallow[:, 2].max() < points[:, 2].max()


@pytest.mark.parametrize("lobes", [3, 4])
def test_cross_section_has_the_stated_number_of_lobes(lobes):
    body = merged(mesh_organs(fruit(lobes=lobes, lobe_depth=1.5, seed=0.2), detail=2.0))
    section = body.section(plane_origin=[0, 0, -0.07], plane_normal=[0, 0, 1])
    outline = max(section.discrete, key=len)[:-1, :2]
    angle, radius = np.arctan2(outline[:, 1], outline[:, 0]), np.linalg.norm(outline, axis=1)
    even = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    wave = np.abs(np.fft.rfft(np.interp(even, np.sort(angle), radius[np.argsort(angle)], period=2 * np.pi)))
    # The strongest harmonic above the oval of an uneven fruit is that of the lobes.
    assert 3 + np.argmax(wave[3:8]) == lobes


def test_ripeness_is_smooth_across_the_seam_and_has_its_mean_and_spread():
    spreads, means = [], []
    for seed in np.linspace(0.0, 0.95, 12):
        mesh = mesh_organs(fruit(seed=seed, ripeness=0.5, ripeness_spread=0.12))
        _, first, number = np.unique(mesh.vertices, axis=0, return_index=True, return_inverse=True)
        np.testing.assert_allclose(mesh.state[first][number.ravel()], mesh.state, atol=1e-6)
        np.testing.assert_allclose(mesh.normals[first][number.ravel()], mesh.normals, atol=1e-6)
        step = np.abs(mesh.state[mesh.faces[:, 0]] - mesh.state[mesh.faces[:, 1]])
        assert step.max() < 0.2
        means.append(mesh.state.mean())
        spreads.append(mesh.state.std())
    np.testing.assert_allclose(means, 0.5, atol=0.03)
    np.testing.assert_allclose(spreads, 0.12, atol=0.02)
    np.testing.assert_allclose(mesh_organs(fruit(ripeness=0.3)).state, 0.3, atol=1e-6)


@pytest.mark.parametrize("parent_of_fruit", [0, -1])
@pytest.mark.parametrize("seed", [0.1, 0.9])
def test_calyx_follows_the_surface_of_the_fruit_below_it(parent_of_fruit, seed):
    mesh = mesh_organs(calyx(seed=seed), fruit(parent=parent_of_fruit, seed=seed))
    points = mesh.vertices[mesh.vertex_runs.rows(0)].astype(float)
    depth = trimesh.proximity.signed_distance(merged(mesh, 1), points)
    radius = np.linalg.norm(points[:, :2], axis=1)
    outer = depth[radius > 0.007]
    # The plate is no thicker than some millimetres, its lower side in the fruit and its upper side out of it.
    assert np.abs(outer).max() < 0.003
    assert (outer > 0).any()
    assert (outer < -0.0008).any()
    # It has the stated radius, and encloses the stalk's end.
    assert 0.8 * 0.018 < radius.max() <= 0.018 + 1e-6
    assert points[:, 2].max() > 0.004


def rim_radii(mesh):
    """Distance from the axis of a calyx' outermost points, in order around it."""
    angle = np.arctan2(mesh.vertices[:, 1], mesh.vertices[:, 0])
    radius = np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 1])
    # One point in each of the narrow sectors around the columns of the mesh.
    order = np.argsort(angle)
    groups = np.split(order, 1 + np.flatnonzero(np.diff(angle[order]) > 1e-3))
    return np.array([radius[group].max() for group in groups if len(group) > 5])


@pytest.mark.parametrize("tooth", [0.1, 0.75])
def test_calyx_has_five_to_seven_teeth_of_the_stated_depth(tooth):
    counts = set()
    for seed in np.linspace(0.0, 0.95, 24):
        rim = rim_radii(mesh_organs(calyx(seed=seed, tooth=tooth)))
        peaks = (rim > np.roll(rim, 1)) & (rim > np.roll(rim, -1)) & (rim > (1.0 - 0.7 * tooth) * 0.018)
        counts.add(int(peaks.sum()))
        assert rim.max() == pytest.approx(0.018, rel=1e-3)
        assert rim.min() == pytest.approx((1.0 - tooth) * 0.018, rel=0.3 * tooth)
    assert counts == {5, 6, 7}


def test_calyx_closes_around_the_end_of_its_stalk():
    tip = 0.0045
    curve = np.array([[-0.02, 0.0, 0.03], [-0.005, 0.0, 0.022], [0.0, 0.0, 0.005]])
    measures = {"radius_m": 0.0035, "radius_tip_m": tip, "seed": 0.2}
    stalk = Organ("peduncle", -1, 0, curve, np.array([0.0, 0.0, 1.0]), measures)
    mesh = mesh_organs(stalk, calyx(parent=0, stalk_end=curve[-1], seed=0.3), fruit(parent=1))
    # The stalk's end is within the calyx, which is sunk in the fruit by less than a millimetre.
    into = (curve[-1] - curve[-2]) / np.linalg.norm(curve[-1] - curve[-2])
    side, across = np.cross(into, [0.0, 1.0, 0.0]), np.array([0.0, 1.0, 0.0])
    turn = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)[:, None]
    rim = curve[-1] + tip * (np.cos(turn) * side + np.sin(turn) * across)
    assert trimesh.proximity.signed_distance(merged(mesh, 1), rim).min() > -1e-4
    plate = mesh.vertices[mesh.vertex_runs.rows(1)]
    assert 0.0 < trimesh.proximity.signed_distance(merged(mesh, 2), plate).max() < 0.001


@pytest.mark.parametrize("point", [0.0, 0.5, 1.0])
def test_point_draws_the_fruit_out(point):
    points = mesh_organs(fruit(length_m=0.15, diameter_m=0.05, point=point, seed=0.4)).vertices
    # Widths of slices at 40 and 90 per cent of the length.
    depth = (points[:, 2].max() - points[:, 2]) / np.ptp(points[:, 2])
    wide, narrow = (greatest_width(points[np.abs(depth - at) < 0.06]) for at in (0.4, 0.9))
    assert narrow / wide == pytest.approx({0.0: 0.8, 0.5: 0.55, 1.0: 0.33}[point], abs=0.12)


def test_bent_axis_moves_the_tip_and_not_the_shoulders():
    shape = {"length_m": 0.15, "diameter_m": 0.05, "point": 1.0}
    straight, bent = (mesh_organs(fruit(**shape, bend_rad=angle)) for angle in (0.0, 0.6))
    depth = straight.vertices[:, 2].max() - straight.vertices[:, 2]
    moved = np.linalg.norm(bent.vertices - straight.vertices, axis=1)
    assert moved[depth < 0.03].max() < 1e-6
    # An arc over seven tenths of the length that ends 0.6 rad off leaves its tangent by a third of that.
    assert moved[np.argmax(depth)] == pytest.approx(0.7 * 0.148 * (1.0 - np.cos(0.6)) / 0.6, rel=0.1)
    assert merged(bent).volume == pytest.approx(merged(straight).volume, rel=0.01)
