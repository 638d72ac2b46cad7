"""Errors of images, and converged reference images that are cached and refined from call to call."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter
from typing import Any, Final
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from pepperscene.bench.scenes import BenchSubject
from pepperscene.camera import Camera, add_pedestal, camera_rgb, correct_colours
from pepperscene.dataset.store.atomic import atomic_write
from pepperscene.errors import SetupError
from pepperscene.render import Quality

OnProgress = Callable[[str], None]
"""Called with a line of progress."""

_MEAN_WEIGHT: Final = 1e-2
"""Regularisation of the relative error, in squared means of the reference: the 0.01 of Rousselle, Knaus and
Zwicker 2011 ("Adaptive sampling and reconstruction using greedy error minimization") for a mean of 1."""


# --- errors -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Errors:
    """Errors of an image.

    Attributes:
        rmse_codes: root mean squared difference of the developed, noise-free images, in 8-bit codes, before
            rounding to whole codes, which would add 0.4 codes.
        relative_mse: mean of (x - r)^2 / (r^2 + 0.01 mean(r)^2) over electrons.
        flip: mean of FLIP (Andersson et al. 2020) at 67 pixels per degree, 0 to 1.
    """

    rmse_codes: float
    relative_mse: float
    flip: float

    def subtract(self, rmse_codes: float, relative_mse: float) -> Errors:
        """Subtract the squared errors of the reference, which are independent of the image's."""
        return dataclasses.replace(
            self,
            rmse_codes=math.sqrt(max(self.rmse_codes**2 - rmse_codes**2, 0.0)),
            relative_mse=max(self.relative_mse - relative_mse, 0.0),
        )


def measure_errors(
    electrons: NDArray[np.floating], reference: NDArray[np.floating], camera: Camera
) -> Errors:
    """Errors of expected electrons `(h, w, c)` against those of the converged image."""
    picture, converged = develop_codes(electrons, camera), develop_codes(reference, camera)
    return Errors(rms(picture - converged), relative_mse(electrons, reference), mean_flip(picture, converged))


def develop_codes(electrons: NDArray[Any], camera: Camera) -> NDArray[np.float64]:
    """`(h, w, c)` the developed image without noise, in 8-bit codes, 0 to 255, not rounded."""
    exact = dataclasses.replace(camera, developing=dataclasses.replace(camera.developing, quantise=False))
    corrected = add_pedestal(correct_colours(camera_rgb(electrons, exact), exact), exact)
    linear = np.clip(np.asarray(corrected, float), 0.0, 1.0)
    if camera.developing.tone == "srgb":
        # IEC 61966-2-1, as `pepperscene.camera.encode_tone` has it with rounding.
        linear = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return linear * 255.0


def rms(difference: NDArray[np.floating]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(difference, dtype=float))))


def relative_mse(image: NDArray[np.floating], reference: NDArray[np.floating]) -> float:
    """Mean of (x - r)^2 / (r^2 + 0.01 mean(r)^2); 0 / 0 counts as 0.

    It is computed in units of the mean, so that no square overflows.
    """
    x, r = np.asarray(image, float), np.asarray(reference, float)
    mean = float(np.abs(r).mean())
    if mean == 0.0:
        return 0.0 if not x.any() else float("inf")
    x, r = x / mean, r / mean
    return float(np.mean((x - r) ** 2 / (r**2 + _MEAN_WEIGHT)))


def mean_flip(image: NDArray[np.float64], reference: NDArray[np.float64]) -> float:
    """Mean LDR-FLIP of two images in codes; it takes 0.2 s for 800 x 600 pixels."""
    import flip_evaluator

    shape = (*image.shape[:2], 3)  # three channels, also for a monochrome sensor
    arrays = [
        np.ascontiguousarray(np.broadcast_to(np.clip(codes / 255.0, 0.0, 1.0), shape), np.float32)
        for codes in (reference, image)
    ]
    _, mean, _ = flip_evaluator.evaluate(*arrays, "LDR", applyMagma=False)
    return float(mean)


def check_packages() -> None:
    """Check that the packages of the extra `bench` are installed.

    Raises:
        SetupError: one is missing.
    """
    packages = {"flip_evaluator": "flip-evaluator", "matplotlib": "matplotlib"}
    missing = [package for module, package in packages.items() if find_spec(module) is None]
    if missing:
        command = "pip install 'pepperscene[bench]'"
        raise SetupError(f"the benchmark needs {' and '.join(missing)}, not installed here: {command}")


