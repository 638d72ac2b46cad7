"""Spectra of leaves, fruit and greenhouses against models, measurements and values from the literature."""

import numpy as np
import pytest
from plant_colours import at, lab, lab_hue, smooth_gloss
from scipy.integrate import solve_ivp

from pepperscene.camera import load_sensor
from pepperscene.cultivar import load_cultivar
from pepperscene.cultivar.organs import DEFAULT_KINDS
from pepperscene.geometry import mesh_plant
from pepperscene.grammar import Organ, Plant
from pepperscene.materials import (
    flesh_reflectance,
    greenhouse_surfaces,
    leaf_body,
    leaf_optics,
    rind_reflectance,
)
from pepperscene.materials.gloss import cone_gloss, cuticle_transmittance, gloss_albedo
from pepperscene.materials.greenhouse import FILM_SCATTERING, GROUND_REFLECTANCE
from pepperscene.materials.leaf import gloss_lobes
from pepperscene.spectra import (
    absorption_coefficients,
    leaf_spectra,
    read_spectra,
    read_spectrum,
    sky_spectrum,
)
from pepperscene.spectra.prospect import INCIDENCE_CONE_RAD

PALE, MEAN, DARK = 0.25, 0.72, 1.0  # states of a blade; lower ones are the tissue of veins


@pytest.fixture(scope="module")
def leaf(surfaces):
    return surfaces["leaf"]


@pytest.fixture(scope="module")
def spectrum(leaf):
    """Spectrum of a table of the leaf at a state."""
    return lambda table, state: at(table, state, leaf.first_state)


@pytest.fixture(scope="module")
def total(leaf, spectrum, kaite):
    """R above, R below and T of the leaf at a state, gloss included, as an integrating sphere measures.

    For light in PROSPECT's cone of incidence. The part of T that the glossier side sends back is added to the
    reflectance of the other, as the renderer does (docs/explanation/optics.md).
    """
    path = kaite.pigments["leaf"]
    lobes = [(1 - path.wide_share, path.roughness), (path.wide_share, path.wide_roughness)]
    gloss = [sum(w * cone_gloss(path.ior, alpha[k]) for w, alpha in lobes) for k in (0, 1)]
    mean = [sum(w * cuticle_transmittance(path.ior, alpha[k])[1] for w, alpha in lobes) for k in (0, 1)]

    def spectra(state):
        through = spectrum(leaf.transmittance, state)
        sides = []
        for side in (0, 1):
            back = through * (1 - min(mean) / mean[side])
            body = spectrum(leaf.reflectance[:, side], state) + back
            sides.append(gloss[side] + (1 - gloss[side]) * body)
        return (*sides, (1 - gloss[0]) * through * min(mean) / mean[0])

    return spectra


@pytest.mark.parametrize("state", [DARK, 0.0, -1.0])
def test_gloss_and_body_sum_to_prospect(total, kaite, nm, state):
    """At the tables' own rows, where nothing is interpolated."""
    path = kaite.pigments["leaf"]
    leaf = leaf_spectra(nm, **path.at([state]))
    upper, _, transmittance = total(state)
    assert upper == pytest.approx(leaf.reflectance[0], abs=1e-9)
    assert transmittance == pytest.approx(leaf.transmittance[0], abs=1e-9)


@pytest.mark.parametrize("state", [DARK, 0.0])
def test_lower_side_is_an_unpigmented_layer_over_a_leaf(total, kaite, nm, state):
    """Multiple reflection between a layer and a leaf of 60 % of the pigments, summed term by term."""
    contents = kaite.pigments["leaf"].at([state])
    pigments = ("chlorophyll_ug_cm2", "carotenoid_ug_cm2", "anthocyanin_ug_cm2", "brown")
    inner = leaf_spectra(nm, **contents | {name: 0.6 * contents[name] for name in pigments}).reflectance[0]
    layer = 0.04
    expected, through = layer, (1 - layer) ** 2 * inner
    for _ in range(60):
        expected, through = expected + through, through * layer * inner
    assert total(state)[1] == pytest.approx(expected, abs=0.003)


