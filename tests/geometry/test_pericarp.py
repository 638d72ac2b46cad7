from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from pepperscene.cultivar.forms import USUAL
from pepperscene.geometry import mesh_plant
from pepperscene.grammar.plant import Organ, Plant

DOWN = np.array([[0.0, 0, 0], [0.0, 0.0, -0.09]])


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
    slimness=st.floats(0.5, 2.0),
    lobes=st.integers(2, 5),
    depth=st.floats(0.0, 1.8),
    shoulder=st.floats(0.0, 1.0),
    taper=st.floats(0.6, 1.0),
    seed=st.floats(0.0, 0.999),
)
def test_length_and_diameter_are_those_asked_for(length, slimness, lobes, depth, shoulder, taper, seed):
    points = mesh_of(
        fruit(
            length_m=length, diameter_m=length / slimness, lobes=lobes, lobe_depth=depth, shoulder=shoulder,
            taper=taper, seed=seed,
        )
    ).vertices  # fmt: skip
    # The curve of the hand-made fruit is 90 mm long whatever its length: sizes come from the measures.
    np.testing.assert_allclose(np.ptp(points[:, 2]), length, rtol=0.02)
    np.testing.assert_allclose(calliper(points), length / slimness, rtol=0.02)


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
        assert step.max() < 0.15
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


def test_a_calyx_has_five_or_six_teeth():
    counts = set()
    for seed in np.linspace(0.0, 0.95, 8):
        axis = np.array([[0.0, 0, 0.004], [0.0, 0.0, 0.0]])
        calyx = Organ("calyx", -1, 0, axis, np.array([1.0, 0, 0]), {"radius_m": 0.018, "seed": seed})
        points = mesh_of(calyx, detail=4.0).vertices
        angle, radius = np.arctan2(points[:, 1], points[:, 0]), np.hypot(points[:, 0], points[:, 1])
        number = np.round(angle / (2 * np.pi) * 80).astype(int) % 80  # the mesh has 80 columns
        rim = np.array([radius[number == column].max() for column in range(80)])
        counts.add(2 + int(np.argmax(np.abs(np.fft.rfft(rim))[2:12])))
    assert counts == {5, 6}
