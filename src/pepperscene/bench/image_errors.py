"""Errors of images against a reference in two independent halves, whose noise cancels."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from pepperscene.camera import Camera, add_pedestal, camera_rgb, correct_colours
from pepperscene.camera.image.colorimetry import srgb_encode
from pepperscene.errors import SetupError

_MEAN_WEIGHT: Final = 1e-2
"""Regularisation of the relative error, in squared means of the reference: the 0.01 of Rousselle, Knaus and
Zwicker 2011 ("Adaptive sampling and reconstruction using greedy error minimization") for a mean of 1."""

_BLOCK_PX: Final = 32
"""Chosen: side of the blocks whose spread gives the standard error; errors of denoised images are correlated
over some ten pixels."""

_MIN_BLOCKS: Final = 4
"""Chosen: number of blocks along each side of a small image, at least."""

_SMOOTHING_PX: Final = 1.0
"""Chosen: standard deviation of the Gaussian that smooths the mean of the reference, at which codes are
linearised. A pixel's own noise then hardly moves the point of its linearisation."""

_STEP: Final = 1e-3
_DARKEST: Final = 1e-2
"""Chosen: step of the central differences, as a fraction of the signal or of a hundredth of its mean, which
counts as a hundredth of an electron at least."""


@dataclass(frozen=True)
class SquaredError:
    """Mean squared error of an image, estimated with two independent references.

    Attributes:
        mean: mean product of the image's differences to the two references. The references' own noise cancels
            in it. It is below 0 for about half of the images without an error.
        standard_error: of `mean`, from the spread between blocks of the image. Differences between parts of
            the image are included, so it is rather too large.
    """

    mean: float
    standard_error: float

    @property
    def is_measurable(self) -> bool:
        """Whether the mean is at least twice its standard error, and above 0."""
        return self.mean > 0.0 and self.mean >= 2.0 * self.standard_error

    @property
    def root(self) -> float | None:
        """Root mean squared error; None if it is not measurable."""
        return math.sqrt(self.mean) if self.is_measurable else None

    @property
    def root_uncertainty(self) -> float | None:
        """Standard error of `root`; None if it is not measurable."""
        return self.standard_error / (2.0 * math.sqrt(self.mean)) if self.is_measurable else None

    @property
    def root_limit(self) -> float:
        """Upper limit of the root mean squared error: two standard errors above the mean."""
        return math.sqrt(max(self.mean, 0.0) + 2.0 * self.standard_error)


@dataclass(frozen=True)
class Errors:
    """Errors of an image.

    Attributes:
        codes: error of the developed, noise-free image in 8-bit codes, linearised about the reference and not
            rounded to whole codes, which would add 0.3 codes; its mean is in squared codes.
        relative: mean of (x - r)^2 / (s^2 + 0.01 mean(s)^2) over electrons, s being the slightly smoothed r.
        flip: mean of FLIP (Andersson et al. 2020) at 67 pixels per degree, 0 to 1, against the mean of the
            references; the noise of the references is included.
    """

    codes: SquaredError
    relative: SquaredError
    flip: float

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Errors:
        """Errors out of JSON data as of `dataclasses.asdict`; JSON has null for infinite standard errors."""
        codes, relative = (
            SquaredError(one["mean"], math.inf if one["standard_error"] is None else one["standard_error"])
            for one in (values["codes"], values["relative"])
        )
        return cls(codes, relative, values["flip"])


def measure_errors(images: Iterable[NDArray[np.floating]], reference: Reference) -> Errors:
    """Errors of images of one setting, averaged as squares.

    Images are `(h, w, c)` expected electrons of the view of the reference, with independent noise.

    Raises:
        ValueError: there is no image.
    """
    converged = develop_codes(reference.electrons, reference.camera)
    in_codes, relative, flips = [], [], []
    for image in images:
        first, second = (np.asarray(image, float) - half for half in reference.halves)
        relative.append((first * second * reference.relative_weights).mean(axis=-1))
        differences = [reference.code_differences(image, half) for half in reference.halves]
        in_codes.append((differences[0] * differences[1]).mean(axis=-1, dtype=float))
        flips.append(mean_flip(develop_codes(image, reference.camera), converged))
    if not flips:
        raise ValueError("errors need at least one image")
    return Errors(
        _squared_error(np.mean(in_codes, axis=0)),
        _squared_error(np.mean(relative, axis=0)),
        float(np.mean(flips)),
    )


