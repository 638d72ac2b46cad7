"""Materials: optical surfaces of organs and of the greenhouse."""

from pepperscene.materials.greenhouse import greenhouse_surfaces, twine_surface
from pepperscene.materials.leaf import leaf_body, leaf_optics
from pepperscene.materials.organs import organ_surfaces
from pepperscene.materials.rind import cut_surface, flesh_reflectance, rind_reflectance
from pepperscene.materials.stand import stand_surfaces
from pepperscene.materials.surface import Surface, lambertian_surface

__all__ = [
    "Surface",
    "cut_surface",
    "flesh_reflectance",
    "greenhouse_surfaces",
    "lambertian_surface",
    "leaf_body",
    "leaf_optics",
    "organ_surfaces",
    "rind_reflectance",
    "stand_surfaces",
    "twine_surface",
]
