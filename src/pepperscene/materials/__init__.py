"""Materials: what the surfaces of organs and of the twine do to light."""

from pepperscene.materials.organs import (
    cut_surface,
    fruit_surface,
    green_surface,
    leaf_surface,
    organ_surfaces,
    twine_surface,
)
from pepperscene.materials.surface import Surface, lambertian

__all__ = [
    "Surface",
    "cut_surface",
    "fruit_surface",
    "green_surface",
    "lambertian",
    "leaf_surface",
    "organ_surfaces",
    "twine_surface",
]
