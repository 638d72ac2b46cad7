"""The progress bar of builds in Python, and the stages of a single frame."""

from __future__ import annotations

from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from pepperscene.building.execution.build import BuildProgress
from pepperscene.building.execution.job import BuildOptions
from pepperscene.building.execution.progress_bar import ProgressBar
from pepperscene.building.execution.single_frame import render_frame

pytestmark = pytest.mark.usefixtures("empty_scenes")


@pytest.fixture
def console():
    return Console(file=StringIO(), width=300, force_terminal=True, color_system=None)


def test_bar_appears_at_once_and_ends_with_an_error(console):
    def build(bar):
        with bar:
            assert bar._bar.live.is_started
            bar(BuildProgress(3, 1, 2, True, 0.25, 4.0, Path("a.png")))
            bar.notice("[red]brackets stay")
            raise RuntimeError("stop")

    bar = ProgressBar(console)
    with pytest.raises(RuntimeError, match="stop"):
        build(bar)
    assert not bar._bar.live.is_started
    text = console.file.getvalue()
    parts = ("growing plants", "frame 000003", "1/2", "4.0 s a frame", "4 s left", "a.png")
    for part in (*parts, "note: [red]brackets stay"):
        assert part in text, part


def test_stages_of_a_frame_are_reported(recipe, fake_renderer, tmp_path):
    stages = []
    render_frame(
        recipe, tmp_path / "frame", 2, options=BuildOptions(renderer=fake_renderer), on_stage=stages.append
    )
    assert stages == ["growing plants", "rendering frame 2", "writing files"]
