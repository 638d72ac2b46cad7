"""Loading the cameras and the lamps of a recipe: their parts by name, with the recipe's settings."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.errors import InputError
from pepperscene.recipe.camera_tables import AUTO, GENERIC_SENSOR, INTRINSICS, SIZE_KEYS, CameraTable
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolve.named_files import NamedFiles
from pepperscene.recipe.tables import MOST_LAMPS, WhiteReferenceTable
from pepperscene.recipe.views_tables import ArcViews, PathViews, PoseViews
from pepperscene.units import NONE, file_values

if TYPE_CHECKING:
    from pepperscene.camera import (
        Camera,
        DepthCamera,
        ImageProcessor,
        Lamp,
        Lens,
        Projector,
        Sensor,
        WhiteReference,
    )
    from pepperscene.camera.optics.calibration import CameraCalibration

# Of the surfaces' spectra. The step is chosen: it resolves the red edge and the pigments' bands, 20 nm wide
# and more. The pigments' absorption coefficients end at 2500 nm.
GRID_STEP_NM: Final = 5.0
MAX_WAVELENGTH_NM: Final = 2500.0
_TYPICAL_EXPOSURE_S: Final = 1e-3
"""Placeholder until automatic exposure has set one. Chosen: only its order of magnitude matters, to decide
what light can be neglected."""
_MIN_EFFICIENCY: Final = 1e-9
"""Electrons per photon, of the most sensitive colour. Chosen: less than any dark current leaves visible, and
far from where single precision ends."""

_MOST_LAMP_FILES: Final = 8  # chosen: as many spectra as the renderer takes

# Of a lens that a recipe describes in numbers.
_F_NUMBER: Final = 2.0  # chosen: camera modules of webcams, phones and depth cameras have 1.8 to 2.4
_TRANSMITTANCE: Final = 0.9
"""Chosen: 5 to 7 glasses or plastic lenses, coated, transmit 0.87 to 0.95."""


def load_camera(recipe: Recipe, where: str | Path = "", files: NamedFiles | None = None) -> Camera:
    """Load the camera with the recipe's settings, without a pose; arguments and errors as in `load_files`."""
    from pepperscene.camera import Camera, lamp_spectrum, load_flash

    where, table, files = where or recipe.name, recipe.camera, files or NamedFiles()
    calibration = _read_calibration(table, where, files)
    sensor = _load_sensor(table, where, calibration, files)
    lens = _load_lens(table, where, sensor, calibration, files)
    flash = None if table.flash == NONE else files.load(load_flash, where, "camera.flash", table.flash)

    # Checks that need several parts.
    if sensor.line_scan:
        _check_line_scan(recipe, where, sensor)
    if table.focus_m is not None and table.focus_m <= lens.focal_length_m:
        problem = f"must be beyond the focal length of {lens.name}, {1e3 * lens.focal_length_m:g} mm"
        raise InputError(where, problem, key="camera.focus_mm", value=file_values(table)["focus_mm"])
    developing = recipe.developing
    if developing.white_balance == "flash" and flash is None and sensor.pattern == "bands":
        # Bands are not balanced, so a recipe that extends one with a flash needs no other value.
        developing = replace(developing, white_balance="daylight")
    if developing.white_balance == "flash" and flash is None and sensor.channels > 1:
        problem = f'needs a developing.white_balance of "daylight", "{NONE}" or three gains, not "flash"'
        raise InputError(where, problem, key="camera.flash", value=NONE)
    is_balanced = developing.white_balance == "lamps" and sensor.channels > 1
    if is_balanced and not recipe.lamps:
        problem = f'needs [[lamps]]; without, it is "daylight", "flash", "{NONE}" or three gains'
        raise InputError(where, problem, key="developing.white_balance", value="lamps")
    lamps = load_lamps(recipe, "camera", where, files)
    exposure_s = _TYPICAL_EXPOSURE_S if table.exposure_s == AUTO else table.exposure_s
    all_lamps = (*lamps, *load_lamps(recipe, "world", where, files)) if is_balanced else ()
    if developing.isp is not None:
        developing = replace(developing, isp=_load_processor(developing.isp, where, sensor, files))
    try:
        return Camera(
            lens=lens,
            sensor=sensor,
            exposure_s=exposure_s,
            flash=flash,
            lamps=lamps,
            lamp_light=lamp_spectrum(all_lamps, exposure_s),
            developing=developing,
            focus_m=table.focus_m,
            labels_per_row=table.labels_per_row is not False,
        )
    except InputError as error:
        # Errors of a lens without a file name the key of the recipe that describes it.
        if table.lens_key == "lens" or error.where != lens.name:
            raise
        key = "distortion" if error.key == "distortion" and table.distortion else table.lens_key
        raise InputError(where, error.problem, key=f"camera.{key}", value=getattr(table, key)) from None