def test_gloss_is_that_of_the_mixture_of_its_lobes(kaite):
    """Half of the area is of either roughness; the cone's mean by the midpoint rule."""
    path = kaite.pigments["leaf"]
    steps = (np.arange(400) + 0.5) / 400 * np.sin(INCIDENCE_CONE_RAD) ** 2
    cosine = np.sqrt(1 - steps)
    expected = 0.5 * sum(gloss_albedo(cosine, 1.45, alpha).mean() for alpha in (0.25, 0.8))
    share = sum(share * cone_gloss(path.ior, alpha) for share, alpha in gloss_lobes(path, 0))
    assert (path.ior, path.wide_share) == (1.45, 0.5)
    assert share == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("name", ["kaite", "tomato"])
def test_no_light_is_made_at_any_wavelength_or_state(name):
    """Complete sheets, healthy and aged, up to 2500 nm, from either side."""
    nm = np.arange(400.0, 2501.0, 10.0)
    for path in load_cultivar(name).pigments.values():
        if path.flesh_reflectance is not None:
            continue
        states = np.linspace(-1.0 if path.ageing else 0.0, 1, 41)
        upper, lower, transmittance = leaf_optics(path, nm, states)
        front, back, through = leaf_body(path, nm, states)
        for sheet in (upper + transmittance, lower + transmittance, front + through, back + through):
            assert sheet.max() <= 1 + 1e-12
        assert min(x.min() for x in (upper, lower, transmittance, front, back, through)) >= 0
        assert np.all(lower[:, nm < 1300] >= upper[:, nm < 1300] - 1e-9)


def channel_ratio(reflectance, nm):
    """Red over green of the sensor under D65, white balanced."""
    response = load_sensor("ueye_ui5250re").quantum_efficiency.at(nm) * sky_spectrum("d65").at(nm) * nm
    red, green, _ = response @ reflectance / response.sum(axis=1)
    return red / green


@pytest.mark.parametrize(("name", "state"), [("kaite", 0.72), ("tomato", 0.65)])
def test_mean_leaf_has_the_hue_of_measured_leaves(name, state, nm):
    """Hue of 103 to 126 and a channel ratio as of the green leaves of Vrhel et al. 1994."""
    state = np.array([state])
    sheet = leaf_optics(load_cultivar(name).pigments["leaf"], nm, state)[0][0]
    visible = (nm >= 400) & (nm <= 780)
    assert 118 < lab_hue(sheet[visible], nm[visible]) < 126
    leaves = [spectrum.at(nm[visible]) for spectrum in read_spectra("leaf/vrhel_leaf_reflectance").values()]
    green = [leaf for leaf in leaves if 103 < lab_hue(leaf, nm[visible]) < 126]
    ratios = [channel_ratio(leaf, nm[visible]) for leaf in green]
    assert len(green) >= 6
    assert min(ratios) < channel_ratio(sheet[visible], nm[visible]) < max(ratios)


# Ranges for green leaves of crops in reviews and handbooks (Woolley 1971, Plant Physiol. 47:656;
# Walter-Shea & Norman 1991 in Myneni & Ross, Photon-Vegetation Interactions; Jacquemoud & Ustin 2019, Leaf
# Optical Properties): upper side, lower side, transmittance.
RANGES = {
    450: ((0.03, 0.08), (0.03, 0.15), (0.0, 0.03)),
    550: ((0.10, 0.20), (0.15, 0.30), (0.08, 0.20)),
    680: ((0.03, 0.07), (0.035, 0.12), (0.0, 0.04)),
    800: ((0.42, 0.52), (0.42, 0.52), (0.40, 0.52)),
}


@pytest.mark.parametrize("state", [PALE, DARK])
def test_blades_are_in_the_ranges_of_the_literature(total, nm, state):
    for wavelength, ranges in RANGES.items():
        for spectrum, (low, high) in zip(total(state), ranges, strict=True):
            assert low <= spectrum[nm == wavelength] <= high


def test_blades_are_among_measured_leaves(leaf, spectrum, nm):
    """Between the minimum and the maximum of thirteen measured leaves, which exclude gloss as well."""
    measured = np.stack([s.at(nm) for s in read_spectra("leaf/vrhel_leaf_reflectance").values()])
    visible = (nm >= 400) & (nm <= 730)
    # The two waxy, dry ones among them do not affect the minimum.
    low, high = measured[:, visible].min(axis=0), measured[:, visible].max(axis=0)
    for state in (PALE, 0.6, 0.8):
        body = spectrum(leaf.reflectance[:, 0], state)[visible]
        assert np.all(body > low - 0.015)
        assert np.all(body < high + 0.01)


