"""Distortion models of OpenCV and ROS: Brown-Conrady, rational and fisheye, on slopes (x/z, y/z)."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

_NEWTON_STEPS: Final = 30  # chosen: quadratic convergence needs about 6; the rest is for strong distortion
_TOLERANCE: Final = 1e-12  # chosen: of slopes, 1e-9 of a pixel and far above rounding
_NEAR_AXIS: Final = 1e-8  # of slopes; chosen: terms of the second order vanish beside 1 in double precision
_LEAST_TURNING: Final = 1e-12  # of 1 / r^2; ignores turning points beyond a slope of a million

LensModel = Literal["plumb_bob", "rational_polynomial", "equidistant"]
"""Names of the models in ROS."""

MODELS: Final[dict[LensModel, tuple[str, ...]]] = {
    "plumb_bob": ("k1", "k2", "p1", "p2", "k3"),
    "rational_polynomial": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "equidistant": ("k1", "k2", "k3", "k4"),
}
"""Coefficients of each model, in the order of OpenCV."""

Slopes = NDArray[np.float64]


@dataclass(frozen=True)
class DistortionModel(ABC):
    """A distortion of slopes around the optical axis; its fields are its coefficients."""

    def __post_init__(self) -> None:
        if not all(math.isfinite(value) for value in astuple(self)):
            raise ValueError("distortion coefficients must be finite")

    @property
    def is_zero(self) -> bool:
        """Whether distorted slopes are the ideal ones."""
        return False

    @property
    @abstractmethod
    def fold_radius(self) -> float:
        """The radius (a slope) at which the radial part starts to decrease; inf if it never does.

        Rays from beyond would fold back into the image; none are traced there.
        """

    @abstractmethod
    def distort(self, slopes: ArrayLike) -> Slopes:
        """Distorted slopes `(..., 2)` of ideal ones `(..., 2)`."""

    @abstractmethod
    def to_json(self) -> dict[str, Any]:
        """JSON-ready coefficients by name; `model` names every model but Brown and Conrady's."""

    def undistort(self, slopes: ArrayLike) -> Slopes:
        """Ideal slopes `(..., 2)` of distorted ones `(..., 2)`; the inverse of `distort`.

        Newton's iteration with the exact Jacobian, on all points at once.

        Raises:
            ValueError: a point has no ideal slope, or is where the distortion folds.
        """
        target = np.asarray(slopes, dtype=float)
        if self.is_zero:
            return target.copy()
        with np.errstate(all="ignore"):  # a diverging point becomes nan or inf and is reported below
            ideal = self._first_guess(target)
            for _ in range(_NEWTON_STEPS):
                # Solve the 2 x 2 system of the symmetric Jacobian by Cramer's rule, for all points at once.
                dx, dy = np.moveaxis(self.distort(ideal) - target, -1, 0)
                xx, xy, yy = self._jacobian(ideal)
                det = xx * yy - xy * xy
                step = np.stack([(yy * dx - xy * dy) / det, (xx * dy - xy * dx) / det], axis=-1)
                ideal -= step
                if not np.abs(step).max(initial=0.0) > _TOLERANCE * 1e-2:
                    break
            # A root beyond the fold has the right image and is the wrong ray.
            valid = np.abs(self.distort(ideal) - target).max(axis=-1) < _TOLERANCE
            valid &= self.area_scale(ideal) > 0
            valid &= np.hypot(ideal[..., 0], ideal[..., 1]) < self.fold_radius
        if not np.all(valid):
            raise ValueError(self._describe_failure(*target[~valid][0]))
        return ideal

    def area_scale(self, slopes: ArrayLike) -> Slopes:
        """Factor `(...)` by which a small area at ideal slopes `(..., 2)` is magnified in the image.

        The determinant of the Jacobian of `distort`: below 1 where barrel distortion contracts the image.
        """
        xx, xy, yy = self._jacobian(np.asarray(slopes, dtype=float))
        return np.asarray(xx * yy - xy * xy)

    def _first_guess(self, distorted: Slopes) -> Slopes:
        """Where Newton's iteration starts, a new array `(..., 2)`."""
        return distorted.copy()

    def _describe_failure(self, x: float, y: float) -> str:
        """Why there is no ideal slope of the distorted one (x, y)."""
        return f"the distortion cannot be inverted at the image slope ({x:.3f}, {y:.3f})"

    @abstractmethod
    def _jacobian(self, slopes: Slopes) -> tuple[Slopes, ...]:
        """The symmetric Jacobian of `distort`: dx'/dx, dx'/dy = dy'/dx, dy'/dy, each `(...)`."""


