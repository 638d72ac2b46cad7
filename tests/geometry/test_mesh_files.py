"""Mesh files as other readers see them: trimesh, and an OBJ parser of a dozen lines."""

import json
import struct
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from pepperscene.classes import CLASS_COLOURS, Instance, OrganClass
from pepperscene.cultivar import load_cultivar
from pepperscene.errors import ArgumentError, InputError
from pepperscene.geometry import concatenate_meshes, mesh_plant, rectangle, sphere
from pepperscene.geometry.export import FORMATS, mesh_files, write_mesh
from pepperscene.geometry.organ_parts import organ_names
from pepperscene.grammar import grow

LEAF_COLOURS = {"leaf": np.array([[0.2, 0.3, 0.1], [0.02, 0.05, 0.01]])}
NAMES = ("leaf_blade_0_node_3", "fruit_0_node_7", "fruit_1_node_9", "twine_0")


def small_plant():
    """A blade, two fruit of different surfaces that grow on it, and a band of twine."""
    blade = rectangle((0.0, 0.1, 0.5), (0.1, 0.0, 0.0), (0.0, 0.02, 0.15))
    fruit = sphere((0.02, 0.0, 0.4), 0.04, subdivisions=1)
    other = sphere((-0.1, -0.03, 0.9), 0.03, surface="calyx", subdivisions=0, organ_class=OrganClass.PEDUNCLE)
    band = rectangle((0.0, 0.0, 0.5), (0.01, 0.0, 0.0), (0.0, 0.0, 1.0), "twine", OrganClass.WIRE)
    instances = (
        Instance(OrganClass.LEAF, "leaf blade", phytomer=3),
        Instance(OrganClass.PEPPER, "fruit", phytomer=7, parent=0),
        Instance(OrganClass.PEDUNCLE, "fruit", phytomer=9, parent=1),
        Instance(OrganClass.WIRE, "twine"),
    )
    return replace(concatenate_meshes([blade, fruit, other, band]), instances=instances)


MESH = small_plant()


def parse_obj(text):
    """Points, and by group its material and the triangles' corners (point, uv, normal), from 0."""
    lists, groups, name = {"v": [], "vt": [], "vn": []}, {}, None
    for line in text.splitlines():
        word, *rest = line.split() or [""]
        if word in lists:
            lists[word].append([float(number) for number in rest])
        elif word == "g":
            (name,) = rest
            assert name not in groups
            groups[name] = (None, [])
        elif word == "usemtl":
            groups[name] = (rest[0], [])
        elif word == "f":
            groups[name][1].append([[int(index) - 1 for index in corner.split("/")] for corner in rest])
    return {key: np.array(value) for key, value in lists.items()}, groups


def test_names_are_unique_and_give_kind_and_node():
    assert organ_names(MESH) == NAMES
    names = organ_names(concatenate_meshes([MESH.with_plant(0), MESH.with_plant(1)]))
    assert len(set(names)) == len(names) == 8
    assert names[5] == "plant_1_fruit_0_node_7"


