"""The chart as the recipe's camera shows it, and the settings with which it shows it as the photographed one.

The chart is imaged by the sensor's noise, the colours, the tone curve and the image signal processor of the
program, at the photograph's pose, and measured as the photograph is. Sharpening is chosen so that both have
the same modulation transfer, then gain and noise reduction so that both have the same noise.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.calibration.edges import FREQUENCIES, Sharpness, chart_sharpness
from pepperscene.calibration.noise import NoiseCurve, chart_noise
from pepperscene.calibration.photographs import ChartPhotograph, JpegSettings, measure_chart
from pepperscene.calibration.response import CameraResponse
from pepperscene.camera import Camera, ImageProcessor, develop
from pepperscene.camera.image.colorimetry import srgb_decode, white_balance_gains
from pepperscene.camera.image.developing import reference_light
from pepperscene.camera.image.electrons import spread_light
from pepperscene.colour.patches.chart_detection import grid_corners, map_points
from pepperscene.scene.charts import CalibrationChart, ChartKind

Floats = NDArray[np.float64]

_PITCH_PX: Final = 64.0  # chosen: 38 pixels along each edge
_STEPS: Final = 6  # chosen: of a fit; later ones change less than the noise of the chart
_ROUNDS: Final = 3  # chosen: the last changes the modulation transfer by less than 0.01
_MARGIN: Final = 0.6  # of the model's picture around the fields, in steps of the grid
_SURROUNDINGS: Final = 0.25  # chosen: reflectance around the chart
_SAMPLES: Final = 4  # chosen: points within a pixel, along either side
_POINTS: Final = 129  # of the tone curve's file; chosen: a point for every other code
_FIELD_PX: Final = 48.0  # side of fields for noise: whole blocks of chroma of JPEG, of 16 pixels
# Logarithm of the gain, blur, amount and radius of sharpening, noise reduction of luma and of chroma: all
# chosen. Blur and sharpening can cancel each other, so that weak ones are preferred.
_EXPECTED: Final = np.array([0.7, 0.5, 0.2, 1.0, 0.01, 0.01])
_SOFTENED: Final = np.array([1.5, 0.2, -0.6, 0.8, 0.01, 0.02])  # a second start: softened after the noise
_EXPECTED_SD: Final = np.array([3.0, 1.0, 1.0, 1.0, 0.2, 0.2])
_LOWEST: Final = np.array([-3.0, 0.0, -0.98, 0.35, 0.0, 0.0])
_HIGHEST: Final = np.array([5.0, 4.0, 6.0, 3.0, 0.5, 0.5])
_DIFFERENCE: Final = 0.05  # chosen: relative step of derivatives, above the grain of the codes
_MTF_ERROR: Final = 0.03  # chosen: difference of modulation that is hardly visible
_USED_FREQUENCIES: Final = slice(1, 26)  # above 0, up to half a cycle per pixel
_NOISE_ERROR: Final = 0.05  # chosen: relative difference of deviations that is not visible


@dataclass(frozen=True)
class DetailSettings:
    """Settings of sensor and image signal processor on which sharpness and noise depend."""

    gain: float = 1.0
    blur_px: float = 0.0
    sharpening: float = 0.0
    radius_px: float = 1.0
    luma_noise_reduction: float = 0.0
    chroma_noise_reduction: float = 0.0


def tone_points(response: CameraResponse) -> tuple[tuple[float, float], ...]:
    """Rows of light and code of the response's tone curve."""
    light = srgb_decode(np.linspace(0.0, 1.0, _POINTS))
    light[-1] = 1.0
    code = np.clip(np.maximum.accumulate(response.tone(light)), 0.0, 1.0)
    return tuple(zip(light.tolist(), code.tolist(), strict=True))


def sensor_gains(camera: Camera, response: CameraResponse) -> Floats:
    """`(3,)` white balance gains of the sensor, the smallest 1."""
    gains = white_balance_gains(camera.sensor, reference_light(camera)) * response.gains
    return np.asarray(gains / gains.min())


