"""Organs to triangles: tubes, leaf blades, fruit; a plant as one mesh with class and instance per face."""

from pepperscene.geometry.mesh import Mesh, concatenate
from pepperscene.geometry.plant_mesh import mesh_plant
from pepperscene.geometry.single import rectangle, sphere
from pepperscene.geometry.twine import twine

__all__ = [
    "Mesh",
    "concatenate",
    "mesh_plant",
    "rectangle",
    "sphere",
    "twine",
]
