"""Contacts are resolved by small rotations of rigid organs about their joints."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from pepperscene.classes import Instance, OrganClass
from pepperscene.cultivar import load_cultivar
from pepperscene.geometry import (
    Mesh,
    ResolvedMesh,
    concatenate_meshes,
    count_contacts,
    mesh_plant,
    move_plant,
    rectangle,
    resolve_contacts,
    sphere,
)
from pepperscene.geometry.contacts.detect import ContactDetector, current_counts
from pepperscene.geometry.contacts.joints import units_of
from pepperscene.geometry.contacts.organs import Organs
from pepperscene.geometry.contacts.patches import SPACING, fill_triangles
from pepperscene.geometry.contacts.resolve import ContactSolver, _Round
from pepperscene.geometry.contacts.shapes import FruitSurfaces, StemCapsules
from pepperscene.grammar import Plant, grow

RADIUS = 0.04


@cache
def grown(name: str = "kaite", seed: int = 3) -> tuple[Plant, Mesh]:
    plant = grow(load_cultivar(name), np.random.default_rng(seed))
    return plant, mesh_plant(plant)


@cache
def resolved(name: str = "kaite", seed: int = 3) -> ResolvedMesh:
    return resolve_contacts(grown(name, seed)[1], np.random.default_rng(seed))


def shifted(mesh: Mesh, x: float = 0.0, z: float = 0.0) -> Mesh:
    return mesh.moved(np.eye(3), np.array([x, 0.0, z]))


def scene(*parts: tuple[Mesh, OrganClass, str, int]) -> Mesh:
    """Bodies as organs: mesh, class, kind and parent of each."""
    mesh = concatenate_meshes([part for part, *_ in parts])
    instances = [Instance(kind, name, plant=0, parent=parent) for _, kind, name, parent in parts]
    return replace(mesh, instances=tuple(instances))


def leafy_node(leaf_height: float, fruit_height: float = 0.95) -> Mesh:
    """A node, a fruit on a stalk next to it, and a horizontal leaf on a stalk at some height."""
    stalk = sphere([0.03, 0.0, fruit_height + 0.05], 0.004)
    return scene(
        (sphere([0.0, 0.0, 1.0], 0.008), OrganClass.STEM, "node", -1),
        (stalk, OrganClass.PEDUNCLE, "peduncle", 0),
        (sphere([0.06, 0.0, fruit_height], RADIUS, subdivisions=4), OrganClass.PEPPER, "fruit", 1),
        (sphere([0.0, 0.01, leaf_height], 0.003), OrganClass.SHOOT, "petiole", 0),
        (rectangle([0.06, 0.03, leaf_height], [0.1, 0, 0], [0, 0.06, 0]), OrganClass.LEAF, "lamina", 3),
    )


def edge_lengths(mesh: Mesh) -> np.ndarray:
    corners = mesh.vertices[mesh.faces].astype(float)
    return np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)


def neighbours() -> Mesh:
    """Two plants as grown, 15 cm apart."""
    second = shifted(grown("kaite", 5)[1].select_plant(1), 0.15)
    return concatenate_meshes([grown()[1].select_plant(0), second])


# --- shapes -----------------------------------------------------------------------------------------------


def test_depth_in_a_sphere_is_exact() -> None:
    surfaces = FruitSurfaces(Organs(sphere([1.0, 2.0, 3.0], RADIUS, subdivisions=4)), np.array([0]))
    spheres = surfaces.spheres(np.array([0]))
    np.testing.assert_allclose(spheres.centre[0], [1.0, 2.0, 3.0], atol=1e-6)
    assert spheres.radius[0] == pytest.approx(RADIUS, rel=1e-5)
    directions = np.random.default_rng(0).normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for distance in (0.5 * RADIUS, RADIUS, 1.2 * RADIUS):
        points = spheres.centre[0] + distance * directions
        # The planes of triangles are a little inside the sphere, or cut a corner off it.
        np.testing.assert_allclose(
            fruit_depth(surfaces, 0, points.T[:, None]), RADIUS - distance, atol=0.01 * RADIUS
        )


def fruit_depth(
    surfaces: FruitSurfaces, fruit: int, points: np.ndarray, margin: float = np.inf
) -> np.ndarray:
    """Depth of the deepest of points `(3, s, h)`, at most `margin` out of its sphere, in a fruit as grown."""
    spheres, count = surfaces.spheres(np.array([fruit])), points.shape[2]
    local = (points - spheres.centre[0][:, None, None]).astype(np.float32)
    matrix = np.repeat(np.eye(3, dtype=np.float32)[..., None], count, axis=2)
    limit = np.full(count, spheres.radius[0] + margin, dtype=np.float32)
    row = np.repeat(spheres.row, count)
    return surfaces.depth(row, local, matrix, np.zeros((3, count), dtype=np.float32), limit)


def test_sample_points_leave_no_gap() -> None:
    # Random points on a large triangle and its neighbour: each has a sample point nearby.
    corners = np.array(
        [[[0, 0, 0], [0.04, 0, 0], [0.01, 0.03, 0]], [[0.04, 0, 0], [0, 0, 0], [0.02, -0.02, 0]]]
    )
    points, triangle = fill_triangles(corners.astype(np.float32))
    assert np.all(np.diff(triangle) >= 0)
    samples = np.concatenate([points, corners.reshape(-1, 3)])
    weights = np.random.default_rng(1).dirichlet(np.ones(3), 400)
    for one in corners:
        distance = np.linalg.norm((weights @ one)[:, None] - samples, axis=2).min(axis=1)
        assert distance.max() < 1.5 * SPACING
    edge = samples[np.abs(samples[:, 1]) < 1e-9]
    assert np.diff(np.sort(edge[:, 0])).max() <= SPACING
    assert len(fill_triangles(corners.astype(np.float32) * 0.05)[0]) == 0


def stem_depth(organs: Organs, stem: int, points: np.ndarray) -> float:
    """Depth of the deepest of points `(p, 3)` in any capsule of a stem."""
    capsules, which, _ = StemCapsules(organs).of_tubes(np.array([stem]))
    start, span, radius = capsules.start[which], capsules.span[which], capsules.radius[which]
    offset = points[:, None].astype(float) - start
    along = np.einsum("pci,ci->pc", offset, span) / np.maximum(np.einsum("ci,ci->c", span, span), 1e-12)
    nearest = offset - np.clip(along, 0.0, 1.0)[..., None] * span
    return float((radius - np.linalg.norm(nearest, axis=2)).max())


def test_a_tube_is_a_chain_of_capsules() -> None:
    plant, mesh = grown()
    organs = Organs(mesh)
    stem = next(i for i, organ in enumerate(plant.organs) if plant.kinds[organ.kind].form == "internode")
    organ = plant.organs[stem]
    middle = 0.5 * (organ.curve[0] + organ.curve[-1])
    depth = stem_depth(organs, stem, middle[None])
    assert depth == pytest.approx(organ.measures["radius_m"], rel=0.3)
    assert stem_depth(organs, stem, middle[None] + [0.05, 0.0, 0.0]) == pytest.approx(depth - 0.05, abs=1e-3)


# --- counting ---------------------------------------------------------------------------------------------


def test_contacts_are_counted_by_class_and_parent() -> None:
    calyx = sphere([0.0, 0.0, RADIUS], 0.01)
    fruit = sphere([0.0, 0.0, 0.0], RADIUS)
    joined = scene((calyx, OrganClass.PEDUNCLE, "calyx", -1), (fruit, OrganClass.PEPPER, "fruit", 0))
    assert count_contacts(joined).fruit_touching == 0
    separate = scene((calyx, OrganClass.PEDUNCLE, "calyx", -1), (fruit, OrganClass.PEPPER, "fruit", -1))
    assert count_contacts(separate).fruit_touching == 1
    two = scene(*((shifted(fruit, x * RADIUS), OrganClass.PEPPER, "fruit", -1) for x in (0.0, 1.9, 9.0)))
    assert (count_contacts(two).fruit, count_contacts(two).fruit_touching) == (3, 2)
    blade = rectangle([0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0])
    apart = scene((blade, OrganClass.LEAF, "lamina", -1), (calyx, OrganClass.STEM, "node", -1))
    assert count_contacts(apart).blades_touching == 0
    through = scene((blade, OrganClass.LEAF, "lamina", -1), (fruit, OrganClass.STEM, "node", -1))
    assert (count_contacts(through).blades, count_contacts(through).blades_touching) == (1, 1)
    ground = rectangle([0.0, 0.0, 0.0], [9.0, 0.0, 0.0], [0.0, 9.0, 0.0])
    scenery = scene((fruit, OrganClass.PEPPER, "fruit", -1), (ground, OrganClass.BACKGROUND, "film", -1))
    assert count_contacts(scenery).fruit_touching == 0


def test_boxes_that_overlap_are_all_found() -> None:
    organs = Organs(grown()[1])
    leaves, others = organs.of_class(int(OrganClass.LEAF)), np.flatnonzero(organs.solid)
    row, column = organs.close_pairs(leaves, others, 0.003)
    overlap = np.all(organs.low[leaves][:, None] < organs.high[others] + 0.003, axis=2)
    overlap &= np.all(organs.high[leaves][:, None] > organs.low[others] - 0.003, axis=2)
    assert set(zip(row.tolist(), column.tolist(), strict=True)) == set(
        zip(*(places.tolist() for places in np.nonzero(overlap)), strict=True)
    )


def test_patches_hold_all_sample_points() -> None:
    organs = Organs(grown()[1])
    for organ in organs.of_class(int(OrganClass.LEAF), int(OrganClass.PEPPER))[::9]:
        patches, patch, place = organs.patches(np.array([organ]))
        corners, _ = organs.original_triangles([organ])
        expected = np.concatenate([organs.original_vertices(organ), fill_triangles(corners)[0]])
        points = patches.points[patch]
        assert not place.any()
        np.testing.assert_array_equal(np.unique(points.reshape(-1, 3), axis=0), np.unique(expected, axis=0))
        distance = np.linalg.norm(points.astype(float) - patches.centre[patch][:, None], axis=2)
        assert np.all(distance <= patches.radius[patch][:, None])


@pytest.mark.parametrize("between_plants", [False, True])
def test_depths_in_fruit_are_those_of_all_points(between_plants: bool) -> None:
    """Boxes and bounding spheres leave out nothing that penetrates: all points of all organs agree."""
    detector = ContactDetector(neighbours() if between_plants else grown()[1], between_plants=between_plants)
    organs, pairs = detector.organs, detector.fruit_pairs()
    solid = np.flatnonzero(organs.solid)
    patches, patch, place = organs.patches(solid)
    points = patches.coordinates(patch)
    for fruit in detector.fruit.tolist():
        expected = np.full(len(solid), -np.inf)
        np.maximum.at(expected, place, fruit_depth(detector.surfaces, fruit, points, 0.0))
        expected[detector.are_joined(np.full(len(solid), fruit), solid)] = -np.inf
        if between_plants:
            expected[organs.plant[solid] == organs.plant[fruit]] = -np.inf
        rows = pairs.organ == fruit
        depths = dict(zip(pairs.other[rows].tolist(), pairs.depth[rows], strict=True))
        # Rounding in single precision, relative to the middle of the row or of the fruit.
        deep = {int(solid[one]): expected[one] for one in np.flatnonzero(expected > 1e-5)}
        assert {other for other, depth in depths.items() if depth > 2e-5} <= set(deep)
        for other, depth in deep.items():
            assert depths[other] == pytest.approx(depth, abs=2e-4)


def test_depths_in_stems_are_those_of_all_points() -> None:
    detector = ContactDetector(grown()[1])
    organs, pairs = detector.organs, detector.blade_pairs()
    depths = dict(zip(zip(pairs.organ.tolist(), pairs.other.tolist(), strict=True), pairs.depth, strict=True))
    stems = np.flatnonzero(detector.is_stem & organs.solid)
    for blade in detector.blades:
        patches, patch, _ = organs.patches(np.array([blade]))
        points = patches.points[patch].reshape(-1, 3)
        # Capsules are at most a centimetre thicker and longer than the stem.
        near = np.all(organs.low[stems] < organs.high[blade] + 0.02, axis=1)
        near &= np.all(organs.high[stems] > organs.low[blade] - 0.02, axis=1)
        for stem in stems[near & ~detector.are_joined(np.full(len(stems), blade), stems)].tolist():
            depth = stem_depth(organs, stem, points)
            if depth > -1e-3:
                assert depths[int(blade), stem] == pytest.approx(depth, abs=1e-5)


def test_contacts_after_motions_are_those_of_the_moved_mesh() -> None:
    expected = resolved()
    detector = ContactDetector(grown()[1])
    current_counts(detector)
    for motion in expected.motions:
        shift = motion.pivot - motion.rotation @ motion.pivot
        detector.organs.move(detector.organs.subtree(motion.instance), motion.rotation, shift)
    assert current_counts(detector) == count_contacts(expected.mesh) == expected.contacts


# --- resolving --------------------------------------------------------------------------------------------


def test_a_leaf_moves_off_a_fruit_and_the_fruit_stays() -> None:
    mesh = leafy_node(0.98)
    assert count_contacts(mesh).fruit_touching == 1
    result = resolve_contacts(mesh, np.random.default_rng(0))
    assert result.contacts.fruit_touching == 0
    assert {motion.instance for motion in result.motions} <= {3, 4}
    fruit = mesh.vertex_runs.rows(2)
    np.testing.assert_array_equal(result.mesh.vertices[fruit], mesh.vertices[fruit])
    # Measured on the triangles: every point of the leaf is outside the sphere.
    leaf = result.mesh.vertices[mesh.faces[mesh.face_instance == 4]].astype(float)
    weights = np.random.default_rng(1).dirichlet(np.ones(3), 4000)
    distance = np.linalg.norm(np.einsum("wc,fci->wfi", weights, leaf) - [0.06, 0.0, 0.95], axis=2)
    assert distance.min() > RADIUS


def test_a_mesh_without_contacts_is_returned_as_it_is() -> None:
    mesh = leafy_node(1.3)
    result = resolve_contacts(mesh, np.random.default_rng(0))
    assert result.mesh is mesh
    assert result.motions == ()
    assert result.contacts == count_contacts(mesh)


def test_zero_rounds_move_nothing() -> None:
    mesh = grown()[1]
    result = resolve_contacts(mesh, np.random.default_rng(0), rounds=0)
    assert result.mesh is mesh
    assert result.contacts == count_contacts(mesh)
    assert result.contacts.fruit_touching > 3


@pytest.mark.parametrize("name", ["kaite", "tomato"])
def test_contacts_of_a_plant_are_resolved_by_few_motions(name: str) -> None:
    mesh, result = grown(name)[1], resolved(name)
    before = count_contacts(mesh)
    assert result.contacts.fruit == before.fruit
    assert before.fruit_touching > 0.3 * before.fruit
    assert result.contacts.fruit_touching <= 1
    assert result.contacts == count_contacts(result.mesh)
    assert len({motion.instance for motion in result.motions}) < 0.2 * len(mesh.instances)


@pytest.mark.parametrize("name", ["kaite", "tomato"])
def test_organs_stay_rigid(name: str) -> None:
    mesh, result = grown(name)[1], resolved(name)
    np.testing.assert_allclose(edge_lengths(result.mesh), edge_lengths(mesh), atol=2e-6)
    np.testing.assert_array_equal(result.mesh.faces, mesh.faces)
    np.testing.assert_array_equal(result.mesh.uv, mesh.uv)
    assert result.mesh.vertices.dtype == np.float32
    assert np.all(np.isfinite(result.mesh.vertices))
    np.testing.assert_allclose(
        np.linalg.norm(result.mesh.normals, axis=1), np.linalg.norm(mesh.normals, axis=1), atol=1e-5
    )
    for motion in result.motions:
        np.testing.assert_allclose(motion.rotation @ motion.rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(motion.rotation) == pytest.approx(1.0)
    # Stem, nodes and cuts never move.
    fixed = np.isin(mesh.face_class, [OrganClass.STEM, OrganClass.CUT])
    np.testing.assert_array_equal(result.mesh.vertices[mesh.faces[fixed]], mesh.vertices[mesh.faces[fixed]])


@pytest.mark.parametrize("name", ["kaite", "tomato"])
def test_motions_reproduce_the_resolved_mesh(name: str) -> None:
    """Applied in order to subtrees of the mesh as grown."""
    mesh, result = grown(name)[1], resolved(name)
    organs = Organs(mesh)
    vertices, normals = mesh.vertices.astype(float), mesh.normals.astype(float)
    for motion in result.motions:
        moved = np.unique(mesh.faces[np.isin(mesh.face_instance, organs.subtree(motion.instance))])
        vertices[moved] = (vertices[moved] - motion.pivot) @ motion.rotation.T + motion.pivot
        normals[moved] = normals[moved] @ motion.rotation.T
    np.testing.assert_allclose(result.mesh.vertices, vertices, atol=1e-6)
    np.testing.assert_allclose(result.mesh.normals, normals, atol=1e-5)


def test_moved_plant_has_the_resolved_mesh() -> None:
    plant, result = grown()[0], resolved()
    again = mesh_plant(move_plant(plant, result.motions))
    distance = np.linalg.norm(again.vertices - result.mesh.vertices, axis=1)
    free = np.isin(again.face_class, [OrganClass.LEAF, OrganClass.PEPPER])
    assert distance[np.unique(again.faces[free])].max() < 1e-5
    # Stalks and calyces are meshed to fit what they join, so a kink in a joint changes their shape a little.
    assert distance.max() < 2e-3


def test_move_plant_raises_on_motions_of_another_plant() -> None:
    plant = grown()[0]
    motion = replace(resolved().motions[0], instance=len(plant.organs))
    with pytest.raises(ValueError, match="not an organ"):
        move_plant(plant, [motion])


def test_feet_stay_in_their_joints() -> None:
    """What grows on a node keeps its distance from the node's middle, and its height."""
    plant = grown()[0]
    moved = move_plant(plant, resolved().motions)
    for before, after in zip(plant.organs, moved.organs, strict=True):
        if before.parent < 0:
            continue
        parent, moved_parent = plant.organs[before.parent], moved.organs[before.parent]
        if plant.kinds[parent.kind].form == "node":
            middle = parent.curve.mean(axis=0)
            assert after.curve[0][2] == pytest.approx(before.curve[0][2], abs=2e-3)
            assert np.linalg.norm(after.curve[0] - middle) == pytest.approx(
                np.linalg.norm(before.curve[0] - middle), abs=3e-3
            )
        else:
            gap = np.linalg.norm(before.curve[0] - parent.curve[-1])
            assert np.linalg.norm(after.curve[0] - moved_parent.curve[-1]) < gap + 0.01


