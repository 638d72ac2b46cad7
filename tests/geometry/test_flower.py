from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from pepperscene.classes import OrganClass
from pepperscene.cultivar.organs import USUAL
from pepperscene.geometry import mesh_plant
from pepperscene.grammar.plant import Organ, Plant

RADIUS = 0.013


def flower(radius=RADIUS, depth=0.3, detail=1.0, **measures):
    curve = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 2.0 * depth * radius]])
    organ = Organ("flower", -1, 0, curve, np.array([1.0, 0.0, 0.0]), {"radius_m": radius} | measures)
    return mesh_plant(Plant("hand-made", (organ,), USUAL), detail)


def rim(mesh):
    """Distance from the axis of the outermost vertices, once around."""
    points = mesh.vertices[mesh.uv[:, 1] == 1.0]
    return np.linalg.norm(points[:, :2], axis=1)


@pytest.mark.parametrize("petals", [5.0, 6.0, 7.0])
def test_a_flower_has_as_many_petals_as_told(petals):
    spectrum = np.abs(np.fft.rfft(np.interp(np.arange(0, 2 * np.pi, 0.01), *_around(flower(petals=petals)))))
    assert np.argmax(spectrum[2:12]) + 2 == petals


def _around(mesh):
    points = mesh.vertices[mesh.uv[:, 1] == 1.0]
    angle = np.arctan2(points[:, 1], points[:, 0]) % (2 * np.pi)
    order = np.argsort(angle)
    reach = np.linalg.norm(points[:, :2], axis=1)[order]
    angle = angle[order]
    return np.concatenate([angle, angle[:1] + 2 * np.pi]), np.concatenate([reach, reach[:1]])


def test_an_open_flower_is_as_wide_as_told_and_a_bud_is_closed():
    assert rim(flower(open=1.0)).max() == pytest.approx(RADIUS, rel=1e-3)
    widths = [rim(flower(open=share)).max() for share in (0.0, 0.3, 0.6, 1.0)]
    assert np.all(np.diff(widths) > 0.0)
    assert widths[0] < 0.45 * RADIUS
    heights = [np.ptp(flower(open=share).vertices[:, 2]) for share in (0.0, 1.0)]
    assert heights[0] > 1.3 * heights[1]


def test_it_is_background_of_few_triangles_whose_normals_leave_the_inside():
    mesh = flower(open=0.9)
    assert set(mesh.face_class) == {OrganClass.BACKGROUND}
    assert mesh.surfaces == ("petal",)
    assert len(mesh.faces) < 200
    assert mesh.normals[mesh.uv[:, 1] > 0.5, 2].min() > 0.3
    # The throat is greener than the petals.
    assert mesh.state[mesh.uv[:, 1] == 0.0].mean() < mesh.state[mesh.uv[:, 1] == 1.0].mean() - 0.2


@settings(max_examples=40, deadline=None)
@given(
    radius=st.floats(0.001, 0.1),
    depth=st.floats(0.01, 2.0),
    petals=st.integers(1, 14),
    opened=st.floats(-0.5, 1.5),
    seed=st.floats(0.0, 0.999),
    detail=st.sampled_from([0.2, 1.0, 2.0]),
)
def test_any_flower_is_a_sound_sheet(radius, depth, petals, opened, seed, detail):
    mesh = flower(radius, depth, detail, petals=float(petals), open=opened, seed=seed)
    body = trimesh.Trimesh(mesh.vertices.astype(float), mesh.faces, process=False)
    assert body.area_faces.min() > 0.0
    assert body.is_winding_consistent
    assert len(np.unique(np.sort(mesh.faces, axis=1), axis=0)) == len(mesh.faces)
    # One sheet around a hole: two borders.
    assert body.euler_number == 0
    for values in (mesh.vertices, mesh.normals, mesh.uv, mesh.state):
        assert np.isfinite(values).all()
    assert mesh.uv.min() >= 0.0
    assert mesh.uv.max() <= 1.0
