from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from pepperscene.classes import OrganClass
from pepperscene.cultivar import load_cultivar
from pepperscene.geometry import mesh_plant, rectangle, sphere, stem_branches, stem_profile, twine_mesh
from pepperscene.grammar import grow
from pepperscene.grammar.plant import Plant

STEM = np.stack([np.zeros(21), np.zeros(21), np.linspace(0.0, 2.0, 21)], axis=1)


def closed(mesh):
    points, number = np.unique(mesh.vertices, axis=0, return_inverse=True)
    return trimesh.Trimesh(points.astype(float), number.ravel()[mesh.faces], process=False)


def test_the_cord_touches_the_stem_all_the_way():
    mesh = twine_mesh(STEM, 0.0045, 0.001, turns_per_m=3.0, phase_rad=0.4, above_m=0.0)
    reach = np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 1])
    inner = (mesh.vertices[:, 2] > 0.01) & (mesh.vertices[:, 2] < 1.99)
    assert reach[inner].min() == pytest.approx(0.0045, abs=2e-4)
    assert reach[inner].max() == pytest.approx(0.0065, abs=2e-4)


@pytest.fixture(scope="module")
def plant():
    """The lowest ten phytomers of a plant, its stem smooth but for its nodes."""
    whole = grow(load_cultivar("kaite"), np.random.default_rng(4))
    smooth = [
        replace(organ, measures=organ.measures | {"groove_m": 0.0}) if organ.kind == "internode" else organ
        for organ in whole.organs
    ]
    kept = [i for i, organ in enumerate(smooth) if organ.phytomer < 10]
    number = {old: new for new, old in enumerate(kept)}
    organs = tuple(replace(smooth[i], parent=number.get(smooth[i].parent, -1)) for i in kept)
    return Plant(whole.cultivar, organs, whole.kinds)


def bodies(plant, *forms):
    """The plant's organs of some forms, each as a closed body."""
    mesh = mesh_plant(plant)
    chosen = [i for i, organ in enumerate(plant.organs) if plant.kinds[organ.kind].form in forms]
    return [closed(mesh.select_instances([i])) for i in chosen]


def rings_of(mesh, sides=6):
    """Rings `(r, sides, 3)` of the cord, and those at three places between each and the next."""
    ring = mesh.vertices[1:-1].reshape(-1, sides + 1, 3)[1:-1, :-1].astype(float)
    return np.concatenate([ring[:-1] + part * (ring[1:] - ring[:-1]) for part in (0.0, 0.25, 0.5, 0.75)])


def depth_in(solids, points):
    """`(n,)` metres that points lie within the nearest of some bodies; negative outside."""
    found = np.full(len(points), -np.inf)
    for solid in solids:
        low, high = solid.bounds
        near = np.flatnonzero(np.all((points > low - 0.003) & (points < high + 0.003), axis=1))
        if near.size:
            found[near] = np.maximum(found[near], trimesh.proximity.signed_distance(solid, points[near]))
    return found


@pytest.mark.parametrize(("radius", "turns"), [(0.001, 3.0), (0.002, 4.0), (0.0005, -2.0)])
def test_cord_and_stem_touch_on_their_triangles(plant, radius, turns):
    cord = twine_mesh(*stem_profile(plant), radius, turns, 0.8, 0.0, branches=stem_branches(plant), seed=0.3)
    ring = rings_of(cord)
    depth = depth_in(bodies(plant, "internode", "node"), ring.reshape(-1, 3)).reshape(ring.shape[:2])
    # Each cross-section of the cord comes as near as half a millimetre, and dips in by less.
    assert depth.max(axis=1).min() > -5e-4
    assert depth.max() < 5e-4


def test_a_cord_passes_beside_what_grows_out_of_the_stem(plant):
    outline, branches = stem_profile(plant), stem_branches(plant)
    others = bodies(plant, "stalk", "peduncle", "cut")
    hit = []
    for aside in (branches, None):
        count = 0
        for phase in (0.0, 2.0, 4.0):
            ring = rings_of(twine_mesh(*outline, 0.001, 3.0, phase, 0.0, branches=aside, seed=0.6))
            count += int((depth_in(others, ring.reshape(-1, 3)) > 1e-4).sum())
        hit.append(count)
    assert hit[0] < 0.03 * hit[1]