def test_rotations_stay_within_their_limits() -> None:
    plant, mesh = grown()
    moved = move_plant(plant, resolved().motions)
    organs = Organs(mesh)
    for index, (before, after) in enumerate(zip(plant.organs, moved.organs, strict=True)):
        units = units_of(organs, index)
        if len(units) == 1 and units[0].on_stem:
            old, new = before.curve[-1] - before.curve[0], after.curve[-1] - after.curve[0]
            cosine = old @ new / np.linalg.norm(old) / np.linalg.norm(new)
            assert np.arccos(min(cosine, 1.0)) <= np.hypot(*units[0].limits) + 1e-6


def test_same_seed_gives_the_same_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = grown()[1]
    other = resolve_contacts(mesh, np.random.default_rng(4)).mesh
    assert other.vertices.tobytes() != resolved().mesh.vertices.tobytes()
    # Whatever the number of distances computed at a time.
    monkeypatch.setattr("pepperscene.geometry.contacts.pairs.ENTRIES", 500)
    again = resolve_contacts(mesh, np.random.default_rng(3)).mesh
    assert again.vertices.tobytes() == resolved().mesh.vertices.tobytes()


def test_order_of_vertices_does_not_matter() -> None:
    mesh = grown()[1]
    order = np.random.default_rng(0).permutation(len(mesh.vertices))
    values = {name: getattr(mesh, name)[order] for name in ("vertices", "normals", "uv", "state")}
    shuffled = replace(mesh, **values, faces=np.argsort(order)[mesh.faces].astype(np.uint32))
    assert count_contacts(shuffled) == count_contacts(mesh)
    result = resolve_contacts(shuffled, np.random.default_rng(3))
    assert result.contacts.fruit_touching <= 1
    np.testing.assert_allclose(edge_lengths(result.mesh), edge_lengths(mesh), atol=2e-6)


