"""Cells of surfaces against their definition in NumPy, and their means against sums written out."""

import numpy as np
import pytest
import trimesh
from bodies import body

from pepperscene.geometry import Mesh, concatenate_meshes
from pepperscene.render.kernel.cells import CELL_M, SurfaceCells, surface_cells
from pepperscene.render.transport.light_cache import PathLight, light_cache

BITS = 28


def small_triangles(count: int, seed: int) -> Mesh:
    rng = np.random.default_rng(seed)
    centres = rng.uniform(-0.4, 0.4, (count, 1, 3))
    corners = centres + rng.uniform(-0.01, 0.01, (count, 3, 3))
    return body(
        trimesh.Trimesh(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3), process=False), "m"
    )


def partition(numbers: np.ndarray) -> set[frozenset[int]]:
    return {frozenset(np.flatnonzero(numbers == number).tolist()) for number in np.unique(numbers)}


def test_small_triangles_share_cells_by_organ_and_cube():
    mesh = concatenate_meshes([small_triangles(400, 1), small_triangles(300, 2)])
    cells = surface_cells(mesh)
    entries = np.asarray(cells.faces)
    centre = mesh.vertices[mesh.faces].mean(axis=1)
    organ = mesh.face_instance[:, None]

    def expected(edge: float, group: np.ndarray) -> set[frozenset[int]]:
        keys = np.column_stack([group, np.floor(centre / edge)])
        return partition(np.unique(keys, axis=0, return_inverse=True)[1].ravel())

    levels = [entries]
    for parent in cells.parents:
        levels.append(parent[levels[-1]])
    assert partition(levels[0]) == expected(CELL_M, organ)
    assert cells.count == len(np.unique(entries)) == entries.max() + 1
    assert partition(levels[1]) == expected(0.15, organ)
    for level, edge in zip(levels[2:], (0.15, 0.45, 1.35, 4.05), strict=True):
        assert partition(level) == expected(edge, 0 * organ)


def test_large_triangles_are_divided_evenly():
    corners = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
    mesh = concatenate_meshes([small_triangles(5, 1), body(trimesh.Trimesh(corners, [[0, 1, 2]]), "m")])
    cells = surface_cells(mesh)
    entry = int(np.asarray(cells.faces)[-1])
    parts = 1 << (entry >> BITS)
    assert 4.0 / parts**2 <= 0.02 < 4.0 / (parts / 2) ** 2
    assert (entry & ((1 << BITS) - 1)) + parts**2 == cells.count


def test_means_are_drawn_to_those_of_larger_cells():
    """Two cells in one larger cell of an organ, and a third in another."""
    parents = (np.array([0, 0, 1]), np.array([0, 1]), np.array([0, 0]))
    light = np.array([[4.0, 2.0, 1.0]] * 4, np.float32)
    expected = np.array([[2.0, 2.0, 2.0]] * 4, np.float32)
    # Samples: two on the front of cell 0, one on the back of cell 2.
    cache = light_cache(
        PathLight(SurfaceCells(None, 3, parents), np.array([0, 0, 5], np.uint32), light, expected)
    )
    ratios = np.asarray(cache.ratios).reshape(3, 2, 4)[..., 0]

    def shrunk(light: float, expected: float, parent: float) -> float:
        weight = 5 * 2.0
        return (light + weight * parent) / (expected + weight)

    scene = 7.0 / 6.0
    front = shrunk(6.0, 4.0, shrunk(6.0, 4.0, shrunk(6.0, 4.0, scene)))
    back = shrunk(1.0, 2.0, scene)
    above = shrunk(1.0, 2.0, shrunk(1.0, 2.0, back))

    # Each sample predicted from the others alone: either of two on the front, and the one that is alone.
    def front_by(light: float) -> float:
        rest = (light + 1.0) / 4.0  # of the scene
        return shrunk(light, 2.0, shrunk(light, 2.0, shrunk(light, 2.0, shrunk(light, 2.0, rest))))

    gain = 7.0 / (2.0 * (front_by(2.0) + front_by(4.0) + 6.0 / 4.0))
    assert ratios[0, 0] == pytest.approx(gain * shrunk(6.0, 4.0, front))
    assert ratios[1, 0] == pytest.approx(gain * front)
    assert ratios[2, 1] == pytest.approx(gain * shrunk(1.0, 2.0, above))
    assert ratios[0, 1] == pytest.approx(gain * back)
    assert np.asarray(cache.ratios).reshape(-1, 4).std(axis=1) == pytest.approx(0.0, abs=1e-6)


def test_without_samples_all_cells_are_black():
    parents = (np.array([0]), np.array([0]), np.array([0]))
    empty = np.zeros((4, 0), np.float32)
    cache = light_cache(PathLight(SurfaceCells(None, 1, parents), np.zeros(0, np.uint32), empty, empty))
    assert not np.asarray(cache.ratios).any()


def test_a_single_sample_is_the_light_of_all_cells():
    parents, one = (np.array([0, 0]), np.array([0]), np.array([0])), np.ones((4, 1), np.float32)
    paths = PathLight(SurfaceCells(None, 2, parents), np.zeros(1, np.uint32), 3.0 * one, 2.0 * one)
    cache = light_cache(paths)
    assert np.asarray(cache.ratios) == pytest.approx(1.5)


def test_few_samples_make_the_light_neither_less_nor_more():
    # Cells with much light are seen more often, and have two samples in the mean; see `light_cache`.
    rng = np.random.default_rng(4)
    parents = (np.repeat(np.arange(500), 8), np.repeat(np.arange(100), 5), np.zeros(100, int))
    light = rng.gamma(0.5, 2.0, 4000) + 0.05
    seen, ones, means = light / light.sum(), np.ones((4, 8000), np.float32), []
    for _ in range(20):
        cell = rng.choice(4000, 8000, p=seen)
        samples = np.stack([light[cell].astype(np.float32)] * 4)
        cache = light_cache(
            PathLight(SurfaceCells(None, 4000, parents), (2 * cell).astype(np.uint32), samples, ones)
        )
        means.append(np.asarray(cache.ratios).reshape(4000, 2, 4)[:, 0, 0] @ seen / (light @ seen))
    error = np.std(means) / 20**0.5
    assert error < 0.001
    assert abs(np.mean(means) - 1.0) < 4.0 * error


def test_a_cache_of_half_of_the_paths_differs_as_much_as_one_of_all_errs():
    # Cells of one brightness, each with 512 paths, half of them in the half: larger cells have little weight.
    rng, one = np.random.default_rng(5), np.float32(1.0)
    parents = (np.repeat(np.arange(500), 8), np.repeat(np.arange(100), 5), np.zeros(100, int))
    cell = np.repeat(np.arange(4000), 512)
    light = np.stack([rng.exponential(one, cell.size).astype(np.float32)] * 4)
    cells = SurfaceCells(None, 4000, parents)
    paths = PathLight(cells, (2 * cell).astype(np.uint32), light, np.ones_like(light))
    all_paths, half = (
        np.asarray(light_cache(part).ratios).reshape(4000, 2, 4)[:, 0, 0] for part in (paths, paths.half())
    )
    # The two means of squares have a standard error of 2.2 % each.
    assert np.mean((half - all_paths) ** 2) == pytest.approx(np.mean((all_paths - 1.0) ** 2), rel=0.13)
