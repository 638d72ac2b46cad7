"""Files of a calibration: the recipe, its tone curve, and a page with photograph and model side by side."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator
from dataclasses import replace
from functools import reduce
from pathlib import Path
from typing import Any, Final

import numpy as np
from markupsafe import Markup

from pepperscene.atomic import check_can_write, remove, write_files
from pepperscene.calibration.edges import FREQUENCIES
from pepperscene.calibration.model import sensor_gains, tone_points
from pepperscene.calibration.options import CalibrationOptions
from pepperscene.calibration.result import ChartCalibration
from pepperscene.camera import Camera
from pepperscene.colour.patches.chart import chart_names
from pepperscene.errors import ArgumentError
from pepperscene.recipe.camera_tables import AUTO
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.recipe.resolve.load_camera import load_camera
from pepperscene.review.report.colours import jpeg_data_uri
from pepperscene.review.report.page import html_environment
from pepperscene.tuning.report import format_with_sd, toml_text
from pepperscene.tuning.write import reference
from pepperscene.units import file_values

_NEUTRAL: Final = {
    "black_level_error": 0.0, "shading": 0.0, "shading_cast": [0.0, 0.0], "saturation": 1.0, "contrast": 0.0,
    "local_tone_mapping": 0.0, "local_contrast": 0.0, "sharpening_threshold": 0.0,
}  # fmt: skip
"""Values of `[developing.isp]` that change nothing: what the recipe has of them is in what was measured."""

_STYLE: Final = """
body { font: 16px/1.5 system-ui, sans-serif; color: #1a1a1a; background: #fff; }
main { max-width: 75rem; margin: 0 auto; padding: 1rem; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .2rem 1.1rem .2rem 0; text-align: left; border-bottom: 1px solid #ccc; font-weight: 400; }
.pair { display: grid; grid-template-columns: 1fr 1fr; gap: 1rem; }
figure { margin: 0; }
img { display: block; width: 100%; height: auto; }
svg { height: 1.1em; vertical-align: middle; outline: 1px solid #888; }
"""


def check_output(path: Path) -> None:
    """Raise an error unless a recipe and the files beside it can be written."""
    if path.suffix != ".toml":
        raise ArgumentError("out", f"must end with .toml, not {path.name!r}")
    check_can_write(path.parent, [path.name, *_names(path)])


def _names(path: Path) -> tuple[str, str]:
    """Names of the tone curve and of the page."""
    return f"{path.stem}_tone.csv", f"{path.stem}.html"


def write_calibration(
    calibration: ChartCalibration, recipe: Recipe, camera: Camera, path: Path, options: CalibrationOptions
) -> ChartCalibration:
    """Write the recipe, its tone curve and the page, all or none; returns the calibration with its files."""
    curve, page = _names(path)
    changes, comments = _changes(calibration, recipe, camera, curve)
    tables: dict[str, Any] = {"extends": reference(options.recipe, "recipes", path.parent), "name": path.stem}
    for key, value in changes.items():
        *above, last = key.split(".")
        reduce(lambda table, name: table.setdefault(name, {}), above, tables)[last] = value
    names = ", ".join(photograph.name for photograph in calibration.photographs)
    head = f"A camera, calibrated by {names}.\nValues with their standard deviations; the page is {page}."
    files = {page: _page(calibration, path.stem, names).encode()}
    if calibration.settings is not None:
        rows = "\n".join(f"{light:.6f},{code:.6f}" for light, code in tone_points(calibration.response))
        files[curve] = f"light,code\n{rows}\n".encode()
    files[path.name] = toml_text(tables, head, comments, depth=2).encode()
    written = write_files(path.parent, files)
    try:
        load_camera(load_recipe(path))
    except BaseException:
        remove(written)
        raise
    return replace(calibration, files=written[::-1])


def _changes(
    calibration: ChartCalibration, recipe: Recipe, camera: Camera, curve: str
) -> tuple[dict[str, Any], dict[str, str]]:
    """Values of the recipe by dotted key, and comments."""
    response, settings, developing = calibration.response, calibration.settings, camera.developing
    changes: dict[str, Any] = {"developing.white_balance": sensor_gains(camera, response).tolist()}
    comments = {"developing.white_balance": _with_sd(response.gains, response.sd["gains"], "of the light")}
    if developing.white_balance_error != (1.0, 1.0, 1.0):
        changes["developing.white_balance_error"] = [1, 1, 1]
    isp: dict[str, Any] = {}
    if len(calibration.photographs) > 1:
        # All of the fall-off was measured, that of the lens included.
        changes["developing.falloff"] = False
        isp["shading"] = float(np.clip(response.vignetting[0], -0.9, 1.0))
        comments["developing.isp.shading"] = _with_sd(response.vignetting, response.sd["vignetting"])
    if settings is not None:
        changes["developing.colour_matrix"] = response.matrix.tolist()
        worst = float(response.sd["matrix"].max())
        comments["developing.colour_matrix"] = f"standard deviations up to {worst:.2g}"
        changes |= {"developing.pedestal": 0, "developing.blur_px": settings.blur_px}
        changes["camera.gain"] = settings.gain
        if recipe.camera.exposure_s != AUTO:
            exposure_us = file_values(recipe.camera)["exposure_us"]
            changes["camera.exposure_us"] = exposure_us * camera.sensor.gain / settings.gain
            comments["camera.exposure_us"] = "as bright as with the gain before"
        isp |= {
            "tone_curve": curve,
            "sharpening": settings.sharpening,
            "sharpening_radius_px": settings.radius_px,
            "luma_noise_reduction": settings.luma_noise_reduction,
            "chroma_noise_reduction": settings.chroma_noise_reduction,
        }
        given = {} if developing.isp is None else developing.isp.to_metadata()
        isp |= {key: value for key, value in _NEUTRAL.items() if key in given and key not in isp}
    if calibration.jpeg is not None:
        isp |= {"jpeg_quality": calibration.jpeg.quality, "jpeg_subsampling": calibration.jpeg.subsampling}
    return changes | {f"developing.isp.{key}": value for key, value in isp.items()}, comments


def _with_sd(values: Any, sd: Any, what: str = "") -> str:
    pairs = zip(np.ravel(values).tolist(), np.ravel(sd).tolist(), strict=True)
    return f"{what} {', '.join(format_with_sd(value, error) for value, error in pairs)}".strip()


def _page(calibration: ChartCalibration, name: str, names: str) -> str:
    environment = html_environment("pepperscene.calibration")
    model, differences = calibration.model, calibration.delta_e
    fields, pictures, summary = [], [], ""
    if model is not None:
        colours = [_hexadecimal(codes) for codes in (calibration.even_codes(), model.codes)]
        fields = list(zip(chart_names(), *colours, [f"{d:.1f}" for d in differences], strict=True))
        first = calibration.photographs[0]
        pictures = [("photograph", jpeg_data_uri(_cropped(first))), ("model", jpeg_data_uri(model.picture))]
        summary = f"CIEDE2000 of photograph and model: median {np.median(differences):.2f}, "
        summary += f"maximum {differences.max():.2f}; the light of the photograph is evened out."
    return environment.get_template("page.html").render(
        title=f"Calibration {name} by {names}", style=Markup(_STYLE), pictures=pictures, summary=summary,
        values=list(calibration_values(calibration)), figure=_figure(calibration), fields=fields,
    )  # fmt: skip


def _cropped(photograph: Any) -> Any:
    """The photograph's part around the chart."""
    low, high = photograph.corners.min(axis=0), photograph.corners.max(axis=0)
    margin = 0.6 * (high - low).max() / 6.0
    left, top = np.maximum(low - margin, 0.0).astype(int)
    right, bottom = (high + margin).astype(int)
    return photograph.picture[top:bottom, left:right]


def _hexadecimal(codes: Any) -> list[str]:
    return ["#" + bytes(row).hex() for row in np.rint(255.0 * np.clip(codes, 0.0, 1.0)).astype(np.uint8)]


def calibration_values(calibration: ChartCalibration) -> Iterator[tuple[str, str]]:
    """Names and texts of the values that were found."""
    response, settings = calibration.response, calibration.settings
    yield "white balance gains relative to the recipe's light", _with_sd(response.gains, response.sd["gains"])
    for row, name in enumerate(("red", "green", "blue") if settings is not None else ()):
        yield f"matrix, {name}", _with_sd(response.matrix[row], response.sd["matrix"][row])
    yield "white diffuser, of full scale", _with_sd(response.exposures, response.sd["exposures"])
    corners = _with_sd(1.0 + response.vignetting, response.sd["vignetting"])
    yield "light at the corners, relative to the middle", corners
    if (sharpness := calibration.sharpness) is not None:
        value = format_with_sd(sharpness.mtf50, sharpness.mtf50_sd)
        yield "MTF50 of the photograph, cycles per pixel", value
    if (sharpness := calibration.model_sharpness) is not None:
        yield "MTF50 of the model, cycles per pixel", f"{sharpness.mtf50:.3f}"
    if calibration.sharpness is None and settings is not None:
        yield "MTF50", "not measured: turn the chart by about five degrees against the edges of the picture"
    for noise, name in ((calibration.noise, "photograph"), (calibration.model_noise, "model")):
        if noise is not None:
            luma, *chroma = (255.0 * noise.mean()[0]).tolist()
            sd = f" ± {luma * noise.relative_sd:.2f}" if noise.relative_sd else ""
            text = f"{luma:.2f}{sd}, {chroma[0]:.2f} and {chroma[1]:.2f}"
            yield f"noise of luma and both chromas of the {name}, in codes", text
    if (transfer := calibration.transfer) is not None:
        slope = format_with_sd(transfer.slope, transfer.slope_sd)
        yield "photon transfer: variance of green per linear value", slope


def _figure(calibration: ChartCalibration) -> str:
    """Tone curve, modulation transfer and noise as a data URI of a PNG; empty of a grey card."""
    from matplotlib.figure import Figure

    if calibration.model is None or calibration.model_noise is None:
        return ""
    figure = Figure(figsize=(12.0, 3.6), dpi=100, layout="constrained")
    tone, transfer, noise = figure.subplots(1, 3)
    light = np.linspace(0.0, 1.0, 257)
    tone.plot(light, 255.0 * calibration.response.tone(light))
    tone.set(title="tone curve", xlabel="light, of full scale", ylabel="code")
    for sharpness, name in ((calibration.sharpness, "photograph"), (calibration.model_sharpness, "model")):
        if sharpness is not None:
            transfer.plot(FREQUENCIES, sharpness.mtf, label=name)
    transfer.set(title="modulation transfer", xlabel="cycles per pixel", ylim=(0.0, None))
    for curve, name in ((calibration.noise, "photograph"), (calibration.model_noise, "model")):
        noise.plot(255.0 * curve.levels[:, 1], 255.0 * curve.deviations[:, 0, 0], "o", label=name)
    noise.set(title="noise of luma", xlabel="code of green", ylabel="standard deviation, codes")
    noise.set(ylim=(0.0, None))
    for axes in (transfer, noise):
        axes.legend(frameon=False)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}"