def _load_processor(
    processor: ImageProcessor, where: str | Path, sensor: Sensor, files: NamedFiles
) -> ImageProcessor:
    """The image signal processor with the values of its preset, and its tone curve read."""
    from pepperscene.camera.isp.processor import TONE_CURVES, load_processor, read_tone_curve

    key = "developing.isp"
    if sensor.pattern == "bands":
        raise InputError(where, f"must be left out: {sensor.name} has bands, and so no colour image", key=key)
    if isinstance(name := processor.tone_curve, str) and name not in TONE_CURVES:
        points = files.load(read_tone_curve, where, f"{key}.tone_curve", name)
        processor = replace(processor, tone_curve=points)
    if processor.preset is None:
        return processor
    preset = files.load(load_processor, where, f"{key}.preset", processor.preset)
    return replace(processor.completed(preset), preset=Path(processor.preset).stem)


def _check_line_scan(recipe: Recipe, where: str | Path, sensor: Sensor) -> None:
    """Raise `InputError` if a line scanner is not used as one."""
    table, views, line_us = recipe.camera, recipe.views, 1e6 * sensor.line_time_s
    is_moving = isinstance(views, PathViews | PoseViews) and views.motion
    is_moving |= isinstance(views, ArcViews) and views.speed_m_s is not None
    if not is_moving:
        kinds = "a path, timed poses, or an arc with speed_mm_s"
        problem = f"must move the camera, as {sensor.name} is a line scanner: {kinds}"
        raise InputError(where, problem, key="views.kind", value=views.kind)
    if table.exposure_s == AUTO:
        problem = f"must be a time: automatic exposure does not know the lines of {sensor.name}"
        raise InputError(where, problem, key="camera.exposure_us", value=AUTO)
    exposure_us = file_values(table)["exposure_us"]
    if exposure_us > line_us:
        problem = f"must be at most {line_us:g}, the time from line to line of {sensor.name}"
        raise InputError(where, problem, key="camera.exposure_us", value=exposure_us)
    if table.labels_per_row is False:
        problem = f"must be true, as {sensor.name} is a line scanner"
        raise InputError(where, problem, key="camera.labels_per_row", value=False)


def white_reference(recipe: Recipe) -> WhiteReference:
    """The white reference of a recipe without variation."""
    from pepperscene.camera import WhiteReference

    table = recipe.white_reference or WhiteReferenceTable()
    distance_m = recipe.views.subject_m if table.distance_m is None else table.distance_m
    return WhiteReference(table.reflectance, distance_m, table.facing)


def surface_wavelengths(sensor: Sensor) -> NDArray[np.float64]:
    """Wavelengths of the surfaces' spectra, nm: the range in which the sensor is sensitive.

    Raises:
        ValueError: the sensor is sensitive nowhere, only between whole nanometres, or beyond
            `MAX_WAVELENGTH_NM`.
    """
    efficiency = sensor.quantum_efficiency
    sensitive = np.flatnonzero((efficiency.values > 0).any(axis=0))
    if not efficiency.values.max() >= _MIN_EFFICIENCY:
        raise ValueError("is not sensitive at any wavelength")
    # Light is traced on a grid of half nanometres: a line between whole ones could be missed.
    whole_nm = np.arange(np.ceil(efficiency.wavelength_nm[0]), efficiency.wavelength_nm[-1] + 0.5)
    if not efficiency.at(whole_nm).max(initial=0.0) >= _MIN_EFFICIENCY:
        raise ValueError("is not sensitive at any whole number of nanometres")
    # The curves fall to zero at the neighbouring entries.
    limits = [max(sensitive[0] - 1, 0), min(sensitive[-1] + 1, efficiency.wavelength_nm.size - 1)]
    nm = efficiency.wavelength_nm[limits]
    first, last = GRID_STEP_NM * np.floor(nm[0] / GRID_STEP_NM), GRID_STEP_NM * np.ceil(nm[1] / GRID_STEP_NM)
    if last > MAX_WAVELENGTH_NM:
        raise ValueError(
            f"is sensitive up to {nm[1]:g} nm, but plant optics are known up to {MAX_WAVELENGTH_NM:g} nm only"
        )
    return np.arange(first, last + GRID_STEP_NM / 2, GRID_STEP_NM)


