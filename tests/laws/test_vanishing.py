"""White furnace test of the renderer: lossless bodies are invisible in uniform light."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import EVEN_SKY, RANGE_NM, axis_camera, sheet, sphere

from pepperscene.materials import Surface
from pepperscene.render import Renderer
from pepperscene.scene import assemble_scene

BODIES = {
    "ball": sphere((0.0, 0.0, 0.5), 0.012, "white"),
    "sheet": sheet(0.02, 0.02, 0.4, "white"),
    "sheet from behind": sheet(0.02, 0.02, 0.4, "white").moved(np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, 0.8]),
}


# Light inside a translucent ball would be reflected endlessly: the ball is opaque, sheets also transmit.
CASES = [(body, 0.0, 1.5) for body in BODIES]
CASES += [(body, *kind) for body in BODIES if body != "ball" for kind in ((0.6, 1.3), (0.5, 1.0))]
USUAL = [(*case, alphas) for case in CASES for alphas in ((0.05, 0.05), (0.3, 0.3), (0.45, 0.9))]
EXTREME = [
    ("sheet", transmittance, ior, (alpha, alpha))
    for transmittance in (0.0, 0.5, 1.0)
    for ior in (1.000001, 2.5)
    for alpha in (0.0, 1e-9, 0.03, 1.0)
]


@pytest.mark.parametrize(("body", "transmittance", "ior", "roughness"), USUAL + EXTREME)
def test_lossless_body_vanishes_in_uniform_light(body, transmittance, ior, roughness):
    # 256 samples on each of some 600 pixels: the mean's standard error is below .1 % (weights vary by 1).
    # No body lights itself, so no light is lost where paths end.
    reflectance = np.full((1, 2, 2), 1.0 - transmittance)
    white = Surface("white", RANGE_NM, reflectance, np.full((1, 2), transmittance), ior, roughness)
    scene = assemble_scene(BODIES[body], {"white": white}, EVEN_SKY)
    image = Renderer(scene).render(axis_camera(32, 32, flash=False), ["electrons", "class"], "reference")
    on_body = image["class"] > 0
    assert 200 < on_body.sum() < 800
    light = image["electrons"] / image["electrons"][~on_body].mean(axis=0)
    assert light[on_body].mean(axis=0) == pytest.approx(np.ones(3), abs=0.005)
    assert np.abs(light - 1.0).max() < 0.25
