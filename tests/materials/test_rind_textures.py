"""Textures of fruit on their body of revolution, against the meshes that show them; ribs and warts."""

import numpy as np
import pytest

from pepperscene.cultivar.organs import DEFAULT_KINDS
from pepperscene.geometry import mesh_plant
from pepperscene.grammar import Organ, Plant
from pepperscene.materials import rind_textures as rt

GIRTH_MM, HEIGHT_MM, CALYX_MM = 264.0, 87.0, 18.5


@pytest.fixture(scope="module")
def body():
    return rt.FruitBody.of(GIRTH_MM, HEIGHT_MM)


@pytest.fixture(scope="module")
def textures():
    return rt.fruit_textures((GIRTH_MM, HEIGHT_MM), CALYX_MM, np.random.default_rng(4))


def test_uncorrelated_fields_are_standardised():
    rng = np.random.default_rng(1)
    shared = rng.standard_normal((1, 40, 50))
    fields = rt.uncorrelated(shared + rng.standard_normal((5, 40, 50)) + 3.0)
    assert fields.mean(axis=(1, 2)) == pytest.approx(0, abs=1e-12)
    assert np.corrcoef(fields.reshape(5, -1)) == pytest.approx(np.eye(5), abs=1e-12)
    assert fields.std(axis=(1, 2)) == pytest.approx(1)


def test_body_has_the_stated_girth_and_height(body):
    assert body.radius_mm.max() == pytest.approx(GIRTH_MM / (2 * np.pi), rel=1e-3)
    assert np.ptp(body.points_mm[..., 2]) == pytest.approx(HEIGHT_MM, rel=0.01)
    assert np.hypot(body.points_mm[..., 0], body.points_mm[..., 1]) == pytest.approx(
        np.repeat(body.radius_mm[:, None], rt.SHAPE[1], axis=1)
    )


def test_a_sphere_is_a_body_of_exponent_two(monkeypatch):
    monkeypatch.setattr(rt, "BODY_EXPONENT", 2.0)
    sphere = rt.FruitBody.of(2 * np.pi * 30.0, 60.0)
    assert sphere.length_mm == pytest.approx(np.pi * 30.0, rel=1e-4)
    assert np.linalg.norm(sphere.points_mm, axis=-1) == pytest.approx(30.0, rel=1e-4)


def test_a_place_on_the_body_is_near_that_on_a_mesh(body):
    """Where a fruit is as wide as its calyx, v of the mesh and of the texture agree within 5 mm."""
    measures = {
        "length_m": 1e-3 * HEIGHT_MM, "diameter_m": 1e-3 * GIRTH_MM / np.pi, "lobes": 4.0, "lobe_depth": 0.9,
        "shoulder": 0.55, "taper": 0.83, "seed": 0.3,
    }  # fmt: skip
    curve = np.array([[0, 0, 0], [0, 0, -0.04], [0, 0, -0.087]], dtype=float)
    fruit = Organ("fruit", -1, 3, curve, np.array([1.0, 0, 0]), measures)
    mesh = mesh_plant(Plant("kaite", (fruit,), DEFAULT_KINDS))
    v, distance = mesh.uv[:, 1], 1e3 * np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 1])
    levels = np.unique(v)
    width = np.array([distance[v == level].mean() for level in levels])
    upper, lower = levels < 0.4, levels > 0.8
    for part, end, rows in ((upper, CALYX_MM, slice(0, 100)), (lower, 6.0, slice(200, 256))):
        order = np.argsort(width[part])
        on_mesh = np.interp(end, width[part][order], levels[part][order])
        order = np.argsort(body.radius_mm[rows])
        on_body = np.interp(end, body.radius_mm[rows][order], (body.wall_mm / body.length_mm)[rows][order])
        assert abs(on_mesh - on_body) * body.length_mm < 5.0


def test_skin_is_wavy_by_20_to_50_micrometres_at_3_to_8_mm(textures, body):
    relief = textures.relief_mm
    # From troughs to crests, without the lowest and the highest twentieth.
    low, high = np.percentile(relief, [5, 95], axis=(1, 2))
    assert np.all((high - low > 0.02) & (high - low < 0.05))
    # A wave of height h and wavelength w has the root mean square slope 2 pi h / w.
    middle = slice(100, 156)
    down = np.gradient(relief, axis=1)[:, middle] * rt.SHAPE[0] / body.length_mm
    around_mm = 2 * np.pi * body.radius_mm[middle, None] / rt.SHAPE[1]
    around = np.gradient(relief, axis=2)[:, middle] / around_mm
    wavelength = 2 * np.pi * relief[:, middle].std() / np.array([down.std(), around.std()])
    # Along one line a wave in any direction is longer, by the square root of 3 on average.
    assert np.all((wavelength / np.sqrt(3) > 3.0) & (wavelength / np.sqrt(3) < 8.0))
    # The gloss does not break up: its normals turn by a degree or two.
    assert 0.5 < np.degrees(np.arctan(np.hypot(down, around))).mean() < 3


