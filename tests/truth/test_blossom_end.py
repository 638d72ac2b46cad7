"""The blossom end on spheres whose coordinates are known."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from pepperscene.truth.cut_point import blossom_end

STRETCH = np.array([0.03, 0.03, 0.05])


def ellipsoid():
    """A fruit 10 cm long whose stalk end is at the origin, triangulated finely; its vertices and faces."""
    ball = trimesh.creation.icosphere(4)
    return ball.vertices * STRETCH + [0.0, 0.0, STRETCH[2]], ball.faces


def test_vertex_with_the_last_surface_coordinate_counts_wherever_it_is():
    points, faces = ellipsoid()
    v = np.linspace(0.0, 0.9, len(points)).astype(np.float32)
    v[17] = 1.0
    np.testing.assert_array_equal(blossom_end(points, faces, v), points[17])


@pytest.mark.parametrize("turn", [0.0, 0.3, 1.1])
def test_scan_ends_where_its_axis_leaves_the_skin(turn):
    points, faces = ellipsoid()
    # Moved aside, so that no vertex is on the axis.
    rotation = trimesh.transformations.rotation_matrix(turn, [0.0, 0.0, 1.0])[:3, :3]
    points = points @ rotation.T + np.array([1e-3, 5e-4, 0.0])
    end = blossom_end(points, faces, np.full(len(points), 0.5))
    np.testing.assert_array_equal(end[:2], 0.0)
    assert end[2] == pytest.approx(0.1, abs=2e-4)
    _, distance, _ = trimesh.proximity.closest_point(trimesh.Trimesh(points, faces, process=False), [end])
    assert distance[0] < 1e-12


def test_farthest_vertex_if_the_axis_misses_the_skin():
    points, faces = ellipsoid()
    end = blossom_end(points + np.array([1.0, 0.0, 0.0]), faces, np.full(len(points), 0.5))
    np.testing.assert_allclose(end, [1.0, 0.0, 0.1], atol=1e-9)