@dataclass(frozen=True)
class Distortion(DistortionModel):
    """Brown-Conrady distortion, "plumb bob" in ROS, and with k4, k5 or k6 OpenCV's rational model.

    With r^2 = x^2 + y^2 and R = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6):
    x' = x R + 2 p1 x y + p2 (r^2 + 2 x^2),  y' = y R + p1 (r^2 + 2 y^2) + 2 p2 x y.

    Methods: D. C. Brown, "Close-range camera calibration", Photogrammetric Engineering 37 (1971) 855; the
    quotient as in D. Claus and A. W. Fitzgibbon, "A rational function lens distortion model for general
    cameras", CVPR 2005, and OpenCV's documentation of calib3d.
    """

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0

    @property
    def is_zero(self) -> bool:
        """Whether all coefficients are zero."""
        return not any(astuple(self))

    @property
    def fold_radius(self) -> float:
        """The radius (a slope) at which the radial part starts to decrease; inf if it never does."""
        if not self._is_rational:
            # d(r R)/dr = 1 + 3 k1 s + 5 k2 s^2 + 7 k3 s^3 with s = r^2 vanishes first at the largest
            # t = 1/s > 0 of t^3 + 3 k1 t^2 + 5 k2 t + 7 k3 = 0, which is well posed for coefficients of zero
            # too.
            return _radius_of_largest_root([7 * self.k3, 5 * self.k2, 3 * self.k1, 1.0])
        # With R = N / D, d(r R)/dr = (N D + 2 s (N' D - N D')) / D^2 vanishes where the numerator does, and
        # the image ends where D vanishes. Coefficients in reverse order are those of a polynomial in t = 1/s.
        numerator = np.polynomial.Polynomial([1.0, self.k1, self.k2, self.k3])
        denominator = np.polynomial.Polynomial([1.0, self.k4, self.k5, self.k6])
        wronskian = numerator.deriv() * denominator - numerator * denominator.deriv()
        turning = numerator * denominator + np.polynomial.Polynomial([0.0, 2.0]) * wronskian
        return min(_radius_of_largest_root(list(p.coef[::-1])) for p in (turning, denominator))

    def distort(self, slopes: ArrayLike) -> Slopes:
        """Distorted slopes `(..., 2)` of ideal ones `(..., 2)`."""
        ideal = np.asarray(slopes, dtype=float)
        if self.is_zero:
            return ideal.copy()
        x, y = np.moveaxis(ideal, -1, 0)
        r2 = x * x + y * y
        radial, _ = self._radial(r2)
        distorted_x = x * radial + 2 * self.p1 * x * y + self.p2 * (r2 + 2 * x * x)
        distorted_y = y * radial + self.p1 * (r2 + 2 * y * y) + 2 * self.p2 * x * y
        return np.stack([distorted_x, distorted_y], axis=-1)

    def to_json(self) -> dict[str, Any]:
        """JSON-ready coefficients by name; with `model` if k4, k5 or k6 is not 0."""
        name: LensModel = "rational_polynomial" if self._is_rational else "plumb_bob"
        model = {"model": name} if self._is_rational else {}
        return {**model, **{key: getattr(self, key) for key in MODELS[name]}}

    @property
    def _is_rational(self) -> bool:
        return any((self.k4, self.k5, self.k6))

    def _radial(self, r2: Slopes) -> tuple[Slopes, Slopes]:
        """R and 2 dR/d(r^2), each `(...)`."""
        radial = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        growth = 2 * (self.k1 + r2 * (2 * self.k2 + r2 * 3 * self.k3))
        if self._is_rational:
            below = 1 + r2 * (self.k4 + r2 * (self.k5 + r2 * self.k6))
            growth_below = 2 * (self.k4 + r2 * (2 * self.k5 + r2 * 3 * self.k6))
            radial = radial / below
            growth = (growth - radial * growth_below) / below
        return radial, growth

    def _jacobian(self, slopes: Slopes) -> tuple[Slopes, ...]:
        x, y = slopes[..., 0], slopes[..., 1]
        radial, growth = self._radial(x * x + y * y)
        return (
            radial + growth * x * x + 2 * self.p1 * y + 6 * self.p2 * x,
            growth * x * y + 2 * self.p1 * x + 2 * self.p2 * y,
            radial + growth * y * y + 6 * self.p1 * y + 2 * self.p2 * x,
        )