class ChartModel:
    """The chart at the pose of a response's first photograph, seen by the recipe's camera."""

    def __init__(
        self,
        camera: Camera,
        photograph: ChartPhotograph,
        response: CameraResponse,
        rgb: Floats,
        jpeg: JpegSettings | None,
    ) -> None:
        self._response, self._jpeg, self._name = response, jpeg, photograph.name
        self.corners, (height, width) = _model_pose(photograph.corners)
        light = float(response.exposures[0] * response.illumination(photograph.place, 0).mean())
        gains = sensor_gains(camera, response)
        table = light * rgb * response.gains / gains
        around = light * _SURROUNDINGS * response.gains / gains
        self._chart = _chart_image(table, around, self.corners, (height, width))
        side = int(_FIELD_PX)
        self._fields = table.reshape(4, 6, 3).repeat(side, axis=0).repeat(side, axis=1)
        matrix: Any = response.matrix
        developing = dataclasses.replace(
            camera.developing,
            white_balance=tuple(gains.tolist()),
            colour_matrix=matrix,
            white_balance_error=(1.0, 1.0, 1.0),
            pedestal=0.0,
        )
        # Ghosts and glare are of the whole image, and part of the tone curve.
        stray = dataclasses.replace(camera.lens.stray_light, veil=0.0, ghosts=())
        lens = dataclasses.replace(camera.lens, stray_light=stray)
        self._camera = dataclasses.replace(camera, lens=lens, developing=developing)
        self._points = tone_points(response)

    def photograph(self, settings: DetailSettings, rng: np.random.Generator | None = None) -> ChartPhotograph:
        """The chart with these settings; without a generator, without noise."""
        height, width = self._chart.shape[:2]
        sensor = dataclasses.replace(self._camera.sensor, columns=width, rows=height)
        developing = dataclasses.replace(self._camera.developing, blur_px=settings.blur_px)
        camera = dataclasses.replace(self._camera, sensor=sensor, developing=developing)
        light = spread_light(self._chart.copy(), camera)
        return measure_chart(self._developed(light, settings, rng), self.corners, self._name)

    def sharpness(self, settings: DetailSettings) -> Sharpness | None:
        """Sharpness of the chart without noise."""
        seen = self.photograph(settings)
        return chart_sharpness(seen, self._response.inverse_tone(seen.picture / 255.0))

    def noise(self, settings: DetailSettings, seed: int) -> NoiseCurve:
        """Noise of the chart's fields, which lie side by side for this."""
        picture = self._developed(self._fields, settings, np.random.default_rng(seed))
        return chart_noise(measure_chart(picture, _FIELD_PX * grid_corners(), self._name))

    def _developed(
        self, fractions: Floats, settings: DetailSettings, rng: np.random.Generator | None
    ) -> NDArray[np.uint8]:
        """The picture of light `(h, w, 3)` in fractions of full scale."""
        isp = ImageProcessor(
            tone_curve=self._points,
            sharpening=settings.sharpening,
            sharpening_radius_px=settings.radius_px,
            luma_noise_reduction=settings.luma_noise_reduction,
            chroma_noise_reduction=settings.chroma_noise_reduction,
        )
        height, width = fractions.shape[:2]
        sensor = dataclasses.replace(self._camera.sensor, gain=settings.gain, columns=width, rows=height)
        developing = dataclasses.replace(self._camera.developing, isp=isp)
        camera = dataclasses.replace(self._camera, sensor=sensor, developing=developing)
        picture = develop(fractions * (sensor.full_well_e / settings.gain), camera, rng)
        return picture if self._jpeg is None else self._jpeg.compressed(picture)


def fit_details(
    model: ChartModel, sharpness: Sharpness | None, noise: NoiseCurve, seed: int
) -> DetailSettings:
    """The settings that give a measured modulation transfer, if there is one, and noise.

    Blur, sharpening, gain and noise reduction are fitted together, because all of them change the noise; once
    with noise reduction of chroma and once without, as it halves the resolution of chroma at any strength.
    Blur and sharpening are factors on the modulation transfer of the model, which is measured again with the
    settings of each round.
    """
    from scipy.optimize import least_squares

    wanted, frequencies = _noise_logarithms(noise), FREQUENCIES[_USED_FREQUENCIES]
    plain = np.ones(len(frequencies))

    def errors(free: Floats) -> Floats:
        of_noise = (_noise_logarithms(model.noise(_settings(free), seed)) - wanted) / _NOISE_ERROR
        expected = (free - _EXPECTED[: len(free)]) / _EXPECTED_SD[: len(free)]
        if sharpness is None:
            return np.concatenate([of_noise, expected])
        difference = plain * _detail_transfer(_settings(free), frequencies) - sharpness.mtf[_USED_FREQUENCIES]
        error = np.hypot(_MTF_ERROR, sharpness.mtf_sd[_USED_FREQUENCIES])
        return np.concatenate([difference / error, of_noise, expected])

    def solved(start: Floats, steps: int) -> Any:
        bounds = _LOWEST[: len(start)], _HIGHEST[: len(start)]
        return least_squares(
            errors, start, bounds=bounds, diff_step=_DIFFERENCE, max_nfev=steps, xtol=1e-3, ftol=1e-3
        )

    free: Floats = np.array([0.0, 0.0, 0.0, 1.0, 0.0])
    for number in range(_ROUNDS):
        seen = model.sharpness(_settings(free))
        if seen is not None:
            plain = seen.mtf[_USED_FREQUENCIES] / _detail_transfer(_settings(free), frequencies)
        starts = (_EXPECTED[:5], _EXPECTED, _SOFTENED[:5], _SOFTENED) if number == 0 else (free,)
        free = min((solved(start, _STEPS) for start in starts), key=lambda solution: solution.cost).x
    return _settings(free)


