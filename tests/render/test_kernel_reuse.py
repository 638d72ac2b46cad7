"""A new scene, another sky, another picture: the machine code is there already."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from greenhouse import camera, greenhouse

from pepperscene.cultivar import load_cultivar
from pepperscene.frame import DEFAULT_OUTPUTS
from pepperscene.geometry import mesh_plant
from pepperscene.grammar import grow
from pepperscene.materials import lambertian_surface, organ_surfaces, twine_surface
from pepperscene.render import Renderer
from pepperscene.render.kernel.arrays import ALIGNMENT, aligned, device_number, device_array
from pepperscene.render.variant import mitsuba_modules
from pepperscene.scene import Sky, Twine, add_twine, assemble_scene, double_row, partly_cloudy_sky

QUALITY = "draft"


def compiled(render):
    """What a render returns, and how many kernels it had to compile or to load from disk."""
    _, dr = mitsuba_modules()
    before = dr.flag(dr.JitFlag.KernelHistory)
    dr.set_flag(dr.JitFlag.KernelHistory, True)
    dr.kernel_history_clear()
    try:
        found = render()
        launched = list(dr.kernel_history([dr.KernelType.JIT]))
    finally:
        dr.kernel_history_clear()
        dr.set_flag(dr.JitFlag.KernelHistory, before)
    assert launched
    return found, sum(not entry["cache_hit"] for entry in launched)


def coarser(sky):
    """The same sky at half the resolution."""
    k, rows, columns = sky.weights.shape
    halved = sky.weights.reshape(k, rows // 2, 2, columns // 2, 2).mean(axis=(2, 4))
    return Sky(halved.astype(np.float32), sky.radiance, sky.sun)


def other_scene(number):
    """Other plants, one surface more, patterns of their own, other wavelengths, another sky."""
    cultivar = load_cultivar("kaite")
    short = cultivar.model_copy(update={"stem": cultivar.stem.model_copy(update={"parts": 7 + number})})
    meshes = []
    for side in range(2):
        plant = grow(short, np.random.default_rng(10 + 2 * number + side))
        cord = Twine(0.003, 4.0)
        meshes.append(add_twine(plant, mesh_plant(plant, 0.4), cord, np.random.default_rng(side)))
    row = double_row(meshes[:1], meshes[1:], spacing_m=0.25, gap_m=0.2, shift_m=0.1)
    nm = np.arange(370.0 + number, 821.0, 7.0)
    twine = twine_surface(nm)
    surfaces = {**organ_surfaces(cultivar, nm), twine.name: twine}
    leaf = surfaces["leaf"]
    surfaces["leaf"] = replace(leaf, pattern=leaf.pattern[::2, ::3], relief_mm=leaf.relief_mm[::2, ::3])
    row = replace(row, surfaces=("board", *row.surfaces), face_surface=row.face_surface + 1)
    surfaces["board"] = lambertian_surface("board", 0.3)
    sky = partly_cloudy_sky(
        np.random.default_rng(number),
        illuminance_lx=4000.0 + number,
        sun_azimuth_rad=-0.2,
        sun_elevation_rad=0.6,
        sun_fraction=0.4,
        cloud_cover=0.3,
    )
    return assemble_scene(row, surfaces, coarser(sky) if number else sky)


@pytest.fixture(scope="module")
def first():
    """A first scene, rendered, and kept: scenes that live on must not show either."""
    made = Renderer(greenhouse())
    made.render(camera(), DEFAULT_OUTPUTS, QUALITY, 1)
    made.render(camera(2), DEFAULT_OUTPUTS, QUALITY, 2)
    return made


@pytest.mark.parametrize("number", range(3))
def test_another_scene_compiles_nothing(first, number):
    scene = other_scene(number)
    _, missed = compiled(lambda: Renderer(scene).render(camera(), DEFAULT_OUTPUTS, QUALITY, 3 + number))
    assert missed == 0


def test_another_picture_size_compiles_nothing(first):
    for columns, rows in ((120, 90), (84, 63)):
        taken = camera(columns=columns, rows=rows)
        _, missed = compiled(lambda taken=taken: first.render(taken, DEFAULT_OUTPUTS, QUALITY, 5))
        assert missed == 0


def test_moved_camera_other_seed_compile_nothing(first):
    _, missed = compiled(lambda: first.render(camera(0), DEFAULT_OUTPUTS, QUALITY, 77))
    assert missed == 0


def test_a_scene_that_is_gone_leaves_its_code(first):
    made = Renderer(other_scene(1))
    made.render(camera(), DEFAULT_OUTPUTS, QUALITY, 1)
    del made
    _, missed = compiled(lambda: Renderer(greenhouse()).render(camera(), DEFAULT_OUTPUTS, QUALITY, 1))
    assert missed == 0


# --- the tables themselves --------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [np.float32, np.uint32])
@pytest.mark.parametrize("shape", [(1,), (2,), (7, 3), (1001, 4)])
def test_tables_are_aligned_copies(shape, dtype):
    given = np.arange(np.prod(shape)).reshape(shape)
    kept = []  # or all would lie at the same place
    for _ in range(8):
        found = aligned_copy(given, dtype)
        kept.append(found)
        assert (found.dtype, found.ndim, found.ctypes.data % ALIGNMENT) == (dtype, 1, 0)
        assert np.array_equal(found[: given.size], given.ravel())
        table = device_array(given, dtype)
        assert np.array_equal(np.asarray(table)[: given.size], given.ravel())


def test_a_table_takes_slices_and_keeps_its_own_copy():
    given = np.arange(60.0).reshape(6, 10)[::2, 1::3]
    table = device_array(given)
    expected = given.ravel().copy()
    given[...] = -1.0
    assert np.array_equal(np.asarray(table), expected)


def test_a_single_entry_is_no_constant():
    _, dr = mitsuba_modules()
    assert dr.width(device_array([3.0])) == 2
    assert dr.gather(type(device_array([3.0])), device_array([3.0]), 1)[0] == 3.0


def test_numbers_of_scenes_are_no_constants():
    mi, dr = mitsuba_modules()
    fraction, whole = device_float(0.25), device_uint(7)
    assert (type(fraction), type(whole)) == (mi.Float, mi.UInt32)
    assert (fraction[0], whole[0]) == (0.25, 7)
    assert fraction.state == whole.state == dr.VarState.Evaluated


def test_empty_tables_and_other_kinds_are_refused():
    with pytest.raises(ValueError, match="at least one value"):
        device_array([])
    with pytest.raises(ValueError, match="not of int64"):
        device_array([1], np.int64)
