"""The scene inside the kernel: the shortcuts find what the long way finds."""

from __future__ import annotations

import numpy as np
import pytest
from greenhouse import greenhouse

from pepperscene.render.kernel.scene import mitsuba_mesh, light_scene, truth_scene
from pepperscene.render.variant import mitsuba_modules

RAYS = 20_000


@pytest.fixture(scope="module")
def scene():
    return greenhouse()


@pytest.fixture(scope="module")
def built(scene):
    return light_scene(scene, 400.0, 800.0)


@pytest.fixture(scope="module")
def rays(scene):
    """Towards random points of the mesh from all sides; some of them pass by."""
    mi, dr = mitsuba_modules()
    rng = np.random.default_rng(3)
    mesh = scene.mesh
    target = mesh.vertices[mesh.faces[rng.integers(0, len(mesh.faces), RAYS)]].mean(axis=1)
    towards = rng.standard_normal((RAYS, 3))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    start = target - 0.3 * towards + 0.002 * rng.standard_normal((RAYS, 3))
    ray = mi.Ray3f(mi.Point3f(start.T.astype(np.float32)), mi.Vector3f(towards.T.astype(np.float32)))
    ray.time, ray.wavelengths = mi.Float(0.25), mi.Spectrum(450.0, 500.0, 600.0, 700.0)
    dr.eval(ray)
    return ray


def rows(value):
    """`(components, RAYS)`."""
    found = np.atleast_2d(np.asarray(value))
    return np.broadcast_to(found, (len(found), RAYS))


def test_interactions_are_those_of_mitsuba(built, rays):
    mi, _ = mitsuba_modules()
    hit = built.scene.ray_intersect_preliminary(rays)
    active = hit.is_valid()
    ours = built.interaction(rays, hit, active)
    theirs = hit.compute_surface_interaction(rays, mi.RayFlags.All, active)
    met = np.asarray(active)
    assert 0.5 < met.mean() < 1.0
    for name in ("t", "time", "wavelengths", "p", "n", "uv", "dp_du", "dp_dv", "wi", "prim_index"):
        assert np.array_equal(rows(getattr(ours, name))[:, met], rows(getattr(theirs, name))[:, met]), name
    for axis in "stn":
        a, b = (rows(getattr(si.sh_frame, axis)) for si in (ours, theirs))
        assert np.array_equal(a[:, met], b[:, met]), axis
    # Rays that leave the shape are the same to the last bit as well.
    a, b = (si.spawn_ray(si.sh_frame.n) for si in (ours, theirs))
    assert np.array_equal(np.asarray(a.o)[:, met], np.asarray(b.o)[:, met])


def test_the_table_of_corners_says_what_attributes_say(scene, built, rays):
    from pepperscene.render.reference.path_tracer import surface_bsdf

    mi, _ = mitsuba_modules()
    shape = mitsuba_mesh(scene.mesh, surface_bsdf().of(built.optics))
    theirs = mi.load_dict({"type": "scene", "plants": shape})
    hit = theirs.ray_intersect_preliminary(rays)
    active = hit.is_valid()
    si = hit.compute_surface_interaction(rays, mi.RayFlags.All, active)
    surface = mi.UInt32(shape.eval_attribute_1("face_surface", si, active) + 0.5)
    state = shape.eval_attribute_1("vertex_state", si, active)
    expected = built.optics.at(si, surface, state, active)
    found = built.point(si, hit, active)
    met = np.asarray(active)
    for name in ("reflectance", "transmittance", "entering", "ior"):
        a, b = (np.asarray(getattr(point, name))[..., met] for point in (found, expected))
        np.testing.assert_allclose(a, b, atol=2e-5)


def test_the_kernel_sees_the_very_mesh(scene):
    shape = mitsuba_mesh(scene.mesh)
    mesh = scene.mesh
    assert np.array_equal(np.asarray(shape.vertex_positions_buffer()), mesh.vertices.ravel())
    assert np.array_equal(np.asarray(shape.vertex_normals_buffer()), mesh.normals.ravel())
    assert np.array_equal(np.asarray(shape.vertex_texcoords_buffer()), mesh.uv.ravel())
    assert np.array_equal(np.asarray(shape.faces_buffer()), mesh.faces.ravel())


def test_large_buffers_are_shared_with_the_mesh(scene):
    mi, _ = mitsuba_modules()
    if not mi.variant().startswith("llvm"):
        pytest.skip("a GPU has memory of its own")
    shape = mitsuba_mesh(scene.mesh)
    for buffer, held in (
        (shape.vertex_positions_buffer(), scene.mesh.vertices),
        (shape.vertex_normals_buffer(), scene.mesh.normals),
        (shape.faces_buffer(), scene.mesh.faces),
    ):
        assert np.shares_memory(np.asarray(buffer), held)


def test_attributes_only_where_a_bsdf_reads_them(scene, built):
    from pepperscene.render.reference.path_tracer import surface_bsdf

    names = ("vertex_state", "face_surface")
    plain, with_bsdf = mitsuba_mesh(scene.mesh), mitsuba_mesh(scene.mesh, surface_bsdf().of(built.optics))
    assert not any(plain.has_attribute(name) for name in names)
    assert all(with_bsdf.has_attribute(name) for name in names)
    assert not truth_scene(scene).shapes()[0].has_attribute("vertex_state")
