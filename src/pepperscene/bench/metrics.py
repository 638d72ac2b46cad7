"""How far a picture is from the converged one: three measures, each told the same light."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera, camera_rgb, corrected
from pepperscene.errors import SetupError

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
    linear = np.clip(np.asarray(corrected(camera_rgb(electrons, exact), exact), float), 0.0, 1.0)
    if camera.developing.tone == "srgb":
        # IEC 61966-2-1, as `pepperscene.camera.encode` has it with rounding.
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