def test_a_vein_has_the_spectrum_of_its_pigments(leaf, spectrum, kaite, nm):
    """On the midrib the pattern moves the state, and the spectrum there is PROSPECT's at those pigments.

    The ratio of vein to blade depends on the wavelength, and is nearly 1 in the near infrared.
    """
    column = leaf.pattern.shape[2] // 2
    offset = float(leaf.pattern[0, 200:300, column - 12 : column + 12].min())
    state = np.clip(MEAN + offset, 0, 1)
    vein = spectrum(leaf.reflectance[:, 0], state)
    exact, _, _ = leaf_body(kaite.pigments["leaf"], nm, np.array([state]))
    assert vein == pytest.approx(exact[0], abs=0.002)
    green = spectrum(leaf.reflectance[:, 0], MEAN)
    ratio = vein / green
    assert ratio[nm == 550] > 1.3
    assert ratio[nm == 900] < 1.1
    assert lab(vein, nm)[0] > lab(green, nm)[0] + 5
    assert 100 < lab_hue(vein, nm) < lab_hue(green, nm)


def test_ageing_tissue_turns_yellow_then_pale_brown_and_dry(total, kaite, nm):
    """Hue falls from green over yellow towards orange, chroma falls with drying, and water's band goes."""
    states = np.array([MEAN, 0.0, -0.25, -0.625, -1.0])
    upper = [total(state)[0] for state in states]
    hues = [lab_hue(sheet, nm) for sheet in upper]
    assert np.all(np.diff(hues) < 0)
    assert 85 < hues[2] < 95
    assert 70 < hues[4] < 90
    chroma = [np.hypot(*lab(sheet, nm)[1:]) for sheet in upper]
    assert chroma[4] < 0.7 * chroma[2]
    assert all(lab(sheet, nm)[0] > lab(upper[0], nm)[0] + 15 for sheet in upper[2:])
    # In water's band at 1450 nm a green leaf is dark and a dry one is not.
    wet, dry = leaf_optics(kaite.pigments["leaf"], np.array([1450.0]), np.array([MEAN, -1.0]))[0][:, 0]
    assert wet < 0.25 < 0.45 < dry


@pytest.fixture(scope="module")
def ripening(surfaces):
    return surfaces["fruit"].reflectance[:, 0]


def test_mixes_pigments_not_spectra(ripening, kaite, nm):
    path = kaite.pigments["fruit"]
    middle = at(ripening, 0.5)
    assert middle == pytest.approx(rind_reflectance(path, nm, 0.5)[0], abs=0.002)
    # Half of the chlorophyll still absorbs more than half as much: the mean of the ends is far too bright.
    mean = 0.5 * (ripening[0] + ripening[-1])
    red = (nm >= 620) & (nm <= 690)
    assert np.all(mean[red] - middle[red] > 0.05)
    # On each section of the path contents are linear, and the spectrum is convex.
    for (low, before), (high, after) in zip(path.knots[:-1], path.knots[1:], strict=True):
        state = 0.5 * (low + high)
        for name, amount in path.at(state).items():
            assert amount == pytest.approx(0.5 * (getattr(before, name) + getattr(after, name)))
        ends = rind_reflectance(path, nm, [low, high]).mean(axis=0)
        assert np.all(ends >= rind_reflectance(path, nm, state)[0] - 1e-12)


def with_gloss(name, nm, state):
    """Reflectance of the whole fruit, gloss included, for light in PROSPECT's cone of incidence."""
    path = load_cultivar(name).pigments["fruit"]
    gloss = cone_gloss(path.ior, path.roughness[0])
    return gloss + (1 - gloss) * rind_reflectance(path, nm, state)[0]


@pytest.mark.parametrize("name", ["kaite", "red_blocky", "orange_pointed"])
def test_unripe_fruit_is_dark_green(nm, name):
    for state in (0.0, 0.1):
        lightness, a, b = lab(with_gloss(name, nm, state), nm)
        assert 33 < lightness < 37
        assert 21 < np.hypot(a, b) < 28


