"""Resolved plants have no intersecting organs, according to FCL through trimesh's collision manager.

FCL (Pan, Chitta & Manocha 2012) tests triangles against triangles, independently of the tables, points and
capsules of `resolve_contacts`. Fruit: less than 1 % touch an organ other than their own calyx and stalk; with
none among n, the rate is below 3 / n at 95 % confidence. Leaves: the depth of two organs is the length of the
shortest translation that separates them (Cameron & Culley 1986), here the shortest of some in 100 directions.
"""

from collections.abc import Iterable, Sequence

import numpy as np
import pytest
import trimesh
from scipy import stats
from trimesh.collision import CollisionManager

from pepperscene.classes import OrganClass
from pepperscene.cultivar import Cultivar, load_cultivar
from pepperscene.geometry import Mesh, mesh_plant, resolve_contacts
from pepperscene.geometry.contacts.detect import ContactDetector
from pepperscene.grammar import grow
from pepperscene.scene import Twine, add_twine, double_row

Pairs = set[tuple[int, int]]

TWINE = Twine(diameter_m=0.003, turns_per_m=4.0)


def unresolved(cultivar: Cultivar, seed: int) -> Mesh:
    """A plant with its twine, before contacts are resolved."""
    plant = grow(cultivar, np.random.default_rng(seed))
    return add_twine(plant, mesh_plant(plant), TWINE, np.random.default_rng(seed))


def resolved(cultivar: Cultivar, seed: int) -> Mesh:
    return resolve_contacts(unresolved(cultivar, seed), np.random.default_rng(seed)).mesh


def of_class(mesh: Mesh, *classes: OrganClass) -> list[int]:
    return [index for index, item in enumerate(mesh.instances) if item.organ_class in classes]


def manager(mesh: Mesh, organs: Iterable[int]) -> CollisionManager:
    """FCL's bodies of those of some organs that have triangles, named by their index."""
    result = CollisionManager()
    order = np.argsort(mesh.face_instance, kind="stable")
    first = np.searchsorted(mesh.face_instance[order], np.arange(len(mesh.instances) + 1))
    for organ in organs:
        if first[organ] == first[organ + 1]:
            continue
        used, faces = np.unique(mesh.faces[order[first[organ] : first[organ + 1]]], return_inverse=True)
        vertices = mesh.vertices[used].astype(float)
        result.add_object(str(organ), trimesh.Trimesh(vertices, faces.reshape(-1, 3), process=False))
    return result


