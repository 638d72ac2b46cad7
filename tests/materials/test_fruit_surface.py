"""The fruit: pigments are mixed before the spectrum is computed; green, yellow, orange and red are paths."""

import numpy as np
import pytest
from plant_colours import at, lab, lab_hue, smooth_gloss

from pepperscene.cultivar import load_cultivar
from pepperscene.cultivar.organs import DEFAULT_KINDS
from pepperscene.geometry import mesh_plant
from pepperscene.grammar import Organ, Plant
from pepperscene.materials import flesh_reflectance, rind_reflectance
from pepperscene.materials.gloss import cone_gloss
from pepperscene.spectra import absorption_coefficients


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