def _squared_error(products: NDArray[np.float64]) -> SquaredError:
    """Mean and standard error of `(h, w)` products; the latter from whole square blocks."""
    height, width = products.shape
    side = max(min(_BLOCK_PX, height // _MIN_BLOCKS, width // _MIN_BLOCKS), 1)
    rows, columns = height // side, width // side
    blocks = products[: rows * side, : columns * side].reshape(rows, side, columns, side).mean(axis=(1, 3))
    # A single block says nothing about its spread.
    spread = float(blocks.std(ddof=1)) / math.sqrt(blocks.size) if blocks.size > 1 else math.inf
    return SquaredError(float(products.mean()), spread)


def develop_codes(electrons: NDArray[Any], camera: Camera) -> NDArray[np.float64]:
    """`(h, w, c)` the developed image without noise, in 8-bit codes, 0 to 255, not rounded."""
    exact = dataclasses.replace(camera, developing=dataclasses.replace(camera.developing, quantise=False))
    corrected = add_pedestal(correct_colours(camera_rgb(electrons, exact), exact), exact)
    linear = np.clip(np.asarray(corrected, float), 0.0, 1.0)
    return (srgb_encode(linear) if camera.developing.tone == "srgb" else linear) * 255.0


def rms(difference: NDArray[np.floating]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(difference, dtype=float))))


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
    """Raise `SetupError` if a package of the extra `bench` is missing."""
    packages = {"flip_evaluator": "flip-evaluator", "matplotlib": "matplotlib"}
    missing = [package for module, package in packages.items() if find_spec(module) is None]
    if missing:
        command = "pip install 'pepperscene[bench]'"
        raise SetupError(f"the benchmark needs {' and '.join(missing)}, not installed here: {command}")


@dataclass(frozen=True, eq=False)
class Reference:
    """A converged image as the means of two independent halves of its samples.

    Attributes:
        halves: `(2, h, w, c)` expected electrons.
        camera: that develops them.
        renders: number of images in both halves.
        seconds: rendering time of all of them.
    """

    halves: NDArray[np.floating]
    camera: Camera
    renders: int = 2
    seconds: float = 0.0

    @cached_property
    def electrons(self) -> NDArray[np.float64]:
        """`(h, w, c)` mean of the halves."""
        return self.halves.mean(axis=0, dtype=float)

    @cached_property
    def _slopes(self) -> NDArray[np.float32]:
        """`(c, h, w, k)` derivatives of the k developed channels, in codes per electron of each channel."""
        middle = _smooth(np.minimum(self.electrons, self.camera.sensor.full_well_e))
        steps = _STEP * np.maximum(middle, _DARKEST * max(float(middle.mean()), _DARKEST))
        slopes = []
        for channel in range(middle.shape[-1]):
            step = np.zeros_like(middle)
            step[..., channel] = steps[..., channel]
            # Electrons below 0 count as 0, so black has a one-sided difference.
            low, high = np.maximum(middle - step, 0.0), middle + step
            difference = develop_codes(high, self.camera) - develop_codes(low, self.camera)
            slopes.append((difference / (high - low)[..., channel, None]).astype(np.float32))
        return np.stack(slopes)

    @cached_property
    def relative_weights(self) -> NDArray[np.float64]:
        """`(h, w, c)` weights of squared differences in the relative error, per squared electron."""
        smooth = _smooth(self.electrons)
        mean = max(float(smooth.mean()), 1e-100)  # any other mean for a black image
        return 1.0 / ((smooth / mean) ** 2 + _MEAN_WEIGHT) / mean / mean

    def code_differences(
        self, first: NDArray[np.floating], second: NDArray[np.floating]
    ) -> NDArray[np.float32]:
        """`(h, w, k)` difference of two images `(h, w, c)` of electrons in codes, linearised.

        The tone curve is concave, so noise of a reference would make its codes too low. Codes linear in
        electrons have no such bias. Electrons above the sensor's full well count as the full well.
        """
        well = self.camera.sensor.full_well_e
        difference = np.minimum(first, well, dtype=float) - np.minimum(second, well, dtype=float)
        return np.einsum("chwk,hwc->hwk", self._slopes, difference.astype(np.float32))

    @cached_property
    def error_codes(self) -> float:
        """Estimated RMSE of the mean of the halves in codes: half of their difference."""
        return rms(self.code_differences(*self.halves)) / 2.0


def _smooth(electrons: NDArray[np.float64]) -> NDArray[np.float64]:
    """`(h, w, c)` electrons with less noise, for derivatives and weights."""
    return gaussian_filter(np.maximum(electrons, 0.0), (_SMOOTHING_PX, _SMOOTHING_PX, 0.0))
