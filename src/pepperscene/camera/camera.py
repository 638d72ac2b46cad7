"""The camera: a lens in front of a sensor at a pose, with or without a flash; its rays, and its exposure."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera.flash import Flash
from pepperscene.camera.lens import Lens
from pepperscene.camera.readout import Developing
from pepperscene.camera.sensor import Sensor
from pepperscene.errors import InputError

_WIDEST_DEG: Final = 85.0
"""Field angle of an image's corner. Chosen: images of the widest lenses that keep lines straight end at 68
degrees, and a straight projection has no image at 90."""
_MAX_FOCAL_PX: Final = 1e6
"""Focal length in pixels. Chosen: rays in single precision are exact to 6e-8, a sixteenth of such a pixel,
and light waves blur it through any lens of less than half a metre."""


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera that is ready to take an image.

    Pixel coordinates (u, v) are continuous: the image spans [0, width] x [0, height], and the centre of the
    pixel in row 0 and column 0 is (0.5, 0.5). Camera axes: x right, y down, z forward.

    Attributes:
        lens, sensor: optics and photosites.
        pose: `(4, 4)` camera to world, metres.
        exposure_s: exposure time (global shutter).
        flash: the flash, or None; its pulse starts with the exposure.
        developing: the steps from electrons to the image.
        focus_m: distance of the focal plane along the optical axis from the projection centre; None makes
            everything sharp: a pinhole with the lens' light.

    Focusing changes neither the field of view nor the light. A thin lens focused at d is (1 + m) f from the
    sensor with m = f / (d - f), and its working f-number is N (1 + m). At 4 mm and 40 cm, m is 1 %: the field
    of view narrows by 1 %, which a calibrated focal length already includes, and the light decreases by 2 %,
    less than f-numbers are rounded to.
    """

    lens: Lens
    sensor: Sensor
    pose: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))
    exposure_s: float = 50e-6
    flash: Flash | None = None
    developing: Developing = field(default_factory=Developing)
    focus_m: float | None = None

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
        pose.setflags(write=False)
        object.__setattr__(self, "pose", pose)
        _check_field(self.lens, self.sensor)

    @property
    def width(self) -> int:
        """Columns of the image."""
        return self.sensor.columns

    @property
    def height(self) -> int:
        """Rows of the image."""
        return self.sensor.rows

    @property
    def intrinsics(self) -> NDArray[np.float64]:
        """`(3, 3)` pinhole matrix in image pixels."""
        return _intrinsics(self.lens, self.sensor)

    @property
    def aperture_radius_m(self) -> float:
        """Radius of the entrance pupil."""
        return self.lens.focal_length_m / (2 * self.lens.f_number)

    @property
    def flash_duty(self) -> float:
        """Fraction of the exposure during which the flash is on."""
        return 0.0 if self.flash is None else min(self.flash.pulse_s, self.exposure_s) / self.exposure_s

    def at_pose(self, pose: ArrayLike) -> Camera:
        """The same camera at another pose."""
        return dataclasses.replace(self, pose=np.asarray(pose, dtype=float))

    def ray_slopes(self) -> NDArray[np.float64]:
        """`(h + 1, w + 1, 2)` undistorted slopes (x/z, y/z) of the rays through the pixel corners.

        Read-only and shared by all cameras with this lens and sensor.
        """
        return _slopes(self.lens, self.sensor, 0.0)

    def pixel_directions(self) -> NDArray[np.float64]:
        """`(h, w, 3)` unit directions in camera axes of the rays through the pixel centres; read-only."""
        return _directions(self.lens, self.sensor)

    def project(self, points_world: ArrayLike) -> NDArray[np.float64]:
        """Pixel coordinates (u, v), `(n, 2)`, of world points `(n, 3)`, inside the image or not.

        nan for points behind the camera, and for those so far off the axis that the distortion would fold
        them back into the image.
        """
        points = np.asarray(points_world, dtype=float).reshape(-1, 3)
        x, y, z = self.pose[:3, :3].T @ (points - self.pose[:3, 3]).T
        in_front = z > 0
        depth_z = np.where(in_front, z, 1.0)
        slopes = np.stack([x / depth_z, y / depth_z], axis=-1)
        valid = in_front & (np.hypot(slopes[:, 0], slopes[:, 1]) < self.lens.distortion.fold_radius)
        slopes[~valid] = np.nan
        matrix = self.intrinsics
        with np.errstate(over="ignore", invalid="ignore"):  # points very close to the camera's plane
            return self.lens.distortion.distort(slopes) * matrix[[0, 1], [0, 1]] + matrix[:2, 2]

    def metadata(self) -> dict[str, Any]:
        """JSON-ready description."""
        matrix = self.intrinsics
        return {
            "pose": self.pose.tolist(),
            "fx": float(matrix[0, 0]),
            "fy": float(matrix[1, 1]),
            "cx": float(matrix[0, 2]),
            "cy": float(matrix[1, 2]),
            "principal_offset_m": list(self.lens.principal_offset_m),
            "distortion": dataclasses.asdict(self.lens.distortion),
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
            "developing": dataclasses.asdict(self.developing),
        }


def _intrinsics(lens: Lens, sensor: Sensor) -> NDArray[np.float64]:
    focal_px = lens.focal_length_m / sensor.pixel_pitch_m
    right, down = (length / sensor.pixel_pitch_m for length in lens.principal_offset_m)
    return np.array(
        [[focal_px, 0, sensor.columns / 2 + right], [0, focal_px, sensor.rows / 2 + down], [0, 0, 1.0]]
    )


