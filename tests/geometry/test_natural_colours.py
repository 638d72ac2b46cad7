"""Baked colours: texels against the tables that they come from, and their places on the mesh."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import LinearNDInterpolator

from pepperscene.camera.image.colorimetry import srgb_encode
from pepperscene.classes import Appearance
from pepperscene.geometry import concatenate_meshes, rectangle, sphere
from pepperscene.geometry.mesh import PIGMENTS
from pepperscene.geometry.natural_colours import bake_colours, linear_colours, natural_surfaces
from pepperscene.geometry.texel_kernel import fill_texels
from pepperscene.materials import Surface, lambertian_surface

NM = np.arange(380.0, 781.0, 5.0)


def ramp(name="leaf", **more):
    """A surface from black at state 0 to white at state 1."""
    reflectance = np.linspace(0.0, 1.0, 3)[:, None, None] * np.ones((3, 2, len(NM)))
    return Surface(name, NM, reflectance, np.zeros((3, len(NM))), **more)


def blade(state, surface="leaf", place=0.0):
    """A rectangle whose state is given at its corners."""
    mesh = rectangle((place, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.1, 0.0), surface)
    return replace(mesh, state=np.broadcast_to(np.float32(state), len(mesh.vertices)).copy())


def colour_at(baked, mesh, face, weights):
    """sRGB codes of the texel at barycentric coordinates of a triangle."""
    image = list(baked.images.values())[baked.face_image[face]]
    u, v = weights @ baked.uv[mesh.faces[face]]
    height, width = image.shape[:2]
    return image[int((1.0 - v) * height), int(u * width)]


def test_white_and_grey_reflectance_are_white_and_grey():
    np.testing.assert_allclose(linear_colours(np.ones((1, len(NM))), NM), [[1.0, 1.0, 1.0]], atol=2e-3)
    np.testing.assert_allclose(linear_colours(0.18 * np.ones((1, len(NM))), NM), [[0.18] * 3], atol=1e-3)


def test_texels_have_the_colour_of_their_state():
    """Two organs in one image: each has its own, and states between vertices are linear."""
    flat, gradient = blade(0.25), blade(0.0, place=0.5)
    gradient = replace(gradient, state=gradient.uv[:, 0].astype(np.float32))
    mesh = concatenate_meshes([flat, gradient])
    baked = bake_colours(mesh, {"leaf": ramp(is_blade=True)})
    assert list(baked.images) == ["leaf"]
    rng = np.random.default_rng(2)
    for face in range(len(mesh.faces)):
        for weights in rng.dirichlet(np.ones(3), 20):
            state = weights @ mesh.state[mesh.faces[face]]
            expected = 255.0 * srgb_encode(np.array(state))
            # A step of a texel is 1/63 of the range.
            low, high = (255.0 * srgb_encode(np.clip(state + d, 0.0, 1.0)) for d in (-0.01, 0.01))
            found = colour_at(baked, mesh, face, weights)
            assert np.all(found >= min(low, expected) - 1.0)
            assert np.all(found <= max(high, expected) + 1.0)


def test_texels_have_pattern_ageing_and_residue():
    pattern = np.zeros((1, 4, 16), np.float32)
    pattern[:, :, 8:] = 0.5
    dusty = Appearance(residue=0.5)
    mesh = replace(blade(0.25), appearances=(dusty,))
    baked = bake_colours(mesh, {"leaf": ramp(pattern=pattern, is_blade=True, residue_reflectance=0.45)})
    left, right = (colour_at(baked, mesh, 0, weights) for weights in corners_of(mesh))
    for found, state in ((left, 0.25), (right, 0.75)):
        expected = 255.0 * srgb_encode(np.array(0.5 * state + 0.5 * 0.45))
        np.testing.assert_allclose(found, expected, atol=1.5)
    # A dried organ has the colour of the last row of its table.
    dry = replace(blade(0.5), appearances=(Appearance(ageing=1.0),))
    ageing = ramp(is_blade=True, first_state=-1.0)
    assert np.all(bake_colours(dry, {"leaf": ageing}).images["leaf"] == 0)


def corners_of(mesh):
    """Barycentric coordinates on the first triangle near its smallest and its largest u."""
    u = mesh.uv[mesh.faces[0], 0]
    return [np.where(np.arange(3) == index, 0.9, 0.05) for index in (u.argmin(), u.argmax())]


def test_surfaces_without_a_table_and_scans_have_no_image():
    scanned = sphere((0.0, 0.0, 1.0), 0.1, surface="fruit", subdivisions=0)
    colour = np.full((len(scanned.vertices), 3), 0.5, np.float32)
    mesh = concatenate_meshes([blade(0.5), blade(0.5, "card", 0.5), replace(scanned, colour=colour)])
    assert mesh.colour.min() == PIGMENTS
    baked = bake_colours(mesh, {"leaf": ramp(), "fruit": ramp("fruit")})
    assert list(baked.images) == ["leaf"]
    without = np.unique(mesh.faces[baked.face_image < 0])
    np.testing.assert_array_equal(baked.uv[without], mesh.uv[without])
    assert natural_surfaces(mesh) == {}
    assert "floor_film" in natural_surfaces(blade(0.5, "floor_film"))


def test_far_plants_have_small_tiles_in_an_image_of_their_own():
    near, far = blade(0.0), blade(1.0, place=1.0)
    far = replace(far, instances=(far.instances[0].numbered(1, -1, 0),))
    baked = bake_colours(concatenate_meshes([near, far]), {"leaf": lambertian_surface("leaf", 0.5)})
    assert {name: image.shape for name, image in baked.images.items()} == {
        "leaf": (16, 16, 3),
        "leaf_far": (4, 4, 3),
    }


@pytest.mark.parametrize("seed", range(3))
def test_filled_texels_are_linear_over_triangles(seed):
    """Against SciPy's interpolation over its own triangulation of random points."""
    from scipy.spatial import Delaunay

    rng = np.random.default_rng(seed)
    points, values = rng.uniform(0.0, 20.0, (30, 2)), rng.normal(size=30)
    triangles = Delaunay(points).simplices
    texels = np.full((1, 21, 21), 9.0)
    fill_texels(texels, np.zeros(len(triangles), np.intp), points[triangles], values[triangles])
    rows, columns = np.mgrid[:21, :21]
    expected = LinearNDInterpolator(points, values)(columns, rows)
    inside = np.isfinite(expected)
    np.testing.assert_allclose(texels[0][inside], expected[inside], atol=1e-9)
    # Beside the triangles there are values of their borders, or what was there before.
    border = texels[0][~inside]
    assert np.all((border == 9.0) | ((border >= values.min()) & (border <= values.max())))
