"""What holds for every surface of the plant and of the greenhouse, from 300 to 1100 nm."""

import numpy as np
import pytest
from plant_colours import at, lab, lab_hue

from pepperscene.cultivar import load_cultivar
from pepperscene.cultivar.organs import USUAL
from pepperscene.materials import greenhouse_surfaces, leaf_body, organ_surfaces, organs, rind_reflectance

ORGANS = {"leaf", "petiole", "stem", "fruit", "peduncle", "calyx", "cut"}
GREENHOUSE = set(greenhouse_surfaces(np.array([550.0])))
GREEN = ["stem", "petiole", "peduncle", "calyx"]


def test_every_surface_that_meshes_name_is_there(surfaces, nm):
    assert set(surfaces) == ORGANS | GREENHOUSE
    assert {kind.surface for form, kind in USUAL.items() if form != "flower"} == ORGANS
    for name, surface in surfaces.items():
        assert surface.name == name
        assert surface.wavelength_nm.tolist() == nm.tolist()


def test_nothing_gives_more_than_it_gets(surfaces):
    for name, surface in surfaces.items():
        assert np.isfinite(surface.reflectance).all(), name
        assert (surface.reflectance + surface.transmittance[:, None]).max() <= 1 + 1e-9, name
        assert min(surface.reflectance.min(), surface.transmittance.min()) >= 0, name


@pytest.mark.parametrize("name", ["fruit", *GREEN])
def test_rows_and_what_lies_between_them_follow_the_pigments(surfaces, kaite, nm, name):
    """The table is linear between rows; everywhere it is the model at the mixed pigments within .002."""
    rows, path = surfaces[name].reflectance, kaite.pigments[name]
    known = np.linspace(0, 1, len(rows))
    assert rows[:, 0] == pytest.approx(rind_reflectance(path, nm, known), abs=1e-12)
    assert np.array_equal(rows[:, 0], rows[:, 1])
    middles = 0.5 * (known[1:] + known[:-1])
    error = 0.5 * (rows[1:, 0] + rows[:-1, 0]) - rind_reflectance(path, nm, middles)
    assert np.abs(error).max() < 0.002
    # A knot of the path may lie anywhere between two rows.
    for state, _ in path.path:
        assert at(rows[:, 0], state) == pytest.approx(rind_reflectance(path, nm, state)[0], abs=0.002)


def test_rows_of_the_leaf_follow_the_pigments(surfaces, kaite, nm):
    """As above, for both sides and for the transmittance."""
    leaf = surfaces["leaf"]
    known = np.linspace(0, 1, len(leaf.reflectance))
    tables = leaf.reflectance[:, 0], leaf.reflectance[:, 1], leaf.transmittance
    exact = leaf_body(kaite.pigments["leaf"], nm, known)
    between = leaf_body(kaite.pigments["leaf"], nm, 0.5 * (known[1:] + known[:-1]))
    for table, rows, middles in zip(tables, exact, between, strict=True):
        assert table == pytest.approx(rows, abs=1e-12)
        assert np.abs(0.5 * (table[1:] + table[:-1]) - middles).max() < 0.002


def test_only_leaves_let_light_through(surfaces):
    for name, surface in surfaces.items():
        assert (surface.transmittance.max() > 0) == (name == "leaf")


def test_organs_are_bright_in_the_near_infrared(surfaces, nm):
    """Neither pigment nor much water absorbs there; at 970 nm the water band is seen in what is thick."""
    plateau, band, past = (nm >= 800) & (nm <= 900), nm == 970, nm == 1070
    for name in ORGANS - {"cut"}:
        surface = surfaces[name]
        given = surface.reflectance + surface.transmittance[:, None]
        floor = 0.85 if name == "leaf" else 0.42
        assert given[..., plateau].min() > floor, name
        assert np.all(given[..., band] < given[..., past]), name
        assert np.all(surface.reflectance[..., nm == 800] > surface.reflectance[..., nm == 550]), name


def test_colours(surfaces, nm):
    for name in ("leaf", *GREEN):
        table = surfaces[name].reflectance[:, 0]
        assert 95 < lab_hue(at(table, 0.6), nm) < 145
        # Dark green is darker than the middle.
        assert lab(at(table, 1), nm)[0] < lab(at(table, 0.5), nm)[0]

    def lightness(name, state=0.6):
        return lab(at(surfaces[name].reflectance[:, 0], state), nm)[0]

    # From light to dark as in photographs: petiole, peduncle, calyx, leaf; and the unripe fruit.
    order = [lightness(name) for name in ("petiole", "peduncle", "calyx", "leaf")]
    assert np.all(np.diff(order) < -3)
    assert lightness("peduncle") > lightness("fruit", 0) + 15