def _sensor_slopes(lens: Lens, sensor: Sensor, u: ArrayLike, v: ArrayLike) -> NDArray[np.float64]:
    """Slopes on the sensor `(rows, columns, 2)`, distortion included, on a grid of pixel coordinates."""
    matrix = _intrinsics(lens, sensor)
    return np.asarray((np.stack(np.meshgrid(u, v), axis=-1) - matrix[:2, 2]) / matrix[[0, 1], [0, 1]])


def _undistorted_slopes(lens: Lens, sensor: Sensor, u: ArrayLike, v: ArrayLike) -> NDArray[np.float64]:
    """Undistorted slopes `(rows, columns, 2)` on a grid of pixel coordinates.

    Raises:
        InputError: the lens and the sensor do not fit together.
    """
    try:
        return lens.distortion.undistort(_sensor_slopes(lens, sensor, u, v))
    except ValueError as error:
        allowed = f"must be invertible over the whole image of {sensor.name}, but {error}"
        value = dataclasses.asdict(lens.distortion)
        raise InputError(lens.name, allowed, key="distortion", value=value) from None


@lru_cache(maxsize=8)
def _check_field(lens: Lens, sensor: Sensor) -> None:
    """Check early, on a coarse grid, the field of view, and that the distortion can be inverted.

    Raises:
        InputError: the lens and the sensor do not fit together.
    """
    value = 1e3 * lens.focal_length_m
    if (focal_px := lens.focal_length_m / sensor.pixel_pitch_m) > _MAX_FOCAL_PX:
        pitch = f"pixels of {sensor.name}, {1e6 * sensor.pixel_pitch_m:g} um wide"
        problem = f"is {focal_px:.3g} {pitch}; at most {_MAX_FOCAL_PX:g} are allowed"
        raise InputError(lens.name, problem, key="focal_length_mm", value=value)
    u, v = np.linspace(0, sensor.columns, 33), np.linspace(0, sensor.rows, 33)
    # Both on the sensor and in the scene, which differ by the distortion.
    for slopes_of in (_sensor_slopes, _undistorted_slopes):
        slopes = slopes_of(lens, sensor, u, v)
        angle = math.degrees(math.atan(float(np.linalg.norm(slopes, axis=-1).max())))
        if angle > _WIDEST_DEG:
            problem = (
                f"gives {sensor.name} a corner at {angle:.1f} degrees from the optical axis; "
                f"at most {_WIDEST_DEG:g} are allowed"
            )
            raise InputError(lens.name, problem, key="focal_length_mm", value=value)


@lru_cache(maxsize=8)
def _slopes(lens: Lens, sensor: Sensor, shift: float) -> NDArray[np.float64]:
    """Undistorted slopes on the grid of pixel corners (shift 0) or pixel centres (shift 0.5)."""
    extra = 1 if shift == 0 else 0
    u, v = np.arange(sensor.columns + extra) + shift, np.arange(sensor.rows + extra) + shift
    slopes = _undistorted_slopes(lens, sensor, u, v)
    slopes.setflags(write=False)
    return slopes


@lru_cache(maxsize=8)
def _directions(lens: Lens, sensor: Sensor) -> NDArray[np.float64]:
    slopes = _slopes(lens, sensor, 0.5)
    directions = np.concatenate([slopes, np.ones((*slopes.shape[:2], 1))], axis=-1)
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    directions.setflags(write=False)
    return directions


def relative_illumination(camera: Camera) -> NDArray[np.float64]:
    """`(h, w)` fall-off towards the image corners, 1 on the axis; 1 everywhere if it is switched off.

    Natural times mechanical vignetting. Seen at the field angle theta, the pupil is smaller by cos(theta),
    and a pixel receives light from a solid angle that is smaller by cos^3(theta), but larger where the
    distortion contracts the image: cos^4(theta) over the distortion's scale of areas, so that all light that
    enters the pupil reaches the sensor (M. Reiss, "The cos^4 law of illumination", J. Opt. Soc. Am. 35 (1945)
    283). The lens' own table is multiplied with it.
    """
    directions = camera.pixel_directions()
    if not camera.developing.falloff:
        return np.ones(directions.shape[:2])
    cosine = directions[..., 2]
    relative = cosine**4
    distortion = camera.lens.distortion
    if not distortion.is_zero:
        relative = relative / distortion.area_scale(directions[..., :2] / cosine[..., None])
    if camera.lens.vignetting is not None:
        relative = relative * camera.lens.vignetting.at(np.arccos(np.minimum(cosine, 1.0)))
    return np.asarray(relative)


def expected_electrons(signal: ArrayLike, camera: Camera) -> NDArray[np.float64]:
    """`(h, w, c)` mean photo-electrons of a photosite of each colour, before noise and saturation.

    The camera equation: under the radiance L, a lens of f-number N gives the irradiance E = L pi / (4 N^2) T
    in the middle of the sensor (far from its focal length), and less towards the corners; a photosite
    integrates it over its area and the exposure.

    Args:
        signal: `(h, w, c)` integral of L(lambda) QE_c(lambda) lambda / (h c) over wavelength: photo-electrons
            per second, square metre and steradian, averaged over the exposure; by sensor channel.
        camera: aperture, transmittance, exposure, pitch and fall-off.

    Raises:
        ValueError: the signal does not have the image's shape.
    """
    light = np.asarray(signal, dtype=float)
    lens, sensor = camera.lens, camera.sensor
    shape = (camera.height, camera.width, sensor.channels)
    if light.shape != shape:
        raise ValueError(f"a signal must have the shape {shape}, not {light.shape}")
    solid_angle = math.pi / (4 * lens.f_number**2)
    on_axis = sensor.pitch_m**2 * camera.exposure_s * solid_angle * lens.transmittance
    return light * (on_axis * relative_illumination(camera))[..., None]
