"""Fits of the model's pigments to measured reflectances, from starts that know nothing of them.

The shipped fruit is such a fit to the measured green pepper (Vrhel, Gershon & Iwan 1994), and the shipped
bounds have their means from it. So the cultivar that these fits start from has another fruit: one with the
contents of the plant's own leaf, which come from tomato leaves, on a flesh in the middle of what is possible.
And only the ends of the bounds are kept, which are far apart: values between them count alike.
"""

from __future__ import annotations

from functools import cache, partial

import numpy as np
import pytest

from pepperscene.colour import MeasuredSpectrum, PatchSet
from pepperscene.cultivar import Cultivar, PigmentPath, load_cultivar
from pepperscene.dataset import load_recipe
from pepperscene.dataset.recipe.equipment import load_camera
from pepperscene.spectra import Spectrum, read_spectra, read_spectrum
from pepperscene.tuning.model.reflectance import CORRELATION_NM, MODEL_ERROR, DirectModel
from pepperscene.tuning.model.view_model import entries_of
from pepperscene.tuning.parameters.parameter import select_parameters
from pepperscene.tuning.parameters.tuned import tuned_parts

FRUITS, LEAVES = "fruit/vrhel_fruit_vegetable_reflectance", "leaf/vrhel_leaf_reflectance"
CONTENTS = ("chlorophyll", "carotenoid", "brown", "structure", "flesh")
RMSE = 0.012


@cache
def uninformed() -> Cultivar:
    """Kaite with a fruit of which nothing was fitted to any fruit: its leaf's tissue on grey flesh."""
    kaite = load_cultivar("kaite")
    leaf = kaite.pigments["leaf"]
    fruit = PigmentPath(
        chosen="the contents of the leaf, dark when unripe and pale when ripe, under a smooth film of wax",
        start=leaf.end,
        end=leaf.start,
        flesh_reflectance=0.5,
        ior=1.45,
        roughness=(0.1, 0.1),
    )
    return kaite.model_copy(update={"pigments": {**kaite.pigments, "fruit": fruit}})


class Fitting:
    """A measured reflectance, and the entries that are fitted to it within the ends of the shipped bounds."""

    def __init__(self, spectrum: MeasuredSpectrum, names: tuple[str, ...], plants: Cultivar) -> None:
        recipe = load_recipe("barth2018")
        camera = load_camera(recipe)
        self.entries = entries_of(select_parameters(recipe, plants, camera, names))
        self.model = DirectModel.of([spectrum], plants, partial(tuned_parts, plants, camera))
        laws = [one.parameter.prior[0] for one in self.entries]
        self.low, self.high = np.array([(law.low, law.high) for law in laws]).T
        self.default = np.array([float(one.parameter.default[0]) for one in self.entries])
        self.evaluations = 0

    def values(self, vector: np.ndarray) -> dict[str, np.ndarray]:
        return {one.parameter.name: vector[i : i + 1] for i, one in enumerate(self.entries)}

    def rmse(self, vector: np.ndarray) -> float:
        residuals = self.model.predicted(self.values(vector)) - self.model.measured
        return float(np.sqrt(np.mean(residuals**2)))

    def anywhere(self, rng: np.random.Generator) -> np.ndarray:
        return rng.uniform(self.low, self.high)

    def best(self, start: np.ndarray) -> np.ndarray:
        from scipy.optimize import least_squares

        margin = 1e-6 * (self.high - self.low)
        done = least_squares(
            lambda x: self.model.residuals(self.values(x)),
            np.clip(start, self.low + margin, self.high - margin),
            lambda x: self.model.jacobian(self.values(x), self.entries),
            bounds=(self.low, self.high),
            x_scale=self.high - self.low,
            xtol=1e-6,
            ftol=1e-6,
            max_nfev=100,
        )
        self.evaluations = int(done.nfev)
        return np.asarray(done.x)


def measured(column: str, kind: str, file: str = FRUITS) -> MeasuredSpectrum:
    return MeasuredSpectrum(column, kind, read_spectrum(file, column, outside="error"))


def fruit(*contents: str) -> tuple[str, ...]:
    return tuple(f"fruit.{name}" for name in contents)


@cache
def green_pepper() -> Fitting:
    return Fitting(measured("green_pepper_136", "pepper.unripe"), fruit(*CONTENTS), uninformed())


