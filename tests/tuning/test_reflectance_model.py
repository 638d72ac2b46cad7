"""The direct model of measured reflectances: surface of a spectrum, residuals, and derivatives."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from pepperscene.colour import MeasuredSpectrum
from pepperscene.cultivar import load_cultivar
from pepperscene.errors import InputError
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.recipe.resolve.load_camera import load_camera
from pepperscene.spectra import Spectrum, read_spectrum
from pepperscene.tuning.parameters import known_parameters, select_parameters
from pepperscene.tuning.pigment_paths import state_distribution
from pepperscene.tuning.reflectance import (
    MODEL_ERROR,
    RANGE_NM,
    DirectModel,
    MeasuredSurface,
    surface_of_kind,
)
from pepperscene.tuning.tuned import tuned_parts
from pepperscene.tuning.view_model import Entry, entries_of

FRUITS, LEAVES = "fruit/vrhel_fruit_vegetable_reflectance", "leaf/vrhel_leaf_reflectance"
MEASURED = {
    "pepper.unripe": (FRUITS, "green_pepper_136"),
    "pepper.ripe": (FRUITS, "carrot_142"),
    "leaf": (LEAVES, "vine_leaf_28"),
    "stem": (LEAVES, "grass_25"),
}


def measured(kind: str) -> MeasuredSpectrum:
    return MeasuredSpectrum(kind, kind, read_spectrum(*MEASURED[kind], outside="error"))


@cache
def camera():
    return load_camera(load_recipe("barth2018"))


def model_of(*spectra: MeasuredSpectrum, cultivar: str = "red_blocky") -> DirectModel:
    plants = load_cultivar(cultivar)
    return DirectModel.of(spectra, plants, lambda values: tuned_parts(plants, camera(), values))


def model(*kinds: str) -> DirectModel:
    return model_of(*map(measured, kinds))


def entries(*names: str) -> tuple[Entry, ...]:
    recipe, plants = load_recipe("barth2018"), load_cultivar("red_blocky")
    return entries_of(select_parameters(recipe, plants, camera(), names))


def test_finds_the_surface_of_a_kind():
    plants = load_cultivar("kaite")
    for stage in ("unripe", "ripe"):
        mean = plants.organs["fruit"].distributions[stage].mean
        assert surface_of_kind(plants, f"pepper.{stage}") == MeasuredSurface("fruit", mean, thin=False)
    leaf = surface_of_kind(plants, "leaf")
    assert (leaf.surface, leaf.thin) == ("leaf", True)
    for kind, surface in {"peduncle": "peduncle", "stem": "stem", "shoot": "petiole"}.items():
        assert surface_of_kind(plants, kind).surface == surface
    for kind in ("pepper", "pepper.state", "pepper.diameter", "leaf.ripe", "wire", "cut"):
        with pytest.raises(InputError, match="must be one of") as error:
            surface_of_kind(plants, kind)
        listed = "pepper.unripe, pepper.breaker, pepper.ripe" in str(error.value)
        assert listed or not kind.startswith("pepper")
    tomato = load_cultivar("tomato")
    for kind in ("pepper.unripe", "pepper.ripe", "leaf", "stem", "shoot"):
        surface = surface_of_kind(tomato, kind)
        assert surface.surface in tomato.pigments
        assert 0.0 <= surface.state <= 1.0


def test_default_values_predict_the_cultivar():
    of, fitted = model("leaf", "pepper.unripe"), entries("leaf.chlorophyll", "fruit.brown")
    values = {one.parameter.name: one.parameter.default for one in fitted}
    # A path with more knots has the same contents up to rounding.
    assert of.predicted(values) == pytest.approx(of.predicted({}), abs=1e-12)
    assert of.residuals({}) == pytest.approx((of.predicted({}) - of.measured) / of.sd)
    assert list(of.parts) == ["leaf", "pepper.unripe"]
    single = np.concatenate([model(kind).predicted({}) for kind in of.parts])
    assert np.array_equal(of.predicted({}), single)


def test_pigments_absorb_at_their_wavelengths():
    leaf, (chlorophyll, carotenoid) = model("leaf"), entries("leaf.chlorophyll", "leaf.carotenoid")
    slopes = leaf.jacobian({}, [chlorophyll, carotenoid]) * leaf.sd[:, None]
    nm = leaf.wavelength_nm[0]
    # More of either never brightens. Chlorophyll acts on the red edge most, carotenoids not beyond 600 nm.
    assert slopes.max() <= 1e-12
    assert 690.0 <= nm[np.argmin(slopes[:, 0])] <= 720.0
    assert np.abs(slopes[nm > 600.0, 1]).max() <= 1e-3 * np.abs(slopes[:, 1]).max()


def test_only_the_range_of_pigments_is_compared():
    nm = np.arange(350.0, 1000.0, 5.0)
    wide = MeasuredSpectrum("wide", "leaf", Spectrum(nm, np.full(nm.size, 0.1), "error"))
    assert model_of(wide).wavelength_nm[0][[0, -1]].tolist() == list(RANGE_NM)
    infrared = Spectrum(nm[nm > 800], np.full((nm > 800).sum(), 0.4))
    with pytest.raises(InputError, match="infrared: wavelength_nm: must have at least two values from 400"):
        model_of(MeasuredSpectrum("infrared", "leaf", infrared))


@pytest.mark.parametrize("step_nm", [1.0, 10.0])
def test_finer_sampling_adds_no_weight(step_nm):
    curve, costs, independent = measured("leaf").spectrum, [], []
    for step in (2.0, step_nm):
        nm = np.arange(400.0, 730.0 + step / 2, step)
        sampled = model_of(MeasuredSpectrum("leaf", "leaf", Spectrum(nm, curve.at(nm), "error")))
        costs.append(np.sum(sampled.residuals({}) ** 2))
        independent.append(sampled.independent)
    assert costs[1] == pytest.approx(costs[0], rel=0.05)
    assert independent[1] == pytest.approx(independent[0], rel=0.05)
    # The expected cost is the number of independent data.
    assert np.sum((MODEL_ERROR / sampled.sd) ** 2) == pytest.approx(sampled.independent)


def disagreement(jacobian: np.ndarray, of: DirectModel, values: dict, columns: tuple[Entry, ...]) -> float:
    """Largest relative difference between a Jacobian's columns and finite differences of predicted spectra.

    These are two central differences, extrapolated (Richardson 1911), with other steps than the model's.
    """
    worst = 0.0
    for column, entry in zip(jacobian.T, columns, strict=True):

        def central(step: float, entry: Entry = entry) -> np.ndarray:
            above, below = (of.predicted(entry.with_step(values, side * step)) for side in (1.0, -1.0))
            return (above - below) / (2.0 * step)

        step = 1e-4 * entry.prior.sd
        slope = (4.0 * central(step) - central(2.0 * step)) / 3.0
        assert np.abs(slope).max() > 0.0, entry.label
        worst = max(worst, float(np.abs(column * of.sd - slope).max() / np.abs(slope).max()))
    return worst


def names(kind: str) -> list[str]:
    plants = load_cultivar("red_blocky")
    surface = surface_of_kind(plants, kind).surface
    return [one for one in known_parameters(plants, camera()) if one.startswith(surface)]


@cache
def interior_point(name: str) -> tuple[tuple[Entry, ...], dict]:
    """One parameter, a third of the way from its default to its upper bound; a spread to its lower one.

    A larger spread of fruit would saturate at the ends of the path, with no derivative.
    """
    (entry,) = entries(name)
    prior, default = entry.prior, entry.value({})
    bound = prior.low if name.endswith("spread") or prior.high <= default else prior.high
    return (entry,), {name: np.array([default + (bound - default) / 3.0])}


def mean_is_a_knot(of: DirectModel) -> bool:
    """Whether the mean of a surface's states is a knot of its path, which a spread does not move.

    Else the mean organ is between knots that move: where the path bends between them or within the smoothing
    radius (stems), and where a stage differs from the mean (fruit), its contents depend on the spread.
    """
    (surface,) = {one.surface for one in of.surfaces}
    states = state_distribution(of.cultivar, surface)
    knots = [state for state, _ in of.cultivar.pigments[surface].knots]
    return all(one.state == pytest.approx(states.mean) for one in of.surfaces) and any(
        knot == pytest.approx(states.mean) for knot in knots
    )


@pytest.mark.parametrize(
    "kind", ["leaf", *(pytest.param(kind, marks=pytest.mark.long) for kind in ("stem", "pepper"))]
)
def test_derivatives_match_finite_differences(kind):
    kinds = ("pepper.unripe", "pepper.ripe") if kind == "pepper" else (kind,)
    of = model(*kinds)
    parameters = names(kinds[0])
    keys = {one.rpartition(".")[2] for one in parameters}
    pigments = {"chlorophyll", "carotenoid", "capsanthin", "anthocyanin", "brown", "structure"}
    assert keys >= pigments | {"ior", "roughness", "spread", "ripeness" if kind == "pepper" else "state"}
    for name in parameters:
        column, values = interior_point(name)
        jacobian = of.jacobian(values, column)
        if name.endswith("spread") and mean_is_a_knot(of):
            # The spectrum of the mean organ does not depend on the spread.
            assert kind == "leaf"
            assert np.abs(jacobian).max() <= 1e-8
            continue
        # The albedo of a rough gloss is a quadrature with finite resolution. The smoother, the less of the
        # lobe is lost at the horizon, and the fewer nodes resolve that edge, as wide as the roughness:
        # relative to the slope, the error is inversely proportional to the square of the roughness.
        tolerance = 1e-6
        if name.endswith("roughness"):
            tolerance = 5e-3 * max(1.0, (0.2 / float(values[name][0])) ** 2)
        assert disagreement(jacobian, of, values, column) <= tolerance, name
        # The same check detects a wrong sign and a wrong scale.
        assert disagreement(-jacobian, of, values, column) >= 1.9, name
        assert disagreement(1.1 * jacobian, of, values, column) >= min(0.09, 0.1 - 1.1 * tolerance), name


def test_derivatives_at_bounds_use_values_within_bounds():
    of = model("pepper.unripe", "leaf")
    for name in ("fruit.chlorophyll", "fruit.flesh", "leaf.structure"):
        (entry,) = entries(name)
        prior = entry.prior
        for bound, inwards in ((prior.low, 1.0), (prior.high, -1.0)):
            used: list[float] = []

            def recorded(values, used=used, name=name):
                used.append(float(values[name][0]))
                return of.tuned_parts(values)

            recording = DirectModel(of.spectra, of.surfaces, of.wavelength_nm, of.cultivar, recorded)
            at_bound = recording.jacobian({name: np.array([bound])}, [entry])
            assert prior.low - 1e-12 <= min(used) <= max(used) <= prior.high + 1e-12
            near = of.jacobian({name: np.array([bound + inwards * 0.01 * prior.sd])}, [entry])
            assert at_bound == pytest.approx(near, rel=0.2, abs=0.02 * np.abs(near).max())


def test_light_and_camera_have_no_derivatives():
    of, columns = model("leaf"), entries("flash.power", "exposure", "white_balance", "colour_matrix")
    jacobian = of.jacobian({}, columns)
    assert jacobian.shape == (of.measured.size, 10)
    assert not jacobian.any()
    assert of.predicted(columns[0].with_step({}, 0.1)) == pytest.approx(of.predicted({}), abs=1e-15)
    assert of.jacobian({}, ()).shape == (of.measured.size, 0)
