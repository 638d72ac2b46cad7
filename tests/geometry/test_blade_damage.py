"""Bites and tears of margins, and blades that roll up and dry."""

from itertools import pairwise

import numpy as np
import pytest
from blade_meshes import LENGTH, LOBED, WIDTH, areas, blade, organ, random_organ, signed_areas
from hypothesis import given
from hypothesis import strategies as st

from pepperscene.geometry.blade.blades import mesh_blades, roll_angles
from pepperscene.geometry.blade.grid import blade_grid

SIZE = np.array([WIDTH, LENGTH])


def flat(batch, k=0):
    return batch.uv[k] * SIZE


def outline(batch, detail=1.0):
    """`(k, 2)` the margin of a flat blade as a closed polygon."""
    left, right = blade_grid(detail, 0.0).margin_vertices
    return flat(batch)[np.concatenate([right[:-1], left[:0:-1]])]


@pytest.mark.parametrize("detail", [0.3, 1.0])
def test_margin_vertices_are_the_edge_of_the_mesh(detail):
    grid = blade_grid(detail, 0.0)
    directed = {
        tuple(edge) for face in grid.faces.tolist() for edge in zip(face, face[1:] + face[:1], strict=True)
    }
    left, right = grid.margin_vertices.tolist()
    edge = {(a, b) for a, b in directed if (b, a) not in directed}
    assert edge == {*pairwise(right), *pairwise(left[::-1])}


def test_whole_blades_are_unchanged():
    for measures in ({"bites": 0.9}, {"tears": 0.9}, {"bite_width_m": 0.02, "tear_depth": 0.9}):
        for name in ("vertices", "uv", "state"):
            np.testing.assert_array_equal(getattr(blade(**measures), name), getattr(blade(), name))


@given(
    seed=st.integers(0, 2**20),
    bites=st.integers(0, 12),
    width=st.floats(0.001, 0.06),
    tears=st.integers(0, 6),
    depth=st.floats(0.0, 1.0),
    detail=st.sampled_from([0.3, 0.5, 1.0, 2.0]),
    lobes=st.sampled_from([0.0, 4.0]),
)
def test_damage_inverts_no_triangle(seed, bites, width, tears, depth, detail, lobes):
    rng = np.random.default_rng(seed)
    measures = {"seed": rng.random(), "lobes": lobes, "lobe_depth": 0.3}
    damage = {"bites": bites, "bite_width_m": width, "tears": tears, "tear_depth": depth}
    before, after = (mesh_blades([organ(**measures, **more)], detail) for more in ({}, damage))
    whole, cut = (signed_areas(flat(batch), before.faces) for batch in (before, after))
    # Those that lobes invert are not damaged further.
    assert cut[whole > 0.0].min() > 0.0
    assert np.isfinite(after.vertices).all()
    assert areas(after).min() > 0.0
    np.testing.assert_allclose(np.linalg.norm(after.normals, axis=2), 1.0, atol=1e-6)


def test_bites_take_out_round_pieces_of_the_stated_width():
    """The area of a segment of a circle whose centre is half a radius outside of the margin."""
    width, missing = 0.01, []
    for seed in np.linspace(0.02, 0.98, 40):
        whole, bitten = (
            signed_areas(flat(blade(seed=seed, detail=2.0, **measures)), blade_grid(2.0, 0.0).faces).sum()
            for measures in ({}, {"bites": 1, "bite_width_m": width})
        )
        missing.append(whole - bitten)
    # Of radii from a half to one and a half of the mean, uniform.
    square = (0.5 * width) ** 2 * (1.0 + 1.0 / 12.0)
    segment = square * (np.pi / 3.0 - 0.5 * np.sqrt(0.75))
    assert min(missing) > -1e-12
    assert np.mean(missing) == pytest.approx(segment, rel=0.25)


def test_tears_are_narrow_notches_of_the_stated_depth():
    depths, widths = [], []
    for seed in np.linspace(0.02, 0.98, 40):
        whole, torn = (outline(blade(seed=seed, tears=n, tear_depth=0.5)) for n in (0, 1))
        moved = np.linalg.norm(torn - whole, axis=1)
        apex = int(moved.argmax())
        depths.append(moved[apex] / np.abs(whole[apex, 0] - 0.5 * WIDTH))
        widths.append(np.linalg.norm(torn[apex - 1] - torn[apex + 1]) / moved[apex])
    # Along a vein the way is longer than to the midrib.
    assert 0.4 < np.mean(depths) < 0.75
    assert max(widths) < 0.5


def test_damaged_blades_stay_on_the_surface_of_whole_ones():
    """The distance of bitten blades from whole ones; tears part by a tenth of their length."""
    rng = np.random.default_rng(8)
    for _ in range(2):
        drawn = random_organ(rng)
        bitten = mesh_blades([drawn, organ(drawn.curve, **drawn.measures | {"bites": 4.0})], 1.0)
        moved = np.flatnonzero(np.any(bitten.uv[0] != bitten.uv[1], axis=1))
        assert moved.size
        points = bitten.vertices[0][bitten.faces]
        normal = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        for vertex in bitten.vertices[1][moved]:
            near = np.argsort(np.linalg.norm(points.mean(axis=1) - vertex, axis=1))[:8]
            heights = np.abs(((vertex - points[near, 0]) * normal[near]).sum(axis=1))
            assert heights.min() < 5e-4


@pytest.mark.parametrize(("angle", "sign"), [(2.5, 1.0), (-2.5, -1.0)])
def test_rolled_margins_turn_towards_the_stated_side(angle, sign):
    """Widths are kept over the surface; seen from above the blade is narrower."""
    for seed in (0.1, 0.6):
        batch = blade(seed=seed, rolled_rad=angle)
        assert sign * batch.vertices[0, :, 2].mean() > 0.003
        assert np.ptp(batch.vertices[0, :, 0]) < 0.75 * WIDTH
        np.testing.assert_allclose(areas(batch).sum(), areas(blade(seed=seed)).sum(), rtol=0.04)


def test_blades_roll_up_as_they_dry():
    ageing = np.linspace(0.0, 1.0, 11)
    angles = np.array(
        [np.abs(roll_angles([organ(ageing=a)] * 20, np.linspace(0.01, 0.99, 20))).mean() for a in ageing]
    )
    assert np.all(angles[ageing <= 0.4] == 0.0)
    assert np.all(np.diff(angles[ageing >= 0.4])[:4] > 0.2)
    assert np.degrees(angles[-1]) > 150.0
    # Spots and rims alone leave the blade as it was, but for the crumples of the rim.
    fresh, rim = (blade(ageing=a).vertices[0] for a in (0.0, 0.3))
    assert 0.0003 < np.abs(rim - fresh).max() < 0.004


def test_lobed_blades_can_be_damaged():
    whole, bitten = blade(**LOBED), blade(**LOBED, bites=3, bite_width_m=0.02)
    assert np.any(whole.uv != bitten.uv)
