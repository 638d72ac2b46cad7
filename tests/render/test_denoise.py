"""The denoiser keeps energy, leaves alone what needs no filter, and takes any picture."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from greenhouse import camera, greenhouse

from pepperscene.render import Renderer
from pepperscene.render.transport.denoise import denoised


def picture(soft, *, flash=0.0, sky=0.0, covered=1.0, albedo=0.5):
    """Light of these parts: what a constant body, seen from the front, would send."""
    soft = np.asarray(soft, np.float32)
    h, w, c = soft.shape
    cover = np.broadcast_to(np.asarray(covered, np.float32), (h, w))

    def full(value, channels=c):
        return np.broadcast_to(np.asarray(value, np.float32), (h, w, channels)).copy()

    return SimpleNamespace(
        flash=full(flash),
        open_flash=full(flash),
        sky=full(sky),
        soft=soft,
        albedo=full(albedo) * cover[..., None],
        normal=full((0.0, 0.0, 1.0), 3) * cover[..., None],
        covered=np.repeat(cover[..., None], 2, axis=-1),
    )


def noisy(shape, rng, level=1.0, share=0.02):
    """Light of mean `level` of which a tenth comes by rare paths."""
    rare = rng.random(shape[:2]) < share
    return level * (0.9 * rng.gamma(2.0, 0.5, shape) + 0.1 / share * rare[..., None]).astype(np.float32)


# --- energy -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.02, 0.002])
def test_energy_of_rare_bright_paths_is_kept(share):
    # The filter alone takes such pixels for faults and loses most of the tenth that they carry.
    soft = noisy((192, 160, 3), np.random.default_rng(1), share=share)
    found = denoised(picture(soft))
    assert found.mean(axis=(0, 1)) == pytest.approx(soft.mean(axis=(0, 1)), rel=0.01)
    # And it does filter: what is left between neighbours is a small part of what there was.
    assert np.diff(found, axis=0).std() < 0.1 * np.diff(soft, axis=0).std()


def test_energy_is_kept_in_each_part_of_the_picture():
    rng = np.random.default_rng(2)
    soft = noisy((256, 384, 3), rng)
    soft[:, 192:] *= 0.1
    found = denoised(picture(soft))
    for part in (np.s_[:, :180], np.s_[:, 204:]):
        assert found[part].mean() == pytest.approx(soft[part].mean(), rel=0.03)


def test_flat_light_stays_flat():
    found = denoised(picture(np.full((90, 70, 3), 0.25)))
    assert found == pytest.approx(0.25, rel=0.01)
    assert found.mean() == pytest.approx(0.25, rel=1e-3)


def test_colours_stay_what_they_are():
    colour = np.array([0.2, 0.5, 0.05])
    soft = colour * np.random.default_rng(3).gamma(4.0, 0.25, (128, 128, 1))
    found = denoised(picture(soft)).mean(axis=(0, 1))
    assert found / found.sum() == pytest.approx(colour / colour.sum(), rel=0.01)


# --- what is sharp ------------------------------------------------------------------------------------------


def test_flash_and_sky_pass_to_the_last_bit():
    rng = np.random.default_rng(4)
    flash, sky = rng.random((2, 48, 64, 3)).astype(np.float32)
    assert np.array_equal(denoised(picture(np.zeros((48, 64, 3)), flash=flash, sky=sky)), flash + sky)
    soft = np.full((48, 64, 3), 0.1)
    with_flash = denoised(picture(soft, flash=flash, sky=sky))
    assert np.allclose(with_flash - denoised(picture(soft)), flash + sky, atol=1e-6)


def test_a_body_before_the_sky_is_as_bright_to_its_outline_as_inside():
    # A half plane whose outline runs through pixels: the soft light of each is that of the share covered.
    cover = np.clip(np.arange(96.0) - 40.3, 0.0, 1.0)[None].repeat(96, axis=0)
    rng = np.random.default_rng(5)
    soft = cover[..., None] * rng.gamma(8.0, 0.125, (96, 96, 3))
    found = denoised(picture(soft, covered=cover)).mean(axis=(0, 2))
    assert (found[:40] == 0.0).all()
    assert found[40:60] == pytest.approx(cover[0, 40:60], rel=0.05)


# --- any picture --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("shape", [(1, 1), (3, 2), (1, 40), (40, 1), (33, 65)])
def test_any_shape_goes_through(shape, channels):
    soft = np.random.default_rng(6).gamma(4.0, 0.25, (*shape, channels))
    found = denoised(picture(soft, flash=1.0))
    assert (found.shape, found.dtype) == (soft.shape, np.float32)
    assert np.isfinite(found).all()
    assert found.min() >= 1.0
    assert (found - 1.0).mean() == pytest.approx(soft.mean(), rel=0.05)


@pytest.mark.parametrize("shape", [(1, 1), (20, 30)])
def test_no_light_stays_no_light(shape):
    assert not denoised(picture(np.zeros((*shape, 3)))).any()
    assert not denoised(picture(np.zeros((*shape, 3)), covered=0.0)).any()


@pytest.mark.parametrize("scale", [1e-30, 1e-12, 1.0, 1e13, 1e25])
def test_the_unit_of_light_does_not_matter(scale):
    soft = noisy((64, 48, 3), np.random.default_rng(7))
    found = denoised(picture(soft * np.float32(scale))) / np.float32(scale)
    assert np.isfinite(found).all()
    assert found == pytest.approx(denoised(picture(soft)), rel=1e-3)


def test_one_bright_pixel_in_the_dark_gives_numbers():
    soft = np.zeros((64, 64, 3))
    soft[20, 30] = 1e13
    cover = np.zeros((64, 64))
    cover[10:40, 10:40] = 0.5
    found = denoised(picture(soft, covered=cover))
    assert np.isfinite(found).all()
    assert found.min() >= 0.0
    assert not found[cover == 0.0].any()


def test_a_grey_picture_is_that_of_three_equal_channels():
    soft = np.random.default_rng(8).gamma(4.0, 0.25, (50, 60, 1))
    grey, colour = denoised(picture(soft)), denoised(picture(np.repeat(soft, 3, axis=-1)))
    assert grey == pytest.approx(colour.mean(axis=-1, keepdims=True), rel=1e-4)


def test_nothing_that_is_given_is_changed():
    light = picture(noisy((40, 40, 3), np.random.default_rng(9)), covered=0.7)
    before = {name: value.copy() for name, value in vars(light).items()}
    denoised(light)
    assert all(np.array_equal(value, before[name]) for name, value in vars(light).items())


# --- on a scene ---------------------------------------------------------------------------------------------


def test_what_is_filtered_from_plants_is_noise_alone(monkeypatch):
    # The same traced light with the filter and without, so that most noise cancels: over twelve frames the
    # mean of each class in view differs by less than 1 %, or less than four standard errors of that mean.
    lights = []

    def watched(light):
        lights.append(light)
        return denoised(light)

    monkeypatch.setattr(sys.modules[Renderer.__module__], "denoised", watched)
    renderer, lens = Renderer(greenhouse()), camera()
    classes = renderer.render(lens, ["class"])["class"]
    for seed in range(12):
        renderer.render(lens, ["electrons"], "standard", seed)
    assert len(lights) == 12
    # The smallest classes are a few pixels wide, and the filter may share their light with what is beside.
    for name in np.flatnonzero(np.bincount(classes.ravel()) > 100):
        region = classes == name
        traced = np.array([light.total()[region].mean() for light in lights])
        filtered = np.array([denoised(light)[region].mean() for light in lights])
        change = (filtered - traced) / traced.mean()
        assert abs(change.mean()) < max(0.01, 4.0 * change.std(ddof=1) / np.sqrt(12.0)), name
