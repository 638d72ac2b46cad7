"""Properties of every surface of the plant and of the greenhouse, from 300 to 1100 nm; stems and stalks."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from plant_colours import at, lab, lab_hue

from pepperscene.cultivar import Cultivar, load_cultivar
from pepperscene.cultivar.organs import DEFAULT_KINDS
from pepperscene.materials import Surface, greenhouse_surfaces, leaf_body, organs, rind_reflectance
from pepperscene.materials.leaf import leaf_surface
from pepperscene.materials.leaf_textures import leaf_textures
from pepperscene.materials.surface import rind_contents
from pepperscene.spectra import read_spectra, read_spectrum

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
    def lightness(name, state=0.6):
        return lab(at(surfaces[name].reflectance[:, 0], state, surfaces[name].first_state), nm)[0]

    for name in ("leaf", *GREEN):
        table, first = surfaces[name].reflectance[:, 0], surfaces[name].first_state
        assert 95 < lab_hue(at(table, 0.6, first), nm) < 145
        assert lightness(name, 1) < lightness(name, 0.5)
    # From light to dark: petiole, peduncle, calyx, leaf; and the unripe fruit.
    order = [lightness(name) for name in ("petiole", "peduncle", "calyx", "leaf")]
    assert np.all(np.diff(order) < -3)
    assert lightness("peduncle") > lightness("fruit", 0) + 15


def test_textures_of_fruit_and_green_organs_differ_and_have_no_seam(surfaces):
    """Stacks of four to eight, of at most 256 x 256, of which no two are correlated."""
    for name in ("fruit", *GREEN, "cut"):
        for images in filter(np.ndim, (surfaces[name].pattern, surfaces[name].relief_mm)):
            assert 4 <= len(images) <= 8
            assert max(images.shape[1:]) <= 256
            assert images.dtype == np.float32
            correlation = np.corrcoef(images.reshape(len(images), -1)) - np.eye(len(images))
            assert np.abs(correlation).max() < 0.2, name
        if name != "cut":
            # The pattern's step across u = 1 -> 0 is like any other step.
            pattern = surfaces[name].pattern
            inside = np.abs(np.diff(pattern, axis=2)).mean()
            assert np.abs(pattern[:, :, 0] - pattern[:, :, -1]).mean() < 3 * inside, name


def test_petals_transmit_and_have_the_colour_of_their_crop(nm):
    tomato = load_cultivar("tomato")
    names = {tomato.kinds[kind].surface: kind for kind in tomato.present_kinds}
    assert set(names) == {"leaf", "petiole", "stem", "fruit", "peduncle", "calyx", "petal"}
    petal = organs._organ_surface(tomato, names["petal"], "petal", nm)
    assert (petal.reflectance + petal.transmittance[:, None]).max() <= 1 + 1e-9
    assert petal.transmittance.max() > 0.1
    # Tomato petals are yellow; those of sweet pepper nearly white, and brighter.
    assert 75 < lab_hue(petal.reflectance[-1, 0], nm) < 110
    path = load_cultivar("kaite_february").pigments["petal"]
    lightness, *ab = lab(leaf_surface("petal", path, nm).reflectance[-1, 0], nm)
    assert np.hypot(*ab) < 15
    assert lightness > lab(petal.reflectance[-1, 0], nm)[0]


def test_surfaces_depend_on_their_name_and_grid_and_not_on_threads(surfaces, kaite: Cultivar, nm):
    """Another name has another pattern, and a coarse grid of wavelengths samples the fine one."""
    for kind, name in (("petiole", "petiole"), ("peduncle", "peduncle"), ("cut", "cut")):
        serial = organs._organ_surface(kaite, kind, name, nm)
        for field in ("reflectance", "transmittance", *MAPS):
            assert np.array_equal(getattr(serial, field), getattr(surfaces[name], field)), (name, field)
    renamed = kaite.model_copy(update={"pigments": kaite.pigments | {"young": kaite.pigments["petiole"]}})
    young = organs._organ_surface(renamed, "petiole", "young", nm[::8])
    assert young.name == "young"
    assert not np.array_equal(young.pattern, surfaces["petiole"].pattern)
    for name, surface in (greenhouse_surfaces(nm[::8]) | {"petiole": young}).items():
        expected = surfaces[name].reflectance[..., ::8]
        assert surface.reflectance == pytest.approx(expected, abs=1e-12)


def test_relief_of_a_kind_scales_its_heights(surfaces, kaite: Cultivar, nm, monkeypatch):
    monkeypatch.setattr(organs, "leaf_textures", partial(leaf_textures, count=1))
    lamina = kaite.organs["lamina"].model_copy(update={"relief": 0.5})
    low = kaite.model_copy(update={"organs": kaite.organs | {"lamina": lamina}})
    leaf = organs._organ_surface(low, "lamina", "leaf", nm[::8])
    np.testing.assert_array_equal(leaf.relief_mm, 0.5 * surfaces["leaf"].relief_mm[:1])


def test_ribs_run_along_the_organ_and_are_gentle(surfaces, kaite):
    """Slopes are steeper around than along, and below 30 degrees almost everywhere."""
    for name, kind in (("petiole", "petiole"), ("stem", "internode"), ("peduncle", "peduncle")):
        size, relief = kaite.organs[kind].distributions, surfaces[name].relief_mm
        diameter_m = (kaite.stem.diameter if name == "stem" else size["diameter"]).mean
        around = np.gradient(relief, axis=2) * relief.shape[2] / (1e3 * np.pi * diameter_m)
        along = np.gradient(relief, axis=1) * relief.shape[1] / (1e3 * size["length"].mean)
        assert np.std(around) > 3 * np.std(along), name
        assert np.mean(np.abs(around) < np.tan(np.radians(30))) > 0.98, name


RIND = {"chlorophyll", "carotenoids"}


def test_each_surface_has_the_traits_that_it_can_have(surfaces):
    traits = {name: set(surface.contents) for name, surface in surfaces.items() if surface.contents}
    rinds = dict.fromkeys(("petiole", "stem", "dry_shoot", "peduncle", "calyx"), RIND)
    assert traits == {**rinds, "leaf": RIND | {"water"}, "fruit": RIND | {"ripeness"}}
    assert {name for name, surface in surfaces.items() if surface.is_blade} == {"leaf"}


@pytest.mark.parametrize("name", ["leaf", "fruit", "calyx"])
def test_rows_hold_the_contents_of_their_states(kaite, surfaces, name):
    surface, path = surfaces[name], kaite.pigments[name]
    assert surface.states[[0, -1]].tolist() == [-1.0 if name == "leaf" else 0.0, 1.0]
    expected = path.at(surface.states)
    np.testing.assert_array_equal(surface.contents["chlorophyll"], expected["chlorophyll_ug_cm2"])
    np.testing.assert_array_equal(surface.contents["carotenoids"], expected["carotenoid_ug_cm2"])
    if name == "leaf":
        np.testing.assert_array_equal(surface.contents["water"], expected["water_cm"])
        # Dry tissue has lost its water and its pigments.
        assert surface.contents["water"][0] < 0.1 * surface.contents["water"][-1]
    if name == "fruit":
        np.testing.assert_array_equal(
            surface.contents["ripeness"], np.linspace(0.0, 1.0, len(surface.states))
        )


def test_red_carotenoids_of_fruit_count():
    red = load_cultivar("red_blocky").pigments["fruit"]
    (carotenoids,) = rind_contents(red, np.array([1.0]))["carotenoids"]
    assert carotenoids == red.end.carotenoid_ug_cm2 + red.end.capsanthin_ug_cm2
    assert carotenoids > 10.0 * red.end.carotenoid_ug_cm2


@pytest.mark.parametrize("amounts", [np.full(9, np.nan), np.full(9, -1.0), np.ones((9, 1))])
def test_contents_that_do_not_fit_are_rejected(amounts):
    reflectance, transmittance = np.zeros((9, 2, 2)), np.zeros((9, 2))
    surface = Surface("petal", np.array([400.0, 700.0]), reflectance, transmittance)
    assert not surface.contents
    with pytest.raises(ValueError, match="petal: chlorophyll must be 9 finite numbers"):
        replace(surface, contents={"chlorophyll": amounts})


STEMS = "organ/koivisto_plant_stem_reflectance"


@pytest.mark.parametrize("name", ["stem", "petiole", "peduncle", "calyx"])
def test_green_organs_have_the_spectrum_of_a_measured_stem(surfaces, nm, name):
    """Petunia is a nightshade like pepper; the measurement's scale is unknown, and noisy below 420 nm."""
    inside = (nm >= 425) & (nm <= 700)
    measured = read_spectrum(STEMS, "green_rod_petunia_23").at(nm)[inside]
    modelled = at(surfaces[name].reflectance[:, 0], 0.55)[inside]
    assert np.corrcoef(measured, modelled)[0, 1] > 0.95
    # Correlation ignores contrast: compare them scaled to the same mean.
    difference = modelled / modelled.mean() - measured / measured.mean()
    assert np.sqrt(np.mean(difference**2)) < (0.12 if name in ("stem", "petiole") else 0.3)


