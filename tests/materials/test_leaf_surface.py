"""The leaf's surface against PROSPECT, measured leaves and values from the literature."""

import numpy as np
import pytest
from plant_colours import at, lab, lab_hue

from pepperscene.camera import load_sensor
from pepperscene.cultivar import load_cultivar
from pepperscene.materials import leaf_body, leaf_optics
from pepperscene.materials.gloss import cone_gloss, cuticle_transmittance, gloss_albedo
from pepperscene.materials.leaf import gloss_lobes
from pepperscene.spectra import leaf_spectra, read_spectra, sky_spectrum
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
