"""Random numbers of a sample that depend only on the seed, the epoch and the position of the sample.

A `DataLoader` distributes samples to workers, whose number and order must not change the result.
"""

from __future__ import annotations

import random  # noqa: TID251 - only its state is set, for the functions of users
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch


def sample_seeds(seed: int, epoch: int, position: int) -> tuple[np.random.Generator, int]:
    """The generator of an augmentation, and an independent seed of 64 bits for the transform of a user."""
    ours, users = np.random.SeedSequence([seed, epoch, position]).spawn(2)
    return np.random.default_rng(ours), int(users.generate_state(1, np.uint64)[0])


def drawn_generator() -> np.random.Generator:
    """A generator seeded by torch's, which a `DataLoader` seeds differently in each worker and epoch."""
    return np.random.default_rng(int(torch.randint(2**62, ())))


@contextmanager
def global_seeds(seed: int) -> Iterator[None]:
    """Seed torch (CPU), NumPy's global generator and `random`; afterwards they are as they were before."""
    numpy_state = np.random.get_state()  # noqa: NPY002 - transforms of users may use it
    torch_state, python_state = torch.get_rng_state(), random.getstate()
    try:
        # `torch.manual_seed` would also start CUDA, which forked workers cannot.
        torch.default_generator.manual_seed(seed)
        np.random.seed(seed % 2**32)  # noqa: NPY002, TID251
        random.seed(seed)
        yield
    finally:
        torch.set_rng_state(torch_state)
        np.random.set_state(numpy_state)  # noqa: NPY002
        random.setstate(python_state)
