"""Interpolation between growth stages: quantiles, probabilities, numbers and pigments are linear."""

import datetime

import numpy as np
import pytest

from pepperscene.cultivar import Cultivar, interpolate_cultivars, load_cultivar
from pepperscene.errors import InputError

PROBABILITIES = (np.arange(2000) + 0.5) / 2000
Stages = tuple[Cultivar, Cultivar, Cultivar]


@pytest.fixture(scope="module")
def stages() -> Stages:
    first, middle, last = (load_cultivar(name) for name in ("kaite_february", "kaite", "kaite_september"))
    return first, middle, last


@pytest.mark.long
def test_every_quantile_is_interpolated(stages: Stages) -> None:
    first, last, _ = stages
    for kind, organ in interpolate_cultivars(first, last, 0.3).organs.items():
        for name, distribution in organ.distributions.items():
            ends = [c.organs[kind].distributions[name].quantiles(PROBABILITIES, 0.4) for c in (first, last)]
            expected = 0.7 * ends[0] + 0.3 * ends[1]
            values = distribution.quantiles(PROBABILITIES, 0.4)
            assert values == pytest.approx(expected, rel=1e-12, abs=1e-15), f"{kind}.{name}"


def test_ends_and_equal_stages_are_unchanged(stages: Stages) -> None:
    first, last, _ = stages
    assert interpolate_cultivars(first, last, 0.0) == first
    assert interpolate_cultivars(first, last, 1.0) == last
    same = interpolate_cultivars(first, first.model_copy(update={"name": "x"}), 0.4)
    assert (same.organs, same.stem, same.pigments) == (first.organs, first.stem, first.pigments)


def test_numbers_probabilities_pigments_and_dates_are_interpolated(stages: Stages) -> None:
    first, last, september = stages
    middle = interpolate_cultivars(first, last, 0.5)
    assert middle.stem.parts == round((first.stem.parts + last.stem.parts) / 2)
    assert None not in (first.date, middle.date, last.date)
    assert abs((middle.date - first.date) - (last.date - middle.date)) <= datetime.timedelta(days=1)
    chances = [
        next(s for s in c.organs["node"].bears if s.name == "fruit").what.probabilities
        for c in (first, middle, last)
    ]
    for outcome in ("peduncle", "cut", "none"):
        assert chances[1][outcome] == pytest.approx((chances[0][outcome] + chances[2][outcome]) / 2)
    red, states = load_cultivar("red_blocky"), np.linspace(0, 1, 21)
    ends = [c.pigments["fruit"].at(states) for c in (september, red)]
    between = interpolate_cultivars(september, red, 0.5).pigments["fruit"].at(states)
    for name, contents in between.items():
        assert contents == pytest.approx(0.5 * (ends[0][name] + ends[1][name]), abs=1e-12)


def test_any_fraction_gives_a_valid_cultivar(stages: Stages) -> None:
    first, middle, last = stages
    for a, b in ((first, middle), (middle, last), (first, last)):
        for fraction in (0.1, 0.5, 0.9):
            interpolate_cultivars(a, b, float(fraction))


def test_raises_on_different_plants(stages: Stages) -> None:
    tomato, kaite = load_cultivar("tomato"), stages[1]
    with pytest.raises(InputError, match="Kaite and Vine tomato: species: must be the same in both"):
        interpolate_cultivars(kaite, tomato, 0.5)
    organs = {("calix" if name == "cut" else name): organ for name, organ in kaite.organs.items()}
    other = kaite.model_copy(update={"organs": organs})
    with pytest.raises(InputError, match="organs: must have the same names in both: calix, cut"):
        interpolate_cultivars(kaite, other, 0.5)
    with pytest.raises(ValueError, match="fraction must be between 0 and 1"):
        interpolate_cultivars(kaite, kaite, 1.5)
