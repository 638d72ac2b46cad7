"""The scene inside Mitsuba: shortcuts give what Mitsuba's own calls give."""

from __future__ import annotations

import numpy as np
import pytest
from greenhouse import greenhouse

from pepperscene.render.kernel.scene import light_scene, mitsuba_mesh, organ_table, truth_scene
from pepperscene.render.reference.path_tracer import surface_bsdf
from pepperscene.render.variant import mitsuba_modules

RAYS = 20_000


@pytest.fixture(scope="module")
def scene():
    return greenhouse()


@pytest.fixture(scope="module")
def kernel_scene(scene):
    return light_scene(scene, 400.0, 800.0)


@pytest.fixture(scope="module")
def rays(scene):
    """Towards random points of the mesh from all sides; some miss it."""
    mi, dr = mitsuba_modules()
    rng = np.random.default_rng(3)
    mesh = scene.mesh
    target = mesh.vertices[mesh.faces[rng.integers(0, len(mesh.faces), RAYS)]].mean(axis=1)
    direction = rng.standard_normal((RAYS, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    start = target - 0.3 * direction + 0.002 * rng.standard_normal((RAYS, 3))
    ray = mi.Ray3f(mi.Point3f(start.T.astype(np.float32)), mi.Vector3f(direction.T.astype(np.float32)))
    ray.time, ray.wavelengths = mi.Float(0.25), mi.Spectrum(450.0, 500.0, 600.0, 700.0)
    dr.eval(ray)
    return ray


def rows(value):
    """`(components, RAYS)`."""
    array = np.atleast_2d(np.asarray(value))
    return np.broadcast_to(array, (len(array), RAYS))


def test_interactions_equal_mitsubas(kernel_scene, rays):
    mi, _ = mitsuba_modules()
    hit = kernel_scene.scene.ray_intersect_preliminary(rays)
    active = hit.is_valid()
    ours = kernel_scene.interaction(rays, hit, active)
    theirs = hit.compute_surface_interaction(rays, mi.RayFlags.All, active)
    mask = np.asarray(active)
    assert 0.5 < mask.mean() < 1.0
    for name in ("t", "time", "wavelengths", "p", "n", "uv", "dp_du", "dp_dv", "wi", "prim_index"):
        assert np.array_equal(rows(getattr(ours, name))[:, mask], rows(getattr(theirs, name))[:, mask]), name
    for axis in "stn":
        a, b = (rows(getattr(si.sh_frame, axis)) for si in (ours, theirs))
        assert np.array_equal(a[:, mask], b[:, mask]), axis
    # Spawned rays have the same bits as well.
    a, b = (si.spawn_ray(si.sh_frame.n) for si in (ours, theirs))
    assert np.array_equal(np.asarray(a.o)[:, mask], np.asarray(b.o)[:, mask])


def test_face_states_equal_mesh_attributes(scene, kernel_scene, rays):
    mi, _ = mitsuba_modules()
    _, face_organ = organ_table(scene)
    shape = mitsuba_mesh(scene.mesh, surface_bsdf().of(kernel_scene.optics), face_organ=face_organ)
    with_attributes = mi.load_dict({"type": "scene", "plants": shape})
    hit = with_attributes.ray_intersect_preliminary(rays)
    active = hit.is_valid()
    si = hit.compute_surface_interaction(rays, mi.RayFlags.All, active)
    organ = mi.UInt32(shape.eval_attribute_1("face_organ", si, active) + 0.5)
    state = shape.eval_attribute_1("vertex_state", si, active)
    expected = kernel_scene.optics.point(si, organ, state, active)
    point = kernel_scene.surface_point(si, hit, active)
    mask = np.asarray(active)
    for name in ("reflectance", "transmittance", "entering"):
        a, b = (np.asarray(getattr(p, name))[..., mask] for p in (point, expected))
        np.testing.assert_allclose(a, b, atol=2e-5)


def test_mitsuba_mesh_holds_the_mesh_and_shares_its_large_buffers(scene):
    mesh, shape = scene.mesh, mitsuba_mesh(scene.mesh)
    buffers = {
        "vertices": shape.vertex_positions_buffer(),
        "normals": shape.vertex_normals_buffer(),
        "uv": shape.vertex_texcoords_buffer(),
        "faces": shape.faces_buffer(),
    }
    for name, buffer in buffers.items():
        assert np.array_equal(np.asarray(buffer), getattr(mesh, name).ravel()), name
        # A GPU has its own memory; the texture coordinates are aligned, and so copied.
        if mitsuba_modules()[0].variant().startswith("llvm") and name != "uv":
            assert np.shares_memory(np.asarray(buffer), getattr(mesh, name)), name


def test_mesh_attributes_exist_only_for_a_bsdf(scene, kernel_scene):
    names = ("vertex_state", "face_organ")
    plain = mitsuba_mesh(scene.mesh)
    _, face_organ = organ_table(scene)
    with_bsdf = mitsuba_mesh(scene.mesh, surface_bsdf().of(kernel_scene.optics), face_organ=face_organ)
    assert not any(plain.has_attribute(name) for name in names)
    assert all(with_bsdf.has_attribute(name) for name in names)
    assert not truth_scene(scene).shapes()[0].has_attribute("vertex_state")
