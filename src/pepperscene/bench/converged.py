"""The converged picture that errors are taken against, in two halves that tell how far it can be trusted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.bench.kept import read_arrays, write_arrays
from pepperscene.bench.metrics import codes, relative_mse, rms
from pepperscene.bench.subject import Subject
from pepperscene.camera import Camera
from pepperscene.render import Quality

SMALLEST_ERROR: Final = 0.5
"""Codes: the smallest error of interest. Chosen: a picture is rounded with an error of 0.3 codes."""

SHARE: Final = 0.1
"""Of the smallest error that the reference's own may be: it then adds half a per cent to what is measured."""

_SEEDS: Final = 1_000_000  # chosen: far from those of what is measured
_KEPT_EVERY_S: Final = 60.0  # chosen: what a stop costs at most
_FORM: Final = 1
"""Of the file; another number forgets all that are there."""

Told = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Converged:
    """A picture whose error is known.

    Attributes:
        electrons: `(h, w, c)` float64, the mean of both halves.
        error_codes: estimated RMSE of it, in codes, from the difference of the halves.
        relative_mse: estimated of it.
        renders: how many pictures went into it.
        seconds: that took.
    """

    electrons: NDArray[np.float64]
    error_codes: float
    relative_mse: float
    renders: int
    seconds: float


@dataclass(eq=False)
class Halves:
    """Sums of independent pictures, even ones in the first half and odd ones in the second."""

    sums: NDArray[np.float64]
    renders: int = 0
    seconds: float = 0.0

    def add(self, electrons: NDArray[np.floating], seconds: float) -> None:
        """One more picture."""
        self.sums[self.renders % 2] += electrons
        self.renders += 1
        self.seconds += seconds

    def converged(self, camera: Camera) -> Converged:
        """What they come to; at least two pictures are needed.

        The mean of two independent halves errs by half of their difference.
        """
        first, second = self.sums[0] / ((self.renders + 1) // 2), self.sums[1] / (self.renders // 2)
        mean = self.sums.sum(axis=0) / self.renders
        apart = rms(codes(first, camera) - codes(second, camera)) / 2
        return Converged(
            mean, apart, relative_mse(mean + (first - second) / 2, mean), self.renders, self.seconds
        )


def converged(
    subject: Subject,
    folder: Path,
    quality: str | Quality = "reference",
    wanted_codes: float = SHARE * SMALLEST_ERROR,
    limit_s: float | None = None,
    told: Told = lambda _: None,
) -> Converged:
    """The converged picture of a subject, from the cache as far as it goes there.

    What is rendered is added to what an earlier call left, so that no sample is paid for twice.

    Args:
        subject: whose camera's view of the whole scene it is.
        folder: of the cache; made when missing. Files are named after scene, camera and version.
        quality: of the pictures that are added up; without denoiser.
        wanted_codes: the error at which it ends.
        limit_s: seconds after which it ends as well, with two pictures at least.
        told: is told how it goes.

    Raises:
        OSError: the cache cannot be written to.
    """
    path = folder / f"{subject.name}_{subject.digest()[:20]}.npz"
    halves = _read(path)
    if halves is None:
        camera = subject.camera
        halves = Halves(np.zeros((2, camera.height, camera.width, camera.sensor.channels)))
    start = kept = perf_counter()
    while True:
        now = perf_counter()
        if halves.renders >= 2:
            found = halves.converged(subject.camera)
            late = limit_s is not None and now - start > limit_s
            done = found.error_codes <= wanted_codes or late
            if done or now - kept > _KEPT_EVERY_S:
                _write(path, halves)
                kept = now
            if done:
                return found
            told(
                f"{subject.name}: reference, {halves.renders} pictures, {found.error_codes:.3f} of "
                f"{wanted_codes:g} codes"
            )
        electrons = subject.truth(quality, _SEEDS + halves.renders)
        halves.add(electrons, perf_counter() - now)


def _read(path: Path) -> Halves | None:
    """What an earlier call left, if it is whole."""
    kept = read_arrays(path)
    if kept is None or int(kept.get("form", 0)) != _FORM:
        return None
    return Halves(kept["sums"], int(kept["renders"]), float(kept["seconds"]))


def _write(path: Path, halves: Halves) -> None:
    write_arrays(path, sums=halves.sums, renders=halves.renders, seconds=halves.seconds, form=_FORM)