def _settings(free: Floats) -> DetailSettings:
    gain, blur, amount, radius, luma, chroma = np.append(free, np.zeros(6 - len(free))).tolist()
    return DetailSettings(float(np.exp(gain)), blur, amount, radius, luma, chroma)


def _detail_transfer(settings: DetailSettings, frequencies: Floats) -> Floats:
    """Modulation transfer of a Gaussian blur and an unsharp mask, at frequencies in cycles per pixel."""
    blur, mask = (
        np.exp(-2.0 * (np.pi * sd * frequencies) ** 2) for sd in (settings.blur_px, settings.radius_px)
    )
    return np.asarray(blur * (1.0 + settings.sharpening * (1.0 - mask)))


def _noise_logarithms(noise: NoiseCurve) -> Floats:
    """Logarithms of mean deviations `(6,)`: of luma in dark, middle and light fields, and of its 2 x 2 means;
    of chroma, and of its 2 x 2 means.
    """
    squares = noise.deviations[np.argsort(noise.levels[:, 1])] ** 2
    luma = [np.nanmean(part) for part in np.array_split(squares[:, 0, 0], 3)]
    means = [np.nanmean(squares[:, 1, 0]), *np.nanmean(squares[:, :, 1:], axis=(0, 2))]
    return np.asarray(0.5 * np.log(np.maximum([*luma, *means], 1e-10)))


def _model_pose(corners: Floats) -> tuple[Floats, tuple[int, int]]:
    """The chart's corners scaled to the model's size, and height and width of its picture."""
    sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    pitch = float((sides / [6.0, 4.0, 6.0, 4.0]).mean())
    scaled = corners * min(1.0, _PITCH_PX / pitch)
    margin = _MARGIN * min(pitch, _PITCH_PX)
    # The same position within a pixel, and an even number of pixels, as Bayer patterns need.
    first = 2.0 * np.floor((scaled.min(axis=0) - margin) / 2.0)
    width, height = (2 * np.ceil((scaled.max(axis=0) + margin - first) / 2.0)).astype(int).tolist()
    return scaled - first, (height, width)


def _chart_image(fields: Floats, around: Floats, corners: Floats, shape: tuple[int, int]) -> Floats:
    """`(h, w, 3)` light of a chart with fields `(24, 3)`, in surroundings `(3,)`, by points within pixels."""
    patches, edges_x, edges_y = CalibrationChart(
        kind=ChartKind.COLORCHECKER, position_m=(0.0, 0.0, 0.0), cell_m=0.1
    ).pattern()
    table = np.concatenate([fields, around[None]])
    numbers = np.pad(patches, 1, constant_values=len(fields))
    steps = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    total = np.zeros((*shape, 3))
    # A grid of fields begins half a gap before the first patch.
    gap = 0.5 * (edges_x[3] - edges_x[2])
    for dy in steps:
        for dx in steps:
            x, y = np.meshgrid(np.arange(shape[1]) + dx, np.arange(shape[0]) + dy)
            place = 0.1 * map_points(np.stack([x, y], axis=-1), corners, grid_corners()) - gap
            column, row = np.searchsorted(edges_x, place[..., 0]), np.searchsorted(edges_y, place[..., 1])
            total += table[numbers[row, column]]
    return total / _SAMPLES**2
