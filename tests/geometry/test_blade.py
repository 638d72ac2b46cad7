from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pepperscene.geometry.batch import hash_uniform, vertex_normals
from pepperscene.geometry.blade.blades import mesh_blades
from pepperscene.geometry.blade.grid import (
    blade_grid,
    origin_of_vein_at,
    vein_number,
    vein_origin,
    vein_rise,
)
from pepperscene.geometry.blade.relief import grid_noise
from pepperscene.grammar.plant import Organ
from pepperscene.materials.patterns import grow_veins

LENGTH, WIDTH = 0.135, 0.112
FLAT = {"length_m": LENGTH, "width_m": WIDTH, "seed": 0.37, "state_mean": 0.6, "state_spread": 0.1}
LOBED = {"lobes": 5.0, "lobe_depth": 0.35}
KAITE = {  # as a blade of Kaite, mean and spread
    "fold_rad": (0.28, 0.19), "curl_rad": (0.09, 0.38), "twist_rad": (0.0, 0.28),
    "margin_wave_m": (0.003, 0.0016), "margin_waves": (4.0, 1.2), "blister_m": (0.0016, 0.0006),
    "vein_m": (0.0004, 0.0002), "asymmetry": (0.0, 0.04), "widest": (0.35, 0.03), "base": (0.8, 0.06),
}  # fmt: skip


def organ(curve=None, **measures):
    """A blade in the xy plane that points along y, upper side up, unless it has another curve."""
    measures = FLAT | measures
    line = np.array([[0.0, 0, 0], [0.0, measures["length_m"], 0.0]]) if curve is None else curve
    return Organ("lamina", -1, 0, line, np.array([0.0, 0.0, 1.0]), measures)


def blade(curve=None, detail=1.0, **measures):
    return mesh_blades([organ(curve, **measures)], detail)


def living(rng, times=1.0, **measures):
    """A blade as on a plant."""
    drawn = {name: mean + times * sd * rng.standard_normal() for name, (mean, sd) in KAITE.items()}
    return organ(droop(float(rng.uniform(0.2, 1.2))), **drawn, **({"seed": rng.random()} | measures))


def droop(angle, points=14, length=LENGTH):
    """A midrib that bends down evenly by `angle` from base to tip."""
    slope = angle * (np.arange(points - 1) + 0.5) / (points - 1)
    steps = np.stack([0.0 * slope, np.cos(slope), -np.sin(slope)], axis=1) * length / (points - 1)
    return np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


def edges(faces):
    return faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)


def areas(batch):
    a, b, c = (batch.vertices[:, batch.faces[:, corner]] for corner in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=2)


def flat_areas(batch):
    """Doubled areas of the triangles on the flat leaf, negative if turned over."""
    a, b, c = (batch.uv[:, batch.faces[:, corner]] for corner in range(3))
    (p, q), (r, s) = np.moveaxis(b - a, -1, 0), np.moveaxis(c - a, -1, 0)
    return p * s - q * r


def margin(batch, k=0):
    """The blade's edge as a closed polygon, in the order of its points."""
    directed = edges(batch.faces).tolist()
    inner = {(b, a) for a, b in directed}
    following = {a: b for a, b in directed if (a, b) not in inner}
    line = [0]
    while (after := following[line[-1]]) != 0:
        line.append(after)
    assert len(line) == len(following)
    return batch.vertices[k][line]


def distance(points, polygon):
    """Of each point from the nearest place on a closed polygon."""
    start, step = polygon, np.roll(polygon, -1, axis=0) - polygon
    offset = points[:, None] - start
    part = np.clip((offset * step).sum(axis=2) / (step * step).sum(axis=1), 0.0, 1.0)
    return np.linalg.norm(offset - part[..., None] * step, axis=2).min(axis=1)


def hausdorff(one, other):
    return max(distance(one, other).max(), distance(other, one).max())


def width_over_surface(batch, place, k=0):
    """Metres along the surface from margin to margin, over every bulge, where v is `place`."""
    height = batch.uv[k, :, 1] - place
    total = 0.0
    for face in batch.faces:
        ends = []
        for a, b in ((face[0], face[1]), (face[1], face[2]), (face[2], face[0])):
            if (height[a] < 0.0) != (height[b] < 0.0):
                part = height[a] / (height[a] - height[b])
                ends.append(batch.vertices[k, a] * (1.0 - part) + batch.vertices[k, b] * part)
        total += np.linalg.norm(ends[1] - ends[0]) if ends else 0.0
    return total


