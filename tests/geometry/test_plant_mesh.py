from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import example, given
from hypothesis import strategies as st
from organ_meshes import KINDS, check_mesh, check_solid, merged, mesh_organs, organ, shading_agreement

from pepperscene.classes import OrganClass
from pepperscene.cultivar import load_cultivar
from pepperscene.cultivar.organs import FORMS
from pepperscene.geometry import mesh_plant
from pepperscene.grammar import grow


def blade(length=0.135, width=0.08, **measures):
    flat = {"length_m": length, "width_m": width, "seed": 0.3} | measures
    return organ("blade", tip=(0.0, length, 0.0), **flat)


def fruit(length=0.09, diameter=0.08, parent=-1, **measures):
    shape = {"length_m": length, "diameter_m": diameter, "seed": 0.6} | measures
    return organ("fruit", tip=(0.0, 0.0, -length), up=(1.0, 0.0, 0.0), parent=parent, **shape)


TOP = (0, 0, 0.1)
ONE_OF_EACH = (
    organ("internode", tip=TOP, up=(0, -1, 0), radius_m=0.005, radius_tip_m=0.0045, groove_m=5e-4),
    organ("node", TOP, (0, 0, 0.115), up=(0, -1, 0), parent=0, radius_m=8e-3, radius_end_m=4.5e-3),
    organ("shoot", TOP, (0.03, 0, 0.13), parent=1, radius_m=0.003, radius_tip_m=0.0025),
    organ("stalk", TOP, (0, -0.09, 0.13), parent=1, radius_m=0.002, radius_tip_m=0.0012),
    blade(),
    organ("peduncle", TOP, (-0.04, 0, 0.1), parent=1, radius_m=0.0035, radius_tip_m=0.0045),
    organ("calyx", (0, 0, 0.004), (0, 0, 0), up=(1, 0, 0), parent=5, radius_m=0.015, seed=0.2),
    fruit(parent=6),
    organ("cut", TOP, (0.012, 0, 0.1), parent=1, radius_m=0.004),
    organ("flower", TOP, (0.004, 0, 0.1), parent=5, radius_m=0.012),
)


@pytest.mark.parametrize("one", ONE_OF_EACH, ids=lambda one: one.kind)
def test_shading_normals_agree_with_the_winding(one):
    assert shading_agreement(mesh_organs(replace(one, parent=-1))) > 0.25


def test_instances_follow_the_plant_and_classes_follow_the_kinds():
    mesh = mesh_organs(*ONE_OF_EACH)
    assert {KINDS[one.kind].form for one in ONE_OF_EACH} == set(FORMS)
    assert [item.kind for item in mesh.instances] == [one.kind for one in ONE_OF_EACH]
    assert [item.parent for item in mesh.instances] == [one.parent for one in ONE_OF_EACH]
    assert set(mesh.face_instance) == set(range(len(ONE_OF_EACH)))
    for number, one in enumerate(ONE_OF_EACH):
        faces = mesh.face_instance == number
        assert set(mesh.face_class[faces]) == {KINDS[one.kind].organ_class}
        assert {mesh.surfaces[i] for i in mesh.face_surface[faces]} == {KINDS[one.kind].surface}
    # Faces and vertices of each organ are contiguous, and organs share no vertices.
    assert mesh.face_runs.order is mesh.vertex_runs.order is None
    assert len(mesh.vertex_instance) == len(mesh.vertices)


def test_an_organ_is_the_same_alone_and_among_others():
    # Organs of one kind are built together.
    together = mesh_organs(blade(seed=0.1), blade(0.05, 0.03, seed=0.7), blade(seed=0.4, fold_rad=0.5))
    alone = mesh_organs(blade(0.05, 0.03, seed=0.7))
    used = together.vertex_runs.rows(1)
    np.testing.assert_allclose(together.vertices[used], alone.vertices, atol=1e-7)
    np.testing.assert_allclose(together.state[used], alone.state, atol=1e-6)


