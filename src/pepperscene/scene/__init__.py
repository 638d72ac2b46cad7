"""Where things stand: plant rows in their greenhouse, sky and roof, as data that any renderer could read."""

from pepperscene.scene.cover import Cover, load_cover
from pepperscene.scene.culling import Reach, culled, reach
from pepperscene.scene.far_rows import coarse, far_rows
from pepperscene.scene.frustum import Sight, sight
from pepperscene.scene.greenhouse import Greenhouse, Posture, furniture, posture, uneven
from pepperscene.scene.placement import Scene, Skeleton, assemble, skeleton
from pepperscene.scene.row import DoubleRow, Twine, about_z, double_row, standing, with_twine
from pepperscene.scene.sky import Sky, Sun, partly_cloudy, uniform_sky

__all__ = [
    "Cover",
    "DoubleRow",
    "Greenhouse",
    "Posture",
    "Reach",
    "Scene",
    "Sight",
    "Skeleton",
    "Sky",
    "Sun",
    "Twine",
    "about_z",
    "assemble",
    "coarse",
    "culled",
    "double_row",
    "far_rows",
    "furniture",
    "load_cover",
    "partly_cloudy",
    "posture",
    "reach",
    "sight",
    "skeleton",
    "standing",
    "uneven",
    "uniform_sky",
    "with_twine",
]
