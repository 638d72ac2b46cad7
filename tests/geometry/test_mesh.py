from dataclasses import replace

import numpy as np
import pytest
from organ_meshes import face_normals, merged

from pepperscene.geometry import concatenate_meshes, rectangle, sphere

CARD = rectangle((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), "leaf")
BALL = sphere((0.0, 0.0, 2.0), 0.5, "fruit", subdivisions=1)
BOTH = concatenate_meshes([CARD, BALL, CARD.moved(np.eye(3), np.array([0.0, 0.0, 5.0]))])


def test_selection_has_the_triangles_of_its_instances():
    ball = BOTH.select_instances([1])
    np.testing.assert_array_equal(ball.vertices[ball.faces], BALL.vertices[BALL.faces])
    np.testing.assert_array_equal(ball.state[ball.faces], BALL.state[BALL.faces])
    assert (ball.surfaces, ball.instances) == (BALL.surfaces, BALL.instances)
    assert len(ball.vertices) == len(BALL.vertices)


def test_selection_keeps_the_given_order():
    part = BOTH.select_instances([2, 1])
    assert part.instances == (BOTH.instances[2], BOTH.instances[1])
    first = part.vertices[part.faces[part.face_instance == 0]]
    assert first[..., 2].min() == 5.0
    assert set(part.surfaces) == {"leaf", "fruit"}
    names = np.array(part.surfaces)[part.face_surface]
    assert set(names[part.face_instance == 0]) == {"leaf"}


@pytest.mark.parametrize("chosen", [[], [3], [-1], [1, 1]])
def test_selection_raises_on_wrong_indices(chosen):
    with pytest.raises(ValueError, match="different indices of 3 instances"):
        BOTH.select_instances(chosen)


@pytest.mark.parametrize("shuffled", ["nothing", "faces", "vertices"])
def test_runs_group_faces_and_vertices_by_instance(shuffled):
    mesh = BOTH
    if shuffled == "faces":
        order = np.random.default_rng(1).permutation(len(mesh.faces))
        mesh = replace(mesh, faces=mesh.faces[order], face_instance=mesh.face_instance[order])
    elif shuffled == "vertices":
        order = np.random.default_rng(1).permutation(len(mesh.vertices))
        faces = np.argsort(order).astype(np.uint32)[mesh.faces]
        mesh = replace(mesh, vertices=mesh.vertices[order], faces=faces)
    assert (mesh.face_runs.order is None) == (shuffled != "faces")
    assert (mesh.vertex_runs.order is None) == (shuffled != "vertices")
    owners = np.repeat(mesh.face_instance, 3).reshape(-1, 3)
    np.testing.assert_array_equal(mesh.vertex_instance[mesh.faces], owners)
    for number in range(3):
        rows = np.arange(len(mesh.faces))[mesh.face_runs.rows(number)]
        np.testing.assert_array_equal(np.sort(rows), np.flatnonzero(mesh.face_instance == number))
        used = np.arange(len(mesh.vertices))[mesh.vertex_runs.rows(number)]
        np.testing.assert_array_equal(np.sort(used), np.unique(mesh.faces[rows]))


def test_raises_if_instances_share_vertices():
    shared = replace(CARD, face_instance=np.array([0, 1], dtype=np.uint32), instances=2 * CARD.instances)
    for name in ("vertex_instance", "vertex_runs"):
        with pytest.raises(ValueError, match="share vertices"):
            getattr(shared, name)
    unused = replace(CARD, faces=CARD.faces[:1], face_instance=CARD.face_instance[:1])
    with pytest.raises(ValueError, match="belong to a face"):
        unused.vertex_instance  # noqa: B018


@pytest.mark.parametrize("matrix", [np.diag([1.0, 1.0, -1.0]), 2.0 * np.eye(3), np.ones((3, 3))])
def test_raises_on_mirroring_and_scaling(matrix):
    with pytest.raises(ValueError, match="rotation must be orthogonal"):
        BALL.moved(matrix, np.zeros(3))


def test_sphere_is_round_and_closed():
    mesh = sphere((1.0, 2.0, 3.0), 0.04, subdivisions=4)
    distance = np.linalg.norm(mesh.vertices - [1.0, 2.0, 3.0], axis=1)
    np.testing.assert_allclose(distance, 0.04, rtol=1e-5)
    np.testing.assert_allclose(mesh.vertices, [1.0, 2.0, 3.0] + 0.04 * mesh.normals, atol=1e-6)
    body = merged(mesh)
    assert body.is_watertight
    assert body.volume == pytest.approx(4.0 / 3.0 * np.pi * 0.04**3, rel=0.01)
    assert 0.0 <= mesh.uv.min() <= mesh.uv.max() <= 1.0
    with pytest.raises(ValueError, match="radius_m"):
        sphere((0, 0, 0), 0.0)


def test_rectangle_faces_right_cross_up():
    mesh = rectangle((0.0, 1.0, 0.0), (0.2, 0.0, 0.0), (0.0, 0.0, 0.3), surface="card")
    np.testing.assert_allclose(mesh.normals, np.tile([0.0, -1.0, 0.0], (4, 1)), atol=1e-7)
    np.testing.assert_allclose(0.5 * face_normals(mesh).sum(axis=0), [0.0, -0.06, 0.0], atol=1e-8)
    np.testing.assert_allclose(mesh.vertices.mean(axis=0), [0.0, 1.0, 0.0], atol=1e-7)
    assert mesh.surfaces == ("card",)
    with pytest.raises(ValueError, match="span"):
        rectangle((0, 0, 0), (1, 0, 0), (2, 0, 0))
