"""Properties of every surface of the plant and of the greenhouse, from 300 to 1100 nm."""

import numpy as np
import pytest
from plant_colours import at, lab, lab_hue

from pepperscene.cultivar import Cultivar, load_cultivar
from pepperscene.cultivar.organs import DEFAULT_KINDS
from pepperscene.materials import greenhouse_surfaces, leaf_body, organ_surfaces, organs, rind_reflectance
from pepperscene.materials.leaf import leaf_surface

ORGANS = {"leaf", "petiole", "stem", "fruit", "peduncle", "calyx", "cut"}
DRY = {"dry_shoot"}
GREENHOUSE = set(greenhouse_surfaces(np.array([550.0])))
GREEN = ["stem", "petiole", "peduncle", "calyx"]
MAPS = ("pattern", "relief_mm", "residue_pattern", "ageing_order")


def test_makes_every_surface_that_meshes_name(surfaces, nm):
    assert set(surfaces) == ORGANS | DRY | GREENHOUSE
    assert {kind.surface for form, kind in DEFAULT_KINDS.items() if form != "flower"} == ORGANS
    for name, surface in surfaces.items():
        assert surface.name == name
        assert surface.wavelength_nm.tolist() == nm.tolist()


def test_conserves_energy_and_only_leaves_transmit(surfaces):
    for name, surface in surfaces.items():
        assert np.isfinite(surface.reflectance).all(), name
        assert (surface.reflectance + surface.transmittance[:, None]).max() <= 1 + 1e-9, name
        assert min(surface.reflectance.min(), surface.transmittance.min()) >= 0, name
        assert (surface.transmittance.max() > 0) == (name == "leaf")


@pytest.mark.parametrize("name", ["fruit", *GREEN])
def test_table_of_a_rind_follows_the_pigments(surfaces, kaite, nm, name):
    """Rows are the model at the mixed pigments; linear interpolation between them is within .002 of it."""
    rows, path = surfaces[name].reflectance, kaite.pigments[name]
    states = np.linspace(0, 1, len(rows))
    assert rows[:, 0] == pytest.approx(rind_reflectance(path, nm, states), abs=1e-12)
    assert np.array_equal(rows[:, 0], rows[:, 1])
    midpoints = 0.5 * (states[1:] + states[:-1])
    error = 0.5 * (rows[1:, 0] + rows[:-1, 0]) - rind_reflectance(path, nm, midpoints)
    assert np.abs(error).max() < 0.002
    # A knot of the path may be anywhere between two rows.
    for state, _ in path.path:
        assert at(rows[:, 0], state) == pytest.approx(rind_reflectance(path, nm, state)[0], abs=0.002)


def test_tables_of_the_leaf_follow_the_pigments(surfaces, kaite, nm):
    """As above, for both sides and for the transmittance."""
    leaf = surfaces["leaf"]
    states = np.linspace(leaf.first_state, 1, len(leaf.reflectance))
    assert leaf.first_state == -1
    tables = leaf.reflectance[:, 0], leaf.reflectance[:, 1], leaf.transmittance
    exact = leaf_body(kaite.pigments["leaf"], nm, states)
    between = leaf_body(kaite.pigments["leaf"], nm, 0.5 * (states[1:] + states[:-1]))
    for table, rows, midpoints in zip(tables, exact, between, strict=True):
        assert table == pytest.approx(rows, abs=1e-12)
        assert np.abs(0.5 * (table[1:] + table[:-1]) - midpoints).max() < 0.002


def test_organs_are_bright_in_the_near_infrared(surfaces, nm):
    """Neither pigment nor much water absorbs there; thick organs show the water band at 970 nm."""
    plateau, band, past = (nm >= 800) & (nm <= 900), nm == 970, nm == 1070
    for name in ORGANS - {"cut"}:
        surface = surfaces[name]
        total = surface.reflectance + surface.transmittance[:, None]
        # Dry tissue of leaves has no water and much brown, so it is left out.
        healthy = np.linspace(surface.first_state, 1, len(total)) >= 0
        total, reflectance = total[healthy], surface.reflectance[healthy]
        least = 0.85 if name == "leaf" else 0.42
        assert total[..., plateau].min() > least, name
        assert np.all(total[..., band] < total[..., past]), name
        assert np.all(reflectance[..., nm == 800] > reflectance[..., nm == 550]), name


def test_green_organs_have_the_hue_and_lightness_of_photographs(surfaces, nm):
    for name in ("leaf", *GREEN):
        table, first = surfaces[name].reflectance[:, 0], surfaces[name].first_state
        assert 95 < lab_hue(at(table, 0.6, first), nm) < 145
        assert lab(at(table, 1, first), nm)[0] < lab(at(table, 0.5, first), nm)[0]

    def lightness(name, state=0.6):
        return lab(at(surfaces[name].reflectance[:, 0], state, surfaces[name].first_state), nm)[0]

    # From light to dark: petiole, peduncle, calyx, leaf; and the unripe fruit.
    order = [lightness(name) for name in ("petiole", "peduncle", "calyx", "leaf")]
    assert np.all(np.diff(order) < -3)
    assert lightness("peduncle") > lightness("fruit", 0) + 15