def test_raises_if_instances_share_vertices() -> None:
    mesh = leafy_node(0.98)
    faces = mesh.faces.copy()
    faces[0, 0] = faces[-1, 0]
    with pytest.raises(ValueError, match="share vertices"):
        resolve_contacts(replace(mesh, faces=faces), np.random.default_rng(0))


@pytest.mark.parametrize("depth", [0.92, 0.96])
def test_nothing_is_moved_through_the_ground(depth: float) -> None:
    # The leaf could move off downwards, but there the ground is near.
    mesh = shifted(leafy_node(0.98), z=-depth)
    result = resolve_contacts(mesh, np.random.default_rng(1))
    for organ in range(5):
        rows = mesh.vertex_runs.rows(organ)
        before, after = mesh.vertices[rows, 2].min(), result.mesh.vertices[rows, 2].min()
        assert after >= min(before, 0.0) - 1e-5


@pytest.mark.parametrize("left_out", [OrganClass.PEPPER, OrganClass.LEAF, OrganClass.STEM])
def test_plants_without_organs_of_a_class_are_resolved(left_out: OrganClass) -> None:
    mesh = grown()[1]
    kept = [i for i, item in enumerate(mesh.instances) if item.organ_class != left_out]
    result = resolve_contacts(mesh.select_instances(kept), np.random.default_rng(0))
    assert np.all(np.isfinite(result.mesh.vertices))