def test_mesh_of_a_grown_plant_is_sound_and_its_solids_are_closed():
    plant = grow(load_cultivar("kaite"), np.random.default_rng(1))
    mesh = mesh_plant(plant)
    check_mesh(mesh)
    assert len(mesh.instances) == len(plant.organs)
    solid = np.array([item.organ_class != OrganClass.LEAF for item in mesh.instances])[mesh.face_instance]
    # Every edge of every solid belongs to two of its faces, once in either direction.
    points, number = np.unique(mesh.vertices, axis=0, return_inverse=True)
    faces = number.ravel()[mesh.faces[solid]]
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    owner = np.tile(mesh.face_instance[solid], 3).astype(np.int64)
    forward = (owner * len(points) + edges[:, 0]) * len(points) + edges[:, 1]
    backward = (owner * len(points) + edges[:, 1]) * len(points) + edges[:, 0]
    assert np.array_equal(np.sort(forward), np.sort(backward))
    assert np.unique(forward).size == forward.size
    again = mesh_plant(plant)
    for name in ("vertices", "normals", "uv", "state", "faces", "face_instance", "face_surface"):
        assert getattr(mesh, name).tobytes() == getattr(again, name).tobytes()


@pytest.mark.parametrize(
    ("organs", "detail", "message"),
    [
        (ONE_OF_EACH, 0.0, "detail"),
        ((), 1.0, "without organs"),
        ((organ("tendril"),), 1.0, "tendril"),
        ((organ("stalk", radius_tip_m=0.001),), 1.0, "radius_m must be a finite number, not None"),
        ((blade(length_m=0.0),), 1.0, "length_m"),
        ((organ("stalk", tip=(0, 0, 0), radius_m=0.001, radius_tip_m=0.001),), 1.0, "distinct"),
    ],
)
def test_raises_on_wrong_input(organs, detail, message):
    with pytest.raises(ValueError, match=message):
        mesh_organs(*organs, detail=detail)


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
@example(  # The radius of a furrow decreases along the shoulder.
    diameter=0.25, slimness=2.875, lobes=3, depth=1.5, shoulder=0.0, taper=1.03125, point=0.0, bend=0.0,
    sepals=1.0, tooth=0.0, spread=0.0, seed=0.0, detail=1.5,
)  # fmt: skip
@example(  # A shoulder bends sharply under long sepals.
    diameter=0.25, slimness=2.0, lobes=1, depth=1.0, shoulder=0.0, taper=1.1875, point=0.0, bend=0.0,
    sepals=0.75, tooth=1.0, spread=0.0, seed=0.0, detail=1.0,
)  # fmt: skip
def test_any_fruit_and_calyx_are_sound_and_closed(
    diameter, slimness, lobes, depth, shoulder, taper, point, bend, sepals, tooth, spread, seed, detail
):
    # Long sepals may be longer than a young fruit is wide, a plate with points may not.
    radius = (sepals if tooth > 0.6 else min(sepals, 0.45)) * diameter
    calyx = organ(
        "calyx", (0, 0, 0.05 * diameter), (0, 0, 0), up=(1, 0, 0), radius_m=radius, tooth=tooth, seed=seed
    )
    pepper = fruit(
        slimness * diameter, diameter, parent=0, lobes=lobes, lobe_depth=depth, shoulder=shoulder,
        taper=taper, point=point, bend_rad=bend, seed=seed, ripeness=0.5, ripeness_spread=spread,
    )  # fmt: skip
    mesh = mesh_organs(calyx, pepper, detail=detail)
    check_solid(mesh)
    for number in (0, 1):
        assert merged(mesh, number).volume > 0.0


PIXEL_M = 0.9e-3
"""Width that a pixel of the standard camera covers at 40 cm."""


@pytest.fixture(scope="module")
def grown():
    """A plant and its meshes of detail 1 and 4."""
    plant = grow(load_cultivar("kaite"), np.random.default_rng(3))
    return plant, mesh_plant(plant), mesh_plant(plant, 4.0)


@pytest.mark.parametrize(
    "kind",
    ["lamina", "fruit", "node", *(pytest.param(k, marks=pytest.mark.long) for k in ("internode", "petiole"))],
)
def test_triangles_are_close_to_the_shapes_that_they_approximate(kind, grown):
    """Half of every surface is within a fifth of a pixel, and 95 % within a pixel.

    Organs have as few triangles as that allows, because triangles cost time from meshing to tracing.
    """
    plant, coarse, fine = grown
    numbers = [number for number, one in enumerate(plant.organs) if one.kind == kind]
    distances = []
    for number in numbers[:: max(1, len(numbers) // 4)]:
        surface, exact = (merged(mesh.select_instances([number])) for mesh in (coarse, fine))
        points, _ = trimesh.sample.sample_surface(exact, int(exact.area / 3e-3**2), seed=1)
        distances.append(trimesh.proximity.closest_point(surface, points)[1])
    assert np.median(np.concatenate(distances)) < PIXEL_M / 5.0
    assert np.quantile(np.concatenate(distances), 0.95) < PIXEL_M
