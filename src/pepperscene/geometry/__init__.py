"""Organs to triangles: tubes, leaf blades, fruit; a plant as one mesh with class and instance per face."""

from pepperscene.geometry.contact import Contacts, contacts
from pepperscene.geometry.export import check_format, mesh_files, organ_names, write_mesh
from pepperscene.geometry.mesh import Mesh, concatenate
from pepperscene.geometry.motion import Motion, moved_plant
from pepperscene.geometry.plant_mesh import mesh_plant
from pepperscene.geometry.settle import Settled, settle
from pepperscene.geometry.single import one_instance, rectangle, sphere
from pepperscene.geometry.stem import stem_branches, stem_profile
from pepperscene.geometry.twine import twine

__all__ = [
    "Contacts",
    "Mesh",
    "Motion",
    "Settled",
    "check_format",
    "concatenate",
    "contacts",
    "mesh_files",
    "mesh_plant",
    "moved_plant",
    "one_instance",
    "organ_names",
    "rectangle",
    "settle",
    "sphere",
    "stem_branches",
    "stem_profile",
    "twine",
    "write_mesh",
]
