"""How far the triangles of detail 1 lie off the shapes that they stand for, told from much finer ones.

Rationale: triangles cost time at every step from meshing to tracing, so organs have as few as do. A pixel
of the standard camera sees 0.9 mm of a plant at 40 cm: half of every surface lies within a fifth of that, and
all but a twentieth within that.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from pepperscene.cultivar import load_cultivar
from pepperscene.geometry import mesh_plant
from pepperscene.grammar import grow

PIXEL_M = 0.9e-3  # about, of the standard camera at 40 cm
EVERY_M = 2.5e-4


@pytest.fixture(scope="module")
def plant():
    return grow(load_cultivar("kaite"), np.random.default_rng(3))


@pytest.fixture(scope="module")
def meshes(plant):
    return mesh_plant(plant), mesh_plant(plant, 4.0)


def laid(mesh, instance, every):
    """`(p, 3)` random points on an organ's triangles, about so far apart."""
    corners = mesh.vertices[mesh.faces[mesh.face_instance == instance]].astype(float)
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = 0.5 * np.linalg.norm(np.cross(one, other), axis=1)
    triangle = np.repeat(np.arange(len(area)), np.ceil(area / every**2).astype(int))
    u, v = np.random.default_rng(1).random((2, len(triangle)))
    u, v = np.where(u + v > 1.0, [1.0 - u, 1.0 - v], [u, v])
    return corners[triangle, 0] + u[:, None] * one[triangle] + v[:, None] * other[triangle]


@pytest.mark.parametrize(
    "kind", ["lamina", "shoot_lamina", "fruit", "node", "internode", "side_shoot", "petiole"]
)
def test_few_triangles_lie_close_to_the_shape(kind, plant, meshes):
    coarse, fine = meshes
    organs = [number for number, organ in enumerate(plant.organs) if organ.kind == kind]
    off = []
    for organ in organs[len(organs) // 4 :: len(organs) // 3]:
        near, _ = cKDTree(laid(coarse, organ, EVERY_M)).query(laid(fine, organ, 1.5e-3))
        # The nearest of random points of this density is so far beside, in the mean of squares.
        off.append(np.sqrt(np.maximum(near**2 - EVERY_M**2 / np.pi, 0.0)))
    assert np.median(np.concatenate(off)) < PIXEL_M / 5.0
    assert np.quantile(np.concatenate(off), 0.95) < PIXEL_M