def surface_range(sensors: Iterable[Sensor]) -> tuple[float, float]:
    """First and last wavelength of surfaces that some sensors see and that light in PAR meets, nm.

    Raises:
        ValueError: as `surface_wavelengths`.
    """
    from pepperscene.spectra.wavebands import PAR

    limits = np.array(
        [(PAR.first_nm, PAR.last_nm), *(surface_wavelengths(sensor)[[0, -1]] for sensor in sensors)]
    )
    return float(limits[:, 0].min()), float(limits[:, 1].max())


def _read_calibration(table: CameraTable, where: str | Path, files: NamedFiles) -> CameraCalibration | None:
    """Read the calibration file, if there is one; its image has the size of the recipe, if that has one."""
    from pepperscene.camera.optics.calibration import read_calibration

    if table.calibration is None:
        return None
    calibration = files.load(read_calibration, where, "camera.calibration", table.calibration)
    for key in SIZE_KEYS:
        size, calibrated = getattr(table, key), getattr(calibration, key)
        if size not in (None, calibrated):
            problem = f"must be {calibrated} as in the calibration, or left out"
            raise InputError(where, problem, key=f"camera.{key}", value=size)
    return calibration


def _load_lens(
    table: CameraTable,
    where: str | Path,
    sensor: Sensor,
    calibration: CameraCalibration | None,
    files: NamedFiles,
) -> Lens:
    """Load the lens, or make the thin lens that the recipe describes in numbers."""
    from pepperscene.camera import load_lens
    from pepperscene.camera.optics.calibration import CameraCalibration, pinhole_calibration

    if table.lens_key == "lens":
        lens = files.load(load_lens, where, "camera.lens", table.lens)
        settings = {key: getattr(table, key) for key in ("f_number", "transmittance")}
        return replace(lens, **{key: value for key, value in settings.items() if value is not None})

    size = sensor.columns, sensor.rows
    if table.hfov_deg is not None:
        try:
            calibration = pinhole_calibration(*size, table.hfov_deg)
        except ValueError as error:
            raise InputError(where, str(error), key="camera.hfov_deg", value=table.hfov_deg) from None
    elif calibration is None:
        fx, fy, cx, cy = (getattr(table, key) for key in INTRINSICS)
        model, coefficients = table.distortion_model or "plumb_bob", table.distortion or ()
        try:
            calibration = CameraCalibration(*size, fx, fy, cx, cy, model, coefficients)
        except ValueError as error:
            key = "distortion" if "distortion" in str(error) else "fx"
            raise InputError(where, str(error), key=f"camera.{key}", value=getattr(table, key)) from None
    f_number = table.f_number if table.f_number is not None else _F_NUMBER
    transmittance = table.transmittance if table.transmittance is not None else _TRANSMITTANCE
    name = f"thin lens of camera.{table.lens_key}"
    return calibration.lens(name, sensor.pixel_pitch_m, f_number, transmittance)


def _load_sensor(
    table: CameraTable, where: str | Path, calibration: CameraCalibration | None, files: NamedFiles
) -> Sensor:
    """Load the sensor with its settings, at the size of the image, behind its filter."""
    from pepperscene.camera import load_filter, load_sensor
    from pepperscene.camera.sensor.bands import describe_bands

    sensor = files.load(load_sensor, where, "camera.sensor", table.sensor)
    sensor = sensor.with_settings(bits=table.bits, gain=table.gain)
    size = (table.width, table.height) if calibration is None else (calibration.width, calibration.height)
    if size[0] is not None and size[1] is not None:
        try:
            sensor = _at_size(sensor, table.sensor, size[0], size[1])
        except ValueError as error:
            key = "width" if calibration is None else "calibration"
            raise InputError(where, str(error), key=f"camera.{key}", value=getattr(table, key)) from None
    key, name = "camera.sensor", table.sensor
    try:
        surface_wavelengths(sensor)
        if table.filter != NONE:
            key, name = "camera.filter", table.filter
            sensor = sensor.with_filter(files.load(load_filter, where, key, name).transmittance)
            surface_wavelengths(sensor)
            if sensor.pattern == "bands":
                describe_bands(sensor.quantum_efficiency)
    except ValueError as error:
        behind = " behind it" if key == "camera.filter" else ""
        raise InputError(where, f"{sensor.name}{behind} {error}", key=key, value=name) from None
    return sensor


