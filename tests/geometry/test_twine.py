from dataclasses import replace

import numpy as np
import pytest
import trimesh
from organ_meshes import check_solid, merged

from pepperscene.classes import OrganClass
from pepperscene.cultivar import load_cultivar
from pepperscene.geometry import mesh_plant, stem_branches, stem_profile, twine_mesh
from pepperscene.grammar import grow
from pepperscene.grammar.plant import Plant

STEM = np.stack([np.zeros(21), np.zeros(21), np.linspace(0.0, 2.0, 21)], axis=1)


@pytest.fixture(scope="module")
def plant():
    """The lowest ten phytomers of a plant, its stem smooth except for its nodes."""
    grown = grow(load_cultivar("kaite"), np.random.default_rng(4))
    smooth = [
        replace(organ, measures=organ.measures | {"groove_m": 0.0}) if organ.kind == "internode" else organ
        for organ in grown.organs
    ]
    kept = [i for i, organ in enumerate(smooth) if organ.phytomer < 10]
    number = {old: new for new, old in enumerate(kept)}
    organs = tuple(replace(smooth[i], parent=number.get(smooth[i].parent, -1)) for i in kept)
    return Plant(grown.cultivar, organs, grown.kinds)


@pytest.fixture(scope="module")
def bodies(plant):
    """Closed bodies of the organs of the stem, and of those that grow out of it."""
    mesh = mesh_plant(plant)
    forms = [plant.kinds[organ.kind].form for organ in plant.organs]
    return [
        [merged(mesh.select_instances([i])) for i, form in enumerate(forms) if form in group]
        for group in (("internode", "node"), ("stalk", "peduncle", "cut"))
    ]


def sections(mesh, sides=6):
    """Rings `(r, sides, 3)` of the twine, and those at three places between each and the next."""
    ring = mesh.vertices[1:-1].reshape(-1, sides + 1, 3)[1:-1, :-1].astype(float)
    return np.concatenate([ring[:-1] + part * (ring[1:] - ring[:-1]) for part in (0.0, 0.25, 0.5, 0.75)])


def depth_in(solids, points):
    """`(n,)` metres of penetration of points in the nearest of some bodies; negative outside."""
    depth = np.full(len(points), -np.inf)
    for solid in solids:
        low, high = solid.bounds
        near = np.flatnonzero(np.all((points > low - 0.003) & (points < high + 0.003), axis=1))
        if near.size:
            depth[near] = np.maximum(depth[near], trimesh.proximity.signed_distance(solid, points[near]))
    return depth


@pytest.mark.parametrize(("radius", "turns"), [(0.002, 4.0), (0.0005, -2.0)])
def test_twine_and_stem_touch_on_their_triangles(plant, bodies, radius, turns):
    twine = twine_mesh(*stem_profile(plant), radius, turns, 0.8, 0.0, branches=stem_branches(plant), seed=0.3)
    ring = sections(twine)
    depth = depth_in(bodies[0], ring.reshape(-1, 3)).reshape(ring.shape[:2])
    # Each cross-section of the twine comes as near as half a millimetre, and penetrates by less.
    assert depth.max(axis=1).min() > -5e-4
    assert depth.max() < 5e-4


def test_twine_avoids_what_grows_out_of_the_stem(plant, bodies):
    outline = stem_profile(plant)
    hits = []
    for branches in (stem_branches(plant), None):
        count = 0
        for phase in (0.0, 2.0):
            ring = sections(twine_mesh(*outline, 0.001, 3.0, phase, 0.0, branches=branches, seed=0.6))
            count += int((depth_in(bodies[1], ring.reshape(-1, 3)) > 1e-4).sum())
        hits.append(count)
    assert hits[0] < 0.03 * hits[1]


