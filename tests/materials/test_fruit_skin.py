"""Ribs and warts of fruit, on the body of a long cucumber."""

from __future__ import annotations

import numpy as np
import pytest

from pepperscene.materials.rind_textures import (
    FRUIT_TEXTURES,
    SHAPE,
    FruitBody,
    FruitSkin,
    FruitTextures,
    add_skin,
)

SIZE_MM = (132.0, 320.0)
ZERO = FruitTextures(*np.zeros((3, FRUIT_TEXTURES, *SHAPE)))


def skin_of(**values):
    return add_skin(ZERO, SIZE_MM, FruitSkin(**values), np.random.default_rng(5))


def test_fruit_without_ribs_and_warts_is_left_as_it_is():
    assert skin_of() is ZERO
    assert skin_of(rib_height_mm=1.0) is ZERO


@pytest.mark.parametrize("ribs", [5, 10])
def test_ribs_have_the_stated_number_and_height(ribs):
    relief = skin_of(ribs=ribs, rib_height_mm=0.4).relief_mm
    middle = relief[:, SHAPE[0] // 2]
    waves = np.abs(np.fft.rfft(middle, axis=1))[:, 1:]
    assert np.all(1 + waves.argmax(axis=1) == ribs)
    assert np.ptp(middle, axis=1) == pytest.approx(0.4, rel=0.02)
    # They end in both ends of the fruit.
    assert np.ptp(relief[:, [0, -1]], axis=2).max() < 0.1 * 0.4


def test_crests_are_paler_at_the_blossom_end():
    pattern = skin_of(ribs=10, rib_height_mm=0.4).pattern
    assert pattern[:, : SHAPE[0] // 2].min() == pytest.approx(0.0, abs=1e-12)
    assert pattern[:, -4:].min() < -0.2
    assert pattern.max() <= 0.0


def test_warts_have_the_stated_number_size_and_height():
    """Sums over the skin: a wart of radius r and height h has a volume of pi r^2 h / 3."""
    per_cm2, height_mm, width_mm = 0.2, 0.5, 6.0
    relief = skin_of(warts_per_cm2=per_cm2, wart_height_mm=height_mm, wart_width_mm=width_mm).relief_mm
    body = FruitBody.of(*SIZE_MM)
    texel_mm2 = 2 * np.pi * body.radius_mm / SHAPE[1] * body.length_mm / SHAPE[0]
    area_mm2 = texel_mm2.sum() * SHAPE[1]
    volume = (relief * texel_mm2[:, None]).sum(axis=(1, 2)).mean()
    # The third moment of the relative size, uniform between 0.6 and 1.4.
    moment = (1.4**4 - 0.6**4) / (4 * 0.8)
    expected = per_cm2 * area_mm2 / 100 * moment * np.pi * (0.5 * width_mm) ** 2 * height_mm / 3
    assert volume == pytest.approx(expected, rel=0.1)
    assert 1.2 * height_mm < relief.max() <= 1.4 * height_mm
    assert relief.min() == 0.0


def test_textures_of_a_skin_differ():
    relief = skin_of(ribs=10, rib_height_mm=0.4, warts_per_cm2=0.3).relief_mm
    assert np.abs(np.corrcoef(relief.reshape(FRUIT_TEXTURES, -1)) - np.eye(FRUIT_TEXTURES)).max() < 0.9
