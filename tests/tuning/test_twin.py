"""Hidden parameters are found again in noisy pictures that another renderer made of them.

Rationale: on a twin, everything is known. What a fit says of a parameter can be held against its true value,
and what it says of its own error against the error.

Set-up: five parameters of a recipe are drawn, and their values from the bounds; patches of its organs are
rendered at those values as pictures are (see `pepperscene.tuning.twin`). The fit starts from the recipe's own
values.

Expected: the median of the entries' relative errors below 5 %, all patches met to less than one CIEDE2000,
and errors as large as the fit says they are.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2
from twins import (
    HIDDEN,
    KINDS,
    SAME,
    Recovery,
    drawn_names,
    drawn_values,
    recovered,
)

from pepperscene.dataset import load_recipe
from pepperscene.dataset.recipe.resolved import load_camera, load_recipe_cultivar
from pepperscene.tuning.fit.diagnostics import as_expected
from pepperscene.tuning.model.subject import TuningTarget
from pepperscene.tuning.parameters.parameter import select_parameters
from pepperscene.tuning.twin import simulate_patches

DRAWS = 20
SIGNIFICANCE = 1e-4
"""Of the tests of what fits say of their errors: a right one fails once in ten thousand."""

FEW_KINDS = ("leaf", "pepper.unripe", "pepper.ripe")
FEW = tuple(name for name in HIDDEN if not name.startswith(("petiole.", "peduncle.", "stem.")))
"""Of a small twin that every run of the tests can afford."""


def twin(seed: int, kinds, among, **size) -> Recovery:
    """One draw, from end to end; twin and fit share organs, and no random number of light and noise."""
    recipe, rng = load_recipe("barth2018"), np.random.default_rng([2018, seed])
    names = drawn_names(rng, among=among)
    values = drawn_values(
        select_parameters(recipe, load_recipe_cultivar(recipe), load_camera(recipe), names), rng
    )
    patches = simulate_patches(recipe, values, kinds, noise=seed + 1, **size)
    subject = TuningTarget(recipe, patches, registered=True, **size)
    return recovered(subject, subject.problem(names), values)


@cache
def small(seed: int) -> Recovery:
    return twin(seed, FEW_KINDS, FEW, organs=2, pixels=32)


@cache
def whole(seed: int) -> Recovery:
    return twin(seed, KINDS, HIDDEN)


def check(found: Recovery) -> None:
    """The laws of one twin."""
    told = dict(zip(found.labels, found.relative.round(4), strict=True))
    assert np.median(found.relative) < 0.05, told
    assert max(found.delta_e.values()) < 1.0, found.delta_e
    assert max(kind.delta_e_after for kind in found.fit.kinds.values()) < 1.0
    assert as_expected(found.fit.chi_squared, found.fit.data), found.fit.diagnostics


def check_errors(every: list[Recovery]) -> None:
    """Errors are no larger than fits say: the sum of squares of all entries, by the fits' own covariances."""
    deviance, entries = sum(one.deviance for one in every), sum(len(one.labels) for one in every)
    assert deviance < chi2.isf(SIGNIFICANCE, entries), f"{deviance:.1f} of {entries} entries"
    # So are those of single entries, the ones that are called open among them (Bonferroni's bound).
    off = np.concatenate([(one.found - one.true) / one.sd for one in every])
    assert (off**2).max() < chi2.isf(SIGNIFICANCE / entries, 1), off.round(1)


@pytest.mark.parametrize("seed", range(2))
def test_hidden_parameters_are_found(seed):
    check(small(seed))


def test_errors_are_as_large_as_the_fit_says():
    check_errors([small(seed) for seed in range(2)])


@pytest.mark.long
@pytest.mark.parametrize("seed", range(DRAWS))
def test_hidden_parameters_are_found_on_every_organ(seed):
    check(whole(seed))


@pytest.mark.long
def test_errors_of_all_draws_are_as_large_as_the_fits_say():
    every = [whole(seed) for seed in range(DRAWS)]
    check_errors(every)
    # Nor are they much smaller: fits are as sure as they can be.
    deviance, entries = sum(one.deviance for one in every), sum(len(one.labels) for one in every)
    assert deviance > chi2.ppf(SIGNIFICANCE, entries)


# --- what twins stand for -----------------------------------------------------------------------------------


def test_draws_keep_apart_what_no_picture_can_tell_apart():
    """Twice the light and twice the gain are the same picture, but for its noise."""
    every = [drawn_names(np.random.default_rng(seed)) for seed in range(300)]
    assert all(len(set(names)) == 5 and set(names) <= set(HIDDEN) for names in every)
    assert not any(set(pair) <= set(names) for names in every for pair in SAME)
    assert set().union(*every) == set(HIDDEN)
