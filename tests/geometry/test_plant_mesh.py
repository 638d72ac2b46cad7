from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from pepperscene.classes import OrganClass
from pepperscene.cultivar import load_cultivar
from pepperscene.cultivar.organs import FORMS, USUAL, OrganKind
from pepperscene.geometry import Mesh, concatenate_meshes, mesh_plant
from pepperscene.grammar import grow
from pepperscene.grammar.plant import Organ, Plant

UP = np.array([0.0, 0.0, 1.0])
KINDS = {**USUAL, "shoot": OrganKind("stalk", OrganClass.SHOOT, "stem")}


def straight(kind, base=(0.0, 0.0, 0.0), tip=(0.0, 0.1, 0.0), up=(0.0, 0.0, 1.0), parent=-1, **measures):
    curve = np.array([base, tip], dtype=float)
    return Organ(kind, parent, 0, curve, np.array(up, dtype=float), measures)


def leaf(length=0.135, width=0.08, **measures):
    flat = {"length_m": length, "width_m": width, "seed": 0.3} | measures
    return straight("blade", tip=(0.0, length, 0.0), **flat)


def bell(length=0.09, diameter=0.08, parent=-1, **measures):
    shape = {"length_m": length, "diameter_m": diameter, "seed": 0.6} | measures
    return straight("fruit", tip=(0.0, 0.0, -length), up=(1.0, 0.0, 0.0), parent=parent, **shape)


ONE_OF_EACH = (
    straight("internode", tip=(0, 0, 0.1), up=(0, -1, 0), radius_m=0.005, radius_tip_m=0.0045, groove_m=5e-4),
    straight("node", (0, 0, 0.1), (0, 0, 0.115), up=(0, -1, 0), parent=0, radius_m=8e-3, radius_end_m=4.5e-3),
    straight("shoot", (0, 0, 0.1), (0.03, 0, 0.13), parent=1, radius_m=0.003, radius_tip_m=0.0025),
    straight("stalk", (0, 0, 0.1), (0, -0.09, 0.13), parent=1, radius_m=0.002, radius_tip_m=0.0012),
    leaf(parent_is_ignored=0.0),
    straight("peduncle", (0, 0, 0.1), (-0.04, 0, 0.1), parent=1, radius_m=0.0035, radius_tip_m=0.0045),
    straight("calyx", (0, 0, 0.004), (0, 0, 0), up=(1, 0, 0), parent=5, radius_m=0.015, seed=0.2),
    bell(parent=6),
    straight("cut", (0, 0, 0.1), (0.012, 0, 0.1), parent=1, radius_m=0.004),
    straight("flower", (0, 0, 0.1), (0.004, 0, 0.1), parent=5, radius_m=0.012),
)
SOLIDS = tuple(organ for organ in ONE_OF_EACH if organ.kind not in ("blade", "flower"))


def mesh_of(*organs, detail=1.0) -> Mesh:
    return mesh_plant(Plant("hand-made", tuple(organs), KINDS), detail)


def body(mesh: Mesh) -> trimesh.Trimesh:
    """The triangles with coincident vertices merged, as a seam of uv needs none of its own in space."""
    points, number = np.unique(mesh.vertices, axis=0, return_inverse=True)
    return trimesh.Trimesh(points.astype(float), number.ravel()[mesh.faces], process=False)


def face_normals(mesh: Mesh) -> np.ndarray:
    a, b, c = (mesh.vertices[mesh.faces[:, corner]].astype(float) for corner in range(3))
    return np.cross(b - a, c - a)


def assert_sound(mesh: Mesh) -> None:
    """What must hold of any mesh, whatever it shows."""
    for array in (mesh.vertices, mesh.normals, mesh.uv, mesh.state):
        assert np.all(np.isfinite(array))
        assert array.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-5)
    assert mesh.uv.min() >= 0.0
    assert mesh.uv.max() <= 1.0
    assert mesh.state.min() >= 0.0
    assert mesh.state.max() <= 1.0
    assert mesh.faces.max() < len(mesh.vertices)
    assert np.unique(mesh.faces).size == len(mesh.vertices)
    assert np.all(np.linalg.norm(face_normals(mesh), axis=1) > 0.0)


