"""Where things stand: plant rows, twine, sky and roof, as pure data that any renderer could read."""

from pepperscene.scene.cover import Cover, load_cover
from pepperscene.scene.placed import Scene, assemble
from pepperscene.scene.row import Twine, double_row, with_twine
from pepperscene.scene.sky import Sky, Sun, partly_cloudy, uniform_sky

__all__ = [
    "Cover",
    "Scene",
    "Sky",
    "Sun",
    "Twine",
    "assemble",
    "double_row",
    "load_cover",
    "partly_cloudy",
    "uniform_sky",
    "with_twine",
]
