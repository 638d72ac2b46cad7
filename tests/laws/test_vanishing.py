"""White furnace test of the renderer: lossless bodies are invisible in uniform light."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import bench_camera, sheet, sphere

from pepperscene.materials import Surface
from pepperscene.render import Renderer
from pepperscene.scene import assemble_scene, uniform_sky
from pepperscene.spectra import Spectrum

NM = np.array([300.0, 1100.0])
SKY = uniform_sky(Spectrum(NM, np.ones(2)), 5500.0)
BODIES = {
    "ball": sphere((0.0, 0.0, 0.5), 0.012, "white"),
    "sheet": sheet(0.02, 0.02, 0.4, "white"),
    "sheet from behind": sheet(0.02, 0.02, 0.4, "white").moved(np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, 0.8]),
}


def lossless(transmittance: float, ior: float, roughness: tuple[float, float]) -> Surface:
    reflectance = np.full((1, 2, 2), 1.0 - transmittance)
    return Surface("white", NM, reflectance, np.full((1, 2), transmittance), ior, roughness)


# Light inside a translucent ball would be reflected endlessly: the ball is opaque, sheets also transmit
# light.
CASES = [(body, 0.0, 1.5) for body in BODIES] + [
    (body, *kind) for body in BODIES if body != "ball" for kind in ((0.6, 1.3), (0.5, 1.0))
]


@pytest.mark.parametrize("roughness", [(0.05, 0.05), (0.3, 0.3), (0.45, 0.9)])
@pytest.mark.parametrize(("body", "transmittance", "ior"), CASES)
def test_lossless_body_vanishes_in_uniform_light(body, transmittance, ior, roughness):
    # 256 samples on each of some 600 pixels: the mean's standard error is below .1 % (weights vary by 1).
    # No body lights itself, so no light is lost where paths end.
    scene = assemble_scene(BODIES[body], {"white": lossless(transmittance, ior, roughness)}, SKY)
    camera = bench_camera(columns=32, rows=32, flash=False)
    image = Renderer(scene).render(camera, ["electrons", "class"], "reference")
    on_body = image["class"] > 0
    assert 200 < on_body.sum() < 800
    light = image["electrons"] / image["electrons"][~on_body].mean(axis=0)
    assert light[on_body].mean(axis=0) == pytest.approx(np.ones(3), abs=0.005)
    assert np.abs(light - 1.0).max() < 0.25