@pytest.mark.parametrize("organ", SOLIDS, ids=lambda organ: organ.kind)
@pytest.mark.parametrize("detail", [0.3, 1.0, 1.7])
def test_solids_are_closed_and_face_outwards(organ, detail):
    mesh = mesh_of(replace(organ, parent=-1), detail=detail)
    solid = body(mesh)
    assert solid.is_watertight
    assert solid.is_winding_consistent
    assert solid.volume > 0.0
    assert_sound(mesh)


@pytest.mark.parametrize("organ", ONE_OF_EACH, ids=lambda organ: organ.kind)
def test_shading_normals_agree_with_the_winding(organ):
    mesh = mesh_of(replace(organ, parent=-1))
    flat = face_normals(mesh)
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    smooth = mesh.normals[mesh.faces].mean(axis=1)
    assert np.all(np.sum(flat * smooth, axis=1) > 0.25)


def test_instances_follow_the_plant_and_classes_follow_the_kinds():
    mesh = mesh_of(*ONE_OF_EACH)
    assert {KINDS[organ.kind].form for organ in ONE_OF_EACH} == set(FORMS)
    assert [item.kind for item in mesh.instances] == [organ.kind for organ in ONE_OF_EACH]
    assert [item.parent for item in mesh.instances] == [organ.parent for organ in ONE_OF_EACH]
    assert set(mesh.face_instance) == set(range(len(ONE_OF_EACH)))
    for number, organ in enumerate(ONE_OF_EACH):
        mine = mesh.face_instance == number
        assert set(mesh.face_class[mine]) == {KINDS[organ.kind].organ_class}
        assert {mesh.surfaces[i] for i in mesh.face_surface[mine]} == {KINDS[organ.kind].surface}


def test_organs_do_not_share_vertices():
    mesh = mesh_of(*ONE_OF_EACH)
    owner = np.full(len(mesh.vertices), -1)
    for number in range(len(mesh.instances)):
        used = np.unique(mesh.faces[mesh.face_instance == number])
        assert np.all(owner[used] == -1)
        owner[used] = number
    assert np.all(owner >= 0)


def test_an_organ_is_the_same_alone_and_in_company():
    # Organs of one kind are shaped together; that must not mix them up.
    together = mesh_of(leaf(seed=0.1), leaf(0.05, 0.03, seed=0.7), leaf(seed=0.4, fold_rad=0.5))
    alone = mesh_of(leaf(0.05, 0.03, seed=0.7))
    used = np.unique(together.faces[together.face_instance == 1])
    np.testing.assert_allclose(together.vertices[used], alone.vertices, atol=1e-7)
    np.testing.assert_allclose(together.state[used], alone.state, atol=1e-6)


