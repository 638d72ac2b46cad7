import numpy as np
import pytest

from pepperscene.cultivar import load_cultivar
from pepperscene.materials import organ_surfaces, twine_surface
from pepperscene.spectra import cuticle_gloss, leaf_spectra, over_body, read_spectrum, sky_spectrum

NM = np.arange(380.0, 781.0, 5.0)
NAMES = {"leaf", "petiole", "stem", "fruit", "calyx", "cut"}


@pytest.fixture(scope="module")
def kaite():
    return load_cultivar("kaite")


@pytest.fixture(scope="module")
def surfaces(kaite):
    return organ_surfaces(kaite, NM) | {"twine": twine_surface(NM)}


def at(surface, state, side=0):
    """Reflectance at a state, linear between the rows."""
    rows = surface.reflectance[:, side]
    where = np.linspace(0, 1, len(rows))
    return np.array([np.interp(state, where, column) for column in rows.T])


def lab(reflectance):
    """CIE Lab under D65, 2 degrees, by colour-science."""
    import colour

    cmfs = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    bars = np.stack([np.interp(NM, cmfs.wavelengths, cmfs.values[:, i]) for i in range(3)])
    light = sky_spectrum("d65").at(NM)
    scale = 1 / np.sum(light * bars[1])
    white = colour.XYZ_to_xy(scale * bars @ light)
    return colour.XYZ_to_Lab(scale * bars @ (light * reflectance), white)


def nm(wavelength):
    return int(np.argmin(np.abs(NM - wavelength)))


def test_every_surface_that_meshes_name_is_there(surfaces):
    assert set(surfaces) == NAMES | {"twine"}
    for name, surface in surfaces.items():
        assert surface.name == name
        assert surface.wavelength_nm.size == NM.size
    assert len(surfaces["leaf"].reflectance) >= 17
    assert len(surfaces["fruit"].reflectance) >= 33


def test_nothing_gives_more_than_it_gets(surfaces):
    for surface in surfaces.values():
        assert (surface.reflectance + surface.transmittance[:, None]).max() <= 1 + 1e-9
        assert surface.reflectance.min() >= 0


def test_gloss_and_diffuse_part_together_are_prospect(surfaces, kaite):
    path = kaite.pigments["leaf"]
    dark = leaf_spectra(NM, **path.at([1.0]))
    gloss = cuticle_gloss(path.ior)
    whole = gloss + (1 - gloss) * surfaces["leaf"].reflectance[-1, 0]
    # In the deepest red the cuticle alone reflects a little more than that leaf: none is taken twice.
    assert whole == pytest.approx(np.maximum(dark.reflectance[0], gloss), abs=1e-9)
    assert whole == pytest.approx(dark.reflectance[0], abs=1e-3)
    assert (1 - gloss) * surfaces["leaf"].transmittance[-1] == pytest.approx(dark.transmittance[0], abs=1e-9)


@pytest.mark.parametrize("name", ["leaf", "fruit", "stem", "petiole", "calyx"])
def test_between_the_rows_interpolation_follows_the_pigments(surfaces, kaite, name):
    path, surface = kaite.pigments[name], surfaces[name]
    for state in np.linspace(0.013, 0.987, 23):
        layer = leaf_spectra(NM, **path.at([state]))
        body = layer if path.flesh_reflectance is None else over_body(layer, path.flesh_reflectance)
        assert at(surface, state) == pytest.approx(body.under_cuticle(path.ior)[0][0], abs=0.002)


def test_a_leaf_is_paler_below_and_as_bright_in_the_infrared(surfaces):
    front, back = surfaces["leaf"].reflectance[:, 0], surfaces["leaf"].reflectance[:, 1]
    assert np.all(back >= front)
    assert np.all(back[:, nm(550)] > 1.2 * front[:, nm(550)])
    assert back[:, nm(780)] == pytest.approx(front[:, nm(780)], abs=0.01)


def test_a_leaf_against_the_light_is_yellow_green(surfaces):
    through = surfaces["leaf"].transmittance[8]
    assert through[nm(550)] > 5 * through[nm(670)] > through[nm(450)]
    lightness, a, b = lab(through)
    assert a < -10
    assert b > 25
    assert lightness > 25


def test_only_leaves_let_light_through(surfaces):
    for name, surface in surfaces.items():
        assert (surface.transmittance.max() > 0) == (name == "leaf")


def test_colours(surfaces):
    """Hue angles in CIE Lab: 90 degrees is yellow, 180 green."""

    def hue(name, state):
        _, a, b = lab(at(surfaces[name], state))
        return np.degrees(np.arctan2(b, a)) % 360

    assert 100 < hue("fruit", 0) < 125
    assert 70 < hue("fruit", 1) < 95
    assert np.all(np.diff([hue("fruit", s) for s in np.linspace(0, 1, 9)]) < 0)
    for name in ("leaf", "petiole", "stem", "calyx"):
        assert 95 < hue(name, 0.6) < 145
        # Dark green is darker than pale green.
        assert lab(at(surfaces[name], 1))[0] < lab(at(surfaces[name], 0))[0]
    # Petioles are lighter than leaves, cuts brown with a darker rim, twine nearly white.
    assert lab(at(surfaces["petiole"], 0.6))[0] > lab(at(surfaces["leaf"], 0.6))[0] + 10
    assert 50 < hue("cut", 0) < 85
    assert lab(at(surfaces["cut"], 1))[0] < lab(at(surfaces["cut"], 0))[0]
    lightness, a, b = lab(at(surfaces["twine"], 0))
    assert lightness > 85
    assert np.hypot(a, b) < 8


def test_unripe_fruit_comes_near_the_measured_green_pepper(surfaces):
    measured = read_spectrum("fruit/vrhel_fruit_vegetable_reflectance", "green_pepper_136").at(NM)
    inside = (NM >= 400) & (NM <= 730)
    # The measurement left the gloss out, but not its shadow on the body.
    entered = 1 - cuticle_gloss(surfaces["fruit"].ior)
    error = (entered * at(surfaces["fruit"], 0) - measured)[inside]
    assert np.sqrt(np.mean(error**2)) < 0.015


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
    for name in ("fruit", "stem", "petiole", "calyx"):
        pattern = surfaces[name].pattern
        inside = np.abs(np.diff(pattern, axis=1)).mean()
        assert np.abs(pattern[:, 0] - pattern[:, -1]).mean() < 3 * inside, name


def test_same_cultivar_same_surfaces(surfaces, kaite):
    again = organ_surfaces(kaite, NM)
    for name, surface in again.items():
        assert surface.reflectance.tobytes() == surfaces[name].reflectance.tobytes()
        if surface.pattern is not None:
            assert surface.pattern.tobytes() == surfaces[name].pattern.tobytes()


def test_a_coarse_grid_is_the_fine_one_sampled(surfaces, kaite):
    coarse = organ_surfaces(kaite, NM[::8])
    for name, surface in coarse.items():
        assert surface.reflectance == pytest.approx(surfaces[name].reflectance[..., ::8], abs=1e-12)
