"""Distance of the triangles at detail 1 from the shapes that they approximate, taken from detail 4.

Triangles cost time at every step from meshing to tracing, so organs have as few as possible. A pixel of the
standard camera covers 0.9 mm of a plant at 40 cm: half of every surface is within a fifth of that, and 95 %
within that.
"""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from organ_meshes import merged
from scipy.spatial import cKDTree

from pepperscene.cultivar import load_cultivar
from pepperscene.geometry import mesh_plant
from pepperscene.grammar import grow

PIXEL_M = 0.9e-3  # about, of the standard camera at 40 cm
SPACING_M = 2.5e-4


@pytest.fixture(scope="module")
def plant():
    return grow(load_cultivar("kaite"), np.random.default_rng(3))


@pytest.fixture(scope="module")
def meshes(plant):
    return mesh_plant(plant), mesh_plant(plant, 4.0)


def random_points(mesh, instance, spacing):
    """Random points on an organ's triangles, about so far apart."""
    body = merged(mesh.select_instances([instance]))
    return trimesh.sample.sample_surface(body, int(body.area / spacing**2), seed=1)[0]


@pytest.mark.parametrize(
    "kind", ["lamina", "shoot_lamina", "fruit", "node", "internode", "side_shoot", "petiole"]
)
def test_coarse_triangles_are_close_to_fine_ones(kind, plant, meshes):
    coarse, fine = meshes
    organs = [number for number, organ in enumerate(plant.organs) if organ.kind == kind]
    distances = []
    for organ in organs[len(organs) // 4 :: len(organs) // 3]:
        tree = cKDTree(random_points(coarse, organ, SPACING_M))
        nearest, _ = tree.query(random_points(fine, organ, 1.5e-3))
        # Root mean square distance to the nearest of random points of this density on the surface itself.
        distances.append(np.sqrt(np.maximum(nearest**2 - SPACING_M**2 / np.pi, 0.0)))
    assert np.median(np.concatenate(distances)) < PIXEL_M / 5.0
    assert np.quantile(np.concatenate(distances), 0.95) < PIXEL_M