def midrib_lengths(batch):
    """`(n,)` lengths of the polylines where u is one half."""
    middle = np.flatnonzero(np.all(batch.uv[..., 0] == 0.5, axis=0))
    middle = middle[np.argsort(batch.uv[0, middle, 1])]
    return np.linalg.norm(np.diff(batch.vertices[:, middle], axis=1), axis=2).sum(axis=1)


# --- the outline ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0.0, 0.21, 0.93])
@pytest.mark.parametrize("asymmetry", [-0.1, 0.0, 0.1])
@pytest.mark.parametrize("detail", [0.3, 1.0])
def test_flat_blade_has_the_stated_sizes(seed, asymmetry, detail):
    x, y, z = blade(seed=seed, asymmetry=asymmetry, detail=detail).vertices[0].T
    np.testing.assert_allclose(np.ptp(y), LENGTH, rtol=1e-9)
    # The width is that of the curve; its polygon stays within it.
    assert WIDTH * 0.99 < np.ptp(x) <= WIDTH * (1.0 + 1e-9)
    np.testing.assert_allclose(x.max() / np.ptp(x), 0.5 * (1.0 + asymmetry), atol=0.004)
    np.testing.assert_allclose(z, 0.0, atol=1e-12)


def test_halves_are_mirror_images_without_asymmetry():
    flat = blade().uv[0]
    mirrored = flat * [-1.0, 1.0] + [1.0, 0.0]
    np.testing.assert_allclose(
        flat[np.lexsort(flat.T.round(9))], mirrored[np.lexsort(mirrored.T.round(9))], atol=1e-9
    )


def test_outline_is_ovate_with_a_drawn_out_tip():
    x, y, _ = blade(detail=2.0).vertices[0].T
    bands = np.array([np.ptp(x[np.abs(y / LENGTH - v) < 0.03]) for v in (0.1, 0.37, 0.75, 0.93)]) / WIDTH
    assert bands[1] > 0.98
    assert 0.5 < bands[0] < 0.8
    assert bands[2] < 0.6
    assert bands[3] < 0.25


@pytest.mark.parametrize("widest", [0.25, 0.35, 0.45])
@pytest.mark.parametrize("base", [0.5, 0.8])
def test_blade_is_widest_at_the_stated_place(widest, base):
    x, y, _ = blade(detail=2.0, widest=widest, base=base).vertices[0].T
    assert y[x.argmax()] / LENGTH == pytest.approx(widest, abs=0.02)


@pytest.mark.parametrize(("measures", "far", "little"), [({}, 0.004, 0.004), (LOBED, 0.045, 0.01)])
@pytest.mark.parametrize("seed", [0.05, 0.6])
def test_outline_is_the_same_at_every_detail(measures, far, little, seed):
    """The polygons differ by half a millimetre on a pepper's leaf; slits between lobes may be cut short."""
    *coarser, finest = (
        margin(blade(detail=detail, seed=seed, **measures))[:, :2] for detail in (0.3, 0.5, 1.0, 2.0)
    )

    def area(line):
        x, y = line.T
        return 0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))

    for line in coarser:
        assert hausdorff(line, finest) < far * LENGTH
        assert area(line) == pytest.approx(area(finest), rel=little)


@pytest.mark.parametrize("detail", [0.3, 0.5, 1.0])
def test_outline_is_the_same_on_living_blades(detail):
    rng = np.random.default_rng(3)
    blades = [living(rng) for _ in range(6)]
    coarse, fine = mesh_blades(blades, detail), mesh_blades(blades, 2.0)
    for k in range(len(blades)):
        assert hausdorff(margin(coarse, k), margin(fine, k)) < 0.025 * LENGTH


def test_outline_looks_smooth():
    """No corner of the margin at detail 1 turns by more than 12 degrees, except at base and tip."""
    step = np.diff(margin(blade())[:, :2], axis=0)
    turn = np.degrees(np.abs(np.diff(np.unwrap(np.arctan2(step[:, 1], step[:, 0])))))
    assert np.sort(turn)[:-4].max() < 12.0


