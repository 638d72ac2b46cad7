"""Parts that run into each other are turned apart: small turns, whole joints, nothing torn."""

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
from pepperscene.geometry.contacts.detect import ContactBodies, counted
from pepperscene.geometry.contacts.fruit import walls
from pepperscene.geometry.contacts.joints import units_of
from pepperscene.geometry.contacts.organs import Organs
from pepperscene.geometry.contacts.resolve import Search
from pepperscene.geometry.contacts.samples import SPACING, filling
from pepperscene.geometry.contacts.stems import capsules
from pepperscene.grammar import Plant, grow

RADIUS = 0.04


@cache
def grown(name: str = "kaite", seed: int = 3) -> tuple[Plant, Mesh]:
    plant = grow(load_cultivar(name), np.random.default_rng(seed))
    return plant, mesh_plant(plant)


@cache
def settled(name: str = "kaite", seed: int = 3) -> ResolvedMesh:
    return resolve_contacts(grown(name, seed)[1], np.random.default_rng(seed))


def scene(*parts: tuple[Mesh, OrganClass, str, int]) -> Mesh:
    """Bodies as organs: mesh, class, kind and parent of each."""
    mesh = concatenate_meshes([part for part, *_ in parts])
    instances = [Instance(kind, name, plant=0, parent=parent) for _, kind, name, parent in parts]
    return replace(mesh, instances=tuple(instances))


def leafy_node(leaf_height: float, fruit_height: float = 0.95) -> Mesh:
    """A node, a fruit that hangs beside it on a stalk, and a level leaf on a stalk at some height."""
    stalk = sphere([0.03, 0.0, fruit_height + 0.05], 0.004)
    return scene(
        (sphere([0.0, 0.0, 1.0], 0.008), OrganClass.STEM, "node", -1),
        (stalk, OrganClass.PEDUNCLE, "peduncle", 0),
        (sphere([0.06, 0.0, fruit_height], RADIUS, subdivisions=4), OrganClass.PEPPER, "fruit", 1),
        (sphere([0.0, 0.01, leaf_height], 0.003), OrganClass.SHOOT, "petiole", 0),
        (rectangle([0.06, 0.03, leaf_height], [0.1, 0, 0], [0, 0.06, 0]), OrganClass.LEAF, "lamina", 3),
    )


def rows(mesh: Mesh, instance: int) -> np.ndarray:
    return np.unique(mesh.faces[mesh.face_instance == instance])


def edges(mesh: Mesh) -> np.ndarray:
    corners = mesh.vertices[mesh.faces].astype(float)
    return np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)


def test_the_wall_of_a_sphere_is_a_sphere() -> None:
    organs = Organs(sphere([1.0, 2.0, 3.0], RADIUS, subdivisions=4))
    (wall,) = walls(organs, [0])
    directions = np.random.default_rng(0).normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for distance in (0.5 * RADIUS, RADIUS, 1.2 * RADIUS):
        found = wall.depth((distance * directions).T.astype(np.float32))
        # The planes of triangles lie a little within the sphere, or cut a corner off it.
        np.testing.assert_allclose(found, RADIUS - distance, atol=0.01 * RADIUS)
    np.testing.assert_allclose(wall.centre, [1.0, 2.0, 3.0], atol=1e-6)
    assert wall.reach == pytest.approx(RADIUS, rel=1e-5)


def test_points_leave_no_gap() -> None:
    # Many points at random on a large triangle, and its neighbour: each has a laid point near.
    corners = np.array(
        [[[0, 0, 0], [0.04, 0, 0], [0.01, 0.03, 0]], [[0.04, 0, 0], [0, 0, 0], [0.02, -0.02, 0]]]
    )
    points, triangle = filling(corners.astype(np.float32))
    assert np.all(np.diff(triangle) >= 0)
    laid = np.concatenate([points, corners.reshape(-1, 3)])
    weights = np.random.default_rng(1).dirichlet(np.ones(3), 400)
    for one in corners:
        apart = np.linalg.norm((weights @ one)[:, None] - laid, axis=2).min(axis=1)
        assert apart.max() < 1.5 * SPACING
    edge = laid[np.abs(laid[:, 1]) < 1e-9]
    assert np.diff(np.sort(edge[:, 0])).max() <= SPACING
    assert len(filling(corners.astype(np.float32) * 0.05)[0]) == 0


