"""Where things stand: plant rows, twine and sky, as pure data that any renderer could read."""

from pepperscene.scene.placed import Scene, assemble
from pepperscene.scene.row import Twine, double_row, with_twine
from pepperscene.scene.sky import Sky, Sun, partly_cloudy, uniform_sky

__all__ = [
    "Scene",
    "Sky",
    "Sun",
    "Twine",
    "assemble",
    "double_row",
    "partly_cloudy",
    "uniform_sky",
    "with_twine",
]