def test_lobes_point_to_the_tip():
    """Each half has several notches; the lobes between them lean forward."""
    line = margin(blade(detail=2.0, widest=0.3, **LOBED))[:, :2]
    right = line[: line[:, 1].argmax()]
    out = right[:, 0]
    tops = np.flatnonzero((out[1:-1] > out[:-2]) & (out[1:-1] > out[2:])) + 1
    notches = [a + out[a:b].argmin() for a, b in pairwise(tops)]
    assert len(tops) >= 2
    assert max(out[a] - out[b] for a, b in zip(tops, notches, strict=False)) > 0.03 * WIDTH
    for top, notch in zip(tops, notches, strict=False):
        below = top - 1 - np.argmax((out[:top] <= out[notch])[::-1]) if (out[:top] <= out[notch]).any() else 0
        assert right[notch, 1] - right[top, 1] < right[top, 1] - right[below, 1]


@pytest.mark.parametrize("measures", [{"lobes": 0.0, "lobe_depth": 0.4}, {"lobes": 0.0}])
def test_entire_margins_have_no_lobes(measures):
    np.testing.assert_array_equal(blade(**measures).vertices, blade().vertices)


# --- the triangles ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("detail", "low", "high"), [(0.3, 150, 400), (0.5, 200, 500), (1.0, 500, 800), (2.0, 2000, 3200)]
)
def test_detail_sets_the_number_of_triangles(detail, low, high):
    assert low <= len(blade_grid(detail, 0.0).faces) <= high
    assert len(blade_grid(detail, 5.0).faces) <= 1.2 * high


@pytest.mark.parametrize("detail", [0.1, 0.3, 0.45, 0.7, 1.0, 1.6, 2.0])
@pytest.mark.parametrize("lobes", [0.0, 3.0, 8.0])
def test_grid_is_one_disc(detail, lobes):
    """Every edge has one or two faces of the same winding; Euler's number is that of a disc."""
    faces = blade_grid(detail, lobes).faces
    directed, counts = np.unique(edges(faces), axis=0, return_counts=True)
    assert counts.max() == 1
    assert len(directed) == 3 * len(faces)
    assert len(np.unique(np.sort(faces, axis=1), axis=0)) == len(faces)
    sides = len(np.unique(np.sort(edges(faces), axis=1), axis=0))
    points = len(np.unique(faces))
    assert points == faces.max() + 1 == blade(detail=detail, lobes=lobes).vertices.shape[1]
    assert points - sides + len(faces) == 1


@pytest.mark.parametrize("aspect", [0.3, 0.83, 1.4])
@pytest.mark.parametrize("base", [0.5, 0.8, 0.9])
@pytest.mark.parametrize("detail", [0.3, 1.0, 2.0])
def test_no_triangle_of_a_flat_blade_is_turned_over(aspect, base, detail):
    for widest in (0.25, 0.35, 0.45):
        flat = blade(width_m=aspect * LENGTH, base=base, widest=widest, asymmetry=0.05, detail=detail)
        assert flat_areas(flat).min() > 0.0


@pytest.mark.parametrize("seed", [0.05, 0.5, 0.77])
def test_lobes_turn_hardly_any_triangle_over(seed):
    area = flat_areas(blade(seed=seed, base=0.7, widest=0.32, **LOBED))
    assert area[area < 0.0].sum() > -0.001 * area.sum()


@settings(deadline=None, max_examples=40)
@given(
    seed=st.integers(0, 2**20),
    times=st.sampled_from([0.0, 1.0, 10.0]),
    length=st.sampled_from([0.001, 0.05, 0.135, 0.3]),
    detail=st.sampled_from([0.2, 0.5, 1.0]),
    lobes=st.sampled_from([0.0, 4.0]),
)
def test_meshes_are_sound_under_extreme_measures(seed, times, length, detail, lobes):
    one = living(np.random.default_rng(seed), times, lobes=lobes, lobe_depth=0.3)
    scale = length / LENGTH
    sizes = {name: scale * one.measures[name] for name in ("width_m", "margin_wave_m", "blister_m", "vein_m")}
    measures = {**one.measures, **sizes, "length_m": length}
    made = mesh_blades([Organ("lamina", -1, 0, one.curve * scale, one.up, measures)], detail)
    for values in (made.vertices, made.normals, made.uv, made.state):
        assert np.isfinite(values).all()
    for values in (made.uv, made.state):
        assert 0.0 <= values.min() <= values.max() <= 1.0
    np.testing.assert_allclose(np.linalg.norm(made.normals, axis=2), 1.0, atol=1e-9)
    # No triangle without area, and no two vertices in one place; all at the precision of a mesh.
    stored = made.vertices.astype(np.float32)[0]
    assert len(np.unique(stored, axis=0)) == len(stored)
    assert areas(made).min() > 1e-9 * areas(made).sum()