def test_a_stem_alone_has_no_contacts() -> None:
    mesh = grown()[1]
    stem = [i for i, item in enumerate(mesh.instances) if item.organ_class == OrganClass.STEM]
    result = resolve_contacts(mesh.select_instances(stem), np.random.default_rng(0))
    assert result.contacts.fruit == result.contacts.blades == 0
    assert result.motions == ()


def test_between_plants_resolves_contacts_of_neighbours() -> None:
    first = resolved("kaite", 3).mesh.select_plant(0)
    second = shifted(resolved("kaite", 5).mesh.select_plant(1), 0.15)
    row = concatenate_meshes([first, second])
    result = resolve_contacts(row, np.random.default_rng(0), between_plants=True)
    assert count_contacts(row).fruit_touching > 2
    assert result.contacts.fruit_touching <= 1
    # Within each plant nothing got worse.
    for number, alone in enumerate((first, second)):
        kept = [i for i, item in enumerate(row.instances) if item.plant == number]
        now = result.mesh.select_instances(kept)
        assert count_contacts(now).fruit_touching <= count_contacts(alone).fruit_touching


def test_between_plants_ignores_contacts_within_a_plant() -> None:
    far = shifted(grown("kaite", 5)[1].select_plant(1), 3.0)
    row = concatenate_meshes([grown()[1].select_plant(0), far])
    result = resolve_contacts(row, np.random.default_rng(0), between_plants=True)
    assert result.motions == ()
    assert result.contacts.fruit_touching == 0