def test_ripening_is_monotonic_from_green_to_yellow(ripening, nm):
    spectra = [at(ripening, state) for state in np.linspace(0, 1, 9)]
    hues = [lab_hue(spectrum, nm) for spectrum in spectra]
    assert 105 < hues[0] < 125
    assert 78 < hues[-1] < 90
    assert np.all(np.diff(hues) < 0)
    assert np.all(np.diff([lab(spectrum, nm)[0] for spectrum in spectra]) > 0)


def test_ripe_fruit_has_measured_hues(nm):
    """Ripe red and yellow greenhouse peppers: 29.9 and 87.5 degrees in CIELAB, gloss included.

    Molinari et al. 1999, Proc. Fla. State Hort. Soc. 112:143-146. Orange is half-way, and a tomato between.
    """
    hue, gloss = {}, smooth_gloss(1.45)
    for name in ("red_blocky", "tomato", "orange_pointed", "kaite"):
        body = rind_reflectance(load_cultivar(name).pigments["fruit"], nm, 1.0)[0]
        hue[name] = lab_hue((1 - gloss) * body + gloss, nm)
    assert hue["red_blocky"] == pytest.approx(29.9, abs=3)
    assert hue["kaite"] == pytest.approx(87.5, abs=7)
    assert hue["orange_pointed"] == pytest.approx(0.5 * (29.9 + 87.5), abs=5)
    assert hue["red_blocky"] + 5 < hue["tomato"] < hue["orange_pointed"] - 5
    # A breaker is hardly lighter than a red fruit, and between green and red in hue.
    path = load_cultivar("red_blocky").pigments["fruit"]
    start, middle, end = rind_reflectance(path, nm, [0.0, 0.5, 1.0])
    assert lab_hue(end, nm) < lab_hue(middle, nm) < lab_hue(start, nm)
    assert lab(middle, nm)[0] < lab(end, nm)[0] + 5


def test_cucumbers_are_dark_green_and_eggplants_nearly_black(nm):
    """At harvest size, gloss included. A young cucumber is lighter and yellower, an eggplant more purple."""
    young, ready = (with_gloss("cucumber", nm, state) for state in (0.0, 1.0))
    lightness, a, b = lab(ready, nm)
    assert 34 < lightness < 40
    assert 18 < np.hypot(a, b) < 30
    assert 120 < lab_hue(ready, nm) < 140
    assert lab(young, nm)[0] > lightness + 5
    assert lab_hue(young, nm) < lab_hue(ready, nm)
    young, ready = (lab(with_gloss("eggplant", nm, state), nm) for state in (0.0, 1.0))
    assert ready[0] < 27
    assert np.hypot(*ready[1:]) < 8
    assert young[1] > ready[1] + 3


def test_flesh_follows_kubelka_and_munk(nm):
    """(1 - R)^2 / 2 R is that of dry flesh plus 2 mu_a / S, for water by PROSPECT's coefficient."""
    wet = flesh_reflectance(0.66, nm)
    added = (1 - wet) ** 2 / (2 * wet) - (1 - 0.66) ** 2 / (2 * 0.66)
    assert added / absorption_coefficients(nm)["water"] == pytest.approx(2 * 0.9 / 7.5, rel=1e-6)
    assert wet[nm <= 650] == pytest.approx(0.66, abs=2e-3)
    assert 0.45 < wet[nm == 970] < 0.6
    assert flesh_reflectance(0.0, nm).max() == 0


