"""What a greenhouse holds stands where its parameters say, and nothing is made that was not asked for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from pepperscene.classes import OrganClass
from pepperscene.materials import greenhouse_surfaces
from pepperscene.scene import DoubleRow, Greenhouse, draw_posture, greenhouse_mesh, jittered_places
from pepperscene.scene.greenhouse import row_lines

ROW = DoubleRow(front=7, back=6, spacing_m=0.2, gap_m=0.3, shift_m=0.1)
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


def things(house, row=ROW):
    """Meshes by kind, in the order they are made."""
    found = {}
    for mesh in greenhouse_mesh(row, house, row.places()):
        assert len(mesh.instances) == 1
        found.setdefault(mesh.instances[0].kind, []).append(mesh)
    return found


def middle(mesh):
    return (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2


def test_without_a_word_there_is_nothing():
    assert greenhouse_mesh(ROW, Greenhouse(), ROW.places()) == []


@pytest.mark.parametrize(
    ("word", "kinds"),
    [
        ({"gutter_width_m": 0.2}, {"gutter", "slab", "block"}),
        ({"floor": True}, {"floor_film"}),
        ({"crop_wire_m": 4.0}, {"crop_wire"}),
        ({"pipes": True}, {"heating_pipe"}),
        ({"far_rows": 2, "row_lean_rad": 0.1, "spacing_sd_m": 0.1}, set()),
    ],
)
def test_each_word_makes_its_own_things(word, kinds):
    assert set(things(Greenhouse(**word))) == kinds


def test_everything_is_background_but_the_wires_above_the_labelled_rows():
    for kind, meshes in things(FULL).items():
        classes = [mesh.instances[0].organ_class for mesh in meshes]
        if kind == "crop_wire":
            assert classes == [OrganClass.WIRE] * 2 + [OrganClass.BACKGROUND] * 4
        else:
            assert set(classes) == {OrganClass.BACKGROUND}


def test_every_surface_is_known():
    known = greenhouse_surfaces(np.arange(400.0, 701.0, 10.0))
    assert {name for meshes in things(FULL).values() for mesh in meshes for name in mesh.surfaces} <= set(
        known
    )


def test_bodies_are_closed():
    for kind, meshes in things(FULL).items():
        for mesh in meshes:
            body = trimesh.Trimesh(mesh.vertices, mesh.faces, process=True, merge_norm=True, merge_tex=True)
            # Bodies that touch share edges; each of them has two faces of its own there.
            _, faces_there = np.unique(body.edges_sorted, axis=0, return_counts=True)
            assert kind == "floor_film" or (faces_there % 2 == 0).all(), kind
            assert mesh.uv.min() >= 0
            assert mesh.uv.max() <= 1


def test_rows_lie_as_far_apart_as_gap_and_aisle_say():
    lines = row_lines(ROW, FULL)
    np.testing.assert_allclose([line.y_m for line in lines], [0, 0.3, -1.6, -1.3, 1.6, 1.9])
    # Between the rows that face each other across an aisle lies the aisle.
    assert [line.aisle for line in lines] == [-1, 1, -1, 1, -1, 1]
    assert [line.own for line in lines] == [True, True, False, False, False, False]
    single = row_lines(replace(ROW, back=0), replace(FULL, far_rows=2))
    np.testing.assert_allclose([line.y_m for line in single], [0, -1.3, 1.3, -2.6, 2.6])


def test_a_gutter_lies_under_each_row_and_slabs_in_it():
    made = things(FULL)
    for gutter, slab, line in zip(made["gutter"], made["slab"], row_lines(ROW, FULL), strict=True):
        low, high = gutter.vertices.min(axis=0), gutter.vertices.max(axis=0)
        np.testing.assert_allclose([low[0], high[0]], [-3, 3])
        np.testing.assert_allclose([low[1], high[1]], [line.y_m - 0.11, line.y_m + 0.11], atol=1e-6)
        assert low[2] == pytest.approx(0.4)
        # The slab rests on the bottom and stands out above the rims.
        assert low[1] < slab.vertices[:, 1].min() < slab.vertices[:, 1].max() < high[1]
        assert low[2] < slab.vertices[:, 2].min() < high[2] < slab.vertices[:, 2].max()


def test_blocks_carry_the_stems_feet():
    (blocks,) = things(FULL)["block"]
    top = blocks.vertices[:, 2].max()
    assert top == pytest.approx(FULL.foot_m)
    assert blocks.vertices[:, 2].min() == pytest.approx(
        max(slab.vertices[:, 2].max() for slab in things(FULL)["slab"])
    )
    # Under every foot there is open rockwool.
    upper = blocks.vertices[blocks.faces[blocks.face_surface == blocks.surfaces.index("rockwool")]]
    upper = upper[(upper[..., 2] > top - 1e-6).all(axis=1)]
    for x, y in ROW.places():
        inside = (upper[..., 0].min(1) <= x) & (x <= upper[..., 0].max(1))
        assert (inside & (upper[..., 1].min(1) <= y) & (y <= upper[..., 1].max(1))).any()


def test_wires_hang_where_the_rows_lean_to():
    made = things(FULL)["crop_wire"]
    away = np.tan(np.radians(4)) * (4.2 - FULL.foot_m)
    for wire, line in zip(made, row_lines(ROW, FULL), strict=True):
        np.testing.assert_allclose(middle(wire), [0, line.y_m + line.aisle * away, 4.2], atol=1e-5)
    assert FULL.away(4.2) == pytest.approx(away)
    assert FULL.away(0.1) == 0


def test_two_pipes_lie_in_every_aisle():
    y = np.array([middle(pipe)[1] for pipe in things(FULL)["heating_pipe"]])
    middles = y.reshape(-1, 2).mean(axis=1)
    np.testing.assert_allclose(sorted(middles), [-2.25, -0.65, 0.95, 2.55], atol=1e-5)
    assert middles[0] == pytest.approx(-0.65)
    np.testing.assert_allclose(np.ptp(y.reshape(-1, 2), axis=1), 0.55, atol=1e-5)
    # They lie above the floor and clear of the gutters, also in a narrow aisle.
    narrow = things(replace(FULL, aisle_m=0.6))
    edges = [(g.vertices[:, 1].min(), g.vertices[:, 1].max()) for g in narrow["gutter"]]
    for pipe in narrow["heating_pipe"]:
        low, high = pipe.vertices.min(axis=0), pipe.vertices.max(axis=0)
        assert low[2] > 0
        assert all(high[1] < left or low[1] > right for left, right in edges)


def test_the_film_is_the_floor():
    (film,) = things(FULL)["floor_film"]
    assert (film.vertices[:, 2] == 0).all()
    assert (film.normals == [0, 0, 1]).all()
    assert np.abs(film.vertices[:, :2]).min() > FULL.far_reach_m


# --- unevenness -------------------------------------------------------------------------------------------

UNEVEN = Greenhouse(
    row_lean_rad=np.radians(4.0),
    lean_sd_rad=np.radians(1.5),
    turn_sd_rad=np.radians(20.0),
    spacing_sd_m=0.015,
    across_sd_m=0.01,
)


def test_postures_spread_as_told():
    many = [draw_posture(UNEVEN, np.random.default_rng(seed)) for seed in range(3000)]
    columns = np.array([[one.across_m, one.lean_rad, one.turn_rad] for one in many]).T
    means = 0.0, UNEVEN.row_lean_rad, 0.0
    spreads = UNEVEN.across_sd_m, UNEVEN.lean_sd_rad, UNEVEN.turn_sd_rad
    for values, mean, sd in zip(columns, means, spreads, strict=True):
        # Four standard errors of a mean and of a standard deviation.
        assert values.mean() == pytest.approx(mean, abs=4 * sd / 3000**0.5)
        assert values.std() == pytest.approx(sd, rel=4 / 6000**0.5)
        assert np.abs(values - mean).max() <= 3 * sd * (1 + 1e-12)
    # Neither of them follows another.
    assert np.abs(np.corrcoef(columns) - np.eye(3)).max() < 4 / 3000**0.5


def test_places_spread_along_the_row_only():
    offsets = np.stack(
        [jittered_places(ROW, UNEVEN, np.random.default_rng(n)) - ROW.places() for n in range(300)]
    )
    assert (offsets[..., 1] == 0).all()
    along = offsets[..., 0]
    assert along.mean() == pytest.approx(0, abs=4 * 0.015 / along.size**0.5)
    assert along.std() == pytest.approx(0.015, rel=4 / (2 * along.size) ** 0.5)


def test_a_regular_greenhouse_leaves_rows_even():
    np.testing.assert_array_equal(jittered_places(ROW, Greenhouse(), np.random.default_rng(0)), ROW.places())
    still = draw_posture(Greenhouse(row_lean_rad=0.05), np.random.default_rng(0))
    assert (still.across_m, still.lean_rad, still.turn_rad) == (0, 0.05, 0)
