import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from organ_meshes import check_mesh, merged, mesh_organs, organ

from pepperscene.classes import OrganClass

RADIUS = 0.013


def flower(radius=RADIUS, depth=0.3, detail=1.0, **measures):
    tip = (0.0, 0.0, 2.0 * depth * radius)
    return mesh_organs(organ("flower", tip=tip, up=(1, 0, 0), radius_m=radius, **measures), detail=detail)


def rim(mesh):
    """Angles about the axis and distances from it of the outermost vertices, once around."""
    points = mesh.vertices[mesh.uv[:, 1] == 1.0]
    angle = np.arctan2(points[:, 1], points[:, 0]) % (2 * np.pi)
    order = np.argsort(angle)
    return angle[order], np.linalg.norm(points[order, :2], axis=1)


@pytest.mark.parametrize("petals", [5.0, 6.0, 7.0])
def test_flower_has_the_stated_number_of_petals(petals):
    radius = np.interp(np.arange(0, 2 * np.pi, 0.01), *rim(flower(petals=petals)), period=2 * np.pi)
    assert np.argmax(np.abs(np.fft.rfft(radius))[2:12]) + 2 == petals


def test_open_flower_has_the_stated_radius_and_a_bud_is_closed():
    assert rim(flower(open=1.0))[1].max() == pytest.approx(RADIUS, rel=1e-3)
    widths = [rim(flower(open=fraction))[1].max() for fraction in (0.0, 0.3, 0.6, 1.0)]
    assert np.all(np.diff(widths) > 0.0)
    assert widths[0] < 0.45 * RADIUS
    heights = [np.ptp(flower(open=fraction).vertices[:, 2]) for fraction in (0.0, 1.0)]
    assert heights[0] > 1.3 * heights[1]


def test_flower_is_background_with_normals_out_of_its_inside():
    mesh = flower(open=0.9)
    assert set(mesh.face_class) == {OrganClass.BACKGROUND}
    assert mesh.surfaces == ("petal",)
    assert len(mesh.faces) < 200
    assert mesh.normals[mesh.uv[:, 1] > 0.5, 2].min() > 0.3
    # The throat is greener than the petals.
    assert mesh.state[mesh.uv[:, 1] == 0.0].mean() < mesh.state[mesh.uv[:, 1] == 1.0].mean() - 0.2


@given(
    radius=st.floats(0.001, 0.1),
    depth=st.floats(0.01, 2.0),
    petals=st.integers(1, 14),
    opened=st.floats(-0.5, 1.5),
    seed=st.floats(0.0, 0.999),
    detail=st.sampled_from([0.2, 1.0, 2.0]),
)
def test_any_flower_is_a_sound_open_surface(radius, depth, petals, opened, seed, detail):
    mesh = flower(radius, depth, detail, petals=float(petals), open=opened, seed=seed)
    check_mesh(mesh)
    body = merged(mesh)
    assert body.is_winding_consistent
    assert len(np.unique(np.sort(mesh.faces, axis=1), axis=0)) == len(mesh.faces)
    # A ring, with two borders.
    assert body.euler_number == 0
