"""Random streams by address: a draw depends on the recipe's seed and on what it is for, on nothing else."""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Stream(IntEnum):
    """What random numbers are drawn for; every frame depends on these values, so never renumber them."""

    PLANT = 0
    SKY = 1
    TWINE = 2
    FRAME = 3
    SETTLE = 4
    PLACE = 5
    FAR = 6


def generator(seed: int, stream: Stream, *address: int) -> np.random.Generator:
    """The generator of one stream at one address.

    Args:
        seed: of the recipe.
        stream: what the numbers are for.
        address: which one of its kind: (set, plant) for a plant, its twine and how its organs settle, (set,)
            for the sky, (set, rotation, 0) for how a row settles, (set, 0) for the row's places, (set, 1,
            plant) for how a plant stands in its own, (0, model) for a plant of the far rows and (1, set,
            rotation) for where they stand.
    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(int(stream), *address)))


def frame_seed(seed: int, index: int) -> int:
    """The 32-bit seed of a frame's sampler and sensor noise."""
    sequence = np.random.SeedSequence(seed, spawn_key=(int(Stream.FRAME), index))
    return int(sequence.generate_state(1)[0])