def test_normals_are_area_weighted_means_of_faces():
    rng = np.random.default_rng(8)
    made = mesh_blades([living(rng) for _ in range(2)], 0.5)
    for vertices, normals in zip(made.vertices, made.normals, strict=True):
        total = np.zeros_like(vertices)
        for a, b, c in made.faces:
            total[[a, b, c]] += np.cross(vertices[b] - vertices[a], vertices[c] - vertices[a])
        np.testing.assert_allclose(normals, total / np.linalg.norm(total, axis=1, keepdims=True), atol=1e-9)


def test_vertex_without_faces_has_a_zero_normal():
    triangle = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 5, 5]]])
    normals = vertex_normals(triangle, np.array([[0, 1, 2]]))
    np.testing.assert_array_equal(normals[0], [[0, 0, 1]] * 3 + [[0, 0, 0]])


def test_normals_point_out_of_the_upper_side():
    assert blade().normals[..., 2].min() > 0.99
    upside_down = Organ("lamina", -1, 0, organ().curve, np.array([0.0, 0.0, -1.0]), FLAT)
    assert mesh_blades([upside_down], 1.0).normals[..., 2].max() < -0.99


def test_uv_are_the_flat_leaf():
    bent = blade(droop(1.0), fold_rad=0.4, curl_rad=0.5, margin_wave_m=0.003, margin_waves=4.0)
    flat = blade()
    np.testing.assert_array_equal(bent.uv, flat.uv)
    np.testing.assert_allclose(flat.vertices[..., 1], flat.uv[..., 1] * LENGTH, atol=1e-9)
    np.testing.assert_allclose(flat.vertices[..., 0], (flat.uv[..., 0] - 0.5) * WIDTH, atol=1e-9)


def test_blades_do_not_depend_on_others_in_the_batch():
    rng = np.random.default_rng(12)
    blades = [living(rng) for _ in range(5)]
    together = mesh_blades(blades, 1.0)
    for k, one in enumerate(blades):
        alone = mesh_blades([one], 1.0)
        # Up to the last bits: the vectorized sines of long arrays are not those of short ones.
        np.testing.assert_allclose(alone.vertices[0], together.vertices[k], atol=1e-13)
        np.testing.assert_allclose(alone.state[0], together.state[k], atol=1e-12)


# --- the form ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("detail", [0.4, 1.0, 2.0])
def test_midribs_keep_their_length(detail):
    rng = np.random.default_rng(5)
    batch = mesh_blades([living(rng) for _ in range(20)], detail)
    np.testing.assert_allclose(midrib_lengths(batch), LENGTH, rtol=0.01)


@pytest.mark.parametrize(
    "measures",
    [
        {"fold_rad": 0.6},
        {"curl_rad": 0.6},
        {"curl_rad": -0.6},
        {"blister_m": 0.0016},
        {"blister_m": 0.003, "vein_m": 5e-4},
    ],
    ids=str,
)
@pytest.mark.parametrize("seed", [0.2, 0.7])
def test_widths_are_kept_over_folds_curls_and_bulges(measures, seed):
    assert width_over_surface(blade(seed=seed, **measures), 0.36) == pytest.approx(WIDTH, rel=0.02)


def test_waves_change_the_width_by_a_few_per_cent():
    """The margin gets longer; across the blade, the height of the waves is subtracted."""
    rng = np.random.default_rng(6)
    made = mesh_blades([living(rng) for _ in range(8)], 1.0)
    widths = np.array([width_over_surface(made, 0.36, k) for k in range(8)]) / WIDTH
    assert 0.97 < widths.mean() < 1.05


