"""The direct model of measured reflectances: what it takes a spectrum to show, and its derivatives."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from pepperscene.colour import MeasuredSpectrum
from pepperscene.cultivar import load_cultivar
from pepperscene.dataset import load_recipe
from pepperscene.dataset.recipe.resolved import load_camera
from pepperscene.errors import InputError
from pepperscene.spectra import Spectrum, read_spectrum
from pepperscene.tuning.model.reflectance import MODEL_ERROR, RANGE_NM, DirectModel, ShownSurface, shown
from pepperscene.tuning.model.view_model import Entry, entries_of
from pepperscene.tuning.parameters.parameter import known_parameters, select_parameters
from pepperscene.tuning.parameters.tuned import tuned_parts

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


def model(*kinds: str, cultivar: str = "red_blocky") -> DirectModel:
    plants = load_cultivar(cultivar)
    spectra = [measured(kind) for kind in kinds]
    return DirectModel.of(spectra, plants, lambda values: tuned_parts(plants, camera(), values))


def entries(*names: str, cultivar: str = "red_blocky") -> tuple[Entry, ...]:
    recipe, plants = load_recipe("barth2018"), load_cultivar(cultivar)
    return entries_of(select_parameters(recipe, plants, camera(), names))


# --- what a spectrum shows --------------------------------------------------------------------------------


def test_kinds_are_found_in_the_cultivar():
    plants = load_cultivar("kaite")
    fruit = plants.organs["fruit"].distributions
    assert shown(plants, "pepper.unripe") == ShownSurface("fruit", fruit["unripe"].mean, thin=False)
    assert shown(plants, "pepper.ripe") == ShownSurface("fruit", fruit["ripe"].mean, thin=False)
    leaf = shown(plants, "leaf")
    assert (leaf.surface, leaf.thin) == ("leaf", True)
    assert shown(plants, "peduncle").surface == "peduncle"
    assert shown(plants, "stem").surface == "stem"
    assert shown(plants, "shoot").surface == "petiole"


def test_another_crops_organs_are_found_whatever_they_are_called():
    for cultivar in ("tomato", "orange_pointed"):
        plants = load_cultivar(cultivar)
        for kind in ("pepper.unripe", "pepper.ripe", "leaf", "stem", "shoot"):
            found = shown(plants, kind)
            assert found.surface in plants.pigments
            assert 0.0 <= found.state <= 1.0


@pytest.mark.parametrize("kind", ["pepper", "pepper.state", "pepper.diameter", "leaf.ripe", "wire", "cut"])
def test_what_plants_have_not_is_refused_with_what_they_have(kind):
    with pytest.raises(InputError, match="must be one of") as fault:
        shown(load_cultivar("kaite"), kind)
    if kind.startswith("pepper"):
        assert "pepper.unripe, pepper.breaker, pepper.ripe" in str(fault.value)


# --- what is compared -------------------------------------------------------------------------------------


def test_without_a_fit_it_predicts_the_cultivar_itself():
    own, fitted = model("leaf", "pepper.unripe"), entries("leaf.chlorophyll", "fruit.brown")
    values = {one.parameter.name: one.parameter.default for one in fitted}
    # A path with more knots says the same; only rounding differs.
    assert own.predicted(values) == pytest.approx(own.predicted({}), abs=1e-12)
    assert own.residuals({}) == pytest.approx((own.predicted({}) - own.measured) / own.sd)
    parts = own.parts
    assert list(parts) == ["leaf", "pepper.unripe"]
    both = own.rmse_by_name({})
    assert own.rmse({}) == pytest.approx(np.sqrt(np.mean([both[name] ** 2 for name in parts])))


def test_pigments_absorb_where_they_do():
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
    plants = load_cultivar("kaite")
    found = DirectModel.of([wide], plants, lambda values: tuned_parts(plants, camera(), values))
    assert found.wavelength_nm[0][[0, -1]].tolist() == list(RANGE_NM)
    beyond = MeasuredSpectrum(
        "infrared", "leaf", Spectrum(nm[nm > 800], np.full(40, 0.4)[: (nm > 800).sum()])
    )
    with pytest.raises(InputError, match="infrared: wavelength_nm: must have at least two values from 400"):
        DirectModel.of([beyond], plants, found.tuned)


@pytest.mark.parametrize("step_nm", [1.0, 5.0, 10.0])
def test_finer_sampling_adds_no_weight(step_nm):
    # The cost of a spectrum is that of the curve; 1 % for the ends of the coarse ones.
    plants, curve = load_cultivar("kaite"), measured("leaf").spectrum
    costs, worth = [], []
    for step in (2.0, step_nm):
        nm = np.arange(400.0, 730.0 + step / 2, step)
        one = MeasuredSpectrum("leaf", "leaf", Spectrum(nm, curve.at(nm), "error"))
        sampled = DirectModel.of([one], plants, lambda values: tuned_parts(plants, camera(), values))
        costs.append(np.sum(sampled.residuals({}) ** 2))
        worth.append(sampled.independent)
    assert costs[1] == pytest.approx(costs[0], rel=0.05)
    assert worth[1] == pytest.approx(worth[0], rel=0.05)
    # A model that errs as expected everywhere costs as much as there are independent data.
    assert np.sum((MODEL_ERROR / sampled.sd) ** 2) == pytest.approx(sampled.independent)


# --- derivatives ------------------------------------------------------------------------------------------


def disagreement(jacobian: np.ndarray, of: DirectModel, values: dict, columns: tuple[Entry, ...]) -> float:
    """Worst difference of a Jacobian's columns from differences of the predicted spectra, by their size.

    Two central differences of its own steps, extrapolated (Richardson 1911).
    """
    worst = 0.0
    for column, entry in zip(jacobian.T, columns, strict=True):

        def central(step: float, entry: Entry = entry) -> np.ndarray:
            above, below = (of.predicted(entry.moved(values, side * step)) for side in (1.0, -1.0))
            return (above - below) / (2.0 * step)

        step = 1e-4 * entry.scale
        slope = (4.0 * central(step) - central(2.0 * step)) / 3.0
        assert np.abs(slope).max() > 0.0, entry.label
        off = np.abs(column * of.sd - slope).max() / np.abs(slope).max()
        worst = max(worst, float(off))
    return worst


def names(kind: str) -> list[str]:
    surface = shown(load_cultivar("red_blocky"), kind).surface
    return [one for one in known_parameters(load_cultivar("red_blocky"), camera()) if one.startswith(surface)]


@cache
def away(name: str) -> tuple[tuple[Entry, ...], dict]:
    """One parameter, a third of the way from its default to its upper bound; a spread to its lower one.

    Fruit that varies more is as green as can be, or as ripe, and stays so whatever its spread.
    """
    found = entries(name)
    (entry,) = found
    law, own = entry.parameter.prior[0], float(entry.parameter.default[0])
    bound = law.low if name.endswith("spread") or law.high <= own else law.high
    return found, {name: np.array([own + (bound - own) / 3.0])}


def tolerance(name: str) -> float:
    """By how much two derivatives may differ; the albedo of a rough gloss is a quadrature, with a grain."""
    return 5e-3 if name.endswith("roughness") else 1e-6


@pytest.mark.parametrize("kind", ["leaf", "stem", "pepper"])
def test_derivatives_are_those_of_the_predicted_spectra(kind):
    kinds = ("pepper.unripe", "pepper.ripe") if kind == "pepper" else (kind,)
    of = model(*kinds)
    every = names(kinds[0])
    ends = {one.rpartition(".")[2] for one in every}
    pigments = {"chlorophyll", "carotenoid", "capsanthin", "anthocyanin", "brown", "structure"}
    assert ends >= pigments | {"ior", "roughness", "spread", "ripeness" if kind == "pepper" else "state"}
    for name in every:
        column, values = away(name)
        true = of.jacobian(values, column)
        if name.endswith("spread") and kind != "pepper":
            # The mean organ's spectrum does not tell how much organs differ.
            assert np.abs(true).max() <= 1e-8
            continue
        assert disagreement(true, of, values, column) <= tolerance(name), name
        # The same check has to see a sign and a scale that are wrong.
        assert disagreement(-true, of, values, column) >= 1.9, name
        assert disagreement(1.1 * true, of, values, column) >= 0.09, name


def test_a_wrong_column_among_many_is_seen():
    of = model("pepper.unripe", "leaf")
    columns = entries("fruit.chlorophyll", "fruit.flesh", "leaf.structure", "leaf.ior")
    values = {one.parameter.name: one.parameter.default for one in columns}
    true = of.jacobian(values, columns)
    assert disagreement(true, of, values, columns) <= 1e-6
    for k in range(len(columns)):
        for factor in (-1.0, 1.1):
            wrong = true.copy()
            wrong[:, k] *= factor
            assert disagreement(wrong, of, values, columns) >= 0.09


def test_derivatives_hold_at_the_bounds():
    # Nothing beyond a bound is asked for: there are no such plants. From within, the slope is the same.
    of = model("pepper.unripe", "leaf")
    for name in ("fruit.chlorophyll", "fruit.flesh", "leaf.structure"):
        (entry,) = entries(name)
        law = entry.parameter.prior[0]
        for bound, inwards in ((law.low, 1.0), (law.high, -1.0)):
            asked: list[float] = []

            def watched(values, asked=asked, name=name):
                asked.append(float(values[name][0]))
                return of.tuned(values)

            watching = DirectModel(of.spectra, of.shown, of.wavelength_nm, of.cultivar, watched)
            there = watching.jacobian({name: np.array([bound])}, [entry])
            assert law.low - 1e-12 <= min(asked) <= max(asked) <= law.high + 1e-12
            near = of.jacobian({name: np.array([bound + inwards * 0.01 * law.sd])}, [entry])
            assert there == pytest.approx(near, rel=0.2, abs=0.02 * np.abs(near).max())


def test_light_and_camera_have_no_slope():
    of, columns = model("leaf"), entries("flash.power", "exposure", "white_balance", "colour_matrix")
    slopes = of.jacobian({}, columns)
    assert slopes.shape == (of.measured.size, 10)
    assert not slopes.any()
    # That is no oversight: what they change leaves the spectrum as it is.
    assert of.predicted(columns[0].moved({}, 0.1)) == pytest.approx(of.predicted({}), abs=1e-15)
    assert of.jacobian({}, ()).shape == (of.measured.size, 0)