def test_an_old_stem_is_corky(surfaces, nm):
    """At state 0 it has the spectrum of a dry stalk, not of a green stem: brown, no chlorophyll."""
    inside = (nm >= 425) & (nm <= 700)
    stems, table = read_spectra(STEMS), surfaces["stem"].reflectance[:, 0]
    old = at(table, 0.0)

    def correlation(column):
        return np.corrcoef(stems[column].at(nm)[inside], old[inside])[0, 1]

    assert correlation("light_brown_dry_rod_koiranputki_148") > 0.95
    assert correlation("light_brown_dry_rod_koiranputki_148") > correlation("green_rod_petunia_23") + 0.2
    assert 60 < lab_hue(old, nm) < 95
    assert lab_hue(at(table, 0.6), nm) > 100


def test_a_cut_has_pale_pith_in_a_green_ring_and_dries_to_brown(surfaces, nm):
    dried, pith, ring, bark = surfaces["cut"].reflectance[:, 0]
    assert 50 < lab_hue(dried, nm) < 85
    lightness = [lab(row, nm)[0] for row in (dried, pith, ring, bark)]
    assert lightness[1] > lightness[0] + 5
    assert lightness[1] > lightness[2] + 20
    assert lightness[2] > lightness[3]
    assert 95 < lab_hue(pith, nm) < lab_hue(ring, nm) < 125
    # The visible part of dried pith is the measured one.
    file = "organ/vrhel_wood_bark_straw_reflectance"
    straw, chip = (read_spectrum(file, c) for c in ("straw_from_broom_154", "bark_chip_iii_129"))
    inside = (nm >= 390) & (nm <= 730)
    assert dried[inside] == pytest.approx(0.5 * (straw.at(nm) + chip.at(nm))[inside], abs=1e-12)
    # It continues without a step, and stays below fresh white paper.
    infrared = dried[nm >= 720]
    assert np.all(np.diff(infrared) > 0)
    assert np.abs(np.diff(infrared, 2)).max() < 0.02
    assert infrared[-1] < 0.8


def test_cork_of_a_stem_is_lighter_than_its_fissures(surfaces, nm):
    """Near state .125 an old stem is greyish brown; fissures lower the state and darken it."""
    table, textures = surfaces["stem"].reflectance[:, 0], surfaces["stem"].pattern
    cork, fissure = (lab(at(table, state), nm) for state in (0.125, 0.0))
    assert cork[0] > fissure[0] + 7
    assert np.hypot(*cork[1:]) < 25
    # On a green stem the same decrease is hardly visible.
    assert abs(lab(at(table, 0.65), nm)[0] - lab(at(table, 0.53), nm)[0]) < 3
    # Fissures are narrow: they change a tenth to a third of the surface by more than .08.
    assert 0.1 < np.mean(textures < -0.08) < 0.33
