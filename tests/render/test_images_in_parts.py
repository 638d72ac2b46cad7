"""Stages that compute large images in parts give the same bits as in one part."""

from __future__ import annotations

import importlib

import numpy as np
import pytest
from greenhouse import camera, cloudy_sky, greenhouse

from pepperscene.render import Renderer
from pepperscene.scene import assemble_scene

OUTPUTS = ["colour", "electrons", "uv", "chlorophyll"]


@pytest.mark.slow
def test_images_do_not_depend_on_the_size_of_their_parts(monkeypatch):
    first = greenhouse()
    scene = assemble_scene(
        first.mesh, dict(zip(first.mesh.surfaces, first.surfaces, strict=True)), cloudy_sky(1)
    )

    def frame():
        return Renderer(scene).render(camera(columns=80, rows=60), OUTPUTS, "standard", 5)

    whole = frame()
    parts = {
        "aov.labels": "_UV_PIXELS",
        "transport.adaptive": "_ROWS_PIXELS",
        "transport.accumulate": "_LANES",
    }
    for module, constant in parts.items():
        monkeypatch.setattr(importlib.import_module(f"pepperscene.render.{module}"), constant, 7 * 80 + 3)
    divided = frame()
    for name in OUTPUTS:
        np.testing.assert_array_equal(divided[name], whole[name])
    assert divided.metadata["sampling"] == whole.metadata["sampling"]
