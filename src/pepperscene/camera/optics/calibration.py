"""Calibrated intrinsics in OpenCV's convention, and their files: ROS camera_info and OpenCV FileStorage."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, cast

from pepperscene.camera.optics.distortion import MODELS, LensModel, make_distortion
from pepperscene.camera.optics.lens import FY_OVER_FX, Lens
from pepperscene.document import read_text
from pepperscene.errors import InputError

_MOST_NODES: Final = 100_000  # chosen: with those of aliases; calibrations with all views have 20,000
LARGEST_SIDE: Final = 20_000  # pixels; chosen: as of sensor files
FOCAL_PX: Final = (1.0, 1e6)
"""Chosen: with the least, a pixel next to the axis is 45 degrees off it; the most is that of `pixel_rays`."""
LARGEST_OFFSET_PX: Final = 100_000.0  # of the principal point; chosen: five times the largest side
LARGEST_COEFFICIENT: Final = 1e5  # chosen: rational models of narrow lenses have some thousands
CENTRE_OF_FIRST_PIXEL: Final = 0.5
"""Pixel coordinate of the first pixel's centre here; OpenCV and ROS count it as 0."""

# Names of the same value in camera_info files, messages of ROS 1 and 2, OpenCV's samples and older versions.
_KEYS: Final = {
    "width": ("image_width", "image_Width", "width"),
    "height": ("image_height", "image_Height", "height"),
    "matrix": ("camera_matrix", "Camera_Matrix", "cameraMatrix", "K", "k", "M1"),
    "distortion": (
        "distortion_coefficients", "Distortion_Coefficients", "distCoeffs", "dist_coeffs", "D", "d", "D1",
    ),
    "model": ("distortion_model",),
    "fisheye": ("fisheye_model",),
}  # fmt: skip
_ALIASES: Final = {"fisheye": "equidistant", "kannala_brandt": "equidistant"}
_BY_COUNT: Final[dict[int, LensModel]] = {
    0: "plumb_bob", 4: "plumb_bob", 5: "plumb_bob",
    8: "rational_polynomial", 12: "rational_polynomial", 14: "rational_polynomial",
}  # fmt: skip
"""OpenCV's model by its number of coefficients; those from the ninth on (thin prism, tilt) must be 0."""


