"""The fruit: pigments are mixed and then give the spectrum; green, yellow, orange and red are paths."""

import numpy as np
import pytest
from plant_colours import at, lab, lab_hue, srgb_hue

from pepperscene.cultivar import load_cultivar
from pepperscene.cultivar.organs import USUAL
from pepperscene.geometry import mesh_plant
from pepperscene.grammar.plant import Organ, Plant
from pepperscene.materials import flesh_reflectance, rind_reflectance
from pepperscene.spectra import absorption_coefficients, cuticle_gloss, read_spectrum


@pytest.fixture(scope="module")
def ripening(surfaces):
    return surfaces["fruit"].reflectance[:, 0]


def test_pigments_are_mixed_and_not_spectra(ripening, kaite, nm):
    path = kaite.pigments["fruit"]
    middle = at(ripening, 0.5)
    assert middle == pytest.approx(rind_reflectance(path, nm, 0.5)[0], abs=0.002)
    # Half of the chlorophyll still absorbs more than half as much: the mean of the ends is far too bright.
    mean = 0.5 * (ripening[0] + ripening[-1])
    red = (nm >= 620) & (nm <= 690)
    assert np.all(mean[red] - middle[red] > 0.05)
    # The same holds for each stretch of the path, where contents are linear: the spectrum is convex there.
    for (low, _), (high, _) in zip(path.knots[:-1], path.knots[1:], strict=True):
        ends = rind_reflectance(path, nm, [low, high]).mean(axis=0)
        half = rind_reflectance(path, nm, 0.5 * (low + high))[0]
        assert np.all(ends >= half - 1e-12)


def test_the_contents_at_a_state_are_mixed_linearly(kaite):
    path = kaite.pigments["fruit"]
    (low, before), (high, after) = path.knots[1:3]
    mixed = path.at(0.5 * (low + high))
    for name, amount in mixed.items():
        assert amount == pytest.approx(0.5 * (getattr(before, name) + getattr(after, name)))


def test_unripe_fruit_comes_near_the_measured_green_pepper(surfaces, ripening, nm):
    measured = read_spectrum("fruit/vrhel_fruit_vegetable_reflectance", "green_pepper_136").at(nm)
    inside = (nm >= 400) & (nm <= 730)
    # The measurement left the gloss out, but not its shadow on the body.
    entered = 1 - cuticle_gloss(surfaces["fruit"].ior)
    error = (entered * ripening[0] - measured)[inside]
    assert np.sqrt(np.mean(error**2)) < 0.012


def test_it_turns_from_green_to_yellow_without_a_step_back(ripening, nm):
    hues = [lab_hue(at(ripening, state), nm) for state in np.linspace(0, 1, 9)]
    assert 105 < hues[0] < 125
    assert 78 < hues[-1] < 90
    assert np.all(np.diff(hues) < 0)
    lightness = [lab(at(ripening, state), nm)[0] for state in np.linspace(0, 1, 9)]
    assert np.all(np.diff(lightness) > 0)


def with_gloss(body):
    """What a colorimeter sees that takes in all that is reflected: the body, and the gloss above it."""
    gloss = cuticle_gloss(1.45)
    return (1 - gloss) * body + gloss


def test_ripe_fruit_has_the_hue_of_ripe_fruit(kaite, nm):
    """Ripe red and yellow greenhouse peppers: 29.9 and 87.5 degrees in CIELAB.

    Molinari et al. 1999, Proc. Fla. State Hort. Soc. 112:143-146. Orange lies half-way, and a tomato between.
    """
    hue = {}
    for name in ("red_blocky", "tomato", "orange_pointed", "kaite"):
        path = load_cultivar(name).pigments["fruit"]
        hue[name] = lab_hue(with_gloss(rind_reflectance(path, nm, 1.0)[0]), nm)
    assert hue["red_blocky"] == pytest.approx(29.9, abs=3)
    assert hue["kaite"] == pytest.approx(87.5, abs=7)
    assert hue["orange_pointed"] == pytest.approx(0.5 * (29.9 + 87.5), abs=5)
    assert hue["red_blocky"] + 5 < hue["tomato"] < hue["orange_pointed"] - 5


def test_a_red_fruit_turns_through_brown(kaite, nm):
    red = load_cultivar("red_blocky").pigments["fruit"]
    assert red.start == kaite.pigments["fruit"].start
    # A breaker is darker than both ends, or hardly lighter, and between them in hue.
    start, middle, end = rind_reflectance(red, nm, [0.0, 0.5, 1.0])
    assert lab_hue(end, nm) < lab_hue(middle, nm) < lab_hue(start, nm)
    assert lab(middle, nm)[0] < lab(end, nm)[0] + 5
    assert 0 <= srgb_hue(end, nm) <= 20


def test_flesh_absorbs_as_kubelka_and_munk_say(nm):
    """(1 - R)^2 / 2 R is that of dry flesh plus 2 mu_a / S, for water by PROSPECT's coefficient."""
    wet = flesh_reflectance(0.66, nm)
    absorbed = (1 - wet) ** 2 / (2 * wet) - (1 - 0.66) ** 2 / (2 * 0.66)
    assert absorbed / absorption_coefficients(nm)["water"] == pytest.approx(2 * 0.9 / 7.5, rel=1e-6)
    assert wet[nm <= 650] == pytest.approx(0.66, abs=2e-3)
    assert 0.45 < wet[nm == 970] < 0.6
    assert flesh_reflectance(0.0, nm).max() == 0


def test_a_breaker_colours_unevenly(surfaces, nm):
    """The mesh's gradient and the surface's noise together spread the hue over a turning fruit."""
    facts = {
        "length_m": 0.087, "diameter_m": 0.084, "lobes": 4.0, "lobe_depth": 1.0, "shoulder": 0.5,
        "taper": 0.83, "ripeness": 0.5, "ripeness_spread": 0.08, "seed": 0.3,
    }  # fmt: skip
    curve = np.array([[0, 0, 0], [0, 0, -0.04], [0, 0, -0.087]], dtype=float)
    fruit = Organ("fruit", -1, 3, curve, np.array([1.0, 0, 0]), facts)
    mesh = mesh_plant(Plant("kaite", (fruit,), USUAL))
    shoulder, blossom_end = mesh.uv[:, 1] < 0.35, mesh.uv[:, 1] > 0.75
    # A gradient from the shoulders to the blossom end.
    assert mesh.state[blossom_end].mean() - mesh.state[shoulder].mean() > 0.05
    # Patches besides: states differ around one height as well.
    assert mesh.state[(mesh.uv[:, 1] > 0.5) & (mesh.uv[:, 1] < 0.6)].std() > 0.01
    pattern = surfaces["fruit"].pattern
    rows = (mesh.uv[:, 1] * 255).astype(int), (mesh.uv[:, 0] * 255).astype(int)
    states = np.clip(mesh.state + pattern[rows], 0, 1)
    table = surfaces["fruit"].reflectance[:, 0]
    low, high = (lab_hue(at(table, s), nm) for s in np.percentile(states, [5, 95]))
    assert low - high > 10
