"""The camera: a lens in front of a sensor at a pose, with or without a flash; its rays, and its exposure."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera.lamps.lamp import Lamp
from pepperscene.camera.metadata import recorded_optics
from pepperscene.camera.optics.flash import Flash
from pepperscene.camera.optics.lens import Lens
from pepperscene.camera.pixel_rays import (
    border_slopes,
    centre_directions,
    check_field,
    corner_slopes,
    intrinsics_matrix,
    slope_limits,
)
from pepperscene.camera.poses.generators import as_points
from pepperscene.camera.poses.motion import Motion
from pepperscene.camera.sensor.developing_steps import Developing
from pepperscene.camera.sensor.rows import Shutter
from pepperscene.camera.sensor.sensor import Sensor
from pepperscene.errors import InputError
from pepperscene.spectra import Spectrum

Array = NDArray[np.float64]
_ROW_ACCURACY_PX: Final = 1e-9  # chosen: rounding of pixel coordinates is a thousandth of it
_MOST_LINE_STEPS: Final = 32  # chosen: a camera that does not turn takes 2, and one that turns 4 or 5
_EXPOSURE_S: Final = 50e-6  # unless another one is given; it does not affect the geometry
_POINTS: Final = 1 << 13  # chosen: points that are projected at a time through a rolling shutter
_MOST_ROW_STEPS: Final = 64
"""Chosen, for the fixed point of `Camera.project`: an image that moves by a tenth of a row while the shutter
advances by one takes 13 steps, one that moves by six tenths takes all of them."""


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera that is ready to take an image.

    Pixel coordinates (u, v) are continuous: the image spans [0, width] x [0, height], and the centre of the
    pixel in row 0 and column 0 is (0.5, 0.5). Camera axes: x right, y down, z forward.

    Attributes:
        lens, sensor: optics and photosites.
        pose: `(4, 4)` camera to world, metres; of a moving camera, at the middle of the image's exposure.
        exposure_s: exposure time of a row.
        flash: the flash, or None; `Shutter.pulse_begin` says when its pulse starts.
        developing: the steps from electrons to the image.
        focus_m: distance of the focal plane along the optical axis from the projection centre; None makes
            everything sharp: a pinhole with the lens' light.
        motion: velocities during the exposure, or None for a camera that stands still.
        labels_per_row: with a rolling shutter and motion, whether ground truth and `project` follow the pose
            of each row at the middle of its own exposure, as the image does, or have `pose` in all rows.
        lamps: that move with the camera, in its axes.
        lamp_light: relative spectrum of the light of all lamps, as of `lamp_spectrum`, for a white balance
            that needs it.

    Focusing changes neither the field of view nor the light. A thin lens focused at d is (1 + m) f from the
    sensor with m = f / (d - f), and its working f-number is N (1 + m). At 4 mm and 40 cm, m is 1 %: the field
    of view narrows by 1 %, which a calibrated focal length already includes, and the light decreases by 2 %,
    less than f-numbers are rounded to.
    """

    lens: Lens
    sensor: Sensor
    pose: Array = field(default_factory=lambda: np.eye(4))
    exposure_s: float = _EXPOSURE_S
    flash: Flash | None = None
    developing: Developing = field(default_factory=Developing)
    focus_m: float | None = None
    motion: Motion | None = None
    labels_per_row: bool = True
    lamps: tuple[Lamp, ...] = ()
    lamp_light: Spectrum | None = None

    def __post_init__(self) -> None:
        pose = np.array(self.pose, dtype=float)
        if pose.shape != (4, 4) or not np.isfinite(pose).all():
            raise ValueError("a pose must be a finite (4, 4) matrix")
        rotation = pose[:3, :3]
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) or np.linalg.det(rotation) < 0:
            raise ValueError("a pose must be a rotation and a translation, without scale or reflection")
        if not 0 < self.exposure_s < math.inf:
            raise ValueError("the exposure must be positive and finite")
        if self.focus_m is not None and not self.lens.focal_length_m < self.focus_m < math.inf:
            allowed = f"must be finite and beyond the focal length of {self.lens.focal_length_m:g} m"
            raise InputError(self.lens.name, allowed, key="focus_m", value=self.focus_m)
        if self.sensor.line_scan and not (self.exposure_s <= self.sensor.line_time_s and self.labels_per_row):
            raise ValueError("the rows of a line scanner are exposed one after the other, labels as well")
        pose.setflags(write=False)
        object.__setattr__(self, "pose", pose)
        check_field(self.lens, self._ray_sensor)

    @property
    def width(self) -> int:
        """Columns of the image."""
        return self.sensor.columns

    @property
    def height(self) -> int:
        """Rows of the image."""
        return self.sensor.rows

    @property
    def intrinsics(self) -> Array:
        """`(3, 3)` pinhole matrix in image pixels."""
        return intrinsics_matrix(self.lens, self.sensor)

    @property
    def _ray_sensor(self) -> Sensor:
        """The photosites whose rays differ: of a line scanner its line, which all rows share."""
        return self.sensor.line if self.sensor.line_scan else self.sensor

    @property
    def aperture_radius_m(self) -> float:
        """Radius of the entrance pupil."""
        return self.lens.focal_length_m / (2 * self.lens.f_number)

    @property
    def flash_duty(self) -> float:
        """Fraction of the exposure during which the flash is on."""
        return 0.0 if self.flash is None else min(self.flash.pulse_s, self.exposure_s) / self.exposure_s

    @property
    def shutter(self) -> Shutter:
        """The times of the rows."""
        return Shutter(self.exposure_s, self.sensor.line_time_s, self.height)

    @property
    def is_moving(self) -> bool:
        """Whether the camera moves during the exposure."""
        return self.motion is not None and not self.motion.is_zero

    @property
    def rows_move(self) -> bool:
        """Whether ground truth and `project` follow the pose of each row; else all rows have `pose`."""
        return self.is_moving and self.sensor.line_time_s != 0.0 and self.labels_per_row

    def pose_at(self, t: ArrayLike) -> Array:
        """`(..., 4, 4)` camera to world at the times `t` `(...)`, seconds; `Shutter` defines time 0."""
        return (self.motion or Motion()).pose_at(self.pose, t)

    def label_poses(self, v: ArrayLike) -> Array:
        """`(..., 4, 4)` poses that ground truth has at the image rows v `(...)`, continuous coordinates."""
        times = self.shutter.middle_at(v)
        return self.pose_at(times if self.rows_move else np.zeros(times.shape))

    def label_centres(self, v: ArrayLike) -> Array:
        """`(..., 3)` projection centres of the `label_poses`."""
        times = self.shutter.middle_at(v)
        moved = (self.motion or Motion()).translation(times if self.rows_move else np.zeros(times.shape))
        return np.asarray(self.pose[:3, 3] + moved)

    def at_pose(self, pose: ArrayLike) -> Camera:
        """The same camera at another pose."""
        return dataclasses.replace(self, pose=np.asarray(pose, dtype=float))

    def ray_slopes(self, rows: slice | None = None) -> Array:
        """`(h + 1, w + 1, 2)` undistorted slopes (x/z, y/z) of the rays through the pixel corners.

        Those of a line scanner are the same in all rows: `(2, w + 1, 2)`. Read-only and shared by all cameras
        with this lens and sensor. Those of some rows of corners, `(n, w + 1, 2)`, take no more memory than
        these if the image is large.
        """
        return corner_slopes(self.lens, self._ray_sensor, rows)

    def border_slopes(self) -> tuple[Array, ...]:
        """The `ray_slopes` along the top and bottom, `(w + 1, 2)`, left and right border, `(h + 1, 2)`.

        Those of a line scanner are along the borders of its line: h is 1.
        """
        return border_slopes(self.lens, self._ray_sensor)

    def slope_limits(self) -> Array:
        """`(2, 2)` the least and the largest of the `ray_slopes`, (x/z, y/z) each."""
        return slope_limits(self.lens, self._ray_sensor)

    def pixel_directions(self, rows: slice | None = None) -> Array:
        """`(h, w, 3)` unit directions in camera axes of the rays through the pixel centres; read-only.

        Those of some rows, `(n, w, 3)`, take no more memory than these if the image is large.
        """
        if not self.sensor.line_scan:
            return centre_directions(self.lens, self.sensor, rows)
        line = centre_directions(self.lens, self._ray_sensor)
        return np.broadcast_to(line, (self.height, *line.shape[1:]))[rows or slice(None)]

    def project(self, points_world: ArrayLike) -> Array:
        """Pixel coordinates (u, v), `(n, 2)`, of world points `(n, 3)`, inside the image or not.

        nan for points behind the camera, and for those so far off the axis that the distortion would fold
        them back into the image. The row of a line scanner is when its line sees the point: nan if it never
        does.

        Raises:
            ArgumentError: the points have another shape; a single one, `(3,)`, is allowed.
        """
        points = as_points(points_world, "points_world")
        if self.rows_move:
            # In parts that stay in the processor's cache: three times as fast, and in little memory.
            parts = np.array_split(points, len(points) // _POINTS + 1)
            project = self._project_lines if self.sensor.line_scan else self._project_rows
            return np.concatenate([project(part) for part in parts])
        if self.sensor.line_scan:
            return np.full((len(points), 2), np.nan)
        return self._image_points(self.pose[:3, :3].T @ (points - self.pose[:3, 3]).T)

    def _image_points(self, points_camera: Array) -> Array:
        """Pixel coordinates `(n, 2)` of points `(3, n)` in camera axes; nan as in `project`."""
        x, y, z = points_camera
        in_front = z > 0
        depth_z = np.where(in_front, z, 1.0)
        slopes = np.stack([x / depth_z, y / depth_z], axis=-1)
        valid = in_front & (np.hypot(slopes[:, 0], slopes[:, 1]) < self.lens.distortion.fold_radius)
        slopes[~valid] = np.nan
        matrix = intrinsics_matrix(self.lens, self._ray_sensor)
        with np.errstate(over="ignore", invalid="ignore"):  # points very close to the camera's plane
            return self.lens.distortion.distort(slopes) * matrix[[0, 1], [0, 1]] + matrix[:2, 2]

    def _project_rows(self, points: Array) -> Array:
        """Pixel coordinates `(n, 2)` of world points in an image whose rows have different poses.

        A point's row sets the time, and the pose at that time sets the point's row: a fixed point, found by
        iteration to `_ROW_ACCURACY_PX`. nan where it does not converge, because the image moves about as fast
        as the shutter or faster.
        """
        motion, shutter = self.motion or Motion(), self.shutter
        pixels = np.full((len(points), 2), np.nan)
        # A point that only the first or last rows have in front of them is found from their times.
        for start in (0.5 * self.height, 0.0, float(self.height)):
            missing = np.flatnonzero(np.isnan(pixels[:, 0]))
            v = np.full(len(missing), start)
            for _ in range(_MOST_ROW_STEPS):
                times = shutter.middle_at(v)
                found = self._image_points(motion.to_camera(self.pose, points[missing], times).T)
                step = np.abs(np.clip(found[:, 1], 0.0, self.height) - np.clip(v, 0.0, self.height))
                is_final = step <= _ROW_ACCURACY_PX
                pixels[missing[is_final]] = found[is_final]
                goes_on = ~is_final & np.isfinite(step)
                missing, v = missing[goes_on], found[goes_on, 1]
                if not missing.size:
                    break
        return pixels

    def _project_lines(self, points: Array) -> Array:
        """Pixel coordinates `(n, 2)` of world points in the image of a line scanner.

        All rows are the same line at other times, so a point's row is the time at which it crosses the middle
        of the line. Newton's method finds it from time 0: first on the plane of a lens without distortion,
        which a camera that does not turn crosses linearly in time, then on the sensor.
        """
        motion, line_time_s = self.motion or Motion(), self.sensor.line_time_s
        matrix = intrinsics_matrix(self.lens, self._ray_sensor)

        def in_plane(times: Array) -> Array:
            _, y, z = motion.to_camera(self.pose, points, times).T
            return np.asarray(matrix[1, 1] * y + (matrix[1, 2] - 0.5) * z)

        def on_sensor(times: Array) -> Array:
            return self._image_points(motion.to_camera(self.pose, points, times).T)[:, 1] - 0.5

        times = _roots(in_plane, np.zeros(len(points)), line_time_s)
        times = _roots(on_sensor, times, line_time_s)
        pixels = self._image_points(motion.to_camera(self.pose, points, times).T)
        pixels[:, 1] = times / line_time_s + 0.5 * self.height
        pixels[np.isnan(pixels).any(axis=1)] = np.nan
        return pixels

    @classmethod
    def from_metadata(cls, metadata: Mapping[str, Any]) -> Camera:
        """The camera of a frame's JSON, for its geometry: values of light and electrons are placeholders.

        `project`, `pixel_directions` and `label_poses` are those of the frame's labels.

        Args:
            metadata: as `to_metadata` describes it, of the types of `CameraMetadata`.

        Raises:
            InputError: the lens has no image of this size.
            ValueError, ZeroDivisionError: a value is out of range.
        """
        lens, sensor = recorded_optics(metadata)
        motion = metadata.get("motion") or {}
        return cls(
            lens,
            sensor,
            np.asarray(metadata["pose"], dtype=float),
            exposure_s=min(sensor.line_time_s, _EXPOSURE_S) if sensor.line_scan else _EXPOSURE_S,
            motion=Motion(motion["velocity_m_s"], motion["angular_velocity_rad_s"]) if motion else None,
            labels_per_row=motion.get("labels_per_row", True),
        )

    def to_metadata(self) -> dict[str, Any]:
        """JSON-ready description; `from_metadata` reads its geometry."""
        matrix, sensor = self.intrinsics, self.sensor
        # Keys of further modes are left out where they do not apply.
        mode: dict[str, Any] = {}
        if sensor.reduction is not None:
            mode = {"reduction": float(sensor.reduction), "site_shape": list(sensor.site_shape)}
        if sensor.line_time_s > 0:
            mode["line_time_s"] = float(sensor.line_time_s)
        if sensor.line_scan:
            mode["line_scan"] = True
        if sensor.pattern == "bands":
            mode["bands"] = [band.to_json() for band in sensor.bands]
        described = {
            "pose": self.pose.tolist(),
            "fx": float(matrix[0, 0]),
            "fy": float(matrix[1, 1]),
            "cx": float(matrix[0, 2]),
            "cy": float(matrix[1, 2]),
            "principal_offset_m": list(self.lens.principal_offset_m),
            "distortion": self.lens.distortion.to_json(),
            "width": self.width,
            "height": self.height,
            "exposure_s": float(self.exposure_s),
            "f_number": float(self.lens.f_number),
            "focus_m": None if self.focus_m is None else float(self.focus_m),
            "vignetting": self.lens.vignetting is not None,
            "pattern": self.sensor.pattern,
            "binning": self.sensor.binning,
            "full_well_e": float(self.sensor.full_well_e),
            "read_noise_e": float(self.sensor.read_noise_e),
            "bits": self.sensor.bits,
            "black_level_dn": float(self.sensor.black_level_dn),
            "gain": float(self.sensor.gain),
            "lens": self.lens.name,
            "sensor": self.sensor.name,
            "flash": None if self.flash is None else self.flash.name,
            "developing": self.developing.to_metadata(),
            **mode,
        }
        if self.motion is not None and self.is_moving:
            described["motion"] = {
                "velocity_m_s": self.motion.velocity_m_s.tolist(),
                "angular_velocity_rad_s": self.motion.angular_velocity_rad_s.tolist(),
                "labels_per_row": self.labels_per_row,
            }
        return described


def _roots(
    residual: Callable[[Array], Array],
    start_s: Array,
    step_s: float,
) -> Array:
    """Times `(n,)` at which n residuals are 0, by Newton's method with differences over a step."""
    times, is_found = start_s.copy(), np.zeros(len(start_s), bool)
    for _ in range(_MOST_LINE_STEPS):
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            value = residual(times)
            change = value * step_s / (residual(times + step_s) - value)
            times = np.where(np.isfinite(change), times - change, np.nan)
            is_found |= np.abs(change) <= _ROW_ACCURACY_PX * step_s
        if (is_found | np.isnan(times)).all():
            break
    return np.where(is_found, times, np.nan)
