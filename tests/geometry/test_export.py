"""What is written is what other readers find: trimesh, and an OBJ parser of a dozen lines."""

from __future__ import annotations

import json
import struct
from collections import Counter

import numpy as np
import pytest
import trimesh

from pepperscene.classes import CLASS_COLOURS, Instance, OrganClass
from pepperscene.errors import InputError
from pepperscene.geometry import concatenate_meshes, rectangle, sphere
from pepperscene.geometry.export import FORMATS, check_mesh_format, mesh_files, organ_names, write_mesh

LEAF_COLOURS = {"leaf": np.array([[0.2, 0.3, 0.1], [0.02, 0.05, 0.01]])}


def little_plant():
    """A blade, two fruit on it, and a band of twine; one of the fruit in a second surface."""
    blade = rectangle((0.0, 0.1, 0.5), (0.1, 0.0, 0.0), (0.0, 0.02, 0.15))
    fruit = sphere((0.02, 0.0, 0.4), 0.04, subdivisions=1)
    other = sphere((-0.1, -0.03, 0.9), 0.03, surface="calyx", subdivisions=0, organ_class=OrganClass.PEDUNCLE)
    band = rectangle((0.0, 0.0, 0.5), (0.01, 0.0, 0.0), (0.0, 0.0, 1.0), "twine", OrganClass.WIRE)
    mesh = concatenate_meshes([blade, fruit, other, band])
    instances = (
        Instance(OrganClass.LEAF, "leaf blade", phytomer=3),
        Instance(OrganClass.PEPPER, "fruit", phytomer=7, parent=0),
        Instance(OrganClass.PEDUNCLE, "fruit", phytomer=9, parent=1),
        Instance(OrganClass.WIRE, "twine"),
    )
    return type(mesh)(**{**vars(mesh), "instances": instances})


NAMES = ("leaf_blade_0_node_3", "fruit_0_node_7", "fruit_1_node_9", "twine_0")


def corners(mesh, instance=None):
    """`(f, 3, 3)` corners of the triangles, of one instance or of all by instance."""
    order = np.argsort(mesh.face_instance, kind="stable")
    chosen = order if instance is None else np.flatnonzero(mesh.face_instance == instance)
    return mesh.vertices[mesh.faces[chosen]]


def parsed_obj(text):
    """Points, and by group its material and the triangles' corners (point, uv, normal), from 0."""
    lists, groups, name = {"v": [], "vt": [], "vn": []}, {}, None
    for line in text.splitlines():
        word, *rest = line.split() or [""]
        if word in lists:
            lists[word].append([float(one) for one in rest])
        elif word == "g":
            (name,) = rest
            assert name not in groups
            groups[name] = (None, [])
        elif word == "usemtl":
            groups[name] = (rest[0], [])
        elif word == "f":
            groups[name][1].append([[int(one) - 1 for one in corner.split("/")] for corner in rest])
    return {key: np.array(value) for key, value in lists.items()}, groups


