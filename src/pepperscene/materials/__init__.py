"""Materials: what the surfaces of organs and of the greenhouse do to light."""

from pepperscene.materials.greenhouse import (
    floor_film_surface,
    greenhouse_surfaces,
    gutter_surface,
    twine_surface,
)
from pepperscene.materials.organs import leaf_body, leaf_surface, organ_surfaces
from pepperscene.materials.rind import (
    cut_surface,
    flesh_reflectance,
    fruit_surface,
    green_surface,
    rind_reflectance,
)
from pepperscene.materials.surface import Surface, lambertian_surface

__all__ = [
    "Surface",
    "cut_surface",
    "flesh_reflectance",
    "floor_film_surface",
    "fruit_surface",
    "green_surface",
    "greenhouse_surfaces",
    "gutter_surface",
    "lambertian_surface",
    "leaf_body",
    "leaf_surface",
    "organ_surfaces",
    "rind_reflectance",
    "twine_surface",
]
