"""The denoiser keeps energy and direct light, and accepts any image; pyoidn loads without PyTorch."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from greenhouse import NM, camera, greenhouse, surfaces
from scipy.ndimage import gaussian_filter
from tracer import Tracer

from pepperscene.classes import OrganClass
from pepperscene.geometry import rectangle
from pepperscene.render import Renderer
from pepperscene.render.transport import strips
from pepperscene.render.transport.denoise import denoised
from pepperscene.scene import assemble_scene, uniform_sky
from pepperscene.scene.cover import directions
from pepperscene.spectra import Spectrum


def traced_light(indirect, *, flash=0.0, sky_and_sun=0.0, coverage=1.0, albedo=0.5, surface=None):
    """The traced light of surfaces of one albedo, seen from the front."""
    indirect = np.asarray(indirect, np.float32)
    h, w, c = indirect.shape
    cover = np.broadcast_to(np.asarray(coverage, np.float32), (h, w))

    def full(value, channels=c):
        return np.broadcast_to(np.asarray(value, np.float32), (h, w, channels)).copy()

    return SimpleNamespace(
        flash=full(flash),
        sky_and_sun=full(sky_and_sun),
        indirect=indirect,
        albedo=full(albedo) * cover[..., None],
        normal=full((0.0, 0.0, 1.0), 3) * cover[..., None],
        coverage=np.repeat(cover[..., None], 2, axis=-1),
        variance=SimpleNamespace(indirect_samples=4),
        surface=surface,
    )


def noisy(shape, rng, level=1.0, rare_fraction=0.02):
    """Light of mean `level`, a tenth of which comes by rare paths."""
    rare = rng.random(shape[:2]) < rare_fraction
    light = 0.9 * rng.gamma(2.0, 0.5, shape) + 0.1 / rare_fraction * rare[..., None]
    return level * light.astype(np.float32)


def test_keeps_energy_of_rare_bright_paths():
    # The filter alone takes such pixels for outliers and loses most of the tenth that they carry.
    indirect = noisy((192, 160, 3), np.random.default_rng(1), rare_fraction=0.002)
    result = denoised(traced_light(indirect))
    assert result.mean(axis=(0, 1)) == pytest.approx(indirect.mean(axis=(0, 1)), rel=0.01)
    # And it does filter: differences between neighbours are a small part of what they were.
    assert np.diff(result, axis=0).std() < 0.1 * np.diff(indirect, axis=0).std()


def test_each_surface_keeps_its_mean():
    """Stripes three pixels wide are half as bright as the rest; the filter makes them too bright."""
    shape, rng = (192, 160, 3), np.random.default_rng(2)
    stripes = np.broadcast_to(np.arange(shape[1]) % 20 < 3, shape[:2])
    truth = np.where(stripes, 0.5, 1.0)[..., None]
    light = (truth * rng.gamma(1.0, 1.0, shape)).astype(np.float32)
    # Numbers of surfaces need not follow each other, and those of a few pixels hardly count.
    surface = np.where(stripes, 7, 2).astype(np.uint16)
    surface[:2, :2], surface[5, 5] = 4, 0

    def ratio(result):
        return result[stripes].mean(axis=0) / 0.5

    assert (ratio(denoised(traced_light(light))) > 1.15).all()
    result = denoised(traced_light(light, surface=surface))
    # The mean of 4,600 pixels has a standard deviation of 1.5 %.
    assert ratio(result) == pytest.approx(1.0, abs=0.06)
    # The filter's own detail is kept: pixels of a surface have one factor.
    factor = result / denoised(traced_light(light))
    assert np.ptp(factor[surface == 7], axis=0) == pytest.approx(0.0, abs=1e-6)
    assert factor[surface == 4] == pytest.approx(1.0, abs=0.05)


def test_direct_light_is_not_filtered():
    rng = np.random.default_rng(4)
    flash, sky = rng.random((2, 48, 64, 3)).astype(np.float32)
    dark = traced_light(np.zeros((48, 64, 3)), flash=flash, sky_and_sun=sky)
    assert np.array_equal(denoised(dark), flash + sky)
    assert np.array_equal(dark.flash, flash)
    # So bright that the same filter applies without direct light.
    indirect = np.full((48, 64, 3), 1.0)
    both = denoised(traced_light(indirect, flash=flash, sky_and_sun=sky))
    assert np.allclose(both - denoised(traced_light(indirect)), flash + sky, atol=1e-6)


def test_outline_against_the_sky_is_as_bright_as_the_inside():
    # A half plane whose outline cuts pixels: the indirect light of each follows the area covered.
    cover = np.clip(np.arange(96.0) - 40.3, 0.0, 1.0)[None].repeat(96, axis=0)
    rng = np.random.default_rng(5)
    indirect = cover[..., None] * rng.gamma(8.0, 0.125, (96, 96, 3))
    result = denoised(traced_light(indirect, coverage=cover)).mean(axis=(0, 2))
    assert (result[:40] == 0.0).all()
    assert result[40:60] == pytest.approx(cover[0, 40:60], rel=0.05)


@pytest.mark.parametrize("shape", [(1, 1, 3), (1, 40, 1), (33, 65, 3)])
def test_accepts_any_shape(shape):
    indirect = np.random.default_rng(6).gamma(4.0, 0.25, shape)
    result = denoised(traced_light(indirect, flash=1.0))
    assert (result.shape, result.dtype) == (indirect.shape, np.float32)
    assert np.isfinite(result).all()
    assert result.min() >= 1.0
    assert (result - 1.0).mean() == pytest.approx(indirect.mean(), rel=0.05)
    for coverage in (0.0, 1.0):
        assert not denoised(traced_light(np.zeros(shape), coverage=coverage)).any()


@pytest.mark.parametrize("scale", [1e-30, 1e25])
def test_result_scales_with_the_light(scale):
    indirect = noisy((64, 48, 3), np.random.default_rng(7))
    result = denoised(traced_light(indirect * np.float32(scale))) / np.float32(scale)
    assert np.isfinite(result).all()
    assert result == pytest.approx(denoised(traced_light(indirect)), rel=1e-3)


def test_one_bright_pixel_in_the_dark_gives_finite_light():
    indirect = np.zeros((64, 64, 3))
    indirect[20, 30] = 1e13
    cover = np.zeros((64, 64))
    cover[10:40, 10:40] = 0.5
    result = denoised(traced_light(indirect, coverage=cover))
    assert np.isfinite(result).all()
    assert result.min() >= 0.0
    assert not result[cover == 0.0].any()


def test_one_channel_equals_three_equal_channels():
    indirect = np.random.default_rng(8).gamma(4.0, 0.25, (50, 60, 1))
    grey, colour = (denoised(traced_light(np.repeat(indirect, n, axis=-1))) for n in (1, 3))
    assert grey == pytest.approx(colour.mean(axis=-1, keepdims=True), rel=1e-4)


def test_keeps_the_mean_light_of_each_class(monkeypatch):
    # The same traced light with the filter and without, so that most noise cancels: over six frames the
    # mean of each class in view differs by less than 1 %, or less than four standard errors of that mean.
    lights = []
    monkeypatch.setattr(strips, "denoised", lambda light: (lights.append(light), denoised(light))[1])
    plants, view = Renderer(greenhouse()), camera()
    classes = plants.render(view, ["class"])["class"]
    for seed in range(6):
        plants.render(view, ["electrons"], "standard", seed)
    assert len(lights) == 6
    # The smallest classes are a few pixels wide, and the filter may mix their light with the surroundings.
    for name in np.flatnonzero(np.bincount(classes.ravel()) > 100):
        region = classes == name
        traced = np.array([light.total()[region].mean() for light in lights])
        filtered = np.array([denoised(light)[region].mean() for light in lights])
        change = (filtered - traced) / traced.mean()
        assert abs(change.mean()) < max(0.01, 4.0 * change.std(ddof=1) / np.sqrt(6.0)), name


# --- pyoidn without PyTorch ---------------------------------------------------------------------------------

DENOISE = (
    "import sys, numpy as np\n"
    "from pepperscene.render.transport.denoise import open_image_denoise\n"
    "grey = np.full((8, 8, 3), 0.5, np.float32)\n"
    "oidn = open_image_denoise()\n"
    "result = oidn.denoise(grey, grey, grey, hdr=True)\n"
    "assert result.shape == grey.shape and np.isfinite(result).all()\n"
)
needs_torch = pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="PyTorch is not installed")


def run(code):
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)


@needs_torch
def test_denoising_imports_no_torch_and_a_later_import_works_with_tensors():
    run(
        DENOISE + "assert 'torch' not in sys.modules and open_image_denoise() is oidn\n"
        "import torch\n"
        "same = torch.from_numpy(grey)\n"
        "tensor = oidn.denoise(same, same, same, hdr=True)\n"
        "assert np.array_equal(tensor.numpy(), result)\n"
        "oidn.utils.require_torch()\n"
    )


@pytest.mark.long
@needs_torch
def test_torch_that_was_imported_before_is_kept():
    run("import torch\nbefore = torch\n" + DENOISE + "import torch\nassert torch is before\n")


@pytest.mark.long
def test_missing_pyoidn_raises_and_leaves_modules_unchanged():
    run(
        "import sys\n"
        "from pepperscene.render.transport.denoise import open_image_denoise\n"
        "sys.modules['pyoidn'] = None\n"
        "try:\n    open_image_denoise()\n"
        "except ImportError:\n    pass\n"
        "else:\n    raise SystemExit('no error')\n"
        "assert 'torch' not in sys.modules\n"
    )


NEAR_M = 0.06
"""At this distance a pixel is about a millimetre wide, a tenth of the cells that bulge on the leaf."""


def _detail(image: np.ndarray) -> np.ndarray:
    """What is finer than the leaf as a whole, away from the border."""
    green = np.asarray(image[..., 1], float)
    return ((green - gaussian_filter(green, 6.0)) / green.mean())[8:-8, 8:-8].ravel()


@pytest.mark.long
def test_relief_in_soft_light_is_kept():
    """Against 4,096 samples without a filter: guides with the relief keep more of it than flat ones."""
    view = camera(flash=False)
    middle = view.pose[:3, 3] + NEAR_M * view.pose[:3, 2]
    across, up = view.pose[:3, 0], -view.pose[:3, 1]
    leaf = rectangle(tuple(middle), tuple(0.112 * across), tuple(0.135 * up), "leaf")
    # A bright part of the sky, 100 degrees wide, up and to the left of the camera.
    towards = directions(64, 128)
    source = -0.3 * view.pose[:3, 2] - 0.7 * view.pose[:3, 1] - 0.5 * view.pose[:3, 0]
    weights = 0.02 + (towards @ (source / np.linalg.norm(source)) > np.cos(np.radians(50.0)))
    sky = replace(
        uniform_sky(Spectrum(NM, np.ones(NM.size)), 5500.0), weights=weights[None].astype(np.float32)
    )
    plain = surfaces(NM)
    plain["leaf"] = replace(plain["leaf"], pattern=np.zeros_like(plain["leaf"].pattern))
    tracer = Tracer(assemble_scene(leaf, plain, sky), view)
    truth = _detail(tracer.light(4096, 4096).total())
    light = tracer.light(32, 32)
    kept = np.corrcoef(truth, _detail(denoised(light)))[0, 1]
    flat = np.broadcast_to(light.normal.mean((0, 1)), light.normal.shape).astype(np.float32)
    lost = np.corrcoef(truth, _detail(denoised(replace(light, normal=flat))))[0, 1]
    assert kept > 0.6
    assert kept > lost + 0.08


@pytest.mark.parametrize("by_flash", [False, True])
def test_light_that_is_gathered_knows_the_surfaces_of_pixels(monkeypatch, by_flash):
    lights = []
    monkeypatch.setattr(strips, "denoised", lambda light: (lights.append(light), denoised(light))[1])
    scene, view = greenhouse(), camera(flash=by_flash)
    frame = Renderer(scene).render(view, ("electrons", "class"), "draft", 2)
    (light,) = lights
    if by_flash:
        assert light.surface is None
        return
    # Leaves are those of the label images, but for pixels that contain an edge.
    is_leaf = np.isin(light.surface, 1 + np.flatnonzero(np.array(scene.mesh.surfaces) == "leaf"))
    assert 0.1 < is_leaf.mean() < 0.9
    assert np.mean(is_leaf == (frame["class"] == OrganClass.LEAF)) > 0.9
    assert light.surface.max() <= len(scene.mesh.surfaces)