def bounding_boxes(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    low, high = np.full((len(mesh.instances), 3), np.inf), np.full((len(mesh.instances), 3), -np.inf)
    order = np.argsort(mesh.face_instance, kind="stable")
    present, first = np.unique(mesh.face_instance[order], return_index=True)
    corners = mesh.vertices[mesh.faces[order]]
    low[present] = np.minimum.reduceat(corners.min(axis=1), first)
    high[present] = np.maximum.reduceat(corners.max(axis=1), first)
    return low, high


def nearby(mesh: Mesh, organs: Sequence[int], others: Sequence[int]) -> list[int]:
    """Those of the others whose boxes overlap with the box of one of the organs."""
    low, high = bounding_boxes(mesh)
    overlap = np.all((low[others][:, None] <= high[organs]) & (high[others][:, None] >= low[organs]), axis=2)
    return np.array(others)[overlap.any(axis=1)].tolist()


def calyx_and_stalk(mesh: Mesh, fruit: int) -> set[int]:
    result, parent = set(), mesh.instances[fruit].parent
    while parent >= 0 and mesh.instances[parent].organ_class == OrganClass.PEDUNCLE:
        result.add(parent)
        parent = mesh.instances[parent].parent
    return result


def fruit_pairs(mesh: Mesh) -> Pairs:
    """(fruit, organ) whose triangles intersect; each pair of fruit once."""
    fruit = of_class(mesh, OrganClass.PEPPER)
    others = sorted(set(range(len(mesh.instances))) - set(fruit))
    bodies = manager(mesh, fruit)
    _, with_others = bodies.in_collision_other(manager(mesh, nearby(mesh, fruit, others)), return_names=True)
    _, with_fruit = bodies.in_collision_internal(return_names=True)
    pairs = {(int(a), int(b)) for a, b in with_others}
    pairs |= {(min(int(a), int(b)), max(int(a), int(b))) for a, b in with_fruit}
    return {(a, b) for a, b in pairs if b not in calyx_and_stalk(mesh, a)}


def touching_fruit(mesh: Mesh) -> set[int]:
    fruit = set(of_class(mesh, OrganClass.PEPPER))
    return {organ for pair in fruit_pairs(mesh) for organ in pair} & fruit


def blades_through_stems(mesh: Mesh) -> set[int]:
    """The blades that intersect a stem or twine."""
    blades, stems = of_class(mesh, OrganClass.LEAF), of_class(mesh, OrganClass.STEM, OrganClass.WIRE)
    bodies = manager(mesh, nearby(mesh, stems, blades))
    return {int(a) for a, _ in bodies.in_collision_other(manager(mesh, stems), return_names=True)[1]}


def leaf_pairs(mesh: Mesh) -> tuple[Pairs, Pairs]:
    """Blades that intersect blades, and (blade, leaf stalk) that intersect and are not joined."""
    blades, stalks = of_class(mesh, OrganClass.LEAF), of_class(mesh, OrganClass.SHOOT)
    bodies = manager(mesh, blades)
    _, with_blades = bodies.in_collision_internal(return_names=True)
    _, with_stalks = bodies.in_collision_other(manager(mesh, stalks), return_names=True)
    parent = [item.parent for item in mesh.instances]
    pairs = {(int(a), int(b)) for a, b in with_stalks}
    return (
        {(min(int(a), int(b)), max(int(a), int(b))) for a, b in with_blades},
        {(a, b) for a, b in pairs if parent[a] != b and parent[b] != a},
    )


def separates(mesh: Mesh, one: int, two: int, distance: float) -> bool:
    """Whether a translation of that length separates two organs."""
    number = np.arange(100) + 0.5
    height, angle = 1.0 - 2.0 * number / 100, np.pi * (1.0 + 5.0**0.5) * number
    out = np.sqrt(1.0 - height**2)
    directions = np.stack([out * np.cos(angle), out * np.sin(angle), height], axis=1)
    body = trimesh.Trimesh(*triangles(mesh, one), process=False)
    other = manager(mesh, [two])
    for direction in directions:
        pose = np.eye(4)
        pose[:3, 3] = distance * direction
        if not other.in_collision_single(body, pose):
            return True
    return False


def triangles(mesh: Mesh, organ: int) -> tuple[np.ndarray, np.ndarray]:
    used, faces = np.unique(mesh.faces[mesh.face_instance == organ], return_inverse=True)
    return mesh.vertices[used].astype(float), faces.reshape(-1, 3)


def count_fruit(meshes: Iterable[Mesh]) -> tuple[int, int]:
    """Numbers of fruit with a contact and of all fruit."""
    counts = [(len(touching_fruit(mesh)), len(of_class(mesh, OrganClass.PEPPER))) for mesh in meshes]
    hits, total = np.sum(counts, axis=0)
    return hits, total


@pytest.fixture(scope="module")
def plants(kaite: Cultivar) -> list[Mesh]:
    return [unresolved(kaite, seed) for seed in range(50, 54)]


@pytest.fixture(scope="module")
def row(kaite: Cultivar) -> Mesh:
    """Six resolved plants in a double row, 20 cm from plant to plant and from row to row."""
    plants = [resolved(kaite, seed) for seed in range(100, 106)]
    return double_row(plants[:3], plants[3:], spacing_m=0.2, gap_m=0.2, shift_m=0.1)


@pytest.mark.parametrize(
    ("name", "plants", "min_fruit", "tolerated"),
    [
        ("kaite", 4, 50, 0),
        pytest.param("kaite", 22, 300, 0, marks=pytest.mark.long),
        pytest.param("red_blocky", 2, 25, 1, marks=pytest.mark.long),
        pytest.param("orange_pointed", 2, 25, 1, marks=pytest.mark.long),
        pytest.param("tomato", 2, 25, 1, marks=pytest.mark.long),
    ],
)
def test_fruit_of_resolved_plants_has_no_contacts(name, plants, min_fruit, tolerated) -> None:
    cultivar = load_cultivar(name)
    hits, total = count_fruit(resolved(cultivar, seed) for seed in range(plants))
    assert total >= min_fruit
    assert hits < 0.01 * total + tolerated


def test_unresolved_plants_have_contacts(plants: list[Mesh]) -> None:
    hits, total = count_fruit(plants)
    assert hits > 0.3 * total


def test_detected_contacts_equal_those_of_fcl(plants: list[Mesh]) -> None:
    """Pairs that only one of them reports are closer than a millimetre, or one organ is inside the other.

    Measured over 18 plants of three crops: 731 pairs in common, 3 more that are apart by less than .6 mm, 8
    more that FCL cannot detect, as it tests surfaces only; 2 missed, by less than .2 mm.
    """
    common = disputed = 0
    for mesh in [*plants, unresolved(load_cultivar("tomato"), 0)]:
        pairs = ContactDetector(mesh).fruit_pairs()
        ours: dict[tuple[int, int], float] = {}
        for fruit, other, depth in zip(*map(np.ndarray.tolist, vars(pairs).values()), strict=True):
            swapped = mesh.instances[other].organ_class == OrganClass.PEPPER and other < fruit
            pair = (other, fruit) if swapped else (fruit, other)
            ours[pair] = max(ours.get(pair, -np.inf), depth)
        theirs = fruit_pairs(mesh)
        assert theirs <= set(ours)
        for pair, depth in ours.items():
            common += depth > 0.0 and pair in theirs
            if (depth > 0.0) != (pair in theirs):
                # Near the surface either may be right; deeper, FCL misses organs that are completely inside.
                disputed += abs(depth) < 1e-3
                assert abs(depth) < 1e-3 or is_inside(mesh, *pair)
    assert common > 150
    assert disputed < 0.02 * common


def is_inside(mesh: Mesh, fruit: int, other: int) -> bool:
    """Whether an organ is completely inside a fruit, by casting rays."""
    body, part = (mesh.select_instances([organ]) for organ in (fruit, other))
    surface = trimesh.Trimesh(body.vertices.astype(float), body.faces)
    return bool(surface.contains(part.vertices[::5].astype(float)).all())


@pytest.mark.long
def test_contacts_between_neighbours_are_resolved(row: Mesh) -> None:
    assert len(touching_fruit(row)) > 0.2 * len(of_class(row, OrganClass.PEPPER))
    assert len(blades_through_stems(row)) > 10
    mesh = resolve_contacts(row, np.random.default_rng(0), between_plants=True).mesh
    hits, total = count_fruit([mesh])
    assert total >= 75
    assert hits < 0.01 * total
    assert len(blades_through_stems(mesh)) < 0.01 * len(of_class(row, OrganClass.LEAF))


def leaf_rates(mesh: Mesh) -> tuple[float, float, float]:
    """Of all blades those that touch a blade, those that touch a stalk, and those deeper than 3 mm."""
    blades = len(of_class(mesh, OrganClass.LEAF))
    with_blades, with_stalks = leaf_pairs(mesh)
    deep = {pair[0] for pair in with_blades | with_stalks if not separates(mesh, *pair, 3e-3)}
    return (
        len({blade for pair in with_blades for blade in pair}) / blades,
        len({blade for blade, _ in with_stalks}) / blades,
        len(deep) / blades,
    )


@pytest.mark.parametrize(
    ("name", "rate"),
    [
        ("kaite", 0.05),
        *(pytest.param(*case, marks=pytest.mark.long) for case in (("red_blocky", 0.05), ("tomato", None))),
    ],
)
def test_leaves_of_a_plant_do_not_run_through_each_other(name: str, rate: float | None) -> None:
    """A quarter of a tomato's leaflets touch others at their lobes, by less than 3 mm, before and after."""
    with_blades, with_stalks, deep = leaf_rates(resolved(load_cultivar(name), 1))
    assert rate is None or with_blades < rate
    assert with_stalks < 0.03
    assert deep < 0.01


def test_counted_blades_touch_stems(row: Mesh) -> None:
    ours, theirs = ContactDetector(row).counts().blades_touching, len(blades_through_stems(row))
    # Capsules are as thick as the tube's widest ring: they overestimate contacts.
    assert theirs <= ours <= 1.2 * theirs + 2


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "plants"),
    [
        ("kaite", 200),
        ("kaite_february", 800),
        ("kaite_september", 200),
        ("orange_pointed", 200),
        ("tomato", 60),
    ],
)
def test_rate_of_contacts_is_below_one_percent_with_confidence(name: str, plants: int) -> None:
    # Young plants have three fruit each, and a few of these stay 2 mm deep in a petal of the flower beside
    # them: 800 of them have as many fruit as 200 old ones, so that the confidence is the same.
    cultivar = load_cultivar(name)
    hits, total = count_fruit(resolved(cultivar, seed) for seed in range(1000, 1000 + plants))
    # One-sided 95 % confidence for a rate (Clopper & Pearson 1934).
    assert stats.beta.ppf(0.95, hits + 1, total - hits) < 0.01