@pytest.mark.parametrize("suffix", FORMATS)
def test_trimesh_reads_the_same_triangles(tmp_path, suffix):
    path = tmp_path / f"plant{suffix}"
    assert write_mesh(MESH, path)[0] == path
    loaded = trimesh.load_scene(path)
    if suffix == ".glb":
        # glTF has y up; the aisle (-y) faces the viewer (+z).
        loaded.apply_transform([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    np.testing.assert_allclose(loaded.bounds, MESH.bounds, atol=1e-7)
    # Triangles in any order, matched by their centres: same centres, areas and front sides.
    both = [loaded.to_mesh().triangles, MESH.vertices[MESH.faces]]
    both = [one[np.lexsort(np.round(one.mean(axis=1), 6).T)] for one in both]
    np.testing.assert_allclose(*(one.mean(axis=1) for one in both), atol=1e-6)
    np.testing.assert_allclose(*map(trimesh.triangles.area, both), atol=1e-8)
    np.testing.assert_allclose(*(trimesh.triangles.normals(one)[0] for one in both), atol=1e-3)


def test_obj_has_a_group_for_each_organ():
    files = mesh_files(MESH, "my plant.obj")
    assert list(files) == ["my plant.obj", "my plant.mtl"]
    lists, groups = parse_obj(files["my plant.obj"].decode())
    assert tuple(groups) == NAMES
    materials = []
    for index, (material, faces) in enumerate(groups.values()):
        at, expected = np.array(faces), MESH.faces[MESH.face_instance == index]
        np.testing.assert_allclose(lists["v"][at[..., 0]], MESH.vertices[expected], atol=1e-7)
        np.testing.assert_allclose(lists["vt"][at[..., 1]], MESH.uv[expected], atol=1e-6)
        np.testing.assert_allclose(lists["vn"][at[..., 2]], MESH.normals[expected], atol=1e-6)
        materials.append(material)
    assert materials == ["leaf_leaf", "pepper_fruit", "peduncle_calyx", "wire_twine"]
    # The materials have the colours of their classes.
    library = files["my plant.mtl"].decode()
    for material, item in zip(materials, MESH.instances, strict=True):
        block = library.partition(f"newmtl {material}\n")[2].partition("newmtl")[0]
        colour = next(line.split()[1:] for line in block.splitlines() if line.startswith("Kd"))
        np.testing.assert_allclose(np.array(colour, float) * 255, CLASS_COLOURS[item.organ_class], atol=1e-4)


def test_ply_has_class_and_instance_of_each_face():
    stream = trimesh.util.wrap_as_stream(mesh_files(MESH, "a.ply")["a.ply"])
    loaded = trimesh.load_mesh(stream, file_type="ply", process=False)
    vertex, face = (loaded.metadata["_ply_raw"][name]["data"] for name in ("vertex", "face"))
    np.testing.assert_array_equal(face["class"], MESH.face_class)
    np.testing.assert_array_equal(face["instance"], MESH.face_instance)
    np.testing.assert_array_equal(loaded.faces, MESH.faces)
    np.testing.assert_array_equal(loaded.vertices.astype(np.float32), MESH.vertices)
    rgb = np.stack([vertex[name] for name in ("red", "green", "blue")], axis=-1)
    np.testing.assert_array_equal(rgb[MESH.faces[:, 1]], np.array(CLASS_COLOURS)[MESH.face_class])
    for name, expected in (("s", MESH.uv[:, 0]), ("t", MESH.uv[:, 1]), ("state", MESH.state)):
        np.testing.assert_array_equal(vertex[name], expected)


def glb_content(mesh=MESH, colours=LEAF_COLOURS):
    """The JSON part of a binary glTF file."""
    content = mesh_files(mesh, "a.glb", colours)["a.glb"]
    magic, version, length, size, kind = struct.unpack("<4sIII4s", content[:20])
    assert (magic, version, length, kind) == (b"glTF", 2, len(content), b"JSON")
    return json.loads(content[20 : 20 + size])


def test_glb_is_a_tree_of_organs_with_metadata():
    tree = glb_content()
    nodes = {node["name"]: node for node in tree["nodes"]}
    organs = {name: node["extras"] for name, node in nodes.items() if "extras" in node}
    assert {name: extras["instance"] for name, extras in organs.items()} == {
        name: index for index, name in enumerate(NAMES)
    }
    fruit = organs["fruit_0_node_7"]
    assert (fruit["class"], fruit["class_id"], fruit["kind"]) == ("pepper", 2, "fruit")
    assert (fruit["phytomer"], fruit["parent"], fruit["surface"]) == (7, 0, "fruit")


@pytest.mark.parametrize(
    ("left_out", "parents"),
    [([], ("plant", NAMES[0], NAMES[1], "plant")), ([1], ("plant", "", NAMES[0], "plant"))],
)
def test_each_organ_is_below_the_nearest_of_its_ancestors_that_has_triangles(left_out, parents):
    tree = glb_content(MESH.without_triangles(np.array(left_out, dtype=int)))
    found = {
        tree["nodes"][child]["name"]: node["name"]
        for node in tree["nodes"]
        for child in node.get("children", ())
    }
    assert tuple(found.get(name, "") for name in NAMES) == parents


def base_colours(materials):
    """Linear RGBA of the materials of a GLB by surface."""
    return {
        one["name"].rpartition("_")[0]: one["pbrMetallicRoughness"]["baseColorFactor"] for one in materials
    }


def test_glb_has_the_given_colours_or_those_of_the_class():
    materials = glb_content()["materials"]
    factors = base_colours(materials)
    # The state of a rectangle is 0.5: half-way between pale and dark.
    np.testing.assert_allclose(factors["leaf"], [0.11, 0.175, 0.055, 1.0], atol=1e-6)
    np.testing.assert_allclose(factors["twine"][:3], (254 / 255) ** 2.22, atol=2e-3)
    assert all(one["doubleSided"] for one in materials)
    assert all(one["pbrMetallicRoughness"]["metallicFactor"] == 0.0 for one in materials)


@pytest.mark.parametrize("name", ["plant", "plant.fbx", ".glb", "plant.glb.txt", "a/b.GL", ""])
def test_raises_on_unknown_suffix(name):
    with pytest.raises(InputError, match=r"must end in \.glb, \.obj, \.ply or \.stl"):
        mesh_files(MESH, name)


# --- natural colours ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def tomato():
    return mesh_plant(grow(load_cultivar("tomato"), np.random.default_rng(3)), 0.2)


@pytest.fixture(scope="module")
def natural(tomato):
    """A file of a mesh of two plants, one of them without some organs, and twine."""
    band = rectangle((0.0, 0.0, 0.5), (0.01, 0.0, 0.0), (0.0, 0.0, 1.0), "twine", OrganClass.WIRE)
    leaves = np.flatnonzero(tomato.instance_class == OrganClass.LEAF)
    part = tomato.moved(np.eye(3), np.ones(3)).with_plant(3).without_triangles(leaves[-1:])
    fruit = tomato.select_instances(np.flatnonzero(tomato.instance_class == OrganClass.PEPPER))
    content = mesh_files(concatenate_meshes([tomato, part, fruit, band]), "a.glb")["a.glb"]
    return trimesh.load_scene(trimesh.util.wrap_as_stream(content), file_type="glb")


def organ_colours(scene, surface):
    """`(n, 3)` mean sRGB codes at the vertices of each organ of a surface, and its state."""
    colours, states = [], []
    for name in scene.graph.nodes_geometry:
        extras = scene.graph.transforms.edge_data[(scene.graph.transforms.parents[name], name)]["metadata"]
        if extras["surface"] == surface:
            colours.append(scene.geometry[name].visual.to_color().vertex_colors[:, :3].mean(axis=0))
            states.append(extras["state"])
    return np.array(colours), np.array(states)


def test_grown_plants_have_their_natural_colours(natural):
    for surface in ("leaf", "stem"):
        found, _ = organ_colours(natural, surface)
        assert len(found)
        assert np.all(found.argmin(axis=1) == 2), "leaves are not blue, nor stems pink"
    found, state = organ_colours(natural, "fruit")
    ripest, greenest = found[state.argmax()], found[state.argmin()]
    assert ripest[0] > 1.5 * ripest[1], "ripe fruit is red"
    assert greenest[1] > greenest[0], "unripe fruit is green"
    assert organ_colours(natural, "twine")[0].min() > 140, "twine is white"


def test_class_colours_are_given_on_request(tomato):
    colours = base_colours(glb_content(tomato, "class")["materials"])
    expected = (np.array(CLASS_COLOURS[OrganClass.STEM]) / 255.0) ** 2.2
    np.testing.assert_allclose(colours["stem"][:3], expected, atol=0.02)
    with pytest.raises(ArgumentError, match='colours: must be "natural", "class" or a table'):
        mesh_files(tomato, "a.glb", "classes")