def test_the_outline_lies_on_the_triangles(plant):
    axis, radius = stem_profile(plant)
    stem = bodies(plant, "internode", "node")
    # Within the outline by a tenth, outside it by a tenth, in any direction across.
    course = np.gradient(axis, axis=0)
    across = np.cross(course, [0.3, 1.0, 0.0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    inner, outer = (axis + share * radius[:, None] * across for share in (0.85, 1.1))
    assert (depth_in(stem, inner)[2:-2] > 0.0).all()
    assert (depth_in(stem, outer)[2:-2] < 0.0).all()
    # It swells at every node.
    widest = [organ.measures["radius_m"] for organ in plant.of_form("node")]
    peaks = radius[1:-1][(radius[1:-1] >= radius[:-2]) & (radius[1:-1] > radius[2:])]
    np.testing.assert_allclose(np.sort(peaks[peaks > 0.9 * min(widest)]), np.sort(widest), rtol=1e-6)


def test_a_plant_without_a_stem_has_no_outline(plant):
    with pytest.raises(ValueError, match="stem"):
        stem_profile(Plant("leafless", plant.of_form("blade"), plant.kinds))


def test_a_seed_makes_the_pitch_uneven():
    angles = []
    for seed in (None, 0.2, 0.2, 0.7):
        points = rings_of(twine_mesh(STEM, 0.0045, 0.0005, 3.0, above_m=0.0, seed=seed)).mean(axis=1)
        points = points[np.argsort(points[:, 2])]
        turned = np.unwrap(np.arctan2(points[:, 0], -points[:, 1])) - 6.0 * np.pi * points[:, 2]
        angles.append(np.interp(np.linspace(0.02, 1.98, 200), points[:, 2], turned))
    assert np.ptp(angles[0]) < 0.02
    assert 0.2 < np.ptp(angles[1]) < 0.8
    np.testing.assert_array_equal(angles[1], angles[2])
    assert np.abs(angles[1] - angles[3]).max() > 0.1


def test_two_plies_turn_about_each_other_once_a_lay():
    mesh = twine_mesh(STEM[:5], 0.0045, 0.001, 0.0, above_m=0.0, lay_m=0.012)
    assert closed(mesh).is_watertight
    ring = mesh.vertices[1:-1].reshape(-1, 9, 3)[1:-1, :-1].astype(float)
    off = ring - ring.mean(axis=1, keepdims=True)
    # A waisted section, whose longer axis turns by half a turn in half a lay.
    reach = np.linalg.norm(off, axis=2)
    assert reach.max() == pytest.approx(0.001, rel=0.01)
    assert reach.min() < 0.75 * 0.001
    angle = np.arctan2(off[..., 0], off[..., 1])
    axis = np.angle(np.sum(reach**2 * np.exp(2j * angle), axis=1))
    height = ring[:, :, 2].mean(axis=1)
    slope = np.polyfit(height, np.unwrap(axis) / 2.0, 1)[0]
    assert abs(slope) == pytest.approx(2.0 * np.pi / 0.012, rel=0.02)


@pytest.mark.parametrize("turns", [-2.0, 0.0, 3.5])
def test_it_winds_as_often_as_told(turns):
    mesh = twine_mesh(STEM, 0.0045, 0.0005, turns, above_m=0.0)
    order = np.argsort(mesh.vertices[:, 2])
    height = mesh.vertices[order, 2]
    angle = np.unwrap(np.arctan2(mesh.vertices[order, 1], mesh.vertices[order, 0]))
    slope = np.polyfit(height, angle, 1)[0] / (2.0 * np.pi)
    assert slope == pytest.approx(turns, abs=0.05)


def test_it_starts_where_the_phase_says():
    first = twine_mesh(STEM, 0.0045, 0.0005, 2.0, 0.0, 0.0).vertices[0]
    assert first[1] == pytest.approx(-0.005, abs=1e-4)
    assert first[0] == pytest.approx(0.0, abs=1e-4)


def test_it_goes_on_straight_above_the_stem():
    mesh = twine_mesh(STEM, 0.0045, 0.001, 2.0, above_m=0.8)
    top = mesh.vertices[mesh.vertices[:, 2] > 2.2]
    assert mesh.vertices[:, 2].max() == pytest.approx(2.8, abs=2e-3)
    assert np.hypot(top[:, 0], top[:, 1]).max() < 0.0013


def test_it_is_a_closed_wire_of_one_instance():
    mesh = twine_mesh(STEM, np.linspace(0.006, 0.003, 21), 0.001, 3.0)
    solid = closed(mesh)
    assert solid.is_watertight
    assert solid.volume > 0.0
    assert mesh.surfaces == ("twine",)
    assert [item.organ_class for item in mesh.instances] == [OrganClass.WIRE]
    assert set(mesh.face_class) == {OrganClass.WIRE}


def test_a_crooked_stem_is_followed():
    wave = STEM + np.stack([0.03 * np.sin(4.0 * STEM[:, 2]), 0.0 * STEM[:, 0], 0.0 * STEM[:, 0]], axis=1)
    mesh = twine_mesh(wave, 0.004, 0.001, 3.0, above_m=0.0)
    fine = np.stack(
        [np.interp(np.linspace(0, 2, 2001), wave[:, 2], wave[:, axis]) for axis in range(3)], axis=1
    )
    distance = np.min(np.linalg.norm(mesh.vertices[:, None, :] - fine[None], axis=2), axis=1)
    assert distance.max() < 0.0068


@pytest.mark.parametrize("radius", [0.0, -0.001, float("nan")])
def test_a_cord_needs_a_radius(radius):
    with pytest.raises(ValueError, match="radius"):
        twine_mesh(STEM, 0.005, radius, 2.0)


def test_plies_need_a_length():
    with pytest.raises(ValueError, match="plies"):
        twine_mesh(STEM, 0.005, 0.001, 2.0, lay_m=0.0)


@pytest.mark.parametrize("axis", [STEM[:1], STEM[:2] * 0.0])
def test_an_axis_needs_a_length(axis):
    with pytest.raises(ValueError, match="distinct"):
        twine_mesh(axis, 0.005, 0.001, 2.0)


def test_a_sphere_is_round_and_closed():
    mesh = sphere((1.0, 2.0, 3.0), 0.04, subdivisions=4)
    away = np.linalg.norm(mesh.vertices - [1.0, 2.0, 3.0], axis=1)
    np.testing.assert_allclose(away, 0.04, rtol=1e-5)
    np.testing.assert_allclose(mesh.vertices, [1.0, 2.0, 3.0] + 0.04 * mesh.normals, atol=1e-6)
    solid = closed(mesh)
    assert solid.is_watertight
    assert solid.volume == pytest.approx(4.0 / 3.0 * np.pi * 0.04**3, rel=0.01)
    assert mesh.uv.min() >= 0.0
    assert mesh.uv.max() <= 1.0
    with pytest.raises(ValueError, match="radius_m"):
        sphere((0, 0, 0), 0.0)


def test_a_rectangle_faces_right_cross_up():
    mesh = rectangle((0.0, 1.0, 0.0), (0.2, 0.0, 0.0), (0.0, 0.0, 0.3), surface="card")
    np.testing.assert_allclose(mesh.normals, np.tile([0.0, -1.0, 0.0], (4, 1)), atol=1e-7)
    a, b, c = (mesh.vertices[mesh.faces[:, corner]].astype(float) for corner in range(3))
    cross = np.cross(b - a, c - a)
    np.testing.assert_allclose(0.5 * cross.sum(axis=0), [0.0, -0.06, 0.0], atol=1e-8)
    np.testing.assert_allclose(mesh.vertices.mean(axis=0), [0.0, 1.0, 0.0], atol=1e-7)
    assert mesh.surfaces == ("card",)
    with pytest.raises(ValueError, match="span"):
        rectangle((0, 0, 0), (1, 0, 0), (2, 0, 0))