# --- settled rows -------------------------------------------------------------------------------------------


DEPTH_M = 3e-3


def settled_row(name: str) -> Mesh:
    """Four plants in a double row, 20 cm from plant to plant and from row to row; few leaves are left out."""
    plants = [
        resolve_contacts(
            unresolved(load_cultivar(name), seed), np.random.default_rng(seed), free_leaves=False
        ).mesh
        for seed in range(4)
    ]
    row = double_row(plants[:2], plants[2:], spacing_m=0.2, gap_m=0.2, shift_m=0.1)
    result = resolve_contacts(row, np.random.default_rng(0), between_plants=True)
    blades = len(of_class(row, OrganClass.LEAF))
    left_out = [index for index in result.left_out if row.instances[index].organ_class == OrganClass.LEAF]
    assert len(left_out) < 0.01 * blades
    assert not np.isin(result.mesh.face_instance, result.left_out).any()
    return result.mesh


def stalks_through_stems(mesh: Mesh) -> Pairs:
    """(leaf stalk, stem) whose triangles intersect, without the nodes and internodes next to its own."""
    stems = of_class(mesh, OrganClass.STEM)
    _, names = manager(mesh, of_class(mesh, OrganClass.SHOOT)).in_collision_other(
        manager(mesh, stems), return_names=True
    )
    pairs = {(int(a), int(b)) for a, b in names}
    return {(a, b) for a, b in pairs if not grows_beside(mesh, a, b)}


def grows_beside(mesh: Mesh, stalk: int, stem: int) -> bool:
    """Whether a stalk grows on a part of a stem, or on the part above or below."""
    near = {index for index in (stem, mesh.instances[stem].parent) if index >= 0}
    near |= {index for index, item in enumerate(mesh.instances) if item.parent == stem}
    return bool(near & {stalk, mesh.instances[stalk].parent})


@pytest.mark.long
@pytest.mark.parametrize("name", ["kaite", "red_blocky", "kaite_old", "orange_pointed"])
def test_no_leaf_of_a_row_is_deep_in_another(name: str) -> None:
    mesh = settled_row(name)
    with_blades, with_stalks = leaf_pairs(mesh)
    touching = {blade for pair in with_blades for blade in pair}
    assert len(touching) < 0.05 * len(of_class(mesh, OrganClass.LEAF))
    pairs = with_blades | with_stalks | stalks_through_stems(mesh)
    assert [pair for pair in sorted(pairs) if not separates(mesh, *pair, DEPTH_M)] == []
