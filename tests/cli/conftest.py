"""The command line in process, with a stand-in for Mitsuba."""

from __future__ import annotations

import numpy as np
import pytest
from typer.testing import CliRunner

from pepperscene.cli import app
from pepperscene.frame import OUTPUTS, Frame


class NoLight:
    """Renders nothing but black, empty images; the scene is examined, as a renderer would."""

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
    """Runs a command line; gives exit code, standard output and standard error."""
    from pepperscene.dataset.scenes import frame_renderer as stage

    runner, patch = CliRunner(), pytest.MonkeyPatch()
    patch.setattr(stage, "mitsuba_renderer", NoLight)

    def run(*arguments):
        return runner.invoke(app, [str(argument) for argument in arguments])

    yield run
    patch.undo()
