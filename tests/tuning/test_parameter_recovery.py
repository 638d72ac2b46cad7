"""Hidden parameters are recovered from noisy simulated patches.

Rationale: the truth of simulated patches is known, so fitted values can be compared with true values, and
stated errors with true errors.

Set-up: five parameters of a recipe are drawn at random, and their values from the priors. Patches of its
organs are rendered at these values like images (see `simulate_patches`). The fit starts from the
recipe's values, and a second one has the sensor's noise at what the first found. Simulation and fit share the
organs, and no random number of light and noise.

Expected: the median relative error of the entries is below 5 %, all patches are matched to less than one
CIEDE2000, and errors are as large as the fit states.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2
from simulated_fits import HIDDEN, KINDS, Recovery, draw_names, draw_values, recover

from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.recipe.resolve.load_camera import load_camera
from pepperscene.recipe.resolve.resolved import load_recipe_cultivar
from pepperscene.render.quality import Quality
from pepperscene.tuning.diagnostics import is_consistent
from pepperscene.tuning.parameters import select_parameters
from pepperscene.tuning.target import TuningTarget, simulate_patches
from pepperscene.tuning.view_model import VIEW_QUALITY

DRAWS = 8
VIEWS = Quality(32, 32, 32, 1, target=None, denoise=False)
"""With the default of 16 samples, the noise of light shifts the spread of colours within dim organs by half a
standard deviation: the median error of the third draw was 5.2 %."""
SIGNIFICANCE = 1e-4
"""Of the tests of stated errors: correct ones fail once in ten thousand."""

FEW_KINDS = ("leaf", "pepper.unripe", "pepper.ripe")
FEW = tuple(name for name in HIDDEN if not name.startswith(("petiole.", "peduncle.", "stem.")))
"""For small fits that every test run can afford."""


def recover_draw(seed: int, kinds, among, quality=VIEW_QUALITY, **size) -> Recovery:
    recipe, rng = load_recipe("barth2018"), np.random.default_rng([2018, seed])
    names = draw_names(rng, among=among)
    values = draw_values(
        select_parameters(recipe, load_recipe_cultivar(recipe), load_camera(recipe), names), rng
    )
    patches = simulate_patches(recipe, values, kinds, noise=seed + 1, **size)
    target = TuningTarget(recipe, patches, registered=True, quality=quality, **size)
    return recover(target, target.problem(names), values)


@cache
def small(seed: int) -> Recovery:
    return recover_draw(seed, FEW_KINDS, FEW, organs=2, pixels=32)


@cache
def large(seed: int) -> Recovery:
    return recover_draw(seed, KINDS, HIDDEN, quality=VIEWS)


def check_recovery(recovery: Recovery) -> None:
    errors = dict(zip(recovery.labels, recovery.relative_error.round(4), strict=True))
    assert np.median(recovery.relative_error) < 0.05, errors
    assert max(recovery.delta_e.values()) < 1.0, recovery.delta_e
    assert max(kind.delta_e_after for kind in recovery.fit.kinds.values()) < 1.0
    assert is_consistent(recovery.fit.chi_squared, recovery.fit.data_count), recovery.fit.diagnostics


def check_errors(recoveries: list[Recovery]) -> tuple[float, int]:
    """Errors are no larger than stated: jointly, by the fits' own covariances, and for each entry."""
    deviance = sum(one.deviance for one in recoveries)
    entries = sum(len(one.labels) for one in recoveries)
    assert deviance < chi2.isf(SIGNIFICANCE, entries), f"{deviance:.1f} of {entries} entries"
    # Single entries with Bonferroni's bound, including those that are reported as undetermined.
    errors = np.concatenate([(one.fitted - one.true) / one.sd for one in recoveries])
    assert (errors**2).max() < chi2.isf(SIGNIFICANCE / entries, 1), errors.round(1)
    return deviance, entries


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.long)])
def test_recovers_hidden_parameters(seed):
    check_recovery(small(seed))


@pytest.mark.long
def test_errors_are_as_large_as_stated():
    check_errors([small(seed) for seed in range(2)])


@pytest.mark.long
@pytest.mark.parametrize("seed", range(DRAWS))
def test_recovers_hidden_parameters_from_all_kinds(seed):
    check_recovery(large(seed))


@pytest.mark.long
def test_errors_of_all_draws_are_as_large_as_stated():
    deviance, entries = check_errors([large(seed) for seed in range(DRAWS)])
    # Nor are they much smaller than stated.
    assert deviance > chi2.ppf(SIGNIFICANCE, entries)