def test_russet_is_around_the_calyx_and_the_scar_at_the_blossom_end(textures, body):
    rim = np.interp(CALYX_MM, body.radius_mm[:100], body.wall_mm[:100])
    beyond, to_end = body.wall_mm - rim, body.length_mm - body.wall_mm
    near = textures.cover[:, (beyond > 0.2) & (beyond < 1.0)]
    assert 0.1 < near.mean() < 0.35
    # A net: lines with bare skin between them.
    assert np.mean(near > 0.3) > 0.1
    assert np.mean(near < 0.05) > 0.2
    between = textures.cover[:, (beyond > 1.3 * rt.RUSSET_MM[1]) & (to_end > 4 * rt.STYLE_SCAR_MM)]
    assert between.mean() < 2 * rt.DUST
    # The median of a lognormal field of this mean.
    assert np.median(between) == pytest.approx(rt.DUST * np.exp(-0.5 * 0.7**2), rel=0.1)
    assert textures.cover[:, -1].min() > 0.5
    assert textures.cover.max() <= 0.95


def test_noise_has_no_seam_and_the_same_grain_at_the_ends(body):
    noise = body.noise(np.random.default_rng(2), (4.0, 8.0))
    step = np.abs(np.diff(noise, axis=2))
    assert np.abs(noise[..., 0] - noise[..., -1]).mean() < 1.2 * step.mean()
    # Texels near the stalk are narrower, so neighbours differ in proportion less.
    rows = [20, 128]
    per_mm = step[:, rows].mean(axis=(0, 2)) / (2 * np.pi * body.radius_mm[rows] / rt.SHAPE[1])
    assert per_mm[0] == pytest.approx(per_mm[1], rel=0.2)


CUCUMBER_MM = (132.0, 320.0)
ZERO = rt.FruitTextures(*np.zeros((3, rt.FRUIT_TEXTURES, *rt.SHAPE)))


def skin_of(**values):
    return rt.add_skin(ZERO, CUCUMBER_MM, rt.FruitSkin(**values), np.random.default_rng(5))


def test_ribs_have_the_stated_number_and_height_and_pale_crests_at_the_blossom_end():
    assert skin_of() is skin_of(rib_height_mm=1.0) is ZERO
    ribs, skin = 10, skin_of(ribs=10, rib_height_mm=0.4)
    relief, pattern = skin.relief_mm, skin.pattern
    middle = relief[:, rt.SHAPE[0] // 2]
    waves = np.abs(np.fft.rfft(middle, axis=1))[:, 1:]
    assert np.all(1 + waves.argmax(axis=1) == ribs)
    assert np.ptp(middle, axis=1) == pytest.approx(0.4, rel=0.02)
    # They end in both ends of the fruit.
    assert np.ptp(relief[:, [0, -1]], axis=2).max() < 0.1 * 0.4
    assert pattern[:, : rt.SHAPE[0] // 2].min() == pytest.approx(0.0, abs=1e-12)
    assert pattern[:, -4:].min() < -0.2
    assert pattern.max() <= 0.0
    # Textures differ.
    rows = skin_of(ribs=10, rib_height_mm=0.4, warts_per_cm2=0.3).relief_mm.reshape(rt.FRUIT_TEXTURES, -1)
    assert np.abs(np.corrcoef(rows) - np.eye(rt.FRUIT_TEXTURES)).max() < 0.9


def test_warts_have_the_stated_number_size_and_height():
    """Sums over the skin: a wart of radius r and height h has a volume of pi r^2 h / 3."""
    per_cm2, height_mm, width_mm = 0.2, 0.5, 6.0
    relief = skin_of(warts_per_cm2=per_cm2, wart_height_mm=height_mm, wart_width_mm=width_mm).relief_mm
    body = rt.FruitBody.of(*CUCUMBER_MM)
    texel_mm2 = 2 * np.pi * body.radius_mm / rt.SHAPE[1] * body.length_mm / rt.SHAPE[0]
    area_mm2 = texel_mm2.sum() * rt.SHAPE[1]
    volume = (relief * texel_mm2[:, None]).sum(axis=(1, 2)).mean()
    # The third moment of the relative size, uniform between 0.6 and 1.4.
    moment = (1.4**4 - 0.6**4) / (4 * 0.8)
    expected = per_cm2 * area_mm2 / 100 * moment * np.pi * (0.5 * width_mm) ** 2 * height_mm / 3
    assert volume == pytest.approx(expected, rel=0.1)
    assert 1.2 * height_mm < relief.max() <= 1.4 * height_mm
    assert relief.min() == 0.0