def test_the_start_does_not_know_the_measurement():
    fitting = green_pepper()
    assert fitting.rmse(fitting.default) >= 4 * RMSE
    # None of the contents that a fit finds is that of the start, nor of the shipped fruit's.
    assert uninformed().pigments["fruit"].start == load_cultivar("kaite").pigments["leaf"].end
    starts = [fitting.rmse(fitting.anywhere(np.random.default_rng(seed))) for seed in range(12)]
    assert np.median(starts) >= 2 * RMSE


def test_the_fit_finds_the_measured_green_pepper():
    fitting = green_pepper()
    starts = [fitting.default, *(fitting.anywhere(np.random.default_rng(seed)) for seed in range(7))]
    found = [fitting.best(start) for start in starts]
    assert max(map(fitting.rmse, found)) <= RMSE
    # There is one answer, whatever the start: within a hundredth of the bounds' width.
    assert np.all(np.ptp(found, axis=0) <= 0.01 * (fitting.high - fitting.low))
    assert fitting.evaluations <= 40


def test_a_tuned_recipe_finds_it_too():
    # The whole machinery of a fit, with spectra alone: nothing is rendered. Its bounds weigh nothing.
    from pepperscene.tuning.fit.least_squares import fit_parameters
    from pepperscene.tuning.model.target import TuningTarget

    spectrum = green_pepper().model.spectra[0]
    laws = {
        entry.parameter.name: {"uniform": [float(low), float(high)], "chosen": "all alike"}
        for entry, low, high in zip(
            green_pepper().entries, green_pepper().low, green_pepper().high, strict=True
        )
    }
    subject = TuningTarget(load_recipe("barth2018"), PatchSet("green pepper", (), (spectrum,)), bounds=laws)
    subject.cultivar = uninformed()
    result = fit_parameters(subject, subject.problem(list(laws)), starts=2)
    (one,) = result.spectra.values()
    assert one.rmse_before >= 4 * RMSE
    assert one.rmse_after <= RMSE
    assert result.variance_reduction["fruit.flesh"][0] >= 0.5


def test_what_was_hidden_is_found():
    # A twin: the reflectance of known contents is the measurement.
    known = green_pepper()
    rng, (nm,) = np.random.default_rng(5), known.model.wavelength_nm
    for _ in range(3):
        hidden = known.low + rng.uniform(0.15, 0.85, known.low.size) * (known.high - known.low)
        seen = Spectrum(nm, known.model.predicted(known.values(hidden)), "error")
        twin = Fitting(MeasuredSpectrum("twin", "pepper.unripe", seen), fruit(*CONTENTS), uninformed())
        assert twin.best(twin.default) == pytest.approx(hidden, rel=1e-3, abs=1e-3)


def test_the_models_error_is_what_fits_leave_over():
    # The constants that weigh spectra against pictures, from leaves of twelve plants.
    names = tuple(f"leaf.{name}" for name in CONTENTS[:4])
    columns = [name for name in read_spectra(LEAVES) if "husk" not in name]
    left, lags = [], []
    for column in columns:
        fitting = Fitting(measured(column, "leaf", LEAVES), names, uninformed())
        best = fitting.best(fitting.default)
        left.append(fitting.rmse(best))
        off = fitting.model.predicted(fitting.values(best)) - fitting.model.measured
        alike = np.correlate(off, off, "full")[off.size - 1 :] / np.sum(off**2)
        until = int(np.argmax(alike < 0.0)) or off.size
        lags.append(2.0 * 2.0 * (alike[1:until].sum() + 0.5))  # both ways, in steps of 2 nm
    assert 0.6 <= np.median(left) / MODEL_ERROR <= 1.6
    assert 0.5 <= np.median(lags) / CORRELATION_NM <= 2.0


def ripe(*pigments: str) -> tuple[str, ...]:
    """Contents at the ripe end of the path, and what holds for all of it."""
    ends = ("chlorophyll", "carotenoid", "brown", *pigments)
    return (*fruit(*(f"ripe.{name}" for name in ends)), *fruit("structure", "flesh"))


def test_the_red_of_a_peach_is_not_that_of_a_pepper():
    # Peaches are red by anthocyanins: added to a yellow fruit, these explain its spectrum and capsanthin not.
    left = {}
    for pigment in ("capsanthin", "anthocyanin"):
        spectrum = measured("peach_skin_red_138", "pepper.ripe")
        fitting = Fitting(spectrum, ripe(pigment), load_cultivar("kaite"))
        starts = (fitting.default, fitting.anywhere(np.random.default_rng(1)))
        left[pigment] = min(fitting.rmse(fitting.best(start)) for start in starts)
    assert left["anthocyanin"] <= 0.5 * left["capsanthin"]