def test_patterns_change_most_states_by_less_than_a_quarter(surfaces):
    for name, surface in surfaces.items():
        # The strands of twine are a structure, not a variation.
        if surface.pattern is None or name == "twine":
            continue
        assert surface.pattern.dtype == np.float32
        assert abs(np.median(surface.pattern)) < 0.08, name
        assert np.mean(np.abs(surface.pattern) < 0.25) > 0.9, name


def test_fruit_and_tubes_have_no_seam(surfaces):
    """The pattern's step across u = 1 -> 0 is like any other step."""
    for name in ("fruit", *GREEN):
        pattern = surfaces[name].pattern
        inside = np.abs(np.diff(pattern, axis=2)).mean()
        assert np.abs(pattern[:, :, 0] - pattern[:, :, -1]).mean() < 3 * inside, name


def test_textures_of_fruit_and_green_organs_differ(surfaces):
    """Stacks of four to eight, of at most 256 x 256, of which no two are correlated."""
    for name in ("fruit", *GREEN, "cut"):
        for images in (surfaces[name].pattern, surfaces[name].relief_mm):
            if images is None:
                continue
            assert 4 <= len(images) <= 8
            assert max(images.shape[1:]) <= 256
            assert images.dtype == np.float32
            correlation = np.corrcoef(images.reshape(len(images), -1)) - np.eye(len(images))
            assert np.abs(correlation).max() < 0.2, name


def test_makes_only_the_surfaces_of_kinds_that_grow(nm):
    tomato = load_cultivar("tomato")
    surfaces = organ_surfaces(tomato, nm)
    assert set(surfaces) == {"leaf", "petiole", "stem", "fruit", "peduncle", "calyx", "petal"}
    petal = surfaces["petal"]
    assert (petal.reflectance + petal.transmittance[:, None]).max() <= 1 + 1e-9
    assert petal.transmittance.max() > 0.1
    # Tomato petals are yellow; those of sweet pepper nearly white, and brighter.
    assert 75 < lab_hue(petal.reflectance[-1, 0], nm) < 110
    path = load_cultivar("kaite_february").pigments["petal"]
    white = leaf_surface("petal", path, nm).reflectance[-1, 0]
    lightness, *ab = lab(white, nm)
    assert np.hypot(*ab) < 15
    assert lightness > lab(petal.reflectance[-1, 0], nm)[0]


def test_changed_organs_have_changed_surfaces(surfaces, kaite, nm):
    """A second kind of leaf with its own pigments has its own pattern, `relief` scales heights, and a coarse
    grid samples the fine one."""
    young = kaite.organs["shoot_lamina"].model_copy(update={"surface": "young_leaf"})
    lamina = kaite.organs["lamina"].model_copy(update={"relief": 0.5})
    cultivar = kaite.model_copy(
        update={
            "organs": kaite.organs | {"shoot_lamina": young, "lamina": lamina},
            "pigments": kaite.pigments | {"young_leaf": kaite.pigments["leaf"]},
        }
    )
    changed = organ_surfaces(cultivar, nm[::8])
    assert changed["young_leaf"].name == "young_leaf"
    assert changed["young_leaf"].reflectance.tobytes() == changed["leaf"].reflectance.tobytes()
    assert not np.array_equal(changed["young_leaf"].pattern, changed["leaf"].pattern)
    np.testing.assert_array_equal(changed["leaf"].relief_mm, 0.5 * surfaces["leaf"].relief_mm)
    for name, surface in (changed | greenhouse_surfaces(nm[::8])).items():
        expected = surfaces[name.removeprefix("young_")].reflectance[..., ::8]
        assert surface.reflectance == pytest.approx(expected, abs=1e-12)


def test_ribs_run_along_the_organ_and_are_gentle(surfaces, kaite):
    """Slopes are steeper around than along, and below 30 degrees almost everywhere."""
    sizes = {name: kaite.organs[name].distributions for name in ("petiole", "internode", "peduncle")}
    girth_m = {
        "petiole": np.pi * sizes["petiole"]["diameter"].mean,
        "stem": np.pi * kaite.stem.diameter.mean,
        "peduncle": np.pi * sizes["peduncle"]["diameter"].mean,
    }
    for (name, girth), size in zip(girth_m.items(), sizes.values(), strict=True):
        relief = surfaces[name].relief_mm
        around = np.gradient(relief, axis=2) * relief.shape[2] / (1e3 * girth)
        along = np.gradient(relief, axis=1) * relief.shape[1] / (1e3 * size["length"].mean)
        assert np.std(around) > 3 * np.std(along), name
        assert np.mean(np.abs(around) < np.tan(np.radians(30))) > 0.98, name


def test_is_deterministic_and_independent_of_threads(surfaces, kaite: Cultivar, nm):
    serial = {}
    for kind in kaite.present_kinds:
        name = kaite.kinds[kind].surface
        if name not in serial:
            serial[name] = organs._organ_surface(kaite, kind, name, nm)
    for name, surface in (serial | greenhouse_surfaces(nm)).items():
        for field in ("reflectance", "transmittance", *MAPS):
            assert np.array_equal(getattr(surface, field), getattr(surfaces[name], field)), (name, field)
