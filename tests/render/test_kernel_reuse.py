"""Kernels are reused by other scenes and images; device arrays; the scene inside Mitsuba."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from greenhouse import camera, cloudy_sky, greenhouse, row_of_plants, surfaces

from pepperscene.materials import lambertian_surface
from pepperscene.outputs import DEFAULT_OUTPUTS
from pepperscene.render import Renderer
from pepperscene.render.arrays import ALIGNMENT, device_array, device_float, device_uint
from pepperscene.render.kernel.scene import light_scene, mitsuba_mesh
from pepperscene.render.variant import mitsuba_modules
from pepperscene.scene import Sky, assemble_scene

QUALITY = "draft"


def launched_kernels(render):
    """The kernels that a render launched."""
    _, dr = mitsuba_modules()
    before = dr.flag(dr.JitFlag.KernelHistory)
    dr.set_flag(dr.JitFlag.KernelHistory, True)
    dr.kernel_history_clear()
    try:
        render()
        launched = list(dr.kernel_history([dr.KernelType.JIT]))
    finally:
        dr.kernel_history_clear()
        dr.set_flag(dr.JitFlag.KernelHistory, before)
    assert launched
    return launched


def count_compiled(render):
    """Number of kernels that a render had to compile or load from disk."""
    return sum(not entry["cache_hit"] for entry in launched_kernels(render))


def half_resolution(sky):
    k, rows, columns = sky.weights.shape
    halved = sky.weights.reshape(k, rows // 2, 2, columns // 2, 2).mean(axis=(2, 4))
    return Sky(halved.astype(np.float32), sky.radiance, sky.sun)


def other_scene(number):
    """Other plants, one more surface, other patterns and wavelengths, and another sky."""
    row = row_of_plants(7 + number, (10 + 2 * number, 11 + 2 * number))
    others = surfaces(np.arange(370.0 + number, 821.0, 7.0))
    leaf = others["leaf"]
    smaller = {name: images[:, ::2, ::3] for name, images in leaf.textures.items()}
    others["leaf"] = replace(leaf, **smaller)
    row = replace(row, surfaces=("board", *row.surfaces), face_surface=row.face_surface + 1)
    others["board"] = lambertian_surface("board", 0.3)
    sky = cloudy_sky(number, -0.2)
    return assemble_scene(row, others, half_resolution(sky) if number else sky)


@pytest.fixture(scope="module")
def first():
    """A first scene, rendered and kept in memory."""
    renderer = Renderer(greenhouse())
    renderer.render(camera(), DEFAULT_OUTPUTS, QUALITY, 1)
    renderer.render(camera(2), DEFAULT_OUTPUTS, QUALITY, 2)
    return renderer


@pytest.mark.parametrize("number", range(2))
def test_another_scene_compiles_nothing(first, number):
    render = Renderer(other_scene(number)).render
    assert count_compiled(lambda: render(camera(), DEFAULT_OUTPUTS, QUALITY, 3 + number)) == 0


def test_another_image_size_pose_or_seed_compiles_nothing(first):
    for view in (camera(columns=84, rows=63), camera(0)):
        assert count_compiled(lambda view=view: first.render(view, DEFAULT_OUTPUTS, QUALITY, 77)) == 0


def test_a_small_image_by_daylight_takes_no_more_launches_than_a_large_one(first):
    # The paths that fill the cache of light are one wavefront, of many samples in few pixels.
    small, large = (
        launched_kernels(lambda view=view: first.render(view, ["electrons"], QUALITY, 5))
        for view in (camera(columns=8, rows=6, flash=False), camera(columns=160, rows=120, flash=False))
    )
    assert len(small) <= 2 * len(large)


@pytest.mark.parametrize(("shape", "dtype"), [((1,), np.float32), ((2,), np.uint32), ((1001, 3), np.float32)])
def test_device_arrays_are_flat_and_aligned(shape, dtype):
    values = np.arange(np.prod(shape)).reshape(shape)
    arrays = [device_array(values, dtype) for _ in range(8)]  # kept, so their addresses differ
    for array in map(np.asarray, arrays):
        assert (array.dtype, array.ndim) == (dtype, 1)
        assert np.array_equal(array[: values.size], values.ravel())
        if mitsuba_modules()[0].variant().startswith("llvm"):
            assert array.ctypes.data % ALIGNMENT == 0


def test_single_entries_and_device_numbers_are_not_compiled_as_constants():
    assert np.asarray(device_array([3.0])).tolist() == [3.0, 3.0]
    mi, dr = mitsuba_modules()
    fraction, integer = device_float(0.25), device_uint(7)
    assert (type(fraction), type(integer)) == (mi.Float, mi.UInt32)
    assert (fraction[0], integer[0]) == (0.25, 7)
    assert fraction.state == integer.state == dr.VarState.Evaluated


def test_device_arrays_copy_slices_and_reject_other_types():
    values = np.arange(60.0).reshape(6, 10)[::2, 1::3]
    array, expected = device_array(values), values.ravel().copy()
    values[...] = -1.0
    assert np.array_equal(np.asarray(array), expected)
    for values, dtype in (([], np.float32), ([1], np.int64)):
        with pytest.raises(ValueError, match="at least one float32 or uint32"):
            device_array(values, dtype)


RAYS = 20_000


@pytest.fixture(scope="module")
def plants():
    return greenhouse()


@pytest.fixture(scope="module")
def kernel_scene(plants):
    return light_scene(plants, 400.0, 800.0)


@pytest.fixture(scope="module")
def rays(plants):
    """Towards random points of the mesh from all sides; some miss it."""
    mi, dr = mitsuba_modules()
    rng = np.random.default_rng(3)
    mesh = plants.mesh
    target = mesh.vertices[mesh.faces[rng.integers(0, len(mesh.faces), RAYS)]].mean(axis=1)
    direction = rng.standard_normal((RAYS, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    start = target - 0.3 * direction + 0.002 * rng.standard_normal((RAYS, 3))
    ray = mi.Ray3f(mi.Point3f(start.T.astype(np.float32)), mi.Vector3f(direction.T.astype(np.float32)))
    ray.time, ray.wavelengths = mi.Float(0.25), mi.Spectrum(450.0, 500.0, 600.0, 700.0)
    dr.eval(ray)
    return ray


def components(value):
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
        assert np.array_equal(
            components(getattr(ours, name))[:, mask], components(getattr(theirs, name))[:, mask]
        ), name
    for axis in "stn":
        a, b = (components(getattr(si.sh_frame, axis)) for si in (ours, theirs))
        assert np.array_equal(a[:, mask], b[:, mask]), axis
    # Spawned rays have the same bits as well.
    a, b = (si.spawn_ray(si.sh_frame.n) for si in (ours, theirs))
    assert np.array_equal(np.asarray(a.o)[:, mask], np.asarray(b.o)[:, mask])


def test_mitsuba_mesh_holds_the_mesh_and_shares_its_large_buffers(plants):
    mesh, shape = plants.mesh, mitsuba_mesh(plants.mesh)
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