@dataclass(frozen=True)
class CameraCalibration:
    """Intrinsics of a camera in OpenCV's convention: the centre of the upper left pixel is at (0, 0).

    Attributes:
        width, height: of the image, pixels.
        fx, fy: focal lengths, pixels.
        cx, cy: principal point, pixels.
        model: of the distortion.
        coefficients: in the order of `MODELS[model]`; missing ones are 0.

    Raises:
        ValueError: a number is not finite or out of range, or there are too many coefficients.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    model: LensModel = "plumb_bob"
    coefficients: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if not (1 <= self.width <= LARGEST_SIDE and 1 <= self.height <= LARGEST_SIDE):
            size = f"{self.width} x {self.height}"
            raise ValueError(f"an image of {size} must be 1 x 1 to {LARGEST_SIDE} x {LARGEST_SIDE} pixels")
        _check_range("fx", self.fx, *FOCAL_PX, "pixels")
        _check_range("fy", self.fy, *FOCAL_PX, "pixels")
        if not FY_OVER_FX[0] <= self.fy / self.fx <= FY_OVER_FX[1]:
            raise ValueError(f"fy = {self.fy:g} must be {FY_OVER_FX[0]:g} to {FY_OVER_FX[1]:g} times fx")
        _check_range("cx", self.cx, -LARGEST_OFFSET_PX, LARGEST_OFFSET_PX, "pixels")
        _check_range("cy", self.cy, -LARGEST_OFFSET_PX, LARGEST_OFFSET_PX, "pixels")
        if self.model not in MODELS:
            raise ValueError(f"distortion_model = {self.model!r} must be one of {', '.join(MODELS)}")
        check_coefficients(self.model, self.coefficients)

    def lens(self, name: str, pixel_pitch_m: float, f_number: float, transmittance: float) -> Lens:
        """The thin lens of this calibration in front of pixels of this pitch."""
        right = self.cx + CENTRE_OF_FIRST_PIXEL - self.width / 2
        down = self.cy + CENTRE_OF_FIRST_PIXEL - self.height / 2
        return Lens(
            name=name,
            focal_length_m=self.fx * pixel_pitch_m,
            f_number=f_number,
            transmittance=transmittance,
            distortion=make_distortion(self.model, self.coefficients),
            principal_offset_m=(right * pixel_pitch_m, down * pixel_pitch_m),
            fy_over_fx=self.fy / self.fx,
        )

    def to_json(self) -> dict[str, Any]:
        """JSON-ready values by name."""
        return {**asdict(self), "coefficients": list(self.coefficients)}


def pinhole_calibration(width: int, height: int, hfov_deg: float) -> CameraCalibration:
    """An image without distortion whose whole width has this horizontal field of view."""
    focal_px = width / 2 / math.tan(math.radians(hfov_deg) / 2)
    centre = (width / 2 - CENTRE_OF_FIRST_PIXEL, height / 2 - CENTRE_OF_FIRST_PIXEL)
    return CameraCalibration(width, height, focal_px, focal_px, *centre)


def check_coefficients(model: LensModel, coefficients: Sequence[float]) -> None:
    """Raise ValueError unless these are coefficients of the model; "plumb_bob" may leave out k3."""
    names = MODELS[model]
    numbers = {len(names)} | ({0, 4} if model == "plumb_bob" else {0})
    if len(coefficients) not in numbers:
        optional = " (k3 may be left out)" if model == "plumb_bob" else ""
        allowed = f"must be the {len(names)} numbers {', '.join(names)}{optional} of {model}"
        raise ValueError(f"distortion {allowed}, not {len(coefficients)}")
    for name, value in zip(names, coefficients, strict=False):
        _check_range(f"the distortion's {name}", value, -LARGEST_COEFFICIENT, LARGEST_COEFFICIENT)


def _check_range(name: str, value: float, low: float, high: float, unit: str = "") -> None:
    if not low <= value <= high:
        raise ValueError(f"{name} = {value:g} must be {low:g} to {high:g} {unit}".rstrip())


def read_calibration(path: str | Path) -> CameraCalibration:
    """Read a camera_info YAML file of ROS or a FileStorage YAML file of OpenCV.

    Raises:
        InputError: the file is missing or not such a file, or a value is missing or out of range; the message
            names file, key and value.
    """
    path = Path(path)
    content = _read_yaml(path)
    width, height = (_whole_number(content, name, path) for name in ("width", "height"))
    fx, skew, cx, zero, fy, cy, *last = _numbers(content, "matrix", path, count=9)
    key, _ = _find(content, "matrix", path)
    if (skew, zero, *last) != (0, 0, 0, 0, 1):
        allowed = "must be [fx, 0, cx, 0, fy, cy, 0, 0, 1] by rows: without skew"
        raise InputError(path, allowed, key=key)
    coefficients = _numbers(content, "distortion", path) if _has(content, "distortion") else []
    model = _model(content, coefficients, path)
    # Thin prism and tilt follow the rational model; without them the model is the same.
    while len(coefficients) > len(MODELS[model]) and coefficients[-1] == 0:
        coefficients.pop()
    try:
        return CameraCalibration(width, height, fx, fy, cx, cy, model, tuple(coefficients))
    except ValueError as error:
        raise InputError(path, str(error)) from None


def _read_yaml(path: Path) -> dict[str, Any]:
    """The keys of a YAML file; OpenCV's files have a first line and a tag that standard YAML does not."""
    import yaml

    class Loader(yaml.SafeLoader):
        pass

    Loader.add_constructor(
        "tag:yaml.org,2002:opencv-matrix", lambda loader, node: loader.construct_mapping(node, deep=True)
    )
    text = read_text(path, "calibration")
    if text.startswith("%YAML:"):
        text = "#" + text
    try:
        loader = Loader(text)
        # Messages that ROS prints end with "---", as if another document followed.
        root = loader.get_node() if loader.check_node() else None
        if root is not None and _count_nodes(root, {}) > _MOST_NODES:
            raise InputError(path, f"has more than {_MOST_NODES:,} values, those of aliases included")
        content = None if root is None else loader.construct_document(root)
    except (yaml.YAMLError, ValueError, LookupError, AttributeError, RecursionError) as error:
        # PyYAML has errors of its own for the syntax, but not for values that do not fit their tag.
        mark = getattr(error, "problem_mark", None)
        where = f" at line {mark.line + 1}" if mark is not None else ""
        raise InputError(path, f"is not valid YAML{where}") from None
    if not isinstance(content, dict):
        raise InputError(path, "must be a calibration: image_width, image_height, camera_matrix and so on")
    return content


