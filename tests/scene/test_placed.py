"""A scene refuses what a renderer could only render wrongly."""

from __future__ import annotations

import pytest

from pepperscene.geometry import concatenate_meshes, rectangle
from pepperscene.materials import lambertian_surface
from pepperscene.scene import Scene, assemble_scene

MESH = concatenate_meshes(
    [
        rectangle((0, 0, 1), (1, 0, 0), (0, 0, 1), surface="leaf"),
        rectangle((0, 1, 1), (1, 0, 0), (0, 0, 1), surface="fruit"),
        rectangle((0, 2, 1), (1, 0, 0), (0, 0, 1), surface="leaf"),
    ]
)
LEAF, FRUIT, STEM = (lambertian_surface(name, 0.5) for name in ("leaf", "fruit", "stem"))


def test_surfaces_stand_in_the_order_that_the_faces_count_in():
    scene = assemble_scene(MESH, {"stem": STEM, "fruit": FRUIT, "leaf": LEAF})
    assert scene.surfaces == (LEAF, FRUIT)
    assert [scene.surfaces[number].name for number in scene.mesh.face_surface[::2]] == [
        "leaf",
        "fruit",
        "leaf",
    ]


def test_ground_truth_needs_no_surfaces():
    scene = assemble_scene(MESH)
    assert scene.surfaces == ()
    assert scene.sky is None


def test_every_missing_surface_is_named():
    with pytest.raises(ValueError, match=r"leaf.*fruit"):
        assemble_scene(MESH, {"stem": STEM})


@pytest.mark.parametrize("surfaces", [(FRUIT, LEAF), (LEAF,), (LEAF, FRUIT, STEM)])
def test_surfaces_that_do_not_match_the_mesh_are_refused(surfaces):
    with pytest.raises(ValueError, match="do not match"):
        Scene(MESH, surfaces)
