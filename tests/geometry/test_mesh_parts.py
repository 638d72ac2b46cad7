"""Parts of a mesh by instance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pepperscene.geometry import concatenate_meshes, rectangle, sphere

CARD = rectangle((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), "leaf")
BALL = sphere((0.0, 0.0, 2.0), 0.5, "fruit", subdivisions=1)
BOTH = concatenate_meshes([CARD, BALL, CARD.moved(np.eye(3), np.array([0.0, 0.0, 5.0]))])


def test_a_part_has_the_triangles_of_its_instances_and_no_others():
    ball = BOTH.select_instances([1])
    np.testing.assert_array_equal(ball.vertices[ball.faces], BALL.vertices[BALL.faces])
    np.testing.assert_array_equal(ball.state[ball.faces], BALL.state[BALL.faces])
    assert (ball.surfaces, ball.instances) == (BALL.surfaces, BALL.instances)
    assert len(ball.vertices) == len(BALL.vertices)


def test_parts_are_numbered_in_the_order_asked_for():
    part = BOTH.select_instances([2, 1])
    assert part.instances == (BOTH.instances[2], BOTH.instances[1])
    first = part.vertices[part.faces[part.face_instance == 0]]
    assert first[..., 2].min() == 5.0
    assert set(part.surfaces) == {"leaf", "fruit"}
    names = np.array(part.surfaces)[part.face_surface]
    assert set(names[part.face_instance == 0]) == {"leaf"}


@pytest.mark.parametrize("chosen", [[], [3], [-1], [1, 1]])
def test_parts_that_are_not_there_are_refused(chosen):
    with pytest.raises(ValueError, match="instances"):
        BOTH.select_instances(chosen)


def test_every_vertex_knows_its_instance_and_every_instance_its_vertices():
    np.testing.assert_array_equal(
        BOTH.vertex_instance[BOTH.faces], np.repeat(BOTH.face_instance, 3).reshape(-1, 3)
    )
    for number, (first, stop) in enumerate(BOTH.instance_vertices):
        assert set(BOTH.faces[BOTH.face_instance == number].ravel()) == set(range(first, stop))
    swapped = BOTH.select_instances([2, 0, 1])
    np.testing.assert_array_equal(
        np.diff(swapped.instance_vertices)[:, 0], np.diff(BOTH.instance_vertices)[[2, 0, 1], 0]
    )


def test_instances_that_share_vertices_are_told():
    shared = replace(CARD, face_instance=np.array([0, 1], dtype=np.uint32), instances=2 * CARD.instances)
    with pytest.raises(ValueError, match="one instance"):
        shared.vertex_instance  # noqa: B018
    order = np.random.default_rng(1).permutation(len(BOTH.vertices))
    mixed = replace(
        BOTH, vertices=BOTH.vertices[order], faces=np.argsort(order).astype(np.uint32)[BOTH.faces]
    )
    with pytest.raises(ValueError, match="together"):
        mixed.instance_vertices  # noqa: B018


@pytest.mark.parametrize("matrix", [np.diag([1.0, 1.0, -1.0]), 2.0 * np.eye(3), np.ones((3, 3))])
def test_a_mesh_is_not_mirrored_or_stretched(matrix: np.ndarray) -> None:
    with pytest.raises(ValueError, match="rotation must be a rotation"):
        BALL.moved(matrix, np.zeros(3))
