"""Runs the command line in this process, with a stub renderer instead of Mitsuba."""

from __future__ import annotations

import numpy as np
import pytest
from typer.testing import CliRunner

from pepperscene.cli import app
from pepperscene.frame import OUTPUTS, Frame


class StubRenderer:
    """Renders black images of 4 x 4 pixels; checks that the scene is finite."""

    def __init__(self, scene):
        assert np.isfinite(scene.mesh.vertices).all()
        self.scene = scene

    def render(self, camera, outputs=(), quality="standard", seed=0, others=None):
        images = {
            name: np.zeros((4, 4, *output.channels[-1:]), output.dtype) if output.is_image else {}
            for name, output in OUTPUTS.items()
            if name in outputs
        }
        return Frame(images, {"camera": camera.metadata(), "instances": {}})


@pytest.fixture(scope="session")
def command():
    """Function that runs a command line and returns exit code, standard output and standard error."""
    from pepperscene.dataset.scenes import frame_renderer

    runner, patch = CliRunner(), pytest.MonkeyPatch()
    patch.setattr(frame_renderer, "mitsuba_renderer", StubRenderer)

    def run(*arguments):
        return runner.invoke(app, [str(argument) for argument in arguments])

    yield run
    patch.undo()
