"""Plants as grown and with their contacts resolved, and a node with a leaf above a fruit."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from pepperscene.classes import Instance, OrganClass
from pepperscene.cultivar import load_cultivar
from pepperscene.geometry import (
    ContactCounts,
    Mesh,
    ResolvedMesh,
    concatenate_meshes,
    mesh_plant,
    rectangle,
    resolve_contacts,
    sphere,
)
from pepperscene.geometry.contacts.detect import ContactDetector
from pepperscene.grammar import Plant, grow

RADIUS = 0.04


@cache
def grown(name: str = "kaite", seed: int = 3) -> tuple[Plant, Mesh]:
    plant = grow(load_cultivar(name), np.random.default_rng(seed))
    return plant, mesh_plant(plant)


@cache
def resolved(name: str = "kaite", seed: int = 3) -> ResolvedMesh:
    return resolve_contacts(grown(name, seed)[1], np.random.default_rng(seed))


def count_contacts(mesh: Mesh) -> ContactCounts:
    return ContactDetector(mesh).counts()


def shifted(mesh: Mesh, x: float = 0.0, z: float = 0.0) -> Mesh:
    return mesh.moved(np.eye(3), np.array([x, 0.0, z]))


def scene(*parts: tuple[Mesh, OrganClass, str, int]) -> Mesh:
    """Bodies as organs: mesh, class, kind and parent of each."""
    mesh = concatenate_meshes([part for part, *_ in parts])
    instances = [Instance(kind, name, plant=0, parent=parent) for _, kind, name, parent in parts]
    return replace(mesh, instances=tuple(instances))


def leafy_node(leaf_height: float, fruit_height: float = 0.95) -> Mesh:
    """A node, a fruit on a stalk next to it, and a horizontal leaf on a stalk at some height."""
    stalk = sphere([0.03, 0.0, fruit_height + 0.05], 0.004)
    return scene(
        (sphere([0.0, 0.0, 1.0], 0.008), OrganClass.STEM, "node", -1),
        (stalk, OrganClass.PEDUNCLE, "peduncle", 0),
        (sphere([0.06, 0.0, fruit_height], RADIUS, subdivisions=4), OrganClass.PEPPER, "fruit", 1),
        (sphere([0.0, 0.01, leaf_height], 0.003), OrganClass.SHOOT, "petiole", 0),
        (rectangle([0.06, 0.03, leaf_height], [0.1, 0, 0], [0, 0.06, 0]), OrganClass.LEAF, "lamina", 3),
    )
