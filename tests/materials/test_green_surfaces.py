"""Stems and stalks against a measured stem of the same family, and the scar of a cut."""

import numpy as np
import pytest
from plant_colours import at, lab, lab_hue

from pepperscene.spectra import read_spectra, read_spectrum

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


def test_stalks_differ_in_gloss(surfaces):
    peduncle, stem, calyx = (surfaces[name] for name in ("peduncle", "stem", "calyx"))
    assert peduncle.ior > stem.ior
    assert peduncle.roughness[0] < stem.roughness[0] < calyx.roughness[0]


def test_a_cut_is_brown_with_a_darker_rim_and_bright_in_the_infrared(surfaces, nm):
    table = surfaces["cut"].reflectance[:, 0]
    assert 50 < lab_hue(table[0], nm) < 85
    assert lab(table[1], nm)[0] < lab(table[0], nm)[0]
    # The visible part is the measured one.
    file = "organ/vrhel_wood_bark_straw_reflectance"
    straw, chip = (read_spectrum(file, c) for c in ("straw_from_broom_154", "bark_chip_iii_129"))
    inside = (nm >= 390) & (nm <= 730)
    assert table[0, inside] == pytest.approx(0.5 * (straw.at(nm) + chip.at(nm))[inside], abs=1e-12)
    # It continues without a step, and stays below fresh white paper.
    infrared = table[0, nm >= 720]
    assert np.all(np.diff(infrared) > 0)
    assert np.abs(np.diff(infrared, 2)).max() < 0.02
    assert infrared[-1] < 0.8