def test_names_are_unique_and_tell_organ_and_node():
    mesh = little_plant()
    assert organ_names(mesh) == NAMES
    two = concatenate_meshes([mesh.select_plant(0), mesh.select_plant(1)])
    names = organ_names(two)
    assert len(set(names)) == len(names) == 8
    assert names[5] == "plant_1_fruit_0_node_7"


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_reader_finds_the_same_triangles(tmp_path, suffix):
    mesh = little_plant()
    path = tmp_path / f"plant{suffix}"
    assert write_mesh(mesh, path)[0] == path
    read = trimesh.load_scene(path)
    if suffix == ".glb":
        # glTF has y up; the aisle (-y) lies towards the viewer (+z).
        read.apply_transform([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    np.testing.assert_allclose(read.bounds, [mesh.vertices.min(0), mesh.vertices.max(0)], atol=1e-7)
    found = read.to_mesh().triangles
    # Triangles in the reader's order, matched by their middles.
    key = [np.lexsort(np.round(one.mean(axis=1), 6).T) for one in (found, corners(mesh))]
    np.testing.assert_allclose(found[key[0]].mean(1), corners(mesh)[key[1]].mean(1), atol=1e-6)
    areas = [trimesh.triangles.area(one[rows]) for one, rows in zip((found, corners(mesh)), key, strict=True)]
    np.testing.assert_allclose(*areas, atol=1e-8)
    # The same side is out.
    turns = [
        trimesh.triangles.normals(one[rows])[0] for one, rows in zip((found, corners(mesh)), key, strict=True)
    ]
    np.testing.assert_allclose(*turns, atol=1e-3)


def test_obj_has_a_group_for_each_organ():
    mesh = little_plant()
    files = mesh_files(mesh, "my plant.obj")
    assert list(files) == ["my plant.obj", "my plant.mtl"]
    lists, groups = parsed_obj(files["my plant.obj"].decode())
    assert tuple(groups) == NAMES
    materials = []
    for index, (material, faces) in enumerate(groups.values()):
        at = np.array(faces)
        np.testing.assert_allclose(lists["v"][at[..., 0]], corners(mesh, index), atol=1e-7)
        own = mesh.faces[mesh.face_instance == index]
        np.testing.assert_allclose(lists["vt"][at[..., 1]], mesh.uv[own], atol=1e-6)
        np.testing.assert_allclose(lists["vn"][at[..., 2]], mesh.normals[own], atol=1e-6)
        materials.append(material)
    assert materials == ["leaf_leaf", "pepper_fruit", "peduncle_calyx", "wire_twine"]
    # The materials have their classes' colours.
    library = files["my plant.mtl"].decode()
    for material, one in zip(materials, mesh.instances, strict=True):
        block = library.partition(f"newmtl {material}\n")[2].partition("newmtl")[0]
        colour = next(line.split()[1:] for line in block.splitlines() if line.startswith("Kd"))
        np.testing.assert_allclose(np.array(colour, float) * 255, CLASS_COLOURS[one.organ_class], atol=1e-4)


def test_materials_of_one_class_stay_apart():
    mesh = concatenate_meshes(
        [
            sphere((0, 0, 0), 0.1, surface=name, organ_class=OrganClass.PEDUNCLE)
            for name in ("peduncle", "calyx")
        ]
    )
    _, groups = parsed_obj(mesh_files(mesh, "a.obj")["a.obj"].decode())
    assert [material for material, _ in groups.values()] == ["peduncle_peduncle", "peduncle_calyx"]


def test_ply_tells_class_and_instance_of_each_face():
    mesh = little_plant()
    stream = trimesh.util.wrap_as_stream(mesh_files(mesh, "a.ply")["a.ply"])
    read = trimesh.load_mesh(stream, file_type="ply", process=False)
    raw = read.metadata["_ply_raw"]
    np.testing.assert_array_equal(raw["face"]["data"]["class"], mesh.face_class)
    np.testing.assert_array_equal(raw["face"]["data"]["instance"], mesh.face_instance)
    np.testing.assert_array_equal(read.faces, mesh.faces)
    np.testing.assert_array_equal(read.vertices.astype(np.float32), mesh.vertices)
    found = np.stack([raw["vertex"]["data"][name] for name in ("red", "green", "blue")], axis=-1)
    np.testing.assert_array_equal(found[mesh.faces[:, 1]], np.array(CLASS_COLOURS)[mesh.face_class])
    for name, wanted in (("s", mesh.uv[:, 0]), ("t", mesh.uv[:, 1]), ("state", mesh.state)):
        np.testing.assert_array_equal(raw["vertex"]["data"][name], wanted)


def read_glb(content):
    """The JSON part of a binary glTF."""
    magic, version, length, size, kind = struct.unpack("<4sIII4s", content[:20])
    assert (magic, version, length, kind) == (b"glTF", 2, len(content), b"JSON")
    return json.loads(content[20 : 20 + size])


def test_glb_is_a_tree_of_organs_with_their_facts():
    mesh = little_plant()
    told = read_glb(mesh_files(mesh, "a.glb", LEAF_COLOURS)["a.glb"])
    nodes = {node["name"]: node for node in told["nodes"]}
    assert {name: node["extras"]["instance"] for name, node in nodes.items() if "extras" in node} == {
        name: index for index, name in enumerate(NAMES)
    }
    fruit = nodes["fruit_0_node_7"]["extras"]
    assert (fruit["class"], fruit["class_id"], fruit["kind"]) == ("pepper", 2, "fruit")
    assert (fruit["phytomer"], fruit["parent"], fruit["surface"]) == (7, 0, "fruit")
    # Each hangs below what it grows out of.
    parents = Counter()
    for node in told["nodes"]:
        for child in node.get("children", ()):
            parents[told["nodes"][child]["name"]] += 1
            below = told["nodes"][child].get("extras", {}).get("parent", -1)
            assert node["name"] == (NAMES[below] if below >= 0 else "plant") or below == -1
    assert all(parents[name] == 1 for name in NAMES)


def test_glb_has_the_colours_given_and_else_those_of_the_class():
    mesh = little_plant()
    told = read_glb(mesh_files(mesh, "a.glb", LEAF_COLOURS)["a.glb"])
    factors = {
        one["name"].rpartition("_")[0]: one["pbrMetallicRoughness"]["baseColorFactor"]
        for one in told["materials"]
    }
    # The state of a rectangle is .5: half-way between pale and dark.
    np.testing.assert_allclose(factors["leaf"], [0.11, 0.175, 0.055, 1.0], atol=1e-6)
    np.testing.assert_allclose(factors["twine"][:3], (254 / 255) ** 2.22, atol=2e-3)
    assert all(one["doubleSided"] for one in told["materials"])
    assert all(one["pbrMetallicRoughness"]["metallicFactor"] == 0.0 for one in told["materials"])


@pytest.mark.parametrize("suffix", FORMATS)
def test_the_same_mesh_gives_the_same_bytes(suffix):
    name = f"a{suffix}"
    assert mesh_files(little_plant(), name, LEAF_COLOURS) == mesh_files(little_plant(), name, LEAF_COLOURS)


@pytest.mark.parametrize("name", ["plant", "plant.fbx", ".glb", "plant.glb.txt", "a/b.GL", ""])
def test_an_unknown_ending_is_refused_in_a_sentence(name):
    with pytest.raises(InputError, match=r"must end in \.glb, \.obj, \.ply or \.stl"):
        mesh_files(little_plant(), name)


def test_the_ending_may_be_in_capitals():
    assert check_mesh_format("PLANT.GLB") == ".glb"
