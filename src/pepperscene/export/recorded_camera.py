"""The cameras of recorded frames, with the geometry that the JSON of a frame describes."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Final

import numpy as np

from pepperscene.camera import Camera, Lens, Motion, Sensor
from pepperscene.camera.optics.distortion import MODELS, LensModel, make_distortion
from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.errors import InputError
from pepperscene.spectra import Spectrum

_PITCH_M: Final = 2.0**-17
"""Pitch of the pixels. Chosen: with any power of two, focal lengths in pixels stay exact."""

_EXPOSURE_S: Final = 50e-6  # any, since it does not affect the geometry


def recorded_camera(frame: DatasetFrame, *, allows_line_scan: bool = False) -> Camera:
    """The camera of a frame, for its geometry only: values of light and electrons are placeholders.

    Pose, intrinsics, distortion, motion and the times of rows are those of the frame's JSON, so that
    `Camera.project`, `pixel_directions` and `label_poses` are those of its labels.

    Raises:
        InputError: a value is missing, the lens has no image of this size, or it is a line scanner, unless
            that is allowed.
    """
    path, values = frame.dataset.frame_path(frame.index), frame.metadata["camera"]
    for key in ("width", "height"):
        if values.get(key) is None:
            raise InputError(path, "is required but missing", key=f"camera.{key}")
    is_line_scan = bool(values.get("line_scan", False))
    if is_line_scan and not allows_line_scan:
        problem = "must be false: this format has cameras that take an image at once, not line scanners"
        raise InputError(path, problem, key="camera.line_scan", value=True)
    model = values["distortion"].get("model", "plumb_bob")
    if model not in MODELS:
        raise InputError(
            path, f"must be one of {', '.join(MODELS)}", key="camera.distortion.model", value=model
        )
    coefficients = tuple(float(values["distortion"].get(name, 0.0)) for name in MODELS[model])
    numbers = tuple(float(values[name]) for name in ("fx", "fy", "cx", "cy"))
    size = int(values["width"]), int(values["height"])
    try:
        line_time_s = float(values.get("line_time_s") or 0.0)
        lens, sensor = _optics(model, coefficients, numbers, size, line_time_s, is_line_scan)
        motion = values.get("motion")
        return Camera(
            lens,
            sensor,
            np.asarray(values["pose"], dtype=float),
            exposure_s=min(line_time_s, _EXPOSURE_S) if is_line_scan else _EXPOSURE_S,
            motion=None
            if motion is None
            else Motion(motion["velocity_m_s"], motion["angular_velocity_rad_s"]),
            labels_per_row=motion is None or motion.get("labels_per_row", True),
        )
    except InputError as error:
        raise InputError(path, error.detail, key="camera") from None
    except (ValueError, ZeroDivisionError) as error:
        raise InputError(path, f"must describe a camera, but {error}", key="camera") from None


@lru_cache(maxsize=8)
def _optics(
    model: LensModel,
    coefficients: tuple[float, ...],
    intrinsics: tuple[float, ...],
    size: tuple[int, int],
    line_time_s: float,
    is_line_scan: bool,
) -> tuple[Lens, Sensor]:
    """Lens and sensor; the same objects for equal values, since rays are cached by them."""
    (fx, fy, cx, cy), (width, height) = intrinsics, size
    electrical: dict[str, Any] = {
        "quantum_efficiency": Spectrum(np.array([400.0, 700.0]), np.ones((1, 2))),
        "full_well_e": 1.0,
        "read_noise_e": 0.0,
        "bits": 8,
        "black_level_dn": 0.0,
    }
    sensor = Sensor(
        "the recorded camera",
        width,
        height,
        _PITCH_M,
        binning=1,
        pattern="mono",
        line_time_s=line_time_s,
        line_scan=is_line_scan,
        **electrical,
    )
    lens = Lens(
        "the recorded camera",
        focal_length_m=fx * _PITCH_M,
        f_number=1.0,
        distortion=make_distortion(model, coefficients),
        principal_offset_m=((cx - width / 2) * _PITCH_M, (cy - height / 2) * _PITCH_M),
        fy_over_fx=fy / fx,
    )
    return lens, sensor