def test_the_same_plant_gives_the_same_bytes():
    plant = grow(load_cultivar("kaite"), np.random.default_rng(3))
    first, second = mesh_plant(plant), mesh_plant(plant)
    for name in ("vertices", "normals", "uv", "state", "faces", "face_instance", "face_surface"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()


@pytest.mark.parametrize("detail", [0.4, 1.0])
def test_a_grown_plant_is_sound_and_its_solids_are_closed(detail):
    plant = grow(load_cultivar("kaite"), np.random.default_rng(1))
    mesh = mesh_plant(plant, detail)
    assert_sound(mesh)
    assert len(mesh.instances) == len(plant.organs)
    firm = np.array([item.organ_class != OrganClass.LEAF for item in mesh.instances])[mesh.face_instance]
    # Every edge of every solid belongs to two of its own faces, once in either direction.
    points, number = np.unique(mesh.vertices, axis=0, return_inverse=True)
    faces = number.ravel()[mesh.faces[firm]]
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    owner = np.tile(mesh.face_instance[firm], 3).astype(np.int64)
    there = (owner * len(points) + edges[:, 0]) * len(points) + edges[:, 1]
    back = (owner * len(points) + edges[:, 1]) * len(points) + edges[:, 0]
    assert np.array_equal(np.sort(there), np.sort(back))
    assert np.unique(there).size == there.size


def test_detail_keeps_the_shape_and_changes_the_count():
    counts, spans = [], []
    for detail in (0.6, 1.0, 2.0):
        mesh = mesh_of(*ONE_OF_EACH, detail=detail)
        counts.append(len(mesh.faces))
        spans.append(np.ptp(mesh.vertices, axis=0))
    assert counts[0] < counts[1] < counts[2]
    np.testing.assert_allclose(spans[0], spans[2], rtol=0.03)
    np.testing.assert_allclose(spans[1], spans[2], rtol=0.02)


def test_wrong_input_is_refused():
    with pytest.raises(ValueError, match="detail"):
        mesh_of(*ONE_OF_EACH, detail=0.0)
    with pytest.raises(ValueError, match="without organs"):
        mesh_of()
    with pytest.raises(ValueError, match="tendril"):
        mesh_of(straight("tendril"))
    with pytest.raises(ValueError, match="radius_m"):
        mesh_of(straight("stalk", radius_tip_m=0.001))
    with pytest.raises(ValueError, match="length_m"):
        mesh_of(leaf(length_m=0.0))
    with pytest.raises(ValueError, match="distinct"):
        mesh_of(straight("stalk", tip=(0, 0, 0), radius_m=0.001, radius_tip_m=0.001))


def test_concatenation_renumbers_faces_instances_and_surfaces():
    first, second = mesh_of(*ONE_OF_EACH), mesh_of(leaf(), bell())
    both = concatenate_meshes([first, second])
    assert len(both.faces) == len(first.faces) + len(second.faces)
    np.testing.assert_array_equal(both.faces[len(first.faces) :], second.faces + len(first.vertices))
    assert both.instances[len(first.instances)].kind == "blade"
    assert both.instances[4].parent == first.instances[4].parent
    tail = both.face_surface[len(first.faces) :]
    assert [both.surfaces[i] for i in tail] == [second.surfaces[i] for i in second.face_surface]
    assert_sound(both)


@settings(max_examples=25, deadline=None)
@given(
    length=st.floats(0.001, 0.3),
    aspect=st.floats(0.1, 1.5),
    fold=st.floats(-0.3, 1.5),
    curl=st.floats(-3.0, 3.0),
    twist=st.floats(-3.0, 3.0),
    wave=st.floats(0.0, 0.1),
    waves=st.floats(0.0, 12.0),
    blister=st.floats(0.0, 0.05),
    uneven=st.floats(-1.0, 1.0),
    seed=st.floats(0.0, 0.999),
    detail=st.floats(0.1, 2.0),
)
def test_any_leaf_is_sound(length, aspect, fold, curl, twist, wave, waves, blister, uneven, seed, detail):
    mesh = mesh_of(
        leaf(
            length, aspect * length, fold_rad=fold, curl_rad=curl, twist_rad=twist, margin_waves=waves,
            margin_wave_m=wave * length, blister_m=blister * length, asymmetry=uneven, seed=seed,
        ),
        detail=detail,
    )  # fmt: skip
    assert_sound(mesh)


@settings(max_examples=25, deadline=None)
@given(
    diameter=st.floats(0.001, 0.3),
    slimness=st.floats(0.4, 4.5),
    lobes=st.integers(1, 6),
    depth=st.floats(0.0, 9.0),
    shoulder=st.floats(0.0, 3.0),
    taper=st.floats(0.2, 1.2),
    point=st.floats(-0.5, 1.5),
    bend=st.floats(-2.0, 2.0),
    sepals=st.floats(0.1, 1.1),
    tooth=st.floats(0.0, 1.0),
    spread=st.floats(0.0, 4.0),
    seed=st.floats(0.0, 0.999),
    detail=st.floats(0.2, 1.5),
)
def test_any_fruit_and_calyx_are_sound_and_closed(
    diameter, slimness, lobes, depth, shoulder, taper, point, bend, sepals, tooth, spread, seed, detail
):
    # Long sepals may be longer than a young fruit is wide, a plate with points may not.
    reach = (sepals if tooth > 0.6 else min(sepals, 0.45)) * diameter
    plate = {"radius_m": reach, "tooth": tooth, "seed": seed}
    stub = np.array([[0.0, 0.0, 0.05 * diameter], [0.0, 0.0, 0.0]])
    calyx = replace(ONE_OF_EACH[6], parent=-1, curve=stub, measures=plate)
    fruit = bell(
        slimness * diameter, diameter, parent=0, lobes=lobes, lobe_depth=depth, shoulder=shoulder,
        taper=taper, point=point, bend_rad=bend, seed=seed, ripeness=0.5, ripeness_spread=spread,
    )  # fmt: skip
    mesh = mesh_of(calyx, fruit, detail=detail)
    assert_sound(mesh)
    solid = body(mesh)
    assert solid.is_watertight
    assert solid.is_winding_consistent
    assert len(np.unique(np.sort(solid.faces, axis=1), axis=0)) == len(solid.faces)
    for number in (0, 1):
        assert body(mesh.select_instances([number])).volume > 0.0