@pytest.mark.parametrize(
    ("curve", "measures", "error"),
    [
        (None, {"fold_rad": 0.5}, 0.05),
        (None, {"curl_rad": 1.0}, 0.05),
        (None, {"curl_rad": -0.8, "fold_rad": 0.3}, 0.05),
        (None, {"twist_rad": 0.6}, 0.05),
        (droop(1.2), {}, 0.01),
    ],
)
def test_bending_keeps_the_area(curve, measures, error):
    np.testing.assert_allclose(areas(blade(curve, **measures)).sum(), areas(blade()).sum(), rtol=error)


def test_halves_rise_by_the_fold_most_at_the_midrib():
    fold, ratios = 0.4, []
    for seed in np.linspace(0.05, 0.95, 10):
        x, y, z = blade(fold_rad=fold, seed=seed, detail=2.0).vertices[0].T
        for side in (-1.0, 1.0):
            out, middle = side * x, np.abs(y / LENGTH - 0.4) < 0.2
            inner, outer = middle & (out > 0.002) & (out < 0.008), middle & (out > 0.045)
            steep, mean = (np.arctan2(z[part], out[part]).mean() for part in (inner, outer))
            # Each half may fold by a quarter more or less, and again along its length.
            assert 0.55 * fold < mean < 1.55 * fold
            ratios.append(steep / mean)
    assert 1.1 < np.mean(ratios) < 1.5


def test_positive_curl_raises_the_margins():
    assert blade(curl_rad=0.6, seed=0.2).vertices[..., 2].mean() > 0.001
    assert blade(curl_rad=-0.6, seed=0.2).vertices[..., 2].mean() < -0.001


def test_midrib_follows_the_curve():
    curve = droop(1.0)
    plain = blade(curve, fold_rad=0.3)
    np.testing.assert_allclose(plain.vertices[0, [0, -1]], curve[[0, -1]], atol=2e-4)
    # Wavy blades bend their tips, by some millimetres, mostly down.
    rng = np.random.default_rng(9)
    tips = np.array([blade(seed=rng.random(), margin_wave_m=0.004).vertices[0, -1] for _ in range(30)])
    assert tips[:, 2].mean() < -0.001
    assert np.abs(tips - [0.0, LENGTH, 0.0]).max() < 0.2 * LENGTH


def test_waves_have_the_stated_amplitude():
    for seed in (0.1, 0.5, 0.9):
        height = np.abs(blade(seed=seed, margin_wave_m=0.004, margin_waves=4.0).vertices[..., 2])
        assert 0.002 < height.max() < 0.02


@pytest.mark.parametrize("height", [0.001, 0.003])
def test_bulges_have_the_stated_height(height):
    tops = [
        np.percentile(blade(seed=seed, blister_m=height, detail=2.0).vertices[..., 2], 98)
        for seed in (0.1, 0.5, 0.9)
    ]
    assert np.mean(tops) == pytest.approx(height, rel=0.4)


def test_vein_formulas_have_their_inverses():
    number, out = np.meshgrid(np.linspace(0.0, 7.0, 15), np.linspace(0.0, 1.0, 9))
    origin = vein_origin(number)
    np.testing.assert_allclose(origin_of_vein_at(origin + vein_rise(origin, out), out), origin, atol=1e-12)
    assert vein_number(float(vein_origin(np.array(3.5)))) == pytest.approx(3.5)


@pytest.mark.parametrize("width", [0.06, WIDTH])
def test_bulges_rise_between_the_veins_of_the_material(width):
    """Veins as the material grows them on its own leaf, found on the mesh through uv."""
    distance_mm = np.mean(
        [grow_veins((112.0, 135.0), np.random.default_rng(k), 128).secondary_mm for k in range(24)], axis=0
    )
    for seed in (0.2, 0.5):
        made = blade(blister_m=0.002, vein_m=0.0006, detail=3.0, seed=seed, width_m=width)
        (u, v), height = made.uv[0].T, made.vertices[0, :, 2]
        away = distance_mm[(v * 127.99).astype(int), (u * 127.99).astype(int)]
        inner = (np.abs(u - 0.5) > 0.1) & (np.abs(u - 0.5) < 0.3) & (v > 0.3) & (v < 0.8)
        low, high = np.percentile(away[inner], [20, 80])
        assert height[inner & (away >= high)].mean() > height[inner & (away <= low)].mean() + 0.0005


