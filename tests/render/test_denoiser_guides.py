"""The denoiser keeps the shading of a leaf's relief by the sky, because its guides show the relief."""

from dataclasses import replace

import numpy as np
import pytest
from greenhouse import NM, camera, surfaces
from scipy.ndimage import gaussian_filter
from tracer import Tracer

from pepperscene.geometry import rectangle
from pepperscene.render.transport.denoise import denoised
from pepperscene.scene import assemble_scene, uniform_sky
from pepperscene.scene.cover import directions
from pepperscene.spectra import Spectrum

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
