"""The leaf's surface against PROSPECT, measured leaves and values from the literature."""

import numpy as np
import pytest
from plant_colours import at, lab, lab_hue

from pepperscene.materials import leaf_body
from pepperscene.materials.gloss import cone_gloss
from pepperscene.spectra import leaf_spectra, read_spectra

PALE, DARK = 0.25, 1.0  # states of a blade; lower ones are the tissue of veins


@pytest.fixture(scope="module")
def leaf(surfaces):
    return surfaces["leaf"]


@pytest.fixture(scope="module")
def total(surfaces, kaite):
    """R above, R below and T of the leaf at a state, gloss included, as an integrating sphere measures."""
    path, leaf = kaite.pigments["leaf"], surfaces["leaf"]
    gloss = [cone_gloss(path.ior, alpha) for alpha in path.roughness]

    def spectra(state):
        sides = [gloss[s] + (1 - gloss[s]) * at(leaf.reflectance[:, s], state) for s in (0, 1)]
        return (*sides, (1 - gloss[0]) * at(leaf.transmittance, state))

    return spectra


def test_gloss_and_body_sum_to_prospect(total, kaite, nm):
    path = kaite.pigments["leaf"]
    dark = leaf_spectra(nm, **path.at([1.0]))
    upper, _, transmittance = total(1.0)
    assert upper == pytest.approx(dark.reflectance[0], abs=1e-9)
    assert transmittance == pytest.approx(dark.transmittance[0], abs=1e-9)


# Ranges for green leaves of crops in reviews and handbooks (Woolley 1971, Plant Physiol. 47:656;
# Walter-Shea & Norman 1991 in Myneni & Ross, Photon-Vegetation Interactions; Jacquemoud & Ustin 2019, Leaf
# Optical Properties): upper side, lower side, transmittance.
RANGES = {
    450: ((0.03, 0.08), (0.03, 0.15), (0.0, 0.03)),
    550: ((0.10, 0.20), (0.15, 0.30), (0.08, 0.20)),
    680: ((0.03, 0.07), (0.035, 0.12), (0.0, 0.04)),
    800: ((0.42, 0.52), (0.42, 0.52), (0.40, 0.52)),
}


@pytest.mark.parametrize("wavelength", RANGES)
@pytest.mark.parametrize("state", [PALE, DARK])
def test_blades_are_in_the_ranges_of_the_literature(total, nm, wavelength, state):
    for spectrum, (low, high) in zip(total(state), RANGES[wavelength], strict=True):
        assert low <= spectrum[nm == wavelength] <= high


def test_blades_are_among_measured_leaves(leaf, nm):
    """Between the minimum and the maximum of thirteen measured leaves, which exclude gloss as well."""
    measured = np.stack([s.at(nm) for s in read_spectra("leaf/vrhel_leaf_reflectance").values()])
    visible = (nm >= 400) & (nm <= 730)
    # The two waxy, dry ones among them do not affect the minimum.
    low, high = measured[:, visible].min(axis=0), measured[:, visible].max(axis=0)
    for state in (PALE, 0.6, 0.8):
        body = at(leaf.reflectance[:, 0], state)[visible]
        assert np.all(body > low - 0.015)
        assert np.all(body < high + 0.01)


def test_red_edge_and_infrared_plateau(leaf, nm):
    """Reflectance is steepest between 690 and 730 nm, later in darker leaves, and then constant."""
    edges = []
    for state in (PALE, 0.6, DARK):
        front = at(leaf.reflectance[:, 0], state)
        edges.append(nm[1:][np.argmax(np.diff(front) * (nm[1:] > 640))])
        plateau = front[(nm >= 800) & (nm <= 900)]
        assert np.ptp(plateau) < 0.02
    assert 690 <= edges[0] <= edges[1] <= edges[2] <= 730
    plateau = (nm >= 800) & (nm <= 1000)
    assert (leaf.reflectance + leaf.transmittance[:, None])[..., plateau].min() > 0.85


def test_lower_side_is_paler_and_as_bright_in_the_infrared(leaf, nm):
    front, back = leaf.reflectance[:, 0], leaf.reflectance[:, 1]
    assert np.all(back >= front)
    green = np.linspace(0, 1, len(front)) >= PALE
    ratio = back[green][:, nm == 550] / front[green][:, nm == 550]
    assert np.all((ratio > 1.3) & (ratio < 2.0))
    infrared = nm >= 800
    assert back[:, infrared] == pytest.approx(front[:, infrared], abs=0.005)


def test_transmitted_light_is_yellow_green(leaf, nm):
    transmittance = at(leaf.transmittance, 0.6)
    assert transmittance[nm == 550] > 5 * transmittance[nm == 670] > transmittance[nm == 450]
    lightness, a, b = lab(transmittance, nm)
    assert a < -10
    assert b > 25
    assert lightness > 25


def test_a_vein_has_the_spectrum_of_its_pigments(leaf, kaite, nm):
    """On the midrib the pattern moves the state, and the spectrum there is PROSPECT's at those pigments.

    The ratio of vein to blade depends on the wavelength, and is nearly 1 in the near infrared.
    """
    blade = 0.72
    column = leaf.pattern.shape[2] // 2
    offset = float(leaf.pattern[0, 200:300, column - 12 : column + 12].min())
    state = np.clip(blade + offset, 0, 1)
    vein = at(leaf.reflectance[:, 0], state)
    exact, _, _ = leaf_body(kaite.pigments["leaf"], nm, np.array([state]))
    assert vein == pytest.approx(exact[0], abs=0.002)
    green = at(leaf.reflectance[:, 0], blade)
    ratio = vein / green
    assert ratio[nm == 550] > 1.8
    assert ratio[nm == 900] < 1.2
    assert lab(vein, nm)[0] > lab(green, nm)[0] + 10
    assert 100 < lab_hue(vein, nm) < lab_hue(green, nm)
