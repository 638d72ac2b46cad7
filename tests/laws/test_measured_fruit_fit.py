"""Fits of the model's pigments to a measured green pepper (Vrhel, Gershon & Iwan 1994), from many starts.

They start from a fruit that is not fitted to any measurement, with a leaf's contents on grey flesh. Only the
wide limits of the bounds are used, with a uniform prior between them.
"""

from functools import cache, partial

import numpy as np
import pytest
from scipy.optimize import least_squares

from pepperscene.colour import MeasuredSpectrum, PatchSet
from pepperscene.cultivar import Cultivar, PigmentPath, Pigments, load_cultivar
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.recipe.resolve.load_camera import load_camera
from pepperscene.spectra import Spectrum, read_spectra, read_spectrum
from pepperscene.tuning.least_squares import fit_parameters
from pepperscene.tuning.parameters import select_parameters
from pepperscene.tuning.reflectance import CORRELATION_NM, MODEL_ERROR, DirectModel
from pepperscene.tuning.target import TuningTarget
from pepperscene.tuning.tuned import tuned_parts
from pepperscene.tuning.view_model import entries_of

FRUITS, LEAVES = "fruit/vrhel_fruit_vegetable_reflectance", "leaf/vrhel_leaf_reflectance"
CONTENTS = ("chlorophyll", "carotenoid", "brown", "structure", "flesh")
RMSE = 0.012
# Water and dry matter of a blade and of its large veins.
BLADE, VEIN = ({"water_cm": w, "dry_matter_g_cm2": d} for w, d in ((0.016, 0.0035), (0.03, 0.005)))


@cache
def unfitted_cultivar() -> Cultivar:
    """Kaite with a fruit that is not fitted to any measurement: a leaf's tissue on grey flesh."""
    kaite = load_cultivar("kaite")
    fruit = PigmentPath(
        chosen="a leaf's contents, dark when unripe and pale when ripe, under a smooth film of wax",
        start=Pigments(structure_n=1.55, chlorophyll_ug_cm2=62.0, carotenoid_ug_cm2=12.0, **BLADE),
        end=Pigments(structure_n=2.0, chlorophyll_ug_cm2=10.0, carotenoid_ug_cm2=3.5, **VEIN),
        flesh_reflectance=0.5,
        ior=1.45,
        roughness=(0.1, 0.1),
    )
    return kaite.model_copy(update={"pigments": {**kaite.pigments, "fruit": fruit}})


class Fitting:
    """Fits parameters to a measured reflectance, within the limits of the shipped bounds."""

    def __init__(self, spectrum: MeasuredSpectrum, names: tuple[str, ...], plants: Cultivar) -> None:
        recipe = load_recipe("barth2018")
        camera = load_camera(recipe)
        self.entries = entries_of(select_parameters(recipe, plants, camera, names))
        self.model = DirectModel.of([spectrum], plants, partial(tuned_parts, plants, camera))
        priors = [entry.parameter.prior[0] for entry in self.entries]
        self.low, self.high = np.array([(prior.low, prior.high) for prior in priors]).T
        self.default = np.array([float(entry.parameter.default[0]) for entry in self.entries])
        self.evaluations = 0

    def values(self, vector: np.ndarray) -> dict[str, np.ndarray]:
        return {entry.parameter.name: vector[i : i + 1] for i, entry in enumerate(self.entries)}

    def rmse(self, vector: np.ndarray) -> float:
        residuals = self.model.predicted(self.values(vector)) - self.model.measured
        return float(np.sqrt(np.mean(residuals**2)))

    def random_start(self, rng: np.random.Generator) -> np.ndarray:
        return rng.uniform(self.low, self.high)

    def fit(self, start: np.ndarray) -> np.ndarray:
        margin = 1e-6 * (self.high - self.low)
        result = least_squares(
            lambda x: self.model.residuals(self.values(x)),
            np.clip(start, self.low + margin, self.high - margin),
            lambda x: self.model.jacobian(self.values(x), self.entries),
            bounds=(self.low, self.high),
            x_scale=self.high - self.low,
            xtol=1e-6,
            ftol=1e-6,
            max_nfev=100,
        )
        self.evaluations = int(result.nfev)
        return np.asarray(result.x)