# --- converged images -------------------------------------------------------------------------------------


SMALLEST_ERROR: Final = 0.5
"""Smallest error of interest, in codes. Chosen: rounding an image has an error of 0.3 codes."""

TARGET_FRACTION: Final = 0.1
"""Target error of the reference over the smallest error of interest: it adds half a per cent to results."""

_FIRST_SEED: Final = 1_000_000  # chosen: far from the seeds of the measured frames
_SAVE_INTERVAL_S: Final = 60.0  # chosen: the most that an interruption costs
_FORMAT: Final = 1
"""Version of the cache files; others are ignored."""


@dataclass(frozen=True, eq=False)
class Reference:
    """A converged image and its estimated error."""

    electrons: NDArray[np.float64]  # `(h, w, c)` float64, the mean of both halves
    error_codes: float  # estimated RMSE in codes, from the difference of the halves
    relative_mse: float  # estimated relative MSE
    renders: int  # number of images in the mean
    seconds: float  # rendering time of all of them


@dataclass(eq=False)
class _Halves:
    """Sums of independent images, even ones in the first half and odd ones in the second."""

    sums: NDArray[np.float64]
    renders: int = 0
    seconds: float = 0.0

    def add(self, electrons: NDArray[np.floating], seconds: float) -> None:
        self.sums[self.renders % 2] += electrons
        self.renders += 1
        self.seconds += seconds

    def reference(self, camera: Camera) -> Reference:
        """Mean of at least two images; its error is half the difference of its independent halves."""
        first, second = self.sums[0] / ((self.renders + 1) // 2), self.sums[1] / (self.renders // 2)
        mean = self.sums.sum(axis=0) / self.renders
        error = rms(develop_codes(first, camera) - develop_codes(second, camera)) / 2
        return Reference(
            mean, error, relative_mse(mean + (first - second) / 2, mean), self.renders, self.seconds
        )


def render_reference(
    subject: BenchSubject,
    folder: Path,
    quality: str | Quality = "reference",
    target_codes: float = TARGET_FRACTION * SMALLEST_ERROR,
    limit_s: float | None = None,
    on_progress: OnProgress = lambda _: None,
) -> Reference:
    """Render the converged image of a subject; images of earlier calls are cached and included.

    Args:
        subject: its camera's view of the full scene is rendered.
        folder: of the cache; created if missing. Files are named by scene, camera and version.
        quality: of the images that are averaged; without denoiser.
        target_codes: error at which it stops.
        limit_s: seconds after which it also stops, once there are two images.
        on_progress: receives progress lines.

    Raises:
        OSError: the cache cannot be written.
    """
    path = folder / f"{subject.name}_{subject.digest()[:20]}.npz"
    camera = subject.camera
    halves = _read_cache(path)
    if halves is None:
        halves = _Halves(np.zeros((2, camera.height, camera.width, camera.sensor.channels)))
    start = saved = perf_counter()
    while True:
        now = perf_counter()
        if halves.renders >= 2:
            reference = halves.reference(camera)
            is_late = limit_s is not None and now - start > limit_s
            is_done = reference.error_codes <= target_codes or is_late
            if is_done or now - saved > _SAVE_INTERVAL_S:
                _write_cache(path, halves)
                saved = now
            if is_done:
                return reference
            on_progress(
                f"{subject.name}: reference, {halves.renders} images, {reference.error_codes:.3f} of "
                f"{target_codes:g} codes"
            )
        frame = subject.render(quality, _FIRST_SEED + halves.renders, full=True)
        halves.add(frame["electrons"], perf_counter() - now)


def _read_cache(path: Path) -> _Halves | None:
    """Sums of an earlier call; None if there are none, or the file is damaged."""
    try:
        with path.open("rb") as file, np.load(file) as arrays:
            if int(arrays["form"]) != _FORMAT:
                return None
            return _Halves(arrays["sums"], int(arrays["renders"]), float(arrays["seconds"]))
    except (OSError, ValueError, EOFError, KeyError, BadZipFile):
        return None


def _write_cache(path: Path, halves: _Halves) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        np.savez(file, sums=halves.sums, renders=halves.renders, seconds=halves.seconds, form=_FORMAT)
