"""Materials: optical surfaces of organs and of the greenhouse."""

from pepperscene.materials.greenhouse import greenhouse_surfaces, twine_surface
from pepperscene.materials.leaf import leaf_body, leaf_optics
from pepperscene.materials.measured import curve_notes
from pepperscene.materials.organs import organ_surfaces
from pepperscene.materials.rind import cut_surface, flesh_reflectance, rind_reflectance
from pepperscene.materials.skin import Skin, load_skin
from pepperscene.materials.stand import stand_surfaces
from pepperscene.materials.surface import Surface, lambertian_surface

__all__ = [
    "Skin",
    "Surface",
    "curve_notes",
    "cut_surface",
    "flesh_reflectance",
    "greenhouse_surfaces",
    "lambertian_surface",
    "leaf_body",
    "leaf_optics",
    "load_skin",
    "organ_surfaces",
    "rind_reflectance",
    "stand_surfaces",
    "twine_surface",
]
