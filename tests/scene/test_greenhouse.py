"""Greenhouse parts are closed bodies at the given positions; plants deviate by the given distributions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from pepperscene.classes import OrganClass
from pepperscene.scene import DoubleRow, Greenhouse, draw_posture, greenhouse_mesh, jittered_positions
from pepperscene.scene.greenhouse import beam, box, rod, row_lines

HEXAGON = [(np.cos(a), 2 * np.sin(a)) for a in np.arange(6) * np.pi / 3]
ROW = DoubleRow(plants_front=7, plants_back=6, spacing_m=0.2, gap_m=0.3, shift_m=0.1)
FULL = Greenhouse(
    row_lean_rad=np.radians(4.0),
    gutter_width_m=0.22,
    gutter_height_m=0.4,
    floor=True,
    crop_wire_m=4.2,
    far_rows=1,
    far_reach_m=3.0,
    aisle_m=1.3,
    pipes=True,
)
IRREGULAR = Greenhouse(
    row_lean_rad=np.radians(4.0),
    lean_sd_rad=np.radians(1.5),
    turn_sd_rad=np.radians(20.0),
    spacing_sd_m=0.015,
    across_sd_m=0.01,
)


def merged(mesh):
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=True, merge_norm=True, merge_tex=True)


def meshes_by_kind(greenhouse, row=ROW):
    meshes = {}
    for mesh in greenhouse_mesh(row, greenhouse, row.positions()):
        assert len(mesh.instances) == 1
        meshes.setdefault(mesh.instances[0].kind, []).append(mesh)
    return meshes


@pytest.fixture(scope="module")
def full():
    return meshes_by_kind(FULL)


@pytest.mark.parametrize(
    ("mesh", "volume"),
    [
        (box((-1.0, 2.0), (0.5, 1.0), (3.0, 7.0), "gutter"), 6.0),
        (beam(HEXAGON, (-1.0, 1.0), "gutter"), 2 * 2 * 1.5 * 3**0.5),
        # A regular polygon of 12 sides.
        (rod(1.0, 2.0, 0.5, (0.0, 3.0), "steel"), 3 * 0.25 * 6 * np.sin(np.pi / 6)),
    ],
)
def test_beam_is_a_closed_prism(mesh, volume):
    body = merged(mesh)
    assert body.is_watertight
    assert body.is_winding_consistent
    assert body.volume == pytest.approx(volume, rel=1e-6)
    assert (body.area_faces > 0).all()
    assert mesh.uv.min() >= 0
    assert mesh.uv.max() <= 1
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-6)


def test_box_sides_are_flat_and_rod_sides_are_round():
    flat = box((-1.0, 1.0), (-1.0, 1.0), (0.0, 1.0), "gutter")
    corners = flat.vertices[flat.faces].astype(float)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    np.testing.assert_allclose(flat.normals[flat.faces], np.repeat(normal[:, None], 3, axis=1), atol=1e-6)
    cylinder = rod(0.5, 0.25, 0.1, (0.0, 1.0), "steel")
    side = np.abs(cylinder.normals[:, 0]) < 0.5
    radial = (cylinder.vertices[side, 1:] - [0.5, 0.25]) / 0.1
    np.testing.assert_allclose(cylinder.normals[side, 1:], radial, atol=1e-5)


@pytest.mark.parametrize(
    ("section", "ends"), [([(0, 0), (1, 0), (1, 1), (0, 1)], (1.0, 1.0)), ([(0, 0), (1, 0)], (0.0, 1.0))]
)
def test_beam_raises_on_invalid_section_or_ends(section, ends):
    with pytest.raises(ValueError, match="convex"):
        beam(section, ends, "gutter")


@pytest.mark.parametrize(
    ("parameters", "kinds"),
    [
        ({}, set()),
        ({"gutter_width_m": 0.2}, {"gutter", "slab", "block"}),
        ({"floor": True}, {"floor_film"}),
        ({"crop_wire_m": 4.0}, {"crop_wire"}),
        ({"pipes": True}, {"heating_pipe"}),
        ({"far_rows": 2, "row_lean_rad": 0.1, "spacing_sd_m": 0.1}, set()),
    ],
)
def test_each_parameter_adds_only_its_own_parts(parameters, kinds):
    assert set(meshes_by_kind(Greenhouse(**parameters))) == kinds


def test_all_parts_are_background_except_wires_of_labelled_rows(full):
    for kind, meshes in full.items():
        classes = [mesh.instances[0].organ_class for mesh in meshes]
        if kind == "crop_wire":
            assert classes == [OrganClass.WIRE] * 2 + [OrganClass.BACKGROUND] * 4
        else:
            assert set(classes) == {OrganClass.BACKGROUND}


def test_parts_are_closed(full):
    for kind, meshes in full.items():
        for mesh in meshes:
            # Bodies that touch share edges; each of them has two faces there.
            _, faces_at_edge = np.unique(merged(mesh).edges_sorted, axis=0, return_counts=True)
            assert kind == "floor_film" or (faces_at_edge % 2 == 0).all(), kind
            assert mesh.uv.min() >= 0
            assert mesh.uv.max() <= 1


def test_rows_are_spaced_by_gap_and_aisle():
    lines = row_lines(ROW, FULL)
    np.testing.assert_allclose([line.y_m for line in lines], [0, 0.3, -1.6, -1.3, 1.6, 1.9])
    assert [line.aisle for line in lines] == [-1, 1, -1, 1, -1, 1]
    assert [line.labelled for line in lines] == [True, True, False, False, False, False]
    single = row_lines(replace(ROW, plants_back=0), replace(FULL, far_rows=2))
    np.testing.assert_allclose([line.y_m for line in single], [0, -1.3, 1.3, -2.6, 2.6])


def test_each_row_has_a_gutter_with_a_slab(full):
    for gutter, slab, line in zip(full["gutter"], full["slab"], row_lines(ROW, FULL), strict=True):
        low, high = gutter.vertices.min(axis=0), gutter.vertices.max(axis=0)
        np.testing.assert_allclose([low[0], high[0]], [-3, 3])
        np.testing.assert_allclose([low[1], high[1]], [line.y_m - 0.11, line.y_m + 0.11], atol=1e-6)
        assert low[2] == pytest.approx(0.4)
        # The slab rests on the bottom and rises above the rims.
        assert low[1] < slab.vertices[:, 1].min() < slab.vertices[:, 1].max() < high[1]
        assert low[2] < slab.vertices[:, 2].min() < high[2] < slab.vertices[:, 2].max()


def test_each_stem_base_is_on_open_rockwool(full):
    (blocks,) = full["block"]
    top = blocks.vertices[:, 2].max()
    assert top == pytest.approx(FULL.stem_base_m)
    slab_top = max(slab.vertices[:, 2].max() for slab in full["slab"])
    assert blocks.vertices[:, 2].min() == pytest.approx(slab_top)
    upper = blocks.vertices[blocks.faces[blocks.face_surface == blocks.surfaces.index("rockwool")]]
    upper = upper[(upper[..., 2] > top - 1e-6).all(axis=1)]
    for x, y in ROW.positions():
        inside = (upper[..., 0].min(1) <= x) & (x <= upper[..., 0].max(1))
        assert (inside & (upper[..., 1].min(1) <= y) & (y <= upper[..., 1].max(1))).any()


def test_wires_are_shifted_by_the_rows_lean(full):
    offset = np.tan(np.radians(4)) * (4.2 - FULL.stem_base_m)
    for wire, line in zip(full["crop_wire"], row_lines(ROW, FULL), strict=True):
        middle = (wire.vertices.min(axis=0) + wire.vertices.max(axis=0)) / 2
        np.testing.assert_allclose(middle, [0, line.y_m + line.aisle * offset, 4.2], atol=1e-5)
    assert FULL.lean_offset_m(4.2) == pytest.approx(offset)
    assert FULL.lean_offset_m(0.1) == 0


def test_each_aisle_has_two_pipes_clear_of_floor_and_gutters(full):
    y = np.array([np.mean(mesh.bounds[:, 1]) for mesh in full["heating_pipe"]])
    middles = y.reshape(-1, 2).mean(axis=1)
    np.testing.assert_allclose(sorted(middles), [-2.25, -0.65, 0.95, 2.55], atol=1e-5)
    assert middles[0] == pytest.approx(-0.65)
    np.testing.assert_allclose(np.ptp(y.reshape(-1, 2), axis=1), 0.55, atol=1e-5)
    narrow = meshes_by_kind(replace(FULL, aisle_m=0.6))
    gutters = [gutter.bounds[:, 1] for gutter in narrow["gutter"]]
    for pipe in narrow["heating_pipe"]:
        low, high = pipe.bounds
        assert low[2] > 0
        assert all(high[1] < left or low[1] > right for left, right in gutters)


def test_floor_film_is_level_and_extends_beyond_the_rows(full):
    (film,) = full["floor_film"]
    assert (film.vertices[:, 2] == 0).all()
    assert (film.normals == [0, 0, 1]).all()
    assert np.abs(film.vertices[:, :2]).min() > FULL.far_reach_m


def test_postures_have_the_given_means_and_deviations():
    postures = [draw_posture(IRREGULAR, np.random.default_rng(seed)) for seed in range(3000)]
    columns = np.array([[one.across_m, one.lean_rad, one.turn_rad] for one in postures]).T
    means = 0.0, IRREGULAR.row_lean_rad, 0.0
    deviations = IRREGULAR.across_sd_m, IRREGULAR.lean_sd_rad, IRREGULAR.turn_sd_rad
    for values, mean, sd in zip(columns, means, deviations, strict=True):
        # Four standard errors of a mean and of a standard deviation.
        assert values.mean() == pytest.approx(mean, abs=4 * sd / 3000**0.5)
        assert values.std() == pytest.approx(sd, rel=4 / 6000**0.5)
        assert np.abs(values - mean).max() <= 3 * sd * (1 + 1e-12)
    # They are uncorrelated.
    assert np.abs(np.corrcoef(columns) - np.eye(3)).max() < 4 / 3000**0.5


def test_plant_positions_vary_only_along_the_row():
    offsets = np.stack(
        [jittered_positions(ROW, IRREGULAR, np.random.default_rng(n)) - ROW.positions() for n in range(300)]
    )
    assert (offsets[..., 1] == 0).all()
    along = offsets[..., 0]
    assert along.mean() == pytest.approx(0, abs=4 * 0.015 / along.size**0.5)
    assert along.std() == pytest.approx(0.015, rel=4 / (2 * along.size) ** 0.5)


def test_regular_greenhouse_has_regular_rows():
    np.testing.assert_array_equal(
        jittered_positions(ROW, Greenhouse(), np.random.default_rng(0)), ROW.positions()
    )
    posture = draw_posture(Greenhouse(row_lean_rad=0.05), np.random.default_rng(0))
    assert (posture.across_m, posture.lean_rad, posture.turn_rad) == (0, 0.05, 0)
