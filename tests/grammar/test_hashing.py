"""Numbers that are looked up are as good as drawn ones: uniform, and independent of each other.

Rationale: all variety of the plants comes out of one hash. Set-up: addresses and names as plants have them.
Expected: chi-squared tests over addresses, and over pairs of numbers, at the significance 0.001.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from pepperscene.cultivar import load_cultivar
from pepperscene.grammar.hashing import descended, drawn_key, number, several_shares, shares, splitmix64

SIGNIFICANCE = 1e-3
KEY = drawn_key(np.random.default_rng(2))
CHILDREN = descended(KEY, np.arange(40_000))


def uniform(values: NDArray[np.float64]) -> bool:
    counts, _ = np.histogram(values, 100, (0.0, 1.0))
    return bool(stats.chisquare(counts).pvalue > SIGNIFICANCE)


def independent(first: NDArray[np.float64], second: NDArray[np.float64]) -> bool:
    counts, _, _ = np.histogram2d(first, second, 16, ((0.0, 1.0), (0.0, 1.0)))
    return bool(stats.chisquare(counts.ravel()).pvalue > SIGNIFICANCE)


def test_the_mixer_is_splitmix64() -> None:
    # The sequence of its seed 1234567 as Rosetta Code lists it for "Pseudo-random numbers/Splitmix64".
    listed = [
        6457827717110365317,
        3203168211198807973,
        9817491932198370423,
        4593380528125082431,
        16408922859458223821,
    ]
    golden = 0x9E3779B97F4A7C15
    states = [(1234567 + k * golden) % 2**64 for k in range(1, 6)]
    assert splitmix64(np.array(states, dtype=np.uint64)).tolist() == listed


@pytest.mark.parametrize("name", ["length", "width", "state", "what"])
def test_shares_are_uniform_over_addresses(name: str) -> None:
    assert uniform(shares(CHILDREN, name))


def test_shares_are_uniform_over_plants() -> None:
    # One number each of plants with neighbouring seeds, and of the same organ in each of them.
    keys = np.concatenate([drawn_key(np.random.default_rng(seed)) for seed in range(5000)])
    assert uniform(shares(keys, "stem.lean"))
    assert uniform(shares(descended(descended(keys, 7), 1), "length"))
    assert independent(shares(keys, "stem.lean"), shares(descended(keys, 0), "length"))


def test_shares_of_one_organ_are_independent() -> None:
    names = ("length", "width", "inclination", "seed", "what")
    values = several_shares(CHILDREN, names)
    for i in range(len(names)):
        for j in range(i):
            assert independent(values[i], values[j]), (names[i], names[j])


def test_neighbours_and_generations_are_independent() -> None:
    for name in ("length", "width"):
        own = shares(CHILDREN, "length")
        assert independent(own[:-1], shares(CHILDREN, name)[1:])
        for child in (0, 1):
            assert independent(own, shares(descended(CHILDREN, child), name))
    assert independent(shares(descended(CHILDREN, 0), "length"), shares(descended(CHILDREN, 1), "length"))


def test_addresses_and_shares_stay_apart() -> None:
    grandchildren = descended(CHILDREN[:, None], np.arange(4)).ravel()
    every = np.concatenate((KEY, CHILDREN, grandchildren))
    assert len(np.unique(every)) == len(every)
    values = shares(every, "length")
    assert 0.0 < values.min() < values.max() < 1.0


def test_no_two_parameters_share_a_number() -> None:
    names = {name for model in load_cultivar("kaite").organs.values() for name in model.distributions}
    names |= {"seed", "what", "count", "azimuth", "spread", "stray", "side", "aside", "phase", "nodes"}
    names |= {"strength", "descent", "ripeness", "lobes", "calyx_seed", "zigzag", "pull", "size"}
    assert len({number(name) for name in names}) == len(names)


def test_numbers_do_not_depend_on_what_else_is_asked() -> None:
    assert np.array_equal(several_shares(CHILDREN, ("width", "length"))[1], shares(CHILDREN, "length"))
    assert np.array_equal(shares(CHILDREN[::-7], "state"), shares(CHILDREN, "state")[::-7])
