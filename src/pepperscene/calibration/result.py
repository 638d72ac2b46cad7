"""What a calibration found."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pepperscene.calibration.edges import Sharpness
from pepperscene.calibration.model import DetailSettings
from pepperscene.calibration.noise import NoiseCurve, PhotonTransfer
from pepperscene.calibration.photographs import ChartPhotograph, JpegSettings
from pepperscene.calibration.response import CameraResponse
from pepperscene.camera import decode_tone
from pepperscene.colour.statistics import delta_e_2000, linear_srgb_to_lab

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ChartCalibration:
    """A camera as its photographs of a chart or a grey card show it.

    Attributes:
        photographs: in the given order; sharpness and noise are those of the first.
        response: gains, matrix, tone curve and illumination, with standard deviations.
        noise: deviations of the fields.
        sharpness: modulation transfer, or None if the edges are not turned against the pixels.
        transfer: photon transfer line, None of a grey card.
        jpeg: how the first photograph was compressed, or None.
        settings: of sensor and image signal processor for the same sharpness and noise; None of a grey card.
        model: the chart as the recipe's camera shows it with all of these, or None.
        model_sharpness, model_noise: of the model.
        files: those that were written, the recipe first.
    """

    photographs: tuple[ChartPhotograph, ...]
    response: CameraResponse
    noise: NoiseCurve
    sharpness: Sharpness | None = None
    transfer: PhotonTransfer | None = None
    jpeg: JpegSettings | None = None
    settings: DetailSettings | None = None
    model: ChartPhotograph | None = None
    model_sharpness: Sharpness | None = None
    model_noise: NoiseCurve | None = None
    files: tuple[Path, ...] = ()

    def even_codes(self) -> Floats:
        """`(n, 3)` mean codes of the first photograph's fields in the mean light of the chart."""
        photograph, response = self.photographs[0], self.response
        light = response.illumination(photograph.place, 0)
        return response.tone(response.inverse_tone(photograph.codes) * (light.mean() / light)[:, None])

    @property
    def delta_e(self) -> Floats:
        """`(24,)` CIEDE2000 of photograph and model in even light; empty without a model."""
        if self.model is None:
            return np.empty(0)
        labs = [linear_srgb_to_lab(decode_tone(255.0 * c)) for c in (self.even_codes(), self.model.codes)]
        return delta_e_2000(*labs)