def test_a_tube_is_a_chain_of_capsules() -> None:
    plant, mesh = grown()
    organs = Organs(mesh)
    stem = next(i for i, organ in enumerate(plant.organs) if plant.kinds[organ.kind].form == "internode")
    chain, organ = capsules(organs, stem), plant.organs[stem]
    middle = 0.5 * (organ.curve[0] + organ.curve[-1])
    at_middle = float(chain.depth(middle[None].astype(np.float32)).max())
    assert at_middle == pytest.approx(organ.measures["radius_m"], rel=0.3)
    outside = middle + np.array([0.05, 0.0, 0.0])
    assert float(chain.depth(outside[None].astype(np.float32)).max()) == pytest.approx(
        at_middle - 0.05, abs=1e-3
    )


def test_contacts_are_counted_by_class_and_kinship() -> None:
    calyx = sphere([0.0, 0.0, RADIUS], 0.01)
    fruit = sphere([0.0, 0.0, 0.0], RADIUS)
    own = scene((calyx, OrganClass.PEDUNCLE, "calyx", -1), (fruit, OrganClass.PEPPER, "fruit", 0))
    assert count_contacts(own).fruit_touching == 0
    other = scene((calyx, OrganClass.PEDUNCLE, "calyx", -1), (fruit, OrganClass.PEPPER, "fruit", -1))
    assert count_contacts(other).fruit_touching == 1
    both = scene(
        (fruit, OrganClass.PEPPER, "fruit", -1),
        (sphere([1.9 * RADIUS, 0.0, 0.0], RADIUS), OrganClass.PEPPER, "fruit", -1),
        (sphere([9.0 * RADIUS, 0.0, 0.0], RADIUS), OrganClass.PEPPER, "fruit", -1),
    )
    assert (count_contacts(both).fruit, count_contacts(both).fruit_touching) == (3, 2)
    blade = rectangle([0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0])
    through = scene((blade, OrganClass.LEAF, "lamina", -1), (calyx, OrganClass.STEM, "node", -1))
    assert count_contacts(through).blades_touching == 0
    deeper = scene((blade, OrganClass.LEAF, "lamina", -1), (fruit, OrganClass.STEM, "node", -1))
    assert (count_contacts(deeper).blades, count_contacts(deeper).blades_touching) == (1, 1)


def test_scenery_is_no_organ() -> None:
    fruit, floor = (
        sphere([0.0, 0.0, 0.0], RADIUS),
        rectangle([0.0, 0.0, 0.0], [9.0, 0.0, 0.0], [0.0, 9.0, 0.0]),
    )
    ground = scene((fruit, OrganClass.PEPPER, "fruit", -1), (floor, OrganClass.BACKGROUND, "film", -1))
    assert count_contacts(ground).fruit_touching == 0


def test_a_leaf_slips_off_a_fruit_and_the_fruit_stays() -> None:
    mesh = leafy_node(0.98)
    assert count_contacts(mesh).fruit_touching == 1
    found = resolve_contacts(mesh, np.random.default_rng(0))
    assert found.contacts.fruit_touching == 0
    assert {motion.instance for motion in found.motions} <= {3, 4}
    np.testing.assert_array_equal(found.mesh.vertices[rows(mesh, 2)], mesh.vertices[rows(mesh, 2)])
    # Measured on the triangles: every point of the leaf is off the sphere.
    leaf = found.mesh.vertices[found.mesh.faces[found.mesh.face_instance == 4]].astype(float)
    weights = np.random.default_rng(1).dirichlet(np.ones(3), 4000)
    apart = np.linalg.norm(np.einsum("wc,fci->wfi", weights, leaf) - [0.06, 0.0, 0.95], axis=2).min()
    assert apart > RADIUS


def test_what_stands_free_stays_as_it_is() -> None:
    mesh = leafy_node(1.3)
    found = resolve_contacts(mesh, np.random.default_rng(0))
    assert found.mesh is mesh
    assert found.motions == ()
    assert found.contacts == count_contacts(mesh)


