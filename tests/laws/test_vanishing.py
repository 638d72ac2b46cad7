"""White furnace test of the renderer: lossless bodies are invisible in uniform light."""

from itertools import product

import numpy as np
import pytest
from bodies import EVEN_SKY, RANGE_NM, axis_camera, card, sphere

from pepperscene.camera import relative_illumination
from pepperscene.geometry import concatenate_meshes
from pepperscene.materials import Surface
from pepperscene.render import Renderer
from pepperscene.scene import assemble_scene

PITCH_PX, SIDE_PX, COLUMNS = 20, 16, 5
DISTANCE_M = 0.4
PIXEL_M = DISTANCE_M * 9e-6 / 4.16e-3
ALPHAS = ((0.05, 0.05), (0.3, 0.3), (0.45, 0.9))
USUAL = product((1, -1), ((0.0, 1.5), (0.6, 1.3), (0.5, 1.0)), ALPHAS[::2])
EXTREME = product((0.0, 1.0), ((1.000001, 1e-9), (1.000001, 1.0), (2.5, 0.0), (2.5, 0.03), (2.5, 1.0)))
SHEETS = [(side, *kind, alphas) for side, kind, alphas in USUAL]
SHEETS += [(1, transmittance, ior, (alpha, alpha)) for transmittance, (ior, alpha) in EXTREME]
"""Side towards the camera, transmittance, refractive index and roughness of both sides."""


def white(name: str, transmittance: float, ior: float, roughness: tuple[float, float]) -> Surface:
    reflectance = np.full((1, 2, 2), 1.0 - transmittance)
    return Surface(name, RANGE_NM, reflectance, np.full((1, 2), transmittance), ior, roughness)


def assert_vanish(parts, surfaces, size, least_pixels):
    """Every body is as bright as the sky, in the mean and nearly in each pixel."""
    camera = axis_camera(*size, flash=False)
    scene = assemble_scene(concatenate_meshes(parts), {s.name: s for s in surfaces}, EVEN_SKY)
    image = Renderer(scene).render(camera, ["electrons", "instance"], "reference")
    light = image["electrons"] / relative_illumination(camera)[..., None]
    light /= light[image["instance"] == 0].mean(axis=0)
    for number, surface in enumerate(surfaces, 1):
        on_body = image["instance"] == number
        assert on_body.sum() >= least_pixels
        # Weights vary by 1: with 256 samples in 250 pixels, the standard error of a mean is below .15 %.
        assert light[on_body].mean(axis=0) == pytest.approx(np.ones(3), abs=0.006), surface
    assert np.abs(light - 1.0).max() < 0.25


def test_lossless_sheets_vanish_in_uniform_light():
    # All are in one plane, so that none lights another.
    parts, surfaces = [], []
    for number, (side, *kind) in enumerate(SHEETS):
        row, column = divmod(number, COLUMNS)
        place = PITCH_PX * PIXEL_M * (np.array([column, row]) - (COLUMNS - 1) / 2)
        sheet = card(0.0, 0.0, SIDE_PX * PIXEL_M, SIDE_PX * PIXEL_M, str(number), 0.0)
        parts.append(sheet.moved(np.diag([1.0, side, side]), np.array([*place, DISTANCE_M])))
        surfaces.append(white(str(number), *kind))
    assert_vanish(parts, surfaces, (COLUMNS * PITCH_PX, COLUMNS * PITCH_PX), 200)


def test_lossless_balls_vanish_in_uniform_light():
    # Opaque: light inside a translucent ball would be reflected endlessly.
    surfaces = [white(str(alphas), 0.0, 1.5, alphas) for alphas in ALPHAS]
    places = (-0.035, 0.0, 0.035)
    parts = [sphere((x, 0.0, 0.5), 0.012, s.name) for x, s in zip(places, surfaces, strict=True)]
    assert_vanish(parts, surfaces, (100, 28), 300)