def test_coarse_blades_bulge_too():
    coarse, fine = (blade(blister_m=0.002, detail=d).vertices[..., 2].max() for d in (0.4, 2.0))
    assert coarse > 0.5 * fine


def test_veins_are_sunken():
    depth = blade(vein_m=0.001, detail=2.0).vertices[..., 2] - blade(detail=2.0).vertices[..., 2]
    assert -0.001 < depth.min() < -0.0004
    assert depth.max() < 1e-6


# --- variety ----------------------------------------------------------------------------------------------


def test_state_has_its_mean_and_spread():
    made = mesh_blades([organ(seed=seed) for seed in np.linspace(0.0, 0.95, 30)], 1.0)
    assert abs(made.state.mean() - 0.6) < 0.03
    assert 0.05 < made.state.std(axis=1).mean() < 0.12


def test_grid_noise_is_the_sum_of_its_waves():
    """Against the plain sum of cosines, wave by wave."""
    grid, seed = blade_grid(0.5, 0.0), np.array([0.3, 0.8])
    origin = np.linspace(0.0, 1.0, len(grid.number))
    noise = grid_noise(type("Flat", (), {"origin": origin, "grid": grid, "seed": seed}), 50, 0.7)
    for k in range(2):
        total = np.zeros((len(origin), len(grid.across)))
        for wave in range(8):
            angle, size, phase = (hash_uniform(seed, 50 + salt, 8)[k, wave] for salt in range(3))
            number = 2.0 * np.pi / 0.7 * (1.0 + 0.4 * (2.0 * size - 1.0))
            x = number * np.cos(2.0 * np.pi * angle) * grid.across
            y = number * np.sin(2.0 * np.pi * angle) * 2.0 * origin
            total += np.cos(x[None, :] + y[:, None] + 2.0 * np.pi * phase)
        np.testing.assert_allclose(noise[k], total * np.sqrt(2.0 / 8), atol=1e-9)


def test_every_seed_gives_another_blade():
    """Same measures, other seeds: more than a rigid motion apart."""
    same = {name: mean for name, (mean, _) in KAITE.items()}
    made = mesh_blades([organ(droop(0.6), **same, seed=seed) for seed in (0.1, 0.11, 0.5)], 1.0).vertices
    for one, other in ((0, 1), (1, 2), (0, 2)):
        a, b = (made[k] - made[k].mean(axis=0) for k in (one, other))
        rotation, _ = Rotation.align_vectors(a, b)
        assert np.sqrt(np.mean(np.sum((a - rotation.apply(b)) ** 2, axis=1))) > 0.001


def test_usual_blades_do_not_intersect_themselves():
    """Edges of the triangles against all others that share no vertex with them."""
    rng = np.random.default_rng(21)
    made = mesh_blades([living(rng) for _ in range(6)], 0.5)
    assert sum(self_intersections(vertices, made.faces) for vertices in made.vertices) == 0


def self_intersections(vertices, faces):
    """Number of pairs of an edge and a triangle that meet away from a vertex (Moeller & Trumbore 1997)."""
    sides = np.unique(np.sort(edges(faces), axis=1), axis=0)
    low, high = vertices[faces].min(axis=1), vertices[faces].max(axis=1)
    start, end = vertices[sides[:, 0]], vertices[sides[:, 1]]
    near = np.all(
        (np.minimum(start, end)[:, None] <= high) & (np.maximum(start, end)[:, None] >= low), axis=2
    )
    near &= ~(faces[None, :, :, None] == sides[:, None, None, :]).any(axis=(2, 3))
    side, face = np.nonzero(near)
    a, b, c = (vertices[faces[face, k]] for k in range(3))
    origin, way = start[side], end[side] - start[side]
    ab, ac = b - a, c - a
    p = np.cross(way, ac)
    determinant = np.sum(ab * p, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.sum((origin - a) * p, axis=1) / determinant
        q = np.cross(origin - a, ab)
        v = np.sum(way * q, axis=1) / determinant
        t = np.sum(ac * q, axis=1) / determinant
    return int(np.sum((u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t >= 0.0) & (t <= 1.0)))
