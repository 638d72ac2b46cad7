"""A new scene, sky, image size or pose reuses the compiled kernels; device arrays are aligned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from greenhouse import camera, cloudy_sky, greenhouse, row_of_plants, surfaces

from pepperscene.materials import lambertian_surface
from pepperscene.outputs import DEFAULT_OUTPUTS
from pepperscene.render import Renderer
from pepperscene.render.arrays import ALIGNMENT, device_array, device_float, device_uint
from pepperscene.render.variant import mitsuba_modules
from pepperscene.scene import Sky, assemble_scene

QUALITY = "draft"


def count_compiled(render):
    """Number of kernels that a render had to compile or load from disk."""
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
    return sum(not entry["cache_hit"] for entry in launched)


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


def test_kernels_outlive_their_scene(first):
    renderer = Renderer(other_scene(1))
    renderer.render(camera(), DEFAULT_OUTPUTS, QUALITY, 1)
    del renderer
    render = Renderer(greenhouse()).render
    assert count_compiled(lambda: render(camera(), DEFAULT_OUTPUTS, QUALITY, 1)) == 0


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
