from __future__ import annotations

import numpy as np
import pytest

from pepperscene.geometry import mesh_plant
from pepperscene.grammar.plant import Organ, Plant

UPRIGHT = np.array([[0.0, 0, 0], [0.0, 0, 0.05], [0.0, 0.0, 0.1]])


def tube(kind, curve=UPRIGHT, up=(0.0, -1.0, 0.0), detail=1.0, **measures):
    return mesh_plant(Plant("hand-made", (Organ(kind, -1, 0, curve, np.array(up), measures),)), detail)


def radius_at(mesh, height, tolerance=1e-5):
    points = mesh.vertices[np.abs(mesh.vertices[:, 2] - height) < tolerance]
    return np.linalg.norm(points[:, :2], axis=1)


@pytest.mark.parametrize("kind", ["internode", "side_shoot", "petiole"])
def test_a_tube_has_its_radius_at_the_tip_and_covers_its_curve(kind):
    mesh = tube(kind, radius_m=0.005, radius_tip_m=0.004, groove_m=0.0)
    np.testing.assert_allclose(radius_at(mesh, 0.1).max(), 0.004, rtol=0.01)
    low, high = mesh.vertices[:, 2].min(), mesh.vertices[:, 2].max()
    # Rounded caps reach a little into the neighbours, so that no joint gapes.
    assert -0.005 < low < -0.001
    assert 0.101 < high < 0.105


def test_a_petiole_is_swollen_at_its_foot_and_channelled_above():
    mesh = tube("petiole", radius_m=0.002, radius_tip_m=0.0012)
    np.testing.assert_allclose(radius_at(mesh, 0.0).max(), 1.25 * 0.002, rtol=0.01)
    middle = mesh.vertices[np.abs(mesh.vertices[:, 2] - 0.05) < 1e-5]
    reach = np.linalg.norm(middle[:, :2], axis=1)
    above = np.argmin(middle[:, 1])  # the upper side is -y
    assert np.argmin(reach) == above or reach[above] < 0.9 * reach.max()


def test_an_internode_has_four_or_five_grooves_as_deep_as_told():
    counts = set()
    for seed in np.linspace(0.0, 0.9, 10):
        mesh = tube("internode", radius_m=0.005, radius_tip_m=0.005, groove_m=0.0008, seed=seed, detail=3.0)
        ring = mesh.vertices[np.abs(mesh.vertices[:, 2] - 0.1 * 4 / 9) < 1e-5][:-1]
        reach = np.linalg.norm(ring[:, :2], axis=1)
        assert 0.0007 < np.ptp(reach) <= 0.00081
        counts.add(1 + int(np.argmax(np.abs(np.fft.rfft(reach))[1:10])))
    assert counts == {4, 5}


def test_a_node_bulges_between_its_ends():
    axis = np.array([[0.0, 0, 0], [0.0, 0, 0.0075], [0.0, 0.0, 0.015]])
    mesh = tube("node", axis, radius_m=0.008, radius_end_m=0.0045)
    np.testing.assert_allclose(radius_at(mesh, 0.0), 0.0045, rtol=1e-4)
    np.testing.assert_allclose(radius_at(mesh, 0.015), 0.0045, rtol=1e-4)
    assert np.hypot(*mesh.vertices[:, :2].T).max() == pytest.approx(0.008, rel=1e-3)


def test_a_peduncle_widens_only_towards_the_calyx():
    mesh = tube("peduncle", radius_m=0.003, radius_tip_m=0.005)
    base, middle, tip = (radius_at(mesh, z).mean() for z in (0.0, 0.05, 0.1))
    np.testing.assert_allclose(tip, 0.005, rtol=0.02)
    assert middle < 0.0035
    assert base < 0.004


def test_a_cut_is_corky_inside_its_rim():
    axis = np.array([[0.0, 0, 0], [0.0, 0.0, 0.005]])
    mesh = tube("cut", axis, radius_m=0.004)
    face = mesh.vertices[:, 2] > 0.0036
    reach = np.linalg.norm(mesh.vertices[face, :2], axis=1)
    assert np.corrcoef(reach, mesh.state[face])[0, 1] > 0.95
    assert mesh.state[face].min() == pytest.approx(0.0, abs=1e-6)
    assert mesh.state[face].max() > 0.9
    # The middle lies deeper than the rim.
    assert mesh.vertices[-1, 2] < mesh.vertices[face, 2].max() - 0.0005


def test_tube_coordinates_run_around_and_along():
    mesh = tube("petiole", radius_m=0.003, radius_tip_m=0.002)
    order = np.argsort(mesh.vertices[:, 2], kind="stable")
    assert np.all(np.diff(mesh.uv[order, 1]) > -1e-6)
    assert mesh.uv[:, 0].min() == 0.0
    assert mesh.uv[:, 0].max() == 1.0
