"""Residue, ageing and damage of leaves: their distributions, and their relation to height and age."""

from functools import cache

import numpy as np
import pytest

from pepperscene.cultivar import load_cultivar
from pepperscene.grammar import draw_parameters

PLANTS = 60


@cache
def blades(name: str) -> tuple[dict[str, np.ndarray], np.ndarray, int]:
    """Values of the stem's leaves of many plants, their phytomers, and the number of mature phytomers."""
    cultivar = load_cultivar(name)
    grown = [draw_parameters(cultivar, np.random.default_rng(k)).organs["lamina"] for k in range(PLANTS)]
    values = {key: np.concatenate([group.values[key] for group in grown]) for key in grown[0].values}
    mature = cultivar.stem.parts - cultivar.stem.young_nodes
    return values, np.concatenate([group.phytomer for group in grown]), mature


def test_leaves_follow_the_stated_distributions() -> None:
    values, phytomer, mature = blades("kaite")
    old = phytomer < mature
    lamina = load_cultivar("kaite").organs["lamina"].distributions
    count = int(old.sum())
    residue = values["residue"][old]
    # Heights are a fixed grid, so means vary less than those of independent draws.
    assert residue.mean() == pytest.approx(lamina["residue"].mean, abs=4.0 * residue.std() / np.sqrt(count))
    for name in ("ageing", "bites", "tears"):
        chance = sum(weight for low, high, weight in lamina[name].bins if high > 0.0)
        share = (values[name][old] > 0.0).mean()
        assert share == pytest.approx(chance, abs=4.0 * np.sqrt(chance * (1.0 - chance) / count))
    assert np.all(values["ageing"][values["ageing"] > 0.0] >= 0.08)


def test_low_leaves_are_older() -> None:
    values, phytomer, mature = blades("kaite")
    low, high = phytomer < mature / 3, (phytomer >= 2 * mature / 3) & (phytomer < mature)
    assert 0.2 < (values["ageing"][low] > 0.0).mean() < 0.35
    assert (values["ageing"][high] > 0.0).mean() < 0.05
    assert values["residue"][low].mean() > 1.5 * values["residue"][high].mean()


def test_signs_of_age_occur_together() -> None:
    values, phytomer, mature = blades("kaite_old")
    # At similar heights, so that the relation is not that with the height.
    middle = (phytomer > 0.3 * mature) & (phytomer < 0.7 * mature)
    ageing = values["ageing"][middle] > 0.0
    for name, sign in (("residue", 1), ("bites", 1), ("inclination", -1)):
        column = values[name][middle]
        error = column.std() * np.sqrt(1.0 / ageing.sum() + 1.0 / (~ageing).sum())
        assert sign * (column[ageing].mean() - column[~ageing].mean()) > 4.0 * error


def test_growing_leaves_are_whole_and_cleaner() -> None:
    values, phytomer, mature = blades("kaite_old")
    young = phytomer >= mature
    for name in ("ageing", "bites", "tears"):
        assert not values[name][young].any()
    assert 0.0 < values["residue"][young].mean() < 0.6 * values["residue"][~young].mean()


def test_clean_crops_have_no_signs_of_use() -> None:
    values, _, _ = blades("kaite_clean")
    for name in ("residue", "ageing", "bites", "tears", "rolled"):
        assert not values[name].any()
