"""Response of a camera: codes of a chart's fields from the light that its sensor measures.

The model of a field's mean code is

    code = tone(exposure * illumination(place) * matrix @ (gains * rgb))

where rgb is what the sensor of the recipe measures of the field's reflectance, 1 for white. Matrix, tone
curve and illumination are fitted together by least squares in codes, because a tone curve acts on colours as
well as on greys (Kim et al. 2012, "A new in-camera imaging model for color computer vision and its
application", IEEE TPAMI 34:2289). The tone curve is a monotone cubic (PCHIP) between values at equal steps of
the sRGB curve, whose second differences are penalised; 1 is the light at which the code is 255.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.calibration.photographs import ChartPhotograph
from pepperscene.camera.image.colorimetry import srgb_decode, srgb_encode

Floats = NDArray[np.float64]

_KNOTS: Final = 17  # chosen: steps of a sixteenth of the codes show a toe and a shoulder
_CODE_ERROR: Final = 1.5 / 255.0  # chosen: specimens of the chart differ by one or two codes
_CURVATURE: Final = 0.006
"""Chosen: expected second difference of the tone curve from knot to knot; a strong S-curve has 0.02."""
_GRADIENT_SD: Final = 0.1  # chosen: change of light over half a diagonal of the picture
_VIGNETTING_SD: Final = 0.5  # chosen: loss at the corners
_BLACK: Final = 0.01  # chosen: code of black from which the fit begins
_STEPS: Final = 60  # chosen: of the fit; later ones change no code
_RESAMPLES: Final = 200  # chosen: a standard deviation is then known to 5 %
_TABLE: Final = 4097  # entries of the inverse; chosen: a sixteenth of a code


@dataclass(frozen=True, eq=False)
class CameraResponse:
    """A fitted response.

    Attributes:
        gains: `(3,)` factors on the gains that make white neutral under the reference light; 1 for green.
        matrix: `(3, 3)` from balanced camera_rgb to linear values; its rows sum to 1.
        knots: `(k,)` codes in 0 to 1 at equal steps of sRGB-encoded light from 0 to 1.
        exposures: `(p,)` green of a white diffuser before the matrix, in the middle of each photograph.
        vignetting: `(1,)` relative change of the light at the corners; it grows with r^2.
        gradients: `(p, 2)` relative change of the light to the right and down, over half a diagonal.
        sd: standard deviations of these, by name.
        residuals: `(p, n, 3)` measured minus fitted codes; nan where clipped.
    """

    gains: Floats
    matrix: Floats
    knots: Floats
    exposures: Floats
    vignetting: Floats
    gradients: Floats
    sd: Mapping[str, Floats] = field(repr=False, default_factory=dict)
    residuals: Floats = field(repr=False, default_factory=lambda: np.zeros((0, 0, 3)))

    def tone(self, linear: Floats) -> Floats:
        """Codes in 0 to 1 of linear values, shape kept."""
        from scipy.interpolate import PchipInterpolator

        curve = PchipInterpolator(np.linspace(0.0, 1.0, len(self.knots)), self.knots)
        return np.asarray(curve(srgb_encode(np.clip(linear, 0.0, 1.0))))

    def inverse_tone(self, codes: Floats) -> Floats:
        """Linear values of codes in 0 to 1, shape kept; those below black are 0."""
        linear = srgb_decode(np.linspace(0.0, 1.0, _TABLE))
        return np.asarray(np.interp(codes, self.tone(linear), linear))

    def codes(self, rgb: Floats, exposure: float | Floats) -> Floats:
        """`(m, 3)` codes in 0 to 1 of balanced camera_rgb `(m, 3)`, at an exposure or `(m, 1)` of them."""
        return self.tone((exposure * rgb * self.gains) @ self.matrix.T)

    def illumination(self, place: Floats, number: int) -> Floats:
        """`(m,)` light of photograph `number` at places `(m, 2)`, relative to its middle."""
        radial = 1.0 + self.vignetting[0] * (place**2).sum(axis=-1)
        return np.asarray(radial * np.exp(place @ self.gradients[number]))


def fit_response(
    photographs: Sequence[ChartPhotograph], rgb: Floats, start: Floats, rng: np.random.Generator
) -> CameraResponse:
    """Fit the response to photographs of one chart.

    Uncertainties are standard deviations over 200 resamples of the fields (bootstrap), each by one step of
    Gauss and Newton from the fit.

    Args:
        photographs: of charts, at any positions and exposures.
        rgb: `(24, 3)` balanced camera_rgb of the chart's fields.
        start: `(3, 3)` matrix to begin with.
        rng: draws the resamples.
    """
    from scipy.optimize import least_squares

    model = _Model(photographs, rgb)
    solution = least_squares(model.errors, model.start(start), loss="soft_l1", x_scale="jac", max_nfev=_STEPS)
    errors, jacobian = model.errors(solution.x), model.jacobian(solution.x)
    robust = 1.0 / np.sqrt(1.0 + errors**2)  # the weights of soft_l1

    # One-step bootstrap: fields are drawn with replacement, and the normal equations solved again.
    samples = []
    for _ in range(_RESAMPLES):
        weights = robust * model.resampled(rng)
        normal = (jacobian.T * weights) @ jacobian
        step = np.linalg.lstsq(normal, -jacobian.T @ (weights * errors), rcond=1e-12)[0]
        samples.append(model.response(solution.x + step))
    names = ("gains", "matrix", "knots", "exposures", "vignetting", "gradients")
    sd = {name: np.std([getattr(s, name) for s in samples], axis=0, ddof=1) for name in names}
    fitted = model.response(solution.x)
    values = {name: getattr(fitted, name) for name in names}
    return CameraResponse(**values, sd=sd, residuals=model.residuals(fitted))


def card_response(
    photographs: Sequence[ChartPhotograph], matrix: Floats, rng: np.random.Generator
) -> CameraResponse:
    """The response by photographs of a grey card, for an sRGB tone curve and a given matrix.

    Uncertainties are standard deviations over 200 resamples of the card's parts.
    """
    linear = np.concatenate([srgb_decode(p.codes[p.usable.all(axis=1)]) for p in photographs])
    square = np.concatenate([(p.place[p.usable.all(axis=1)] ** 2).sum(axis=-1) for p in photographs])
    owner = np.repeat(np.arange(len(photographs)), [int(p.usable.all(axis=1).sum()) for p in photographs])
    basis = np.column_stack([owner[:, None] == np.arange(len(photographs)), square]).astype(float)

    def fitted(number: NDArray[np.intp]) -> tuple[Floats, Floats, Floats]:
        # What sensors see of the card is what the matrix makes this colour of.
        device = linear[number] @ np.linalg.inv(matrix).T
        light = np.linalg.lstsq(basis[number], device[:, 1], rcond=None)[0]
        gains = device.mean(axis=0)
        return gains / gains[1], light[:-1], light[-1:] / light[:-1].mean()

    names = ("gains", "exposures", "vignetting")
    drawn = [fitted(rng.integers(0, len(linear), len(linear))) for _ in range(_RESAMPLES)]
    sd = {name: np.std([sample[at] for sample in drawn], axis=0, ddof=1) for at, name in enumerate(names)}
    values = dict(zip(names, fitted(np.arange(len(linear))), strict=True))
    knots = np.linspace(0.0, 1.0, _KNOTS)
    return CameraResponse(
        matrix=matrix, knots=knots, gradients=np.zeros((len(photographs), 2)), sd=sd, **values
    )


class _Model:
    """Residuals of the response as a function of a vector of free numbers."""

    def __init__(self, photographs: Sequence[ChartPhotograph], rgb: Floats) -> None:
        self._rgb = rgb
        self._codes = np.stack([photograph.codes for photograph in photographs])
        self._usable = np.stack([photograph.usable for photograph in photographs])
        self._place = np.stack([photograph.place for photograph in photographs])
        self._number = len(photographs)

    def start(self, matrix: Floats) -> Floats:
        """Numbers of an sRGB curve, with exposures by the white field."""
        white = srgb_decode(self._codes[:, 18].max(axis=-1)) / self._rgb[18].max()
        steps = np.full(_KNOTS, np.log((1.0 - _BLACK) / (_KNOTS - 1)))
        steps[0] = np.log(_BLACK)
        others = np.log(white[1:] / white[0])
        return np.concatenate([(white[0] * matrix).ravel(), steps, others, np.zeros(1 + 2 * self._number)])

    def response(self, free: Floats) -> CameraResponse:
        """The response of these numbers."""
        parts = np.split(free, np.cumsum([9, _KNOTS, self._number - 1, 1]))
        matrix, steps, others, vignetting, gradients = parts
        # The gains are those that make the matrix' rows sum to 1: of the light that it shows as neutral.
        combined = matrix.reshape(3, 3)
        balance = 1.0 / np.linalg.solve(combined, np.ones(3))
        growth = np.exp(steps - steps.max())
        return CameraResponse(
            gains=balance / balance[1],
            matrix=combined / balance,
            knots=np.cumsum(growth) / growth.sum(),
            exposures=balance[1] * np.exp(np.concatenate([[0.0], others])),
            vignetting=vignetting,
            gradients=gradients.reshape(self._number, 2),
        )

    def residuals(self, response: CameraResponse) -> Floats:
        """`(p, n, 3)` measured minus fitted codes; nan where clipped."""
        fitted = [
            response.codes(self._rgb, exposure * response.illumination(self._place[number], number)[:, None])
            for number, exposure in enumerate(response.exposures)
        ]
        return np.where(self._usable, self._codes - np.stack(fitted), np.nan)

    def errors(self, free: Floats) -> Floats:
        """Residuals in standard deviations: of the codes, then of what is expected of the numbers."""
        response = self.response(free)
        expected = [
            np.diff(response.knots, 2) / _CURVATURE,
            response.vignetting / _VIGNETTING_SD,
            response.gradients.ravel() / _GRADIENT_SD,
            [free[9 : 9 + _KNOTS].mean()],  # the steps have one number too many
        ]
        codes = np.nan_to_num(self.residuals(response)).ravel() / _CODE_ERROR
        return np.concatenate([codes, *expected])

    def jacobian(self, free: Floats) -> Floats:
        """`(r, n)` derivatives of the errors, by central differences."""
        columns = []
        for number in range(len(free)):
            step = np.zeros_like(free)
            step[number] = 1e-5
            columns.append((self.errors(free + step) - self.errors(free - step)) / 2e-5)
        return np.stack(columns, axis=1)

    def resampled(self, rng: np.random.Generator) -> Floats:
        """Weights `(r,)` of the errors if the fields are drawn with replacement, in all photographs alike."""
        count = self._codes.shape[1]
        drawn = np.bincount(rng.integers(0, count, count), minlength=count).astype(float)
        expectations = _KNOTS - 2 + 1 + 2 * self._number + 1
        return np.concatenate([np.tile(np.repeat(drawn, 3), self._number), np.ones(expectations)])
