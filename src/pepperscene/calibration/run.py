"""Calibration of a camera from photographs of a chart: reads them, fits the response, details and noise."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pepperscene.calibration.edges import chart_sharpness
from pepperscene.calibration.model import ChartModel, fit_details
from pepperscene.calibration.noise import chart_noise, chart_transfer
from pepperscene.calibration.options import CalibrationOptions
from pepperscene.calibration.photographs import jpeg_settings, read_card, read_chart
from pepperscene.calibration.response import card_response, fit_response
from pepperscene.calibration.result import ChartCalibration
from pepperscene.camera import Camera
from pepperscene.camera.image.colorimetry import NM, balanced_rgb, colour_checker_reflectances
from pepperscene.camera.image.developing import reference_correction, reference_light
from pepperscene.errors import ArgumentError, InputError

Floats = NDArray[np.float64]


def calibrate(
    photographs: Sequence[str | Path] | str | Path,
    out: str | Path | None = None,
    options: CalibrationOptions | None = None,
) -> ChartCalibration:
    """Find the recipe with which frames look like a camera's photographs of a ColorChecker Classic.

    White balance, colour matrix and tone curve are fitted together to the fields of all photographs, with the
    light's fall-off; sharpness is measured by the slanted edges of the chart and noise by its fields. Blur,
    sharpening, gain and noise reduction are those with which the program's own image of the chart has the
    same. Of a grey card, only the white balance and the fall-off are found.

    Args:
        photographs: of one camera with one setting, of the same chart: at several positions for the fall-off
            of light, at several exposures for a longer tone curve.
        out: recipe to write, such as "camera.toml"; its tone curve and a page are written beside it. None
            writes nothing.
        options: see `CalibrationOptions`.

    Raises:
        InputError: a file is no photograph, or shows no chart that can be measured.
        ArgumentError: an option is not valid.
        OutputError: a file cannot be written.
    """
    from pepperscene.calibration.write import check_output, write_calibration
    from pepperscene.recipe.resolve.load import load_recipe
    from pepperscene.recipe.resolve.load_camera import load_camera

    options = options or CalibrationOptions()
    if out is not None:
        check_output(Path(out))
    recipe = load_recipe(options.recipe)
    camera = load_camera(recipe)
    if camera.sensor.pattern in ("mono", "bands"):
        raise InputError(options.recipe, f"must have a colour sensor; {camera.sensor.name} has none")
    files = [Path(file) for file in ([photographs] if isinstance(photographs, str | Path) else photographs)]
    if not files:
        raise ArgumentError("photographs", "must be at least one file")
    calibration = _calibrated(files, camera, options)
    return calibration if out is None else write_calibration(calibration, recipe, camera, Path(out), options)


def _calibrated(files: Sequence[Path], camera: Camera, options: CalibrationOptions) -> ChartCalibration:
    rng = np.random.default_rng(options.seed)
    if options.grey_card is not None:
        cards = tuple(read_card(file, options.grey_card) for file in files)
        response = card_response(cards, reference_correction(camera).matrix, rng)
        return ChartCalibration(cards, response, chart_noise(cards[0], rng), jpeg=jpeg_settings(files[0]))

    corners = None if options.corners is None else np.reshape(options.corners, (4, 2))
    charts = tuple(read_chart(file, corners) for file in files)
    rgb = balanced_rgb(camera.sensor, reference_light(camera), colour_checker_reflectances().at(NM))
    response = fit_response(charts, rgb, reference_correction(camera).matrix, rng)
    first = charts[0]
    noise = chart_noise(first, rng)
    sharpness = chart_sharpness(first, response.inverse_tone(first.picture / 255.0), rng)
    transfer = chart_transfer(first, tuple(response.inverse_tone(codes) for codes in first.middles), rng)
    jpeg = jpeg_settings(files[0])
    model = ChartModel(camera, first, response, rgb, jpeg)
    settings = fit_details(model, sharpness, noise, options.seed)
    seen = model.photograph(settings, rng)
    return ChartCalibration(
        charts, response, noise, sharpness, transfer, jpeg, settings, seen,
        model_sharpness=chart_sharpness(seen, response.inverse_tone(seen.picture / 255.0)),
        model_noise=model.noise(settings, options.seed + 1),
    )  # fmt: skip
