"""Palmate blades: sizes, lobes, teeth, veins and triangles.

Rationale: the rows of such a blade fan out from the base, so that triangles could be inverted, and the stated
sizes could be lost. Set-up: flat blades in the xy plane that point along y.
"""

import numpy as np
import pytest
from blade_meshes import edges, margin, organ, polygon_area, signed_areas
from organ_meshes import check_mesh, mesh_organs

from pepperscene.geometry.blade.blades import mesh_blades
from pepperscene.geometry.blade.grid import TIP_NUMBER, blade_grid

LENGTH, WIDTH, SINUS = 0.2, 0.25, 0.22
CUCUMBER = {
    "length_m": LENGTH, "width_m": WIDTH, "palmate": 1.0, "lobes": 2.0, "lobe_depth": 0.16, "sinus": SINUS,
}  # fmt: skip
TEETH = {"teeth": 20.0, "tooth_depth_m": 0.0035}


def palmate(**measures):
    return organ(**{**CUCUMBER, **measures})


def flat(*organs, detail=1.0):
    batch = mesh_blades(organs, detail)
    return batch.vertices[..., :2], batch


def lobes_of(line, sinus):
    """Number of corners of half a margin that stick out beside the tip, if all extents are scaled to 1."""
    line = line / [0.5 * WIDTH, LENGTH]
    line[:, 1] /= np.where(line[:, 1] < 0.0, sinus, 1.0)
    radius = np.linalg.norm(line, axis=1)[: line[:, 1].argmax()]
    inner = radius[1:-1]
    return np.count_nonzero((inner > radius[:-2]) & (inner >= radius[2:]))


@pytest.mark.parametrize("seed", [0.0, 0.4, 0.93])
@pytest.mark.parametrize("detail", [0.4, 1.0])
def test_stated_sizes(seed, detail):
    points, batch = flat(palmate(seed=seed, **TEETH), detail=detail)
    x, y = points[0].T
    assert y.max() == pytest.approx(LENGTH, rel=1e-9)
    assert -y.min() == pytest.approx(SINUS * LENGTH, rel=0.04)
    assert np.ptp(x) == pytest.approx(WIDTH, rel=0.03)
    assert batch.vertices[..., 2] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_stated_number_of_lobes(count):
    for seed in (0.1, 0.55, 0.8):
        points, batch = flat(palmate(seed=seed, lobes=count, lobe_depth=0.2), detail=2.0)
        assert lobes_of(margin(points[0], batch.faces), SINUS) == count


def test_teeth_are_cut_into_the_margin_only():
    """Their mean depth over the margin is about the half of the stated one, and inner vertices stay."""
    (smooth, batch), (toothed, _) = flat(palmate(**TEETH | {"tooth_depth_m": 0.0})), flat(palmate(**TEETH))
    moved = np.flatnonzero(np.any(smooth[0] != toothed[0], axis=1))
    grid = blade_grid(1.0, 0.0, TEETH["teeth"])
    assert set(moved) < set(grid.margin_vertices.ravel().tolist())
    line = margin(smooth[0], batch.faces)
    length = np.linalg.norm(np.diff(line, axis=0, append=line[:1]), axis=1).sum()
    lost = (polygon_area(line) - polygon_area(margin(toothed[0], batch.faces))) / length
    assert 0.15 * TEETH["tooth_depth_m"] < lost < 0.5 * TEETH["tooth_depth_m"]


@pytest.mark.parametrize("detail", [0.3, 0.6, 1.0, 2.0])
def test_no_triangle_is_inverted(detail):
    """For sizes about those of the cucumber's leaves."""
    rng = np.random.default_rng(2)
    blades = [
        palmate(
            seed=rng.random(),
            width_m=WIDTH * rng.uniform(0.8, 1.2),
            lobe_depth=rng.uniform(0.0, 0.24),
            sinus=rng.uniform(0.12, 0.35),
            teeth=float(rng.integers(14, 28)),
            tooth_depth_m=rng.uniform(0.0, 0.005),
        )
        for _ in range(60)
    ]
    points, batch = flat(*blades, detail=detail)
    assert signed_areas(points, batch.faces).min() > 0.0


DAMAGED = {"bites": 4.0, "bite_width_m": 0.012, "tears": 2.0, "ageing": 0.6, "rolled_rad": 1.0}


@pytest.mark.parametrize(
    "measures", [{}, {"sinus": 0.0}, {"lobes": 0.0}, {"lobes": 6.0, "lobe_depth": 1.0}, DAMAGED]
)
def test_any_palmate_blade_is_one_valid_sheet(measures):
    bent = {"fold_rad": 0.3, "curl_rad": -0.6, "blister_m": 0.004, "vein_m": 0.001, "margin_wave_m": 0.006}
    one = palmate(**TEETH, **bent, **measures)
    mesh = mesh_organs(one.__class__("blade", -1, 0, one.curve, one.up, one.measures))
    check_mesh(mesh)
    directed = edges(mesh.faces)
    assert len(np.unique(directed, axis=0)) == len(directed)
    boundary = len(directed) - 2 * (len(directed) - len(np.unique(np.sort(directed, axis=1), axis=0)))
    # Euler's number of a disc.
    assert len(mesh.vertices) - (len(directed) + boundary) // 2 + len(mesh.faces) == 1


def test_the_lowest_veins_radiate_from_the_base():
    """Rows of the three lowest veins leave the midrib within a tenth of it, and later ones one by one."""
    points, _ = flat(palmate())
    grid = blade_grid(1.0, 0.0, 0.0)
    columns = len(grid.across)
    midrib = points[0][1 + grid.side :: columns][: len(grid.number), 1] / LENGTH
    assert np.all(np.diff(midrib) > 0.0)
    assert midrib[grid.number <= 2.0].max() < 0.1
    assert midrib[grid.number >= 3.0].min() > 0.15
    assert midrib[-1] > 0.75
    ends = points[0][columns::columns][: len(grid.number)]
    lowest, third = (ends[np.argmin(np.abs(grid.number - number))] for number in (0.0, 2.0))
    # They point into the lower and the upper lobe.
    assert lowest[1] < 0.0 < third[1]
    assert grid.number.max() < TIP_NUMBER


def test_a_pinnate_blade_beside_a_palmate_one_keeps_its_outline():
    alone, own = flat(organ())
    beside, shared = flat(organ(), palmate())
    assert polygon_area(margin(beside[0], shared.faces)) == pytest.approx(
        polygon_area(margin(alone[0], own.faces)), rel=2e-3
    )
    assert np.ptp(beside[0], axis=0) == pytest.approx(np.ptp(alone[0], axis=0), rel=5e-3)