def _count_nodes(node: Any, known: dict[int, int]) -> int:
    """The number of values below a node of YAML, where an alias counts as often as it occurs."""
    if id(node) not in known:
        # A node that contains itself never ends.
        known[id(node)] = _MOST_NODES + 1
        children = node.value if isinstance(node.value, list) else []
        parts = (part for child in children for part in (child if isinstance(child, tuple) else (child,)))
        known[id(node)] = 1 + sum(_count_nodes(part, known) for part in parts)
    return known[id(node)]


def _has(content: Mapping[str, Any], name: str) -> bool:
    return any(key in content for key in _KEYS[name])


def _find(content: Mapping[str, Any], name: str, path: Path) -> tuple[str, Any]:
    """A value under one of its keys, and the key."""
    for key in _KEYS[name]:
        if key in content:
            return key, content[key]
    raise InputError(path, "is required but missing", key=_KEYS[name][0])


def _whole_number(content: Mapping[str, Any], name: str, path: Path) -> int:
    key, value = _find(content, name, path)
    number = _number(value)
    if number is None or not number.is_integer():
        raise InputError(path, "must be a whole number", key=key, value=value)
    return int(number)


def _numbers(content: Mapping[str, Any], name: str, path: Path, count: int | None = None) -> list[float]:
    """The numbers of a matrix: its `data`, a list, or a list of rows."""
    key, value = _find(content, name, path)
    values = value.get("data") if isinstance(value, dict) else value
    if isinstance(values, list) and all(isinstance(row, list) for row in values):
        values = [number for row in values for number in row]
    numbers = [_number(each) for each in values] if isinstance(values, list) else [None]
    if None in numbers or (count is not None and len(numbers) != count):
        allowed = f"must hold {'' if count is None else f'{count} '}finite numbers"
        raise InputError(path, allowed, key=key)
    return cast(list[float], numbers)


def _number(value: Any) -> float | None:
    """A finite number; YAML 1.1 reads "1e-3" as text."""
    try:
        number = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


def _model(content: Mapping[str, Any], coefficients: Sequence[float], path: Path) -> LensModel:
    """The model that the file names; without a name, OpenCV's by the number of coefficients."""
    if _has(content, "model"):
        key, value = _find(content, "model", path)
        name = _ALIASES.get(value, value) if isinstance(value, str) else value
        if name in ("", "none", None) and not any(coefficients):
            return "plumb_bob"
        if not isinstance(name, str) or name not in MODELS:
            raise InputError(path, f"must be one of {', '.join(MODELS)}", key=key, value=value)
        return name
    if _has(content, "fisheye") and _find(content, "fisheye", path)[1] in (1, True):
        return "equidistant"
    if len(coefficients) not in _BY_COUNT:
        key, _ = _find(content, "distortion", path)
        counts = ", ".join(str(count) for count in _BY_COUNT)
        raise InputError(path, f"must hold {counts} numbers, not {len(coefficients)}", key=key)
    return _BY_COUNT[len(coefficients)]
