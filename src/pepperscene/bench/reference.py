"""Pictures that are kept for the next bench: a file of arrays is whole, or counts as not there."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any, Final
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from pepperscene.bench.scenes import BenchSubject
from pepperscene.camera import Camera, camera_rgb, correct_colours
from pepperscene.dataset.store.atomic import atomic_write
from pepperscene.errors import SetupError
from pepperscene.render import Quality


def read_arrays(path: Path) -> dict[str, NDArray[Any]] | None:
    """The arrays of a file by name; None where there is no such file or it is damaged."""
    try:
        with path.open("rb") as file, np.load(file) as kept:
            return dict(kept)
    except (OSError, ValueError, EOFError, BadZipFile):
        return None


def write_arrays(path: Path, **arrays: Any) -> None:
    """Write arrays and numbers by name; the folder is made when missing.

    Raises:
        OSError: it cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)


EXTRA: Final = "pip install 'pepperscene[bench]'"

REGULARISER: Final = 1e-2
"""Of the relative squared error, times the squared mean of the reference: the 0.01 with which Rousselle,
Knaus and Zwicker ("Adaptive sampling and reconstruction using greedy error minimization", 2011) divide where
pictures have a mean about 1."""


@dataclass(frozen=True)
class Errors:
    """Of a picture.

    Attributes:
        rmse_codes: root of the mean squared difference of the developed, noise-free pictures, in codes of
            8 bits, but not rounded to whole ones: rounding alone would add 0.4 codes.
        relative_mse: mean of (x - r)^2 / (r^2 + 0.01 mean(r)^2) over electrons.
        flip: mean of FLIP (Andersson et al. 2020) at 67 pixels per degree, 0 to 1; nan where it was not asked
            for.
    """

    rmse_codes: float
    relative_mse: float
    flip: float = float("nan")

    def without(self, rmse_codes: float, relative_mse: float) -> Errors:
        """What is left when a reference's own error, independent of the picture's, is taken off in squares.

        Args:
            rmse_codes: of the reference; nan where it is not known, which takes nothing off.
            relative_mse: of it.
        """
        own_codes, own_relative = (0.0 if x != x else x for x in (rmse_codes, relative_mse))
        return dataclasses.replace(
            self,
            rmse_codes=math.sqrt(max(self.rmse_codes**2 - own_codes**2, 0.0)),
            relative_mse=max(self.relative_mse - own_relative, 0.0),
        )


def errors(
    electrons: NDArray[np.floating], reference: NDArray[np.floating], camera: Camera, *, flip: bool = True
) -> Errors:
    """The errors of `(h, w, c)` expected electrons against those of the converged picture.

    Raises:
        SetupError: FLIP is asked for and not installed.
    """
    found, wanted = codes(electrons, camera), codes(reference, camera)
    return Errors(
        rmse_codes=rms(found - wanted),
        relative_mse=relative_mse(electrons, reference),
        flip=flip_of(found, wanted) if flip else float("nan"),
    )


def codes(electrons: NDArray[Any], camera: Camera) -> NDArray[np.float64]:
    """`(h, w, c)` the developed picture without noise, in codes of 8 bits, 0 to 255, not rounded."""
    exact = dataclasses.replace(camera, developing=dataclasses.replace(camera.developing, quantise=False))
    linear = np.clip(np.asarray(correct_colours(camera_rgb(electrons, exact), exact), float), 0.0, 1.0)
    if camera.developing.tone == "srgb":
        # IEC 61966-2-1, as `pepperscene.camera.encode_tone` has it with rounding.
        linear = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return linear * 255.0


def rms(difference: NDArray[np.floating]) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(difference, dtype=float))))


def relative_mse(found: NDArray[np.floating], reference: NDArray[np.floating]) -> float:
    """Mean of (x - r)^2 / (r^2 + `REGULARISER` mean(r)^2); 0 / 0 counts as 0.

    It is worked out in units of the mean, so that no square overflows.
    """
    x, r = np.asarray(found, float), np.asarray(reference, float)
    mean = float(np.abs(r).mean())
    if mean == 0.0:
        return 0.0 if not x.any() else float("inf")
    x, r = x / mean, r / mean
    return float(np.mean((x - r) ** 2 / (r**2 + REGULARISER)))


def flip_of(found: NDArray[np.float64], reference: NDArray[np.float64]) -> float:
    """Mean LDR-FLIP of two pictures in codes.

    Raises:
        SetupError: the package is not installed.
    """
    try:
        import flip_evaluator
    except ImportError:
        raise SetupError(f"the bench needs flip-evaluator, which is not installed: {EXTRA}") from None
    pictures = [_three(picture / 255.0) for picture in (reference, found)]
    _, mean, _ = flip_evaluator.evaluate(*pictures, "LDR", applyMagma=False)
    return float(mean)


def check_extra() -> None:
    """Find out before anything is measured whether the extra `bench` is there.

    Raises:
        SetupError: it is not.
    """
    from importlib.util import find_spec

    packages = {"flip_evaluator": "flip-evaluator", "matplotlib": "matplotlib"}
    missing = [package for module, package in packages.items() if find_spec(module) is None]
    if missing:
        raise SetupError(f"the bench needs {' and '.join(missing)}, not installed here: {EXTRA}")


def _three(picture: NDArray[np.float64]) -> NDArray[np.float32]:
    """Three channels, whatever the sensor has."""
    shape = (*picture.shape[:2], 3)
    return np.ascontiguousarray(np.broadcast_to(np.clip(picture, 0.0, 1.0), shape), np.float32)


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
    subject: BenchSubject,
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
