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


def test_relief_of_a_calyx_loses_little_light(surfaces, kaite):
    """A relief loses (1 - cos t) / 2 of the light on slopes of angle t: the plate's form is in the mesh."""
    fruit = kaite.organs["fruit"].distributions
    radius_mm = 1e3 * fruit["calyx_radius"].mean * fruit["diameter"].mean
    relief = surfaces["calyx"].relief_mm
    around = np.gradient(relief, axis=2) * relief.shape[2] / (np.pi * radius_mm)
    along = np.gradient(relief, axis=1) * relief.shape[1] / (2 * radius_mm)
    assert np.mean(0.5 - 0.5 / np.sqrt(1 + around**2 + along**2)) < 0.002