def test_a_breaker_colours_unevenly(surfaces, ripening, nm):
    """The mesh's gradient and the surface's noise together spread the hue over a turning fruit."""
    measures = {
        "length_m": 0.087, "diameter_m": 0.084, "lobes": 4.0, "lobe_depth": 1.0, "shoulder": 0.5,
        "taper": 0.83, "ripeness": 0.5, "ripeness_spread": 0.08, "seed": 0.3,
    }  # fmt: skip
    curve = np.array([[0, 0, 0], [0, 0, -0.04], [0, 0, -0.087]], dtype=float)
    fruit = Organ("fruit", -1, 3, curve, np.array([1.0, 0, 0]), measures)
    mesh = mesh_plant(Plant("kaite", (fruit,), DEFAULT_KINDS))
    shoulder, blossom_end = mesh.uv[:, 1] < 0.35, mesh.uv[:, 1] > 0.75
    # A gradient from the shoulders to the blossom end.
    assert mesh.state[blossom_end].mean() - mesh.state[shoulder].mean() > 0.05
    # Patches: states differ at one height as well.
    assert mesh.state[(mesh.uv[:, 1] > 0.5) & (mesh.uv[:, 1] < 0.6)].std() > 0.01
    rows = (mesh.uv[:, 1] * 255).astype(int), (mesh.uv[:, 0] * 255).astype(int)
    for pattern in surfaces["fruit"].pattern:
        states = np.clip(mesh.state + pattern[rows], 0, 1)
        low, high = (lab_hue(at(ripening, state), nm) for state in np.percentile(states, [5, 95]))
        assert low - high > 10


WHITE = ("gutter", "foil", "floor_film", "pipe")


def test_all_but_wire_and_substrate_are_nearly_white(surfaces, nm):
    assert set(greenhouse_surfaces(nm)) == {*WHITE, "twine", "steel", "rockwool"}
    for name in WHITE:
        lightness, a, b = lab(surfaces[name].reflectance[0, 0], nm)
        assert lightness > 85, name
        assert np.hypot(a, b) < 8, name
        # Paint is dark in the ultraviolet only.
        assert surfaces[name].reflectance[0, 0][nm <= 380].max() < 0.25
        assert surfaces[name].reflectance[0, 0][nm >= 430].min() > 0.55
    furrow, crown = (lab(row, nm) for row in surfaces["twine"].reflectance[:, 0])
    assert 80 < crown[0] < 88
    assert furrow[0] < crown[0] - 10
    assert max(np.hypot(*furrow[1:]), np.hypot(*crown[1:])) < 5


def test_twine_is_laid_of_three_strands(surfaces):
    """Three periods around, nine along fifteen diameters: each strand turns once in five diameters."""
    for images in (surfaces["twine"].pattern, surfaces["twine"].relief_mm):
        power = np.abs(np.fft.fft2(images[0] - images[0].mean())) ** 2
        row, column = np.unravel_index(np.argmax(power), power.shape)
        height, width = power.shape
        assert (min(row, height - row), min(column, width - column)) == (9, 3)
        # The helix repeats without a step where v jumps from 1 to 0.
        inside = np.abs(np.diff(images[0], axis=0)).mean()
        assert np.abs(images[0, 0] - images[0, -1]).mean() < 2 * inside
    # Crowns are high and light, furrows low and dark.
    pattern, relief = surfaces["twine"].pattern, surfaces["twine"].relief_mm
    low, high = np.percentile(relief, [20, 80])
    assert pattern[relief > high].mean() > pattern[relief < low].mean() + 0.4


def test_the_floor_solves_the_equations_of_kubelka_and_munk(surfaces, nm):
    """The closed form solves dR/dx = S - 2 (K + S) R + S R^2, from the ground up through the layer."""
    paint = read_spectrum("chart/colorchecker_iso17321_1", "white_9_5_05_d", outside="hold").at(nm)
    scattering = FILM_SCATTERING * 550 / nm
    absorption = scattering * (1 - paint) ** 2 / (2 * paint)

    def rate(depth, r):
        return scattering - 2 * (absorption + scattering) * r + scattering * r**2

    ground = np.full(nm.size, GROUND_REFLECTANCE)
    reflectance = solve_ivp(rate, (0, 1), ground, rtol=1e-9, atol=1e-10).y[:, -1]
    assert surfaces["floor_film"].reflectance[0, 0] == pytest.approx(reflectance, abs=1e-6)


def test_zinc_is_neutral_grey_and_wet_stone_wool_dark_brown(surfaces, nm):
    lightness, a, b = lab(surfaces["steel"].reflectance[0, 0], nm)
    assert 55 < lightness < 75
    assert np.hypot(a, b) < 1
    lightness, a, b = lab(surfaces["rockwool"].reflectance[0, 0], nm)
    assert lightness < 50
    # Between red and yellow.
    assert 0 < np.degrees(np.arctan2(b, a)) < 90
    assert np.hypot(a, b) > 8
