"""Contacts are found by sample points in fruit and stems, and counted by class and parent."""

import numpy as np
import pytest
from contact_meshes import RADIUS, count_contacts, grown, resolved, scene, shifted

from pepperscene.classes import OrganClass
from pepperscene.geometry import concatenate_meshes, rectangle, sphere
from pepperscene.geometry.contacts.detect import ContactDetector
from pepperscene.geometry.contacts.joints import rotations
from pepperscene.geometry.contacts.organs import Organs
from pepperscene.geometry.contacts.patches import SPACING, Patches, fill_triangles
from pepperscene.geometry.contacts.shapes import FruitSurfaces, StemCapsules


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
            fruit_depth(surfaces, 0, points[:, None]), RADIUS - distance, atol=0.01 * RADIUS
        )


def fruit_depth(
    surfaces: FruitSurfaces, fruit: int, points: np.ndarray, margin: float = np.inf
) -> np.ndarray:
    """Depth of the deepest of points `(h, s, 3)`, at most `margin` out of its sphere, in a fruit as grown."""
    spheres = surfaces.spheres(np.array([fruit]))
    local = np.ascontiguousarray((points - spheres.centre[0]).transpose(2, 0, 1), dtype=np.float32)
    patches = Patches(local.transpose(1, 2, 0), local[:, :, 0].T, np.zeros(len(points), dtype=np.float32))
    still = np.eye(3, dtype=np.float32)[None], np.zeros((1, 3), dtype=np.float32)
    limit = (spheres.radius + margin).astype(np.float32)
    hit, patch = np.zeros(len(points), dtype=np.intp), np.arange(len(points))
    return surfaces.patch_depths(spheres.row, *still, limit, hit, patches, patch)


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


def test_organs_moved_together_are_where_they_are_moved_alone() -> None:
    organs, rng = Organs(grown()[1]), np.random.default_rng(0)
    chosen = organs.of_class(int(OrganClass.LEAF), int(OrganClass.PEPPER))[::3]
    first = chosen[::2]
    # Some have sample points before they move, the others get them later.
    organs.sample(first)
    expected = {organ: organs.original_vertices(organ).astype(float) for organ in chosen.tolist()}
    for group in (chosen, first):
        axis = rng.normal(size=(len(group), 3))
        axis /= np.linalg.norm(axis, axis=1, keepdims=True)
        rotation = rotations(axis, rng.uniform(0.0, 1.0, (len(group), 1)))[:, 0]
        shift = rng.uniform(-0.1, 0.1, (len(group), 3))
        organs.move(group, rotation, shift)
        for row, organ in enumerate(group.tolist()):
            expected[organ] = expected[organ] @ rotation[row].T + shift[row]
    assert np.array_equal(np.flatnonzero(organs.moved_at), chosen)
    mesh = organs.current_mesh()
    for organ, points in expected.items():
        np.testing.assert_allclose(organs.low[organ], points.min(axis=0), atol=1e-6)
        np.testing.assert_allclose(organs.high[organ], points.max(axis=0), atol=1e-6)
        np.testing.assert_allclose(mesh.vertices[mesh.vertex_runs.rows(organ)], points, atol=1e-6)
        # Every vertex is a sample point.
        patches, patch, _ = organs.patches(np.array([organ]))
        sampled = patches.points[patch].reshape(-1, 3)
        distance = np.linalg.norm(points[::20, None] - sampled, axis=2)
        assert distance.min(axis=1).max() < 1e-6
        radius = np.linalg.norm(patches.points[patch] - patches.centre[patch][:, None], axis=2)
        assert np.all(radius <= patches.radius[patch][:, None] + 1e-6)


@pytest.mark.parametrize("between_plants", [False, True])
def test_depths_in_fruit_are_those_of_all_points(between_plants: bool) -> None:
    """Boxes and bounding spheres leave out nothing that penetrates: all points of all organs agree."""
    mesh = grown()[1]
    if between_plants:
        second = shifted(grown("kaite", 5)[1].with_plant(1), 0.15)
        mesh = concatenate_meshes([mesh.with_plant(0), second])
    detector = ContactDetector(mesh, between_plants=between_plants)
    organs, pairs = detector.organs, detector.fruit_pairs()
    solid = np.flatnonzero(organs.solid)
    patches, patch, place = organs.patches(solid)
    points = patches.points[patch]
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
    detector.counts()
    for motion in expected.motions:
        shift = motion.pivot - motion.rotation @ motion.pivot
        moved = np.array(detector.organs.subtree(motion.instance))
        rotation, shift = np.tile(motion.rotation, (len(moved), 1, 1)), np.tile(shift, (len(moved), 1))
        detector.organs.move(moved, rotation, shift)
    assert detector.counts() == count_contacts(expected.mesh) == expected.contacts
