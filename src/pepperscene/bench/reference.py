"""Converged reference images that are cached and refined from call to call."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Final
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from pepperscene.atomic import atomic_write
from pepperscene.bench.image_errors import Reference
from pepperscene.bench.scenes import BenchSubject
from pepperscene.camera import Camera
from pepperscene.errors import InputError
from pepperscene.render import Quality, resolve_quality
from pepperscene.user_files import open_file

OnProgress = Callable[[str], None]
"""Called with a line of progress."""

SMALLEST_ERROR: Final = 0.5
"""Smallest error of interest, in codes. Chosen: rounding an image has an error of 0.3 codes."""

TARGET_FRACTION: Final = 0.1
"""Chosen: target error of the reference over the smallest error of interest."""

_FIRST_SEED: Final = 1_000_000  # chosen: far from the seeds of the measured frames
_SAVE_INTERVAL_S: Final = 60.0  # chosen: the most that an interruption costs
_REPORT_INTERVAL_S: Final = 5.0  # chosen: small images take less than a second each
_FORMAT: Final = 2
"""Version of the cache files; others are ignored."""


@dataclass(eq=False)
class _Halves:
    """Weighted sums of independent images; each image is added to the half with less weight."""

    sums: NDArray[np.float64]  # `(2, h, w, c)`
    weights: NDArray[np.float64] = field(default_factory=lambda: np.zeros(2))  # samples per pixel
    renders: int = 0
    seconds: float = 0.0

    def add(self, electrons: NDArray[np.floating], samples: int, seconds: float) -> None:
        half = int(np.argmin(self.weights))
        self.sums[half] += electrons * float(samples)
        self.weights[half] += samples
        self.renders += 1
        self.seconds += seconds

    @property
    def are_filled(self) -> bool:
        return bool((self.weights > 0).all())

    def reference(self, camera: Camera) -> Reference:
        return Reference(self.sums / self.weights[:, None, None, None], camera, self.renders, self.seconds)


def render_reference(
    subject: BenchSubject,
    folder: Path,
    quality: str | Quality = "reference",
    target_codes: float = TARGET_FRACTION * SMALLEST_ERROR,
    limit_s: float = math.inf,
    on_progress: OnProgress = lambda _: None,
) -> Reference:
    """Render the converged image of a subject; images of earlier calls are cached and included.

    Args:
        subject: its camera's view of the full scene is rendered.
        folder: of the cache; created if missing. Files are named by scene, camera and version.
        quality: of the images that are averaged, weighted by their samples; without denoiser.
        target_codes: error at which it stops.
        limit_s: approximate time limit. Once each half has an image, no image is started that would end
            later, as far as the time of the last one shows.
        on_progress: receives progress lines.

    Raises:
        OSError: the cache cannot be written.
    """
    path = folder / f"{subject.name}_{subject.digest()[:20]}.npz"
    camera, samples = subject.camera, resolve_quality(quality).samples
    halves = _read_cache(path)
    if halves is None:
        halves = _Halves(np.zeros((2, camera.height, camera.width, camera.sensor.channels)))
    start = saved = reported = perf_counter()
    last_s = 0.0
    while True:
        now = perf_counter()
        if halves.are_filled:
            reference = halves.reference(camera)
            is_late = now - start + last_s > limit_s
            is_done = reference.error_codes <= target_codes or is_late
            if is_done or now - saved > _SAVE_INTERVAL_S:
                _write_cache(path, halves)
                saved = now
            if is_done:
                return reference
            if now - reported > _REPORT_INTERVAL_S:
                on_progress(
                    f"{subject.name}: reference, {halves.renders} images, {reference.error_codes:.3f} of "
                    f"{target_codes:g} codes"
                )
                reported = now
        before = perf_counter()
        frame = subject.render(quality, _FIRST_SEED + halves.renders, full=True)
        last_s = perf_counter() - before
        halves.add(frame["electrons"], samples, last_s)


def _read_cache(path: Path) -> _Halves | None:
    """Sums of an earlier call; None if there are none, or the file is damaged."""
    try:
        with open_file(path, "cache") as file, np.load(file) as arrays:
            if int(arrays["form"]) != _FORMAT:
                return None
            return _Halves(
                arrays["sums"], arrays["weights"], int(arrays["renders"]), float(arrays["seconds"])
            )
    except (InputError, OSError, ValueError, EOFError, KeyError, BadZipFile):
        return None


def _write_cache(path: Path, halves: _Halves) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        np.savez(
            file,
            sums=halves.sums,
            weights=halves.weights,
            renders=halves.renders,
            seconds=halves.seconds,
            form=_FORMAT,
        )
