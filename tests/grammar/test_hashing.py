"""Hashed random numbers are as good as drawn ones: uniform, and independent of each other.

Rationale: all random variation of plants comes from one hash. Set-up: addresses and names as plants use them.
Expected: chi-squared tests over addresses, and over pairs of numbers, at the significance 0.001.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from pepperscene.cultivar import load_cultivar
from pepperscene.grammar.hashing import (
    GOLDEN_GAMMA,
    child_addresses,
    draw_key,
    name_number,
    splitmix64,
    uniforms,
)

SIGNIFICANCE = 1e-3
KEY = draw_key(np.random.default_rng(2))
CHILDREN = child_addresses(KEY, np.arange(40_000))


def is_uniform(values: NDArray[np.float64]) -> bool:
    counts, _ = np.histogram(values, 100, (0.0, 1.0))
    return bool(stats.chisquare(counts).pvalue > SIGNIFICANCE)


def are_independent(first: NDArray[np.float64], second: NDArray[np.float64]) -> bool:
    counts, _, _ = np.histogram2d(first, second, 16, ((0.0, 1.0), (0.0, 1.0)))
    return bool(stats.chisquare(counts.ravel()).pvalue > SIGNIFICANCE)


def test_the_mixer_is_splitmix64() -> None:
    # The sequence of its seed 1234567 as Rosetta Code lists it for "Pseudo-random numbers/Splitmix64".
    expected = [
        6457827717110365317,
        3203168211198807973,
        9817491932198370423,
        4593380528125082431,
        16408922859458223821,
    ]
    states = [(1234567 + k * int(GOLDEN_GAMMA)) % 2**64 for k in range(1, 6)]
    assert splitmix64(np.array(states, dtype=np.uint64)).tolist() == expected


def test_numbers_are_uniform_over_plants() -> None:
    # One number of each of many plants with consecutive seeds, and of the same organ in each of them.
    keys = np.concatenate([draw_key(np.random.default_rng(seed)) for seed in range(4000)])
    assert is_uniform(uniforms(keys, "stem.lean"))
    assert is_uniform(uniforms(child_addresses(child_addresses(keys, 7), 1), "length"))
    assert are_independent(uniforms(keys, "stem.lean"), uniforms(child_addresses(keys, 0), "length"))


def test_neighbours_and_generations_are_independent() -> None:
    first, second = (child_addresses(CHILDREN, child) for child in (0, 1))
    length = uniforms(CHILDREN, "length")
    for name in ("length", "width"):
        assert are_independent(length[:-1], uniforms(CHILDREN, name)[1:])
        for child in (first, second):
            assert are_independent(length, uniforms(child, name))
    assert are_independent(uniforms(first, "length"), uniforms(second, "length"))


def test_addresses_are_unique_and_numbers_exclude_0_and_1() -> None:
    grandchildren = child_addresses(CHILDREN[:, None], np.arange(4)).ravel()
    addresses = np.concatenate((KEY, CHILDREN, grandchildren))
    assert len(np.unique(addresses)) == len(addresses)
    values = uniforms(addresses, "length")
    assert 0.0 < values.min() < values.max() < 1.0


def test_names_have_different_numbers() -> None:
    names = {name for model in load_cultivar("kaite").organs.values() for name in model.distributions}
    names |= {"seed", "what", "count", "azimuth", "spread", "stray", "side", "aside", "phase", "nodes"}
    names |= {"strength", "descent", "ripeness", "lobes", "calyx_seed", "zigzag", "pull", "size"}
    assert len({name_number(name) for name in names}) == len(names)


def test_numbers_do_not_depend_on_other_requests() -> None:
    assert np.array_equal(uniforms(CHILDREN, ("width", "length"))[1], uniforms(CHILDREN, "length"))
    assert np.array_equal(uniforms(CHILDREN[::-7], "state"), uniforms(CHILDREN, "state")[::-7])