def test_no_rounds_move_nothing() -> None:
    mesh = grown()[1]
    found = resolve_contacts(mesh, np.random.default_rng(0), rounds=0)
    assert found.mesh is mesh
    assert found.contacts == count_contacts(mesh)
    assert found.contacts.fruit_touching > 3


@pytest.mark.parametrize("name", ["kaite", "tomato"])
def test_a_plant_is_freed_by_few_motions(name: str) -> None:
    _, mesh = grown(name)
    found = settled(name)
    assert found.contacts.fruit == count_contacts(mesh).fruit
    assert count_contacts(mesh).fruit_touching > 0.3 * found.contacts.fruit
    assert found.contacts.fruit_touching <= 1
    assert found.contacts == count_contacts(found.mesh)
    assert len({motion.instance for motion in found.motions}) < 0.2 * len(mesh.instances)


@pytest.mark.parametrize("name", ["kaite", "tomato"])
def test_organs_stay_rigid(name: str) -> None:
    _, mesh = grown(name)
    found = settled(name)
    np.testing.assert_allclose(edges(found.mesh), edges(mesh), atol=2e-6)
    np.testing.assert_array_equal(found.mesh.faces, mesh.faces)
    np.testing.assert_array_equal(found.mesh.uv, mesh.uv)
    assert found.mesh.vertices.dtype == np.float32
    assert np.all(np.isfinite(found.mesh.vertices))
    np.testing.assert_allclose(
        np.linalg.norm(found.mesh.normals, axis=1), np.linalg.norm(mesh.normals, axis=1), atol=1e-5
    )
    for motion in found.motions:
        np.testing.assert_allclose(motion.rotation @ motion.rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(motion.rotation) == pytest.approx(1.0)
    # Stem, nodes and cuts never move.
    fixed = [
        i for i, one in enumerate(mesh.instances) if one.organ_class in (OrganClass.STEM, OrganClass.CUT)
    ]
    still = np.isin(mesh.face_instance, fixed)
    np.testing.assert_array_equal(found.mesh.vertices[mesh.faces[still]], mesh.vertices[mesh.faces[still]])


@pytest.mark.parametrize("name", ["kaite", "tomato"])
def test_motions_tell_the_whole_story(name: str) -> None:
    """The motions, done one after the other to subtrees of the mesh as grown, give the settled mesh."""
    _, mesh = grown(name)
    found = settled(name)
    organs = Organs(mesh)
    vertices, normals = mesh.vertices.astype(float), mesh.normals.astype(float)
    for motion in found.motions:
        moved = np.unique(mesh.faces[np.isin(mesh.face_instance, organs.subtree(motion.instance))])
        vertices[moved] = (vertices[moved] - motion.pivot) @ motion.rotation.T + motion.pivot
        normals[moved] = normals[moved] @ motion.rotation.T
    np.testing.assert_allclose(found.mesh.vertices, vertices, atol=1e-6)
    np.testing.assert_allclose(found.mesh.normals, normals, atol=1e-5)


def test_a_moved_plant_has_the_mesh_that_was_settled() -> None:
    plant, _ = grown()
    found = settled()
    again = mesh_plant(move_plant(plant, found.motions))
    apart = np.linalg.norm(again.vertices - found.mesh.vertices, axis=1)
    organs = Organs(again)
    free = organs.of_class(int(OrganClass.LEAF), int(OrganClass.PEPPER))
    same = np.unique(again.faces[np.isin(again.face_instance, free)])
    assert apart[same].max() < 1e-5
    # Stalks and calyces are meshed to fit what they join, so a kink in a joint shapes them a little anew.
    assert apart.max() < 2e-3


def test_motions_of_another_plant_are_refused() -> None:
    plant, _ = grown()
    motion = replace(settled().motions[0], instance=len(plant.organs))
    with pytest.raises(ValueError, match="no organ"):
        move_plant(plant, [motion])


def test_feet_stay_in_their_joints() -> None:
    """What grows on a node stays as far from its middle, and as high up."""
    plant, _ = grown()
    moved = move_plant(plant, settled().motions)
    for before, after in zip(plant.organs, moved.organs, strict=True):
        if before.parent < 0:
            continue
        holder, now = plant.organs[before.parent], moved.organs[before.parent]
        if plant.kinds[holder.kind].form == "node":
            middle = holder.curve.mean(axis=0)
            assert after.curve[0][2] == pytest.approx(before.curve[0][2], abs=2e-3)
            assert np.linalg.norm(after.curve[0] - middle) == pytest.approx(
                np.linalg.norm(before.curve[0] - middle), abs=3e-3
            )
        else:
            gap = np.linalg.norm(before.curve[0] - holder.curve[-1])
            assert np.linalg.norm(after.curve[0] - now.curve[-1]) < gap + 0.01


def test_turns_stay_within_their_limits() -> None:
    plant, mesh = grown()
    moved = move_plant(plant, settled().motions)
    organs = Organs(mesh)
    for index, (before, after) in enumerate(zip(plant.organs, moved.organs, strict=True)):
        roots = units_of(organs, index)
        if len(roots) == 1 and roots[0].on_stem:
            one, two = before.curve[-1] - before.curve[0], after.curve[-1] - after.curve[0]
            cosine = one @ two / np.linalg.norm(one) / np.linalg.norm(two)
            assert np.arccos(min(cosine, 1.0)) <= np.hypot(*roots[0].limits) + 1e-6


def test_the_same_seed_gives_the_same_bytes() -> None:
    mesh = grown()[1]
    again = resolve_contacts(mesh, np.random.default_rng(3)).mesh
    assert again.vertices.tobytes() == settled().mesh.vertices.tobytes()
    other = resolve_contacts(mesh, np.random.default_rng(4)).mesh
    assert other.vertices.tobytes() != again.vertices.tobytes()


def test_the_order_of_vertices_does_not_matter() -> None:
    mesh = grown()[1]
    order = np.random.default_rng(0).permutation(len(mesh.vertices))
    place = np.argsort(order)
    shuffled = replace(
        mesh,
        vertices=mesh.vertices[order],
        normals=mesh.normals[order],
        uv=mesh.uv[order],
        state=mesh.state[order],
        faces=place[mesh.faces].astype(np.uint32),
    )
    assert count_contacts(shuffled) == count_contacts(mesh)
    found = resolve_contacts(shuffled, np.random.default_rng(3))
    assert found.contacts.fruit_touching <= 1
    np.testing.assert_allclose(edges(found.mesh), edges(mesh), atol=2e-6)


def test_instances_that_share_vertices_are_refused() -> None:
    mesh = leafy_node(0.98)
    faces = mesh.faces.copy()
    faces[0, 0] = faces[-1, 0]
    with pytest.raises(ValueError, match="share vertices"):
        resolve_contacts(replace(mesh, faces=faces), np.random.default_rng(0))


def test_nothing_is_moved_through_the_ground() -> None:
    # The leaf could slip off downwards, but there the ground is near.
    mesh = leafy_node(0.98)
    for lift in (0.92, 0.96):
        low = mesh.moved(np.eye(3), np.array([0.0, 0.0, -lift]))
        found = resolve_contacts(low, np.random.default_rng(1))
        lowest = [found.mesh.vertices[rows(low, i)][:, 2].min() for i in range(5)]
        before = [low.vertices[rows(low, i)][:, 2].min() for i in range(5)]
        for now, then in zip(lowest, before, strict=True):
            assert now >= min(then, 0.0) - 1e-5


def test_plants_without_fruit_or_leaves_are_settled_too() -> None:
    plant, mesh = grown()
    for left_out in (OrganClass.PEPPER, OrganClass.LEAF, OrganClass.STEM):
        kept = [i for i, one in enumerate(mesh.instances) if one.organ_class != left_out]
        found = resolve_contacts(mesh.select_instances(kept), np.random.default_rng(0))
        assert np.all(np.isfinite(found.mesh.vertices))
    only = [i for i, one in enumerate(mesh.instances) if one.organ_class == OrganClass.STEM]
    found = resolve_contacts(mesh.select_instances(only), np.random.default_rng(0))
    assert found.contacts.fruit == found.contacts.blades == 0
    assert found.motions == ()
    assert len(plant.organs) > len(only)


def test_between_plants_only_what_stands_between_is_mended() -> None:
    first = settled("kaite", 3).mesh.select_plant(0)
    second = settled("kaite", 5).mesh.select_plant(1).moved(np.eye(3), np.array([0.15, 0.0, 0.0]))
    row = concatenate_meshes([first, second])
    found = resolve_contacts(row, np.random.default_rng(0), between_plants=True)
    assert count_contacts(row).fruit_touching > 2
    assert found.contacts.fruit_touching <= 1
    # Within each plant nothing got worse.
    for number, alone in enumerate((first, second)):
        now = found.mesh.select_instances([i for i, one in enumerate(row.instances) if one.plant == number])
        assert count_contacts(now).fruit_touching <= count_contacts(alone).fruit_touching


def test_between_plants_leaves_alone_what_stands_within_one() -> None:
    mesh = grown()[1].select_plant(0)
    far = grown("kaite", 5)[1].select_plant(1).moved(np.eye(3), np.array([3.0, 0.0, 0.0]))
    found = resolve_contacts(concatenate_meshes([mesh, far]), np.random.default_rng(0), between_plants=True)
    assert found.motions == ()
    assert found.contacts.fruit_touching == 0


# --- what is left out because it is far off -----------------------------------------------------------------


def test_boxes_that_meet_are_all_found() -> None:
    organs = Organs(grown()[1])
    some, others = organs.of_class(int(OrganClass.LEAF)), np.flatnonzero(organs.solid)
    row, column = organs.meeting(some, others, 0.003)
    meet = np.all(organs.low[some][:, None] < organs.high[others] + 0.003, axis=2)
    meet &= np.all(organs.high[some][:, None] > organs.low[others] - 0.003, axis=2)
    assert set(zip(row.tolist(), column.tolist(), strict=True)) == set(
        zip(*(places.tolist() for places in np.nonzero(meet)), strict=True)
    )


def test_patches_hold_the_points_that_they_are_made_of() -> None:
    organs = Organs(grown()[1])
    for organ in organs.of_class(int(OrganClass.LEAF), int(OrganClass.PEPPER))[::9].tolist():
        laid, patch, place = organs.patches([organ])
        corners, _ = organs.triangles([organ])
        wanted = np.concatenate([organs.vertices(organ), filling(corners)[0]])
        points = laid.points[patch]
        assert not place.any()
        np.testing.assert_array_equal(np.unique(points.reshape(-1, 3), axis=0), np.unique(wanted, axis=0))
        off = np.linalg.norm(points.astype(float) - laid.centre[patch][:, None], axis=2)
        assert np.all(off <= laid.radius[patch][:, None])


@pytest.mark.parametrize("between_plants", [False, True])
def test_depths_are_those_of_every_point(between_plants: bool) -> None:
    """Balls and boxes leave out nothing that reaches in: all points of all organs, one by one, agree."""
    second = grown("kaite", 5)[1].select_plant(1).moved(np.eye(3), np.array([0.15, 0.0, 0.0]))
    mesh = concatenate_meshes([grown()[1].select_plant(0), second]) if between_plants else grown()[1]
    bodies = ContactBodies(mesh, between_plants=between_plants)
    organs, found = bodies.organs, bodies.into_fruit(bodies.fruit.tolist())
    solid = np.flatnonzero(organs.solid)
    laid, patch, place = organs.patches(solid.tolist())
    for fruit, wall in zip(bodies.fruit.tolist(), walls(organs, bodies.fruit.tolist()), strict=True):
        local = laid.points[patch].reshape(-1, 3) - wall.centre
        near = np.linalg.norm(local, axis=1) < wall.reach
        depth = np.full(len(local), -np.inf)
        depth[near] = wall.depth(local[near].T.astype(np.float32))
        deepest = np.full(len(solid), -np.inf)
        np.maximum.at(deepest, place, depth.reshape(len(patch), -1).max(axis=1))
        deepest[np.isin(solid, list(bodies.own(fruit)))] = -np.inf
        if between_plants:
            deepest[organs.plant[solid] == organs.plant[fruit]] = -np.inf
        into = {} if fruit not in found else dict(zip(found[fruit].others, found[fruit].depth, strict=True))
        # Rounding of single numbers, told from the middle of the row or of the fruit.
        theirs = {int(solid[one]): deepest[one] for one in np.flatnonzero(deepest > 1e-5)}
        assert {one for one, depth in into.items() if depth > 2e-5} <= set(theirs)
        for one, depth in theirs.items():
            assert into[one] == pytest.approx(depth, abs=2e-4 if depth > 0.0 else 0.0)


def test_blades_in_stems_are_those_of_every_point() -> None:
    bodies = ContactBodies(grown()[1])
    organs, found = bodies.organs, bodies.into_stems(bodies.blades.tolist())
    for blade in bodies.blades.tolist():
        laid, patch, _ = organs.patches([blade])
        points = laid.points[patch].reshape(-1, 3)
        into = {} if blade not in found else dict(zip(found[blade].others, found[blade].depth, strict=True))
        for stem in np.flatnonzero(bodies.is_stem & organs.solid).tolist():
            depth = float(capsules(organs, stem).depth(points).max())
            if depth > -1e-3 and stem not in bodies.own(blade):
                assert into[stem] == pytest.approx(depth, abs=1e-5)


def test_what_is_known_after_turns_is_what_is_found_afresh() -> None:
    found = settled()
    search = ContactBodies(grown()[1])
    search.into_fruit(search.fruit.tolist())
    search.into_stems(search.blades.tolist())
    for motion in found.motions:
        shift = motion.pivot - motion.rotation @ motion.pivot
        search.organs.turn(search.organs.subtree(motion.instance), motion.rotation, shift)
    assert counted(search) == count_contacts(found.mesh) == found.contacts


# --- many units at once -------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [0, 1])
def test_units_are_tried_together_as_one_by_one(number: int) -> None:
    search = Search(ContactBodies(grown()[1]), np.random.default_rng(0))
    found = search._touching()
    phase = np.random.default_rng(1).uniform(0.0, 2.0 * np.pi, len(search.organs))
    units = {unit.root: [unit, place] for place, pair in enumerate(found) for unit in search._sides(*pair)}
    together = search._tried(
        [unit for unit, _ in units.values()], [[place] for _, place in units.values()], found, phase, number
    )
    assert sum(one.gain > 0.0 for one in together.values()) > 10
    for root, (unit, place) in units.items():
        alone = search._tried([unit], [[place]], found, phase, number)[root]
        np.testing.assert_array_equal(alone.angles, together[root].angles)
        assert (alone.gain, alone.small, alone.helps) == (
            together[root].gain,
            together[root].small,
            together[root].helps,
        )


def test_how_much_is_worked_out_at_a_time_does_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pepperscene.geometry.contacts.pairs.ENTRIES", 500)
    again = resolve_contacts(grown()[1], np.random.default_rng(3))
    assert again.mesh.vertices.tobytes() == settled().mesh.vertices.tobytes()


def test_units_that_are_apart_turn_in_one_go_as_each_would_alone() -> None:
    single = leafy_node(0.98)
    number = len(single.instances)
    parts = [single.moved(np.eye(3), np.array([0.5 * step, 0.0, 0.0])) for step in range(4)]
    row = concatenate_meshes(parts)
    phase = np.random.default_rng(1).uniform(0.0, 2.0 * np.pi, number)
    together = Search(ContactBodies(row), np.random.default_rng(0))
    found = together._touching()
    assert len(found) == 4
    assert not len(together._part(found, np.tile(phase, 4), 0))
    alone = Search(ContactBodies(single), np.random.default_rng(0))
    alone._part(alone._touching(), phase, 0)
    assert len(together.motions) == 4 * len(alone.motions) > 0
    for step in range(4):
        places = slice(number * step, number * (step + 1))
        np.testing.assert_allclose(together._angles[places], alone._angles, atol=1e-6)


def test_units_that_would_meet_wait_for_each_other() -> None:
    """In one go much is freed, and what is near to something that was just turned waits."""
    search = Search(ContactBodies(grown()[1]), np.random.default_rng(0))
    found = search._touching()
    phase = np.random.default_rng(1).uniform(0.0, 2.0 * np.pi, len(search.organs))
    before = counted(search.bodies)
    waiting = search._part(found, phase, 0)
    assert 0 < len(waiting) < len(found)
    turned = {motion.instance for motion in search.motions}
    freed = [pair for pair, depth in zip(found, search.bodies.depths(*found.T), strict=True) if depth < 0.0]
    assert len(freed) > 0.5 * len(turned)
    assert counted(search.bodies).fruit_touching < before.fruit_touching
