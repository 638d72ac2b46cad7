"""Between two growth stages: quantiles, probabilities, numbers and pigments are mixed linearly."""

from __future__ import annotations

import datetime

import numpy as np
import pytest

from pepperscene.cultivar import Cultivar, Distribution, interpolate_cultivars, load_cultivar
from pepperscene.errors import InputError

SHARES = (np.arange(2000) + 0.5) / 2000


@pytest.fixture(scope="module")
def stages() -> tuple[Cultivar, Cultivar, Cultivar]:
    first, middle, last = (load_cultivar(name) for name in ("kaite_february", "kaite", "kaite_september"))
    return first, middle, last


def test_every_quantile_is_the_mix_of_both(stages: tuple[Cultivar, Cultivar, Cultivar]) -> None:
    first, last, _ = stages
    mixed = interpolate_cultivars(first, last, 0.3)
    for kind, organ in mixed.organs.items():
        for name, law in organ.distributions.items():
            ends = [c.organs[kind].distributions[name].quantiles(SHARES, 0.4) for c in (first, last)]
            expected = 0.7 * ends[0] + 0.3 * ends[1]
            assert law.quantiles(SHARES, 0.4) == pytest.approx(expected, rel=1e-12, abs=1e-15), (
                f"{kind}.{name}"
            )


def test_the_ends_are_the_stages_themselves(stages: tuple[Cultivar, Cultivar, Cultivar]) -> None:
    first, last, _ = stages
    assert interpolate_cultivars(first, last, 0.0) == first
    assert interpolate_cultivars(first, last, 1.0) == last
    alike = interpolate_cultivars(first, first.model_copy(update={"name": "x"}), 0.4)
    assert (alike.organs, alike.stem, alike.pigments) == (first.organs, first.stem, first.pigments)


def test_between_two_normal_laws_lies_a_normal_law(stages: tuple[Cultivar, Cultivar, Cultivar]) -> None:
    """Both cut at three standard deviations, so every moment is mixed linearly."""
    _, first, last = stages
    law = interpolate_cultivars(first, last, 0.25).organs["node"].distributions["width"]
    ends = [c.organs["node"].distributions["width"] for c in (first, last)]
    mean, sd = (0.75 * getattr(ends[0], m) + 0.25 * getattr(ends[1], m) for m in ("mean", "sd"))
    normal = Distribution(law="normal", mean=mean, sd=sd, low=mean - 3 * sd, high=mean + 3 * sd, chosen="x")
    assert law.quantiles(SHARES) == pytest.approx(normal.quantiles(SHARES), rel=1e-9)
    assert (law.mean, law.sd) == (pytest.approx(mean), pytest.approx(sd, rel=1e-3))


def test_numbers_probabilities_pigments_and_dates_are_mixed(
    stages: tuple[Cultivar, Cultivar, Cultivar],
) -> None:
    first, last, _ = stages
    mixed = interpolate_cultivars(first, last, 0.5)
    assert mixed.stem.parts == round((first.stem.parts + last.stem.parts) / 2)
    assert None not in (first.date, mixed.date, last.date)
    assert abs((mixed.date - first.date) - (last.date - mixed.date)) <= datetime.timedelta(days=1)
    slots = [
        {s.name: s for s in c.organs["node"].bears}["fruit"].what.probabilities for c in (first, mixed, last)
    ]
    for outcome in ("peduncle", "cut", "none"):
        assert slots[1][outcome] == pytest.approx((slots[0][outcome] + slots[2][outcome]) / 2)
    red = load_cultivar("red_blocky")
    states = np.linspace(0, 1, 21)
    ends = [c.pigments["fruit"].at(states) for c in (last, red)]
    between = interpolate_cultivars(last, red, 0.5).pigments["fruit"].at(states)
    for name, contents in between.items():
        assert contents == pytest.approx(0.5 * (ends[0][name] + ends[1][name]), abs=1e-12)


def test_any_share_between_any_two_stages_is_a_cultivar(stages: tuple[Cultivar, Cultivar, Cultivar]) -> None:
    first, middle, last = stages
    for one, other in ((first, middle), (middle, last), (first, last)):
        for share in np.linspace(0, 1, 11):
            interpolate_cultivars(one, other, float(share))


def test_stages_of_different_plants_are_told(stages: tuple[Cultivar, Cultivar, Cultivar]) -> None:
    tomato, kaite = load_cultivar("tomato"), stages[1]
    with pytest.raises(InputError, match="Kaite and Vine tomato: species: must be the same in both"):
        interpolate_cultivars(kaite, tomato, 0.5)
    organs = {("calix" if name == "cut" else name): organ for name, organ in kaite.organs.items()}
    other = kaite.model_copy(update={"organs": organs})
    with pytest.raises(InputError, match="organs: must name the same in both: calix, cut"):
        interpolate_cultivars(kaite, other, 0.5)
    with pytest.raises(ValueError, match="share"):
        interpolate_cultivars(kaite, kaite, 1.5)