# --- many units at once -----------------------------------------------------------------------------------


def solver_and_round(number: int = 0) -> tuple[ContactSolver, _Round]:
    solver = ContactSolver(ContactDetector(grown()[1]), np.random.default_rng(0))
    phase = np.random.default_rng(1).uniform(0.0, 2.0 * np.pi, len(solver.organs))
    return solver, _Round(number, phase)


@pytest.mark.parametrize("number", [0, 1])
def test_units_tried_together_give_the_same_as_one_at_a_time(number: int) -> None:
    solver, attempt = solver_and_round(number)
    contacts = solver._find_contacts()
    units = {
        unit.root: (unit, [place])
        for place, pair in enumerate(contacts)
        for unit in solver._candidate_units(*pair)
    }
    together = solver._try_units(*map(list, zip(*units.values(), strict=True)), contacts, attempt)
    assert sum(trial.gain > 0.0 for trial in together.values()) > 10
    for root, (unit, places) in units.items():
        alone, other = solver._try_units([unit], [places], contacts, attempt)[root], together[root]
        np.testing.assert_array_equal(alone.angles, other.angles)
        assert (alone.gain, alone.small, alone.resolves) == (other.gain, other.small, other.resolves)


def test_distant_units_move_together_as_each_would_alone() -> None:
    single = leafy_node(0.98)
    number = len(single.instances)
    row = concatenate_meshes([shifted(single, 0.5 * step) for step in range(4)])
    phase = np.random.default_rng(1).uniform(0.0, 2.0 * np.pi, number)
    together, alone = (
        ContactSolver(ContactDetector(mesh), np.random.default_rng(0)) for mesh in (row, single)
    )
    contacts = together._find_contacts()
    assert len(contacts) == 4
    assert not len(together._resolve_some(contacts, _Round(0, np.tile(phase, 4))))
    alone._resolve_some(alone._find_contacts(), _Round(0, phase))
    assert len(together.motions) == 4 * len(alone.motions) > 0
    for step in range(4):
        places = slice(number * step, number * (step + 1))
        np.testing.assert_allclose(together._angles[places], alone._angles, atol=1e-6)


def test_units_that_would_meet_wait_for_each_other() -> None:
    """Many contacts are resolved at once; those near something that has just moved wait."""
    solver, attempt = solver_and_round()
    contacts = solver._find_contacts()
    before = current_counts(solver.detector)
    waiting = solver._resolve_some(contacts, attempt)
    assert 0 < len(waiting) < len(contacts)
    moved = {motion.instance for motion in solver.motions}
    assert (solver.detector.depths(*contacts.T) < 0.0).sum() > 0.5 * len(moved)
    assert current_counts(solver.detector).fruit_touching < before.fruit_touching