def test_stem_profile_is_on_the_triangles(plant, bodies):
    axis, radius = stem_profile(plant)
    # Inside the stem within the outline, outside beyond it, in any direction across.
    across = np.cross(np.gradient(axis, axis=0), [0.3, 1.0, 0.0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    inner, outer = (axis + factor * radius[:, None] * across for factor in (0.85, 1.1))
    assert (depth_in(bodies[0], inner)[2:-2] > 0.0).all()
    assert (depth_in(bodies[0], outer)[2:-2] < 0.0).all()
    # It swells at every node.
    widest = [organ.measures["radius_m"] for organ in plant.of_form("node")]
    peaks = radius[1:-1][(radius[1:-1] >= radius[:-2]) & (radius[1:-1] > radius[2:])]
    np.testing.assert_allclose(np.sort(peaks[peaks > 0.9 * min(widest)]), np.sort(widest), rtol=1e-6)
    with pytest.raises(ValueError, match="stem"):
        stem_profile(Plant("stemless", plant.of_form("blade"), plant.kinds))


def test_seed_makes_the_pitch_uneven():
    angles = []
    for seed in (None, 0.2, 0.2, 0.7):
        points = sections(twine_mesh(STEM, 0.0045, 0.0005, 3.0, above_m=0.0, seed=seed)).mean(axis=1)
        points = points[np.argsort(points[:, 2])]
        angle = np.unwrap(np.arctan2(points[:, 0], -points[:, 1])) - 6.0 * np.pi * points[:, 2]
        angles.append(np.interp(np.linspace(0.02, 1.98, 200), points[:, 2], angle))
    assert np.ptp(angles[0]) < 0.02
    assert 0.2 < np.ptp(angles[1]) < 0.8
    np.testing.assert_array_equal(angles[1], angles[2])
    assert np.abs(angles[1] - angles[3]).max() > 0.1


def test_surface_coordinates_repeat_every_fifteen_diameters():
    mesh = twine_mesh(STEM, 0.0045, 0.001, 3.0, above_m=0.3)
    assert merged(mesh).is_watertight
    ring = mesh.vertices[1:-1].reshape(-1, 7, 3)[1:-1].astype(float)
    v = mesh.uv[1:-1, 1].reshape(-1, 7)[1:-1]
    assert np.ptp(v, axis=1).max() == 0.0
    middle, v = ring[:, :-1].mean(axis=1), v[:, 0].astype(float)
    # From v = 1 to 0 the twine does not move; elsewhere v counts its length.
    step, rise = np.linalg.norm(np.diff(middle, axis=0), axis=1), np.diff(v)
    jump = rise < -0.5
    assert step[jump].max() < 1e-6
    np.testing.assert_allclose(v[:-1][jump], 1.0)
    np.testing.assert_allclose(v[1:][jump], 0.0)
    assert jump.sum() == np.ceil(step.sum() / 0.03) - 1
    # Chords are a little shorter than the curve, and repeats are within a sampling step of it.
    length = np.concatenate([[0.0], np.cumsum(step)])
    turn = v + np.concatenate([[0.0], np.cumsum(jump)])
    np.testing.assert_allclose(0.03 * turn, length, rtol=0.01, atol=3e-4)


@pytest.mark.parametrize("turns", [-2.0, 0.0, 3.5])
def test_twine_has_the_stated_windings_per_metre(turns):
    mesh = twine_mesh(STEM, 0.0045, 0.0005, turns, above_m=0.0)
    x, y, z = mesh.vertices[np.argsort(mesh.vertices[:, 2])].T
    slope = np.polyfit(z, np.unwrap(np.arctan2(y, x)), 1)[0] / (2.0 * np.pi)
    assert slope == pytest.approx(turns, abs=0.05)


def test_twine_starts_on_the_aisle_side_at_phase_zero():
    first = twine_mesh(STEM, 0.0045, 0.0005, 2.0, 0.0, 0.0).vertices[0]
    np.testing.assert_allclose(first[:2], [0.0, -0.005], atol=1e-4)


def test_twine_continues_straight_above_the_stem():
    mesh = twine_mesh(STEM, 0.0045, 0.001, 2.0, above_m=0.8)
    top = mesh.vertices[mesh.vertices[:, 2] > 2.2]
    assert mesh.vertices[:, 2].max() == pytest.approx(2.8, abs=2e-3)
    assert np.hypot(top[:, 0], top[:, 1]).max() < 0.0013


def test_twine_is_a_closed_wire_of_one_instance():
    mesh = twine_mesh(STEM, np.linspace(0.006, 0.003, 21), 0.001, 3.0)
    check_solid(mesh)
    assert mesh.surfaces == ("twine",)
    assert [item.organ_class for item in mesh.instances] == [OrganClass.WIRE]
    assert set(mesh.face_class) == {OrganClass.WIRE}


@pytest.mark.parametrize(
    ("axis", "radius", "message"),
    [
        (STEM, 0.0, "radius"),
        (STEM, -0.001, "radius"),
        (STEM, float("nan"), "radius"),
        (STEM[:1], 0.001, "distinct"),
        (STEM[:2] * 0.0, 0.001, "distinct"),
    ],
)
def test_raises_on_wrong_input(axis, radius, message):
    with pytest.raises(ValueError, match=message):
        twine_mesh(axis, 0.005, radius, 2.0)
