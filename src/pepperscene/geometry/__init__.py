"""Meshes of plants: organs to triangles, contacts between organs resolved, mesh files."""

from pepperscene.geometry.contacts.detect import ContactCounts
from pepperscene.geometry.contacts.joints import JointRotation, move_plant
from pepperscene.geometry.contacts.resolve import ResolvedMesh, resolve_contacts
from pepperscene.geometry.export import check_mesh_format, mesh_files, write_mesh
from pepperscene.geometry.mesh import Mesh, concatenate_meshes, single_instance_mesh
from pepperscene.geometry.organ_parts import organ_names
from pepperscene.geometry.plant_mesh import mesh_plant
from pepperscene.geometry.primitives import rectangle, sphere
from pepperscene.geometry.tubes.stem import stem_branches, stem_profile
from pepperscene.geometry.tubes.twine import twine_mesh

__all__ = [
    "ContactCounts",
    "JointRotation",
    "Mesh",
    "ResolvedMesh",
    "check_mesh_format",
    "concatenate_meshes",
    "mesh_files",
    "mesh_plant",
    "move_plant",
    "organ_names",
    "rectangle",
    "resolve_contacts",
    "single_instance_mesh",
    "sphere",
    "stem_branches",
    "stem_profile",
    "twine_mesh",
    "write_mesh",
]
