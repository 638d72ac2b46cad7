"""Straight bodies are closed, their normals point out, and their volume is that of a prism."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from pepperscene.scene.greenhouse import beam, box, rod

HEXAGON = [(np.cos(a), 2 * np.sin(a)) for a in np.arange(6) * np.pi / 3]


def closed(mesh):
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=True, merge_norm=True, merge_tex=True)


@pytest.mark.parametrize(
    ("mesh", "volume"),
    [
        (box((-1.0, 2.0), (0.5, 1.0), (3.0, 7.0), "gutter"), 6.0),
        (beam(HEXAGON, (-1.0, 1.0), "gutter"), 2 * 2 * 1.5 * 3**0.5),
        # A regular polygon of 12 sides.
        (rod(1.0, 2.0, 0.5, (0.0, 3.0), "steel"), 3 * 0.25 * 6 * np.sin(np.pi / 6)),
    ],
)
def test_a_beam_is_a_closed_prism(mesh, volume):
    body = closed(mesh)
    assert body.is_watertight
    assert body.is_winding_consistent
    assert body.volume == pytest.approx(volume, rel=1e-6)
    assert (body.area_faces > 0).all()
    assert mesh.uv.min() >= 0
    assert mesh.uv.max() <= 1
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-6)


def test_the_sides_of_a_box_are_flat_and_those_of_a_rod_round():
    flat = box((-1.0, 1.0), (-1.0, 1.0), (0.0, 1.0), "gutter")
    corners = flat.vertices[flat.faces].astype(float)
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    face /= np.linalg.norm(face, axis=1, keepdims=True)
    np.testing.assert_allclose(flat.normals[flat.faces], np.repeat(face[:, None], 3, axis=1), atol=1e-6)
    round_ = rod(0.5, 0.25, 0.1, (0.0, 1.0), "steel")
    side = np.abs(round_.normals[:, 0]) < 0.5
    out = (round_.vertices[side, 1:] - [0.5, 0.25]) / 0.1
    np.testing.assert_allclose(round_.normals[side, 1:], out, atol=1e-5)


@pytest.mark.parametrize(
    ("section", "ends"),
    [
        ([(0, 0), (1, 0), (1, 1), (0, 1)], (1.0, 1.0)),
        ([(0, 0), (0, 1), (1, 1), (1, 0)], (0.0, 1.0)),
        ([(0, 0), (1, 0)], (0.0, 1.0)),
        ([(0, 0), (2, 0), (1, 0.2), (1, 2)], (0.0, 1.0)),
    ],
)
def test_what_is_no_prism_is_refused(section, ends):
    with pytest.raises(ValueError, match="convex"):
        beam(section, ends, "gutter")