def _at_size(sensor: Sensor, name: str, columns: int, rows: int) -> Sensor:
    """The sensor in the mode of an image size; the generic one has as many photosites as that needs.

    Raises:
        ValueError: the sensor has too few photosites.
    """
    if name != GENERIC_SENSOR:
        return sensor.with_size(columns, rows)
    from pepperscene.camera.sensor.sensor_files import MAX_PHOTOSITES

    if columns * rows * sensor.binning**2 > MAX_PHOTOSITES:
        allowed = f"have at most {MAX_PHOTOSITES // sensor.binning**2} pixels"
        raise ValueError(f"an image of {columns} x {rows} pixels must {allowed}")
    return replace(sensor, columns=columns, rows=rows)


_MIN_DETECTED: Final = 1e-3
"""Chosen: of the highest quantum efficiency; less is the leak of a filter that blocks the projector."""


def load_depth_camera(
    recipe: Recipe, where: str | Path = "", files: NamedFiles | None = None
) -> DepthCamera | None:
    """Load the depth camera with the recipe's settings, without a pose; None if the recipe has none.

    Arguments and errors are as in `load_files`.
    """
    table = recipe.depth_camera
    if table is None:
        return None
    from pepperscene.camera import DepthCamera, Developing, load_projector
    from pepperscene.camera.lamps.lamp import lamps_seen_from

    where, files = where or recipe.name, files or NamedFiles()
    # The imagers are described as any camera is; they have no flash.
    imager = recipe.model_copy(update={"camera": table, "developing": Developing(white_balance="daylight")})
    try:
        left = load_camera(imager, where, files)
    except InputError as error:
        key = f"depth_{error.key}" if error.key.startswith("camera.") else error.key
        raise InputError(error.where, error.problem, key=key, value=error.value) from None
    if left.lamps:
        left = replace(left, lamps=lamps_seen_from(left.lamps, table.extrinsics))
    if left.sensor.line_scan or left.sensor.pattern == "bands":
        problem = "must take photographs: it is a line scanner or has bands"
        raise InputError(where, problem, key="depth_camera.sensor", value=table.sensor)
    if not left.lens.distortion.is_zero:
        problem = "must be without distortion, as the images of depth cameras are after rectification"
        raise InputError(where, problem, key=f"depth_camera.{table.lens_key}")
    projector = None
    if table.projector != NONE:
        key = "depth_camera.projector"
        projector = files.load(load_projector, where, key, table.projector)
        _check_detected(projector, left.sensor, where, key, table.projector)
    return DepthCamera(
        left=left,
        baseline_m=table.baseline_m,
        projector=projector,
        matching=table.matching,
        exposure_control=table.auto_exposure.control() if table.exposure_s == AUTO else None,
        depth_unit_m=table.depth_unit_m,
    )


def _check_detected(projector: Projector, sensor: Sensor, where: str | Path, key: str, name: str) -> None:
    """Raise `InputError` if an imager does not detect the projector."""
    efficiency = sensor.quantum_efficiency
    if not efficiency.at([projector.wavelength_nm]).max() >= _MIN_DETECTED * efficiency.values.max():
        problem = f"emits {projector.wavelength_nm:g} nm, which the imagers do not detect"
        raise InputError(where, problem, key=key, value=name)


def load_lamps(
    recipe: Recipe, fixed: str, where: str | Path = "", files: NamedFiles | None = None
) -> tuple[Lamp, ...]:
    """Load the lamps that are fixed in the "world" or to the "camera", in its axes.

    Other arguments and errors are as in `load_files`.
    """
    if not recipe.lamps:
        return ()
    from pepperscene.camera.lamps.lamp_files import load_lamp

    where, files = where or recipe.name, files or NamedFiles()
    if (count := sum(table.lamps for table in recipe.lamps)) > MOST_LAMPS:
        raise InputError(where, f"must be at most {MOST_LAMPS} lamps, not {count}", key="lamps")
    if len({table.lamp for table in recipe.lamps}) > _MOST_LAMP_FILES:
        raise InputError(where, f"must name at most {_MOST_LAMP_FILES} different files", key="lamps")
    placed: list[Lamp] = []
    for number, table in enumerate(recipe.lamps):
        key = f"lamps.{number}.lamp"
        lamp = files.load(load_lamp, where, key, table.lamp)
        if lamp.pulse_s is not None and recipe.camera.exposure_s == AUTO:
            problem = "is flashed, which needs an exposure in microseconds"
            raise InputError(where, problem, key=key, value=table.lamp)
        try:
            lamps = table.placed(lamp)
        except ValueError as error:
            raise InputError(where, str(error), key=f"lamps.{number}") from None
        placed += lamps if table.fixed == fixed else []
    return tuple(placed)