@dataclass(frozen=True)
class FisheyeDistortion(DistortionModel):
    """The fisheye model of OpenCV, "equidistant" in ROS.

    A ray at the angle theta to the axis is imaged at the radius
    theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8).
    Without coefficients this is the equidistant projection, which differs from the rectilinear one: the
    distortion is never zero.

    Method: J. Kannala and S. S. Brandt, "A generic camera model and calibration method for conventional,
    wide-angle, and fish-eye lenses", IEEE Trans. Pattern Anal. Mach. Intell. 28 (2006) 1335.
    """

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0

    @property
    def fold_radius(self) -> float:
        """The slope of the angle at which the image radius starts to decrease; inf from 90 degrees on."""
        # d(theta_d)/d(theta) as a polynomial in s = theta^2, reversed as in `Distortion`.
        angle = _radius_of_largest_root([9 * self.k4, 7 * self.k3, 5 * self.k2, 3 * self.k1, 1.0])
        return math.tan(angle) if angle < math.pi / 2 else math.inf

    def distort(self, slopes: ArrayLike) -> Slopes:
        """Distorted slopes `(..., 2)` of ideal ones `(..., 2)`."""
        ideal = np.asarray(slopes, dtype=float)
        scale, _ = self._scale(np.hypot(ideal[..., 0], ideal[..., 1]))
        return np.asarray(ideal * scale[..., None])

    def to_json(self) -> dict[str, Any]:
        """JSON-ready coefficients by name, with `model`."""
        return {"model": "equidistant", **{field.name: getattr(self, field.name) for field in fields(self)}}

    def _image_radius(self, angle: Slopes) -> tuple[Slopes, Slopes]:
        """theta_d and its derivative, each `(...)`."""
        s = angle * angle
        radius = angle * (1 + s * (self.k1 + s * (self.k2 + s * (self.k3 + s * self.k4))))
        slope = 1 + s * (3 * self.k1 + s * (5 * self.k2 + s * (7 * self.k3 + s * 9 * self.k4)))
        return radius, slope

    def _scale(self, radius: Slopes) -> tuple[Slopes, Slopes]:
        """Image radius over slope, m(r) = theta_d(r) / r, and m'(r) / r, each `(...)`."""
        near = radius < _NEAR_AXIS
        r = np.where(near, 1.0, radius)
        image, slope = self._image_radius(np.arctan(r))
        scale = image / r
        growth = (slope / (1 + r * r) - scale) / (r * r)
        # On the axis, m = 1 + (k1 - 1/3) r^2.
        return np.where(near, 1.0, scale), np.where(near, 2 * (self.k1 - 1 / 3), growth)

    def _angle(self, image_radius: Slopes) -> Slopes:
        """The angle theta `(...)` of an image radius theta_d, by Newton's iteration."""
        # Start below the angle at which the radius starts to decrease; the iteration does not pass it.
        angle = np.minimum(image_radius, 0.9 * math.atan(self.fold_radius))
        for _ in range(_NEWTON_STEPS):
            image, slope = self._image_radius(angle)
            angle = angle - (image - image_radius) / slope
        return np.asarray(angle)

    def _first_guess(self, distorted: Slopes) -> Slopes:
        """The inverse by angles, which stays stable where slopes grow without limit."""
        radius = np.hypot(distorted[..., 0], distorted[..., 1])
        angle = self._angle(radius)
        angle = np.where(angle < math.pi / 2, angle, np.nan)
        near = radius < _NEAR_AXIS
        scale = np.where(near, 1.0, np.tan(angle) / np.where(near, 1.0, radius))
        return np.asarray(distorted * scale[..., None])

    def _describe_failure(self, x: float, y: float) -> str:
        angle = float(self._angle(np.array(math.hypot(x, y))))
        if not math.pi / 2 <= angle < math.pi:
            return super()._describe_failure(x, y)
        return f"the image slope ({x:.3f}, {y:.3f}) is at {math.degrees(angle):.1f} degrees from the axis"

    def _jacobian(self, slopes: Slopes) -> tuple[Slopes, ...]:
        x, y = slopes[..., 0], slopes[..., 1]
        scale, growth = self._scale(np.hypot(x, y))
        return scale + growth * x * x, growth * x * y, scale + growth * y * y


def make_distortion(model: LensModel, coefficients: Sequence[float]) -> DistortionModel:
    """The distortion of a model by its coefficients in the order of OpenCV; missing ones are 0."""
    values = dict(zip(MODELS[model], (float(value) for value in coefficients), strict=False))
    return FisheyeDistortion(**values) if model == "equidistant" else Distortion(**values)


def _radius_of_largest_root(coefficients: list[float]) -> float:
    """1 / sqrt(t) of the largest positive root t of a polynomial, from the constant term up; inf for none."""
    roots = np.polynomial.Polynomial(coefficients).roots()
    real = np.real(roots[np.abs(np.imag(roots)) <= 1e-9 * np.abs(roots)])
    turning = real[real > _LEAST_TURNING]
    return float(1 / np.sqrt(turning.max())) if turning.size else math.inf
