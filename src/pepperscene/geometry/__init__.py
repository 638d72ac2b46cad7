"""Organs to triangles: tubes, leaf blades, fruit; a plant as one mesh with class and instance per face."""

from pepperscene.geometry.bodies import one_instance, rectangle, sphere
from pepperscene.geometry.contacts.detect import Contacts, contacts
from pepperscene.geometry.contacts.joints import Motion, moved_plant
from pepperscene.geometry.contacts.resolve import Settled, settle
from pepperscene.geometry.export import check_format, mesh_files, organ_names, write_mesh
from pepperscene.geometry.mesh import Mesh, concatenate
from pepperscene.geometry.plant_mesh import mesh_plant
from pepperscene.geometry.tubes.stem import stem_branches, stem_profile
from pepperscene.geometry.tubes.twine import twine

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