def measured(column: str, kind: str, file: str = FRUITS) -> MeasuredSpectrum:
    return MeasuredSpectrum(column, kind, read_spectrum(file, column, outside="error"))


def fruit(*contents: str) -> tuple[str, ...]:
    return tuple(f"fruit.{name}" for name in contents)


@cache
def green_pepper() -> Fitting:
    return Fitting(measured("green_pepper_136", "pepper.unripe"), fruit(*CONTENTS), unfitted_cultivar())


def test_fit_reproduces_the_measured_green_pepper():
    fitting = green_pepper()
    starts = [fitting.default, *(fitting.random_start(np.random.default_rng(seed)) for seed in range(2))]
    results = [fitting.fit(start) for start in starts]
    assert max(map(fitting.rmse, results)) <= RMSE
    # All starts give the same result, within a hundredth of the bounds' width.
    assert np.all(np.ptp(results, axis=0) <= 0.01 * (fitting.high - fitting.low))
    assert fitting.evaluations <= 40


def test_tuning_a_recipe_reproduces_the_measured_green_pepper():
    # A complete tuning fit with spectra alone, so nothing is rendered; its priors are uniform.
    pepper = green_pepper()
    spectrum = pepper.model.spectra[0]
    bounds = {
        entry.parameter.name: {"uniform": [float(low), float(high)], "chosen": "uniform"}
        for entry, low, high in zip(pepper.entries, pepper.low, pepper.high, strict=True)
    }
    target = TuningTarget(load_recipe("barth2018"), PatchSet("green pepper", (), (spectrum,)), bounds=bounds)
    target.cultivar = unfitted_cultivar()
    result = fit_parameters(target, target.problem(list(bounds)), starts=2)
    (fit,) = result.spectra.values()
    assert fit.rmse_before >= 4 * RMSE
    assert fit.rmse_after <= RMSE
    assert result.variance_reduction["fruit.flesh"][0] >= 0.5


def test_fit_recovers_known_contents():
    # A twin experiment: the measurement is the model's reflectance at known contents.
    pepper = green_pepper()
    rng, (nm,) = np.random.default_rng(5), pepper.model.wavelength_nm
    contents = pepper.low + rng.uniform(0.15, 0.85, pepper.low.size) * (pepper.high - pepper.low)
    spectrum = Spectrum(nm, pepper.model.predicted(pepper.values(contents)), "error")
    twin = Fitting(MeasuredSpectrum("twin", "pepper.unripe", spectrum), fruit(*CONTENTS), unfitted_cultivar())
    assert twin.fit(twin.default) == pytest.approx(contents, rel=1e-3, abs=1e-3)


@pytest.mark.long
def test_model_error_constants_match_residuals_of_leaf_fits():
    # The constants that weight spectra against images, for leaves of twelve plants.
    names = tuple(f"leaf.{name}" for name in CONTENTS[:4])
    columns = [name for name in read_spectra(LEAVES) if "husk" not in name]
    residuals, lags = [], []
    for column in columns:
        fitting = Fitting(measured(column, "leaf", LEAVES), names, unfitted_cultivar())
        best = fitting.fit(fitting.default)
        residuals.append(fitting.rmse(best))
        error = fitting.model.predicted(fitting.values(best)) - fitting.model.measured
        correlation = np.correlate(error, error, "full")[error.size - 1 :] / np.sum(error**2)
        until = int(np.argmax(correlation < 0.0)) or error.size
        lags.append(2.0 * 2.0 * (correlation[1:until].sum() + 0.5))  # in both directions, in steps of 2 nm
    assert 0.6 <= np.median(residuals) / MODEL_ERROR <= 1.6
    assert 0.5 <= np.median(lags) / CORRELATION_NM <= 2.0
