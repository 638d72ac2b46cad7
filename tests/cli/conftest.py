"""Runs the command line in this process, with a stub renderer instead of Mitsuba."""

from __future__ import annotations

import numpy as np
import pytest
import typer
from PIL import Image
from stand_in import SceneStandIn
from typer.testing import CliRunner

from pepperscene.building.scenes import frame_renderer
from pepperscene.cli import app
from pepperscene.errors import EXIT_BAD_INPUT
from pepperscene.frame import Frame
from pepperscene.outputs import OUTPUTS


def empty_image(name, seed):
    """An image `(4, 4, ...)` without organs; colours are random, since `check` rejects equal photographs."""
    output = OUTPUTS[name]
    shape = (4, 4, *output.channels[-1:])
    if name == "colour":
        return np.random.default_rng(seed).integers(0, 256, shape, output.dtype)
    return np.full(shape, np.inf if name == "distance" else 0, output.dtype)


class StubRenderer(SceneStandIn):
    """Renders empty images of 4 x 4 pixels; checks that the scene is finite."""

    def __init__(self, scene):
        assert np.isfinite(scene.mesh.vertices).all()
        super().__init__(scene)

    def render(self, camera, outputs=(), quality="standard", seed=0, **_others):
        images = {name: empty_image(name, seed) if OUTPUTS[name].is_image else {} for name in outputs}
        metadata = camera.to_metadata() | {"width": 4, "height": 4}
        return Frame(images, {"camera": metadata, "instances": {}})


@pytest.fixture(scope="session")
def command():
    """Function that runs a command line and returns exit code, standard output and standard error."""
    runner = CliRunner()
    commands = typer.main.get_command(app)

    def run(*arguments):
        # Only during the command, so that other tests of the same process render for real.
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(frame_renderer, "mitsuba_renderer", StubRenderer)
            # The runner would read the signatures of all commands again, for longer than most tests take.
            patch.setattr("typer.testing._get_command", lambda _: commands)
            return runner.invoke(app, [str(argument) for argument in arguments])

    return run


@pytest.fixture(scope="session")
def rejects(command):
    """Function that runs an invalid command line and checks its error: one line with a message."""

    def check(message, *arguments):
        result = command(*arguments)
        assert result.exit_code == EXIT_BAD_INPUT, result.output
        assert result.stdout == ""
        assert result.stderr.startswith("error: ")
        assert result.stderr.count("\n") == 1
        assert message in result.stderr

    return check


@pytest.fixture(scope="module")
def data_set(command, tmp_path_factory):
    """Three frames of empty images."""
    folder = tmp_path_factory.mktemp("cli") / "set"
    changes = ("--set", "row={plants_front=1, plants_back=0}", "--set", "cultivar=kaite_february")
    outputs = ("--outputs", "colour,class,instance,distance")
    result = command("build", "demo", "--out", folder, "--frames", "6137:6140", *outputs, *changes)
    assert result.exit_code == 0, result.stderr
    return folder


def write_photographs(folder, value, green):
    """Write two photographs and their masks."""
    folder.mkdir(parents=True)
    for number in (1, 2):
        colour = np.full((24, 32, 3), (90, green, 20 * number), np.uint8)
        Image.fromarray(colour).save(folder / f"img{number}.png")
        mask = np.zeros((24, 32), np.uint8)
        mask[12 - 3 * number : 12 + 3 * number] = value
        Image.fromarray(mask).save(folder / f"mask{number}.png")
    return folder


@pytest.fixture(scope="session")
def without_table(tmp_path_factory):
    """Masks with the values of montoya2021, without a table of labels."""
    return write_photographs(tmp_path_factory.mktemp("photographs") / "plain", 1, 140)


@pytest.fixture(scope="session")
def with_table(tmp_path_factory):
    """Masks with a table of labels that gives the values another meaning."""
    folder = write_photographs(tmp_path_factory.mktemp("photographs") / "table", 5, 60)
    (folder / "classes.toml").write_text('0 = "background"\n5 = "pepper"\n', encoding="utf-8")
    return folder
