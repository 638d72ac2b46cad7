"""Contacts are resolved by small rotations of rigid organs about their joints, or leaves are left out."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from contact_meshes import RADIUS, count_contacts, grown, leafy_node, resolved, scene, shifted

from pepperscene.classes import OrganClass
from pepperscene.geometry import (
    Mesh,
    concatenate_meshes,
    mesh_plant,
    move_plant,
    rectangle,
    resolve_contacts,
    sphere,
)
from pepperscene.geometry.contacts.compiled import compiled
from pepperscene.geometry.contacts.detect import ContactDetector
from pepperscene.geometry.contacts.joints import units_of
from pepperscene.geometry.contacts.leaf_crossings import deep_pairs, superfluous_leaves
from pepperscene.geometry.contacts.leaves import LeafSolver, nested_units
from pepperscene.geometry.contacts.organs import LEAF, Organs
from pepperscene.geometry.contacts.resolve import ContactSolver, _Round


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


@pytest.mark.parametrize(("mesh", "rounds"), [(leafy_node(1.3), 3), (grown()[1], 0)])
def test_without_contacts_or_rounds_nothing_moves(mesh: Mesh, rounds: int) -> None:
    result = resolve_contacts(mesh, np.random.default_rng(0), rounds=rounds)
    assert result.mesh is mesh
    assert result.motions == ()
    assert result.contacts == count_contacts(mesh)
    assert (result.contacts.fruit_touching > 3) == (rounds == 0)


@pytest.mark.parametrize("name", ["kaite", "tomato"])
def test_contacts_of_a_plant_are_resolved_by_few_motions(name: str) -> None:
    mesh, result = grown(name)[1], resolved(name)
    before = count_contacts(mesh)
    assert result.contacts.fruit == before.fruit
    assert before.fruit_touching > 0.3 * before.fruit
    assert result.contacts.fruit_touching <= 1
    assert result.contacts == count_contacts(result.mesh)
    assert len({motion.instance for motion in result.motions}) < 0.2 * len(mesh.instances)


def test_motions_reproduce_the_resolved_mesh() -> None:
    """Applied in order to subtrees of the mesh as grown; stem, nodes and cuts never move."""
    mesh, result = grown()[1], resolved()
    organs = Organs(mesh)
    fixed = np.isin(mesh.face_class, [OrganClass.STEM, OrganClass.CUT])
    np.testing.assert_array_equal(result.mesh.vertices[mesh.faces[fixed]], mesh.vertices[mesh.faces[fixed]])
    np.testing.assert_array_equal(result.mesh.faces, mesh.faces)
    vertices, normals = mesh.vertices.astype(float), mesh.normals.astype(float)
    for motion in result.motions:
        np.testing.assert_allclose(motion.rotation @ motion.rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(motion.rotation) == pytest.approx(1.0)
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


def test_same_seed_gives_the_same_bytes() -> None:
    again = resolve_contacts(grown()[1], np.random.default_rng(3)).mesh
    assert again.vertices.tobytes() == resolved().mesh.vertices.tobytes()


def test_order_of_vertices_does_not_matter() -> None:
    mesh = grown()[1]
    order = np.random.default_rng(0).permutation(len(mesh.vertices))
    values = {name: getattr(mesh, name)[order] for name in ("vertices", "normals", "uv", "state")}
    shuffled = replace(mesh, **values, faces=np.argsort(order)[mesh.faces].astype(np.uint32))
    assert count_contacts(shuffled) == count_contacts(mesh)


def test_raises_if_instances_share_vertices() -> None:
    mesh = leafy_node(0.98)
    faces = mesh.faces.copy()
    faces[0, 0] = faces[-1, 0]
    with pytest.raises(ValueError, match="share vertices"):
        resolve_contacts(replace(mesh, faces=faces), np.random.default_rng(0))


def test_nothing_is_moved_through_the_ground() -> None:
    # The leaf could move off downwards, but there the ground is near.
    mesh = shifted(leafy_node(0.98), z=-0.96)
    result = resolve_contacts(mesh, np.random.default_rng(1))
    for organ in range(5):
        rows = mesh.vertex_runs.rows(organ)
        before, after = mesh.vertices[rows, 2].min(), result.mesh.vertices[rows, 2].min()
        assert after >= min(before, 0.0) - 1e-5


def test_a_stem_alone_has_no_contacts() -> None:
    mesh = grown()[1]
    stem = [i for i, item in enumerate(mesh.instances) if item.organ_class == OrganClass.STEM]
    result = resolve_contacts(mesh.select_instances(stem), np.random.default_rng(0))
    assert result.contacts.fruit == result.contacts.blades == 0
    assert result.motions == ()


def test_between_plants_resolves_contacts_of_neighbours() -> None:
    first = resolved("kaite", 3).mesh.with_plant(0)
    second = shifted(resolved("kaite", 5).mesh.with_plant(1), 0.15)
    row = concatenate_meshes([first, second])
    result = resolve_contacts(row, np.random.default_rng(0), between_plants=True)
    assert count_contacts(row).fruit_touching > 2
    assert result.contacts.fruit_touching <= 1
    # Within each plant nothing got worse.
    for number, alone in enumerate((first, second)):
        kept = [i for i, item in enumerate(row.instances) if item.plant == number]
        now = result.mesh.select_instances(kept)
        assert count_contacts(now).fruit_touching <= count_contacts(alone).fruit_touching


def test_between_plants_only_leaves_are_tried_again_within_a_plant() -> None:
    far = shifted(grown("kaite", 5)[1].with_plant(1), 3.0)
    row = concatenate_meshes([grown()[1].with_plant(0), far])
    assert count_contacts(row).fruit_touching > 2
    result = resolve_contacts(row, np.random.default_rng(0), between_plants=True)
    assert result.contacts.fruit_touching == 0  # of those between plants
    classes = {row.instances[motion.instance].organ_class for motion in result.motions}
    assert OrganClass.LEAF in classes
    assert OrganClass.PEPPER not in classes
    assert OrganClass.PEDUNCLE not in classes


def solver_and_round() -> tuple[ContactSolver, _Round]:
    solver = ContactSolver(ContactDetector(grown()[1]), np.random.default_rng(0))
    phase = np.random.default_rng(1).uniform(0.0, 2.0 * np.pi, len(solver.organs))
    return solver, _Round(0, phase)


def test_units_tried_together_give_the_same_as_one_at_a_time() -> None:
    solver, attempt = solver_and_round()
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
    assert len(together.moving.motions) == 4 * len(alone.moving.motions) > 0
    for step in range(4):
        places = slice(number * step, number * (step + 1))
        np.testing.assert_allclose(together.moving.angles[places], alone.moving.angles, atol=1e-6)


def test_units_that_share_organs_clash_wherever_they_move() -> None:
    """A shoot and a leaf on it must not move in the same pass: each is tried with the other at rest."""
    organs = Organs(grown()[1])
    nested = next(
        units for units in (units_of(organs, index) for index in organs.of_class(LEAF)) if len(units) > 2
    )
    others = units_of(organs, nested[-1].members[0] - 1)
    units = [*nested, *(unit for unit in others if not set(unit.members) & set(nested[-1].members))]
    pairs = {(min(pair), max(pair)) for pair in nested_units(units)}
    assert {(a, b) for a, b in pairs if a < len(nested)} == set(combinations(range(len(nested)), 2))
    # Compared with their members.
    assert pairs == {
        (a, b) for a, b in combinations(range(len(units)), 2) if set(units[a].members) & set(units[b].members)
    }


# --- leaves that are deep in others -------------------------------------------------------------------------


NODE, STALK, BLADE = OrganClass.STEM, OrganClass.SHOOT, OrganClass.LEAF


def sheet(width: float, x: float = 0.0, upright: bool = False) -> Mesh:
    across = [0.0, 0.0, width] if upright else [0.0, width, 0.0]
    return rectangle([x, 0.0, 1.0], [width, 0.0, 0.0], across)


def leaves(*blades: Mesh) -> Mesh:
    """A node, and one leaf stalk for each blade: instances 1, 3, 5 and 2, 4, 6."""
    parts = [(sphere([0.0, 0.0, 0.5], 0.01), NODE, "node", -1)]
    for number, blade in enumerate(blades):
        stalk = sphere([0.3 + number, 0.0, 0.5], 0.003)
        parts += [(stalk, STALK, "petiole", 0), (blade, BLADE, "lamina", 2 * number + 1)]
    return scene(*parts)


@pytest.mark.parametrize(("overlap", "is_deep"), [(0.001, False), (0.01, True)])
def test_depth_is_the_shortest_way_out(overlap: float, is_deep: bool) -> None:
    """An upright sheet that overlaps a level one at its edge: the way out is as long as the overlap."""
    mesh = leaves(sheet(0.1), shifted(sheet(0.1, upright=True), 0.1 - overlap))
    pairs = np.array([[2, 4]])
    assert len(deep_pairs(Organs(mesh), pairs)) == is_deep


def test_the_leaf_that_is_deep_in_most_others_goes_with_its_stalk() -> None:
    organs = Organs(leaves(sheet(0.1), sheet(0.12), sheet(0.08)))
    assert superfluous_leaves(organs, np.array([[2, 4], [4, 6]])).tolist() == [3, 4]
    assert superfluous_leaves(organs, np.empty((0, 2), dtype=np.intp)).tolist() == []


def test_of_two_leaves_the_smaller_one_goes() -> None:
    organs = Organs(leaves(sheet(0.1), sheet(0.12)))
    assert superfluous_leaves(organs, np.array([[2, 4]])).tolist() == [1, 2]


def test_stems_and_stalks_of_several_leaves_stay() -> None:
    mesh = leaves(sheet(0.1), sheet(0.12))
    shared = replace(mesh.instances[4], parent=1)
    mesh = replace(mesh, instances=(*mesh.instances[:4], shared))
    organs = Organs(mesh)
    assert superfluous_leaves(organs, np.array([[0, 2]])).tolist() == [2]
    assert superfluous_leaves(organs, np.array([[0, 1]])).tolist() == []


def test_organs_without_triangles_keep_their_numbers() -> None:
    mesh = leaves(sheet(0.1), sheet(0.12))
    part = mesh.without_triangles(np.array([1, 2]))
    assert part.instances == mesh.instances
    assert np.unique(part.face_instance).tolist() == [0, 3, 4]
    for organ in (0, 3, 4):
        before, after = (each.vertices[each.faces[each.face_instance == organ]] for each in (mesh, part))
        np.testing.assert_array_equal(before, after)
    assert np.array_equal(np.unique(part.faces), np.arange(len(part.vertices)))


def test_only_rows_lose_leaves(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two crossed sheets that nothing moves: a plant alone keeps both, a row loses the smaller one."""
    monkeypatch.setattr(LeafSolver, "_run_pass", lambda *_: np.empty(0, dtype=np.intp))
    alone = leaves(sheet(0.2), sheet(0.1, upright=True))
    owners = tuple(replace(item, plant=int(number > 2)) for number, item in enumerate(alone.instances))
    row = replace(alone, instances=owners)
    result, kept = (
        resolve_contacts(mesh, np.random.default_rng(0), between_plants=mesh is row) for mesh in (row, alone)
    )
    assert (result.left_out, kept.left_out) == ((3, 4), ())
    assert np.unique(result.mesh.face_instance).tolist() == [0, 1, 2]
    assert result.mesh.instances == row.instances
    assert (result.contacts.blades, kept.contacts.blades) == (1, 2)


# --- compiled functions -------------------------------------------------------------------------------------


def test_functions_without_a_folder_for_their_code_are_compiled() -> None:
    """The code of a function that was not read from a file has no folder."""
    names: dict[str, object] = {}
    exec("def add(a, b):\n    return a + b", names)
    assert compiled(names["add"])(2, 3) == 5