def test_patterns_keep_their_state_on_average(surfaces):
    """Most of a surface stays within a tenth of the state that it was given."""
    for name, surface in surfaces.items():
        if surface.pattern is None:
            continue
        assert surface.pattern.dtype == np.float32
        assert abs(np.median(surface.pattern)) < 0.08, name
        assert np.mean(np.abs(surface.pattern) < 0.25) > 0.9, name


def test_fruit_and_tubes_have_no_seam_around(surfaces):
    """The pattern's step across u = 1 -> 0 is like any other step."""
    for name in ("fruit", *GREEN):
        pattern = surfaces[name].pattern
        inside = np.abs(np.diff(pattern, axis=1)).mean()
        assert np.abs(pattern[:, 0] - pattern[:, -1]).mean() < 3 * inside, name


def test_a_crop_has_the_surfaces_of_its_kinds(nm):
    """Flowers cost petals only where they grow, and a surface is made like the bodies that have it."""
    tomato = load_cultivar("tomato")
    found = organ_surfaces(tomato, nm)
    assert set(found) == {"leaf", "petiole", "stem", "fruit", "peduncle", "calyx", "petal"}
    petal = found["petal"]
    assert (petal.reflectance + petal.transmittance[:, None]).max() <= 1 + 1e-9
    assert petal.transmittance.max() > 0.1
    # Tomato petals are yellow; those of sweet pepper nearly white, and brighter.
    assert 75 < lab_hue(petal.reflectance[-1, 0], nm) < 110
    white = organ_surfaces(load_cultivar("kaite_february"), nm)["petal"].reflectance[-1, 0]
    lightness, *ab = lab(white, nm)
    assert np.hypot(*ab) < 15
    assert lightness > lab(petal.reflectance[-1, 0], nm)[0]


def test_a_surface_goes_by_any_name(kaite, nm):
    """A second kind of leaf, with pigments of its own, is a leaf; its pattern is its own."""
    organs = kaite.organs | {
        "shoot_lamina": kaite.organs["shoot_lamina"].model_copy(update={"surface": "young_leaf"})
    }
    pigments = kaite.pigments | {"young_leaf": kaite.pigments["leaf"]}
    found = organ_surfaces(kaite.model_copy(update={"organs": organs, "pigments": pigments}), nm)
    assert found["young_leaf"].name == "young_leaf"
    assert found["young_leaf"].reflectance.tobytes() == found["leaf"].reflectance.tobytes()
    assert not np.array_equal(found["young_leaf"].pattern, found["leaf"].pattern)


def test_ribs_run_along_and_are_gentle(surfaces, kaite):
    """Slopes are steeper around than along, and below 30 degrees on all but a few places."""
    girths_mm = {
        "petiole": kaite.organs["petiole"].laws["diameter"].mean,
        "stem": kaite.stem.diameter.mean,
        "peduncle": kaite.organs["peduncle"].laws["diameter"].mean,
    }
    for name, diameter_m in girths_mm.items():
        relief = surfaces[name].relief_mm
        around = np.gradient(relief, axis=1) * relief.shape[1] / (1e3 * np.pi * diameter_m)
        along = np.gradient(relief, axis=0) * relief.shape[0] / (1e3 * np.pi * diameter_m)
        assert np.std(around) > 3 * np.std(along), name
        assert np.mean(np.abs(around) < np.tan(np.radians(30))) > 0.98, name


def test_same_cultivar_same_surfaces(surfaces, kaite, nm):
    again = organ_surfaces(kaite, nm) | greenhouse_surfaces(nm)
    for name, surface in again.items():
        assert surface.reflectance.tobytes() == surfaces[name].reflectance.tobytes()
        if surface.pattern is not None:
            assert surface.pattern.tobytes() == surfaces[name].pattern.tobytes()


def test_a_coarse_grid_is_the_fine_one_sampled(surfaces, kaite, nm):
    coarse = organ_surfaces(kaite, nm[::8]) | greenhouse_surfaces(nm[::8])
    for name, surface in coarse.items():
        assert surface.reflectance == pytest.approx(surfaces[name].reflectance[..., ::8], abs=1e-12)


def test_surfaces_made_side_by_side_are_those_made_one_by_one(kaite):
    nm = np.arange(400.0, 801.0, 50.0)
    for name, found in organ_surfaces(kaite, nm).items():
        kind = next(kind for kind in kaite.grown if kaite.kinds[kind].surface == name)
        alone = organs._surface(kaite, kind, name, nm)
        for part in ("reflectance", "transmittance", "pattern", "relief_mm"):
            assert np.array_equal(getattr(found, part), getattr(alone, part)), (name, part)
