"""Checks of photographs (black, dark, overexposed, constant) and of measured values."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset.store.images import unlit_bands
from pepperscene.outputs import OUTPUTS
from pepperscene.review.check.findings import camera_centres, camera_integer
from pepperscene.truth import saturated_fraction

_BLACK: Final = 2
"""Chosen: highest grey value of a black photograph, below the noise of any sensor."""
_DARK: Final = 25
"""Highest 99th percentile of the grey values of a dark photograph. It is 21 for the paper's camera with the
lens cap on, 22 to 25 for a hundredth of the paper's light, 29 to 45 for a thirtieth."""
_SATURATED: Final = 0.5
"""Chosen: fraction of saturated pixels; the recipe can expect less."""

_LENGTH_TOLERANCE: Final = 1e-3
"""Chosen: of a unit vector; float32 leaves 1e-6."""
_TOLERANCE: Final = 1e-4
"""Chosen: of positions, in metres and as a fraction of the distance; float32 leaves 1e-6."""
_COVERAGE_TOLERANCE: Final = 8 * 2.0**-11
"""Of the sum of eight fractions in 16-bit floats, each rounded to half of 2^-10."""


def check_photo(photo: NDArray[np.uint8]) -> Iterator[tuple[str, str]]:
    """Yield kind and description of the problem of an `(h, w, 3)` photograph, at most one."""
    counts = np.bincount(photo.ravel(), minlength=256)
    values = np.flatnonzero(counts)
    if values[-1] <= _BLACK:
        yield "black", f"no grey value is above {values[-1]}"
    elif len(values) == 1:
        yield "constant", f"every grey value is {values[0]}"
    elif (percentile := int(np.searchsorted(counts.cumsum(), 0.99 * photo.size))) <= _DARK:
        yield "dark", f"99 % of its grey values are at most {percentile} of 255"
    elif (fraction := saturated_fraction(photo)) > _SATURATED:
        yield "saturated", f"{fraction:.0%} of its pixels have a channel at 255"


@dataclass(frozen=True, eq=False)
class _Content:
    """The images of a frame, by output; all that are no JSON have one size.

    Attributes:
        images: by output name.
        metadata: the frame's JSON.
        ignored: whether class fractions of a pixel may sum to less than 1.
        sky: where no surface is hit, by the distance or else the instances; None if neither is there.
    """

    images: Mapping[str, Any]
    metadata: Mapping[str, Any]
    ignored: bool
    sky: NDArray[np.bool_] | None


Problems = Iterator[tuple[str, Any]]
"""Descriptions of problems, each with the pixels `(h, w)` that it concerns."""


def check_values(
    images: Mapping[str, Any], metadata: Mapping[str, Any], *, ignored: bool = False
) -> Iterator[tuple[str, str, str]]:
    """Yield kind, output and description of the problems of a frame's measured images.

    The images, by output name, have the right type and all one size; the metadata are the frame's JSON. With
    `ignored`, class fractions of a pixel may sum to less than 1.
    """
    sky = images["instance"] == 0 if "instance" in images else None
    if "distance" in images:
        sky = np.isinf(images["distance"])
    content = _Content(images, metadata, ignored, sky)
    # Comparisons with nan are False, as required here, and need no warning.
    with np.errstate(invalid="ignore", over="ignore"):
        for output, image in images.items():
            checks = [_CHECKS[output](image, content)] if output in _CHECKS else []
            if (limits := OUTPUTS[output].limits) is not None:
                checks.append(_check_limits(image, limits, OUTPUTS[output].padding, sky))
            for problem, pixels in chain.from_iterable(checks):
                if pixels.any():
                    yield "value", output, f"{np.count_nonzero(pixels)} pixels {problem}"


def _check_limits(
    image: NDArray[Any], limits: tuple[float, float], padding: float, sky: NDArray[np.bool_] | None
) -> Problems:
    is_empty = np.isnan(image) if np.isnan(padding) else image == padding
    yield "have a value outside its range", ~is_empty & ((image < limits[0]) | (image > limits[1]))
    if sky is not None:
        yield "have a value where no surface is hit", ~is_empty & sky


def _check_distance(distance: NDArray[np.float32], content: _Content) -> Problems:
    yield "are not a number", np.isnan(distance)
    yield "have a distance of 0 or below", distance <= 0
    if "instance" not in content.images and np.isfinite(distance).all():
        yield "have all the same distance", np.full(distance.shape, np.ptp(distance) == 0)


def _check_depth(depth: NDArray[np.float32], content: _Content) -> Problems:
    yield "are not a number", np.isnan(depth)
    yield "have a depth of 0 or below", depth <= 0
    if content.sky is not None:
        problem = "have a depth where no surface is hit, or none where one is"
        yield problem, np.isinf(depth) != content.sky
    if (distance := content.images.get("distance")) is not None:
        # The optical axis is the shortest way to a plane across it.
        yield "have a depth beyond their distance", depth > distance * (1 + _TOLERANCE)


def _check_position(position: NDArray[np.float32], content: _Content) -> Problems:
    yield "are not a number", np.isnan(position).any(-1)
    if content.sky is not None:
        wrong = content.sky == np.isfinite(position).all(-1)
        yield "have a position where no surface is hit, or none where one is", wrong
    distance, centres = content.images.get("distance"), camera_centres(content.metadata, len(position))
    if distance is not None and centres is not None:
        difference = np.abs(np.sqrt(np.square(position - centres).sum(-1)) - distance)
        wrong = difference > _TOLERANCE * (1 + distance)
        yield "have a position at another distance from the camera", wrong


def _check_depth_sensor(depth: NDArray[np.float32], content: _Content) -> Problems:
    # Holes are not a number.
    yield "have a depth of 0 or below, or an infinite one", (depth <= 0) | np.isinf(depth)


def _check_depth_confidence(confidence: NDArray[np.float32], content: _Content) -> Problems:
    yield "have a confidence outside 0 to 1", ~((confidence >= 0) & (confidence <= 1))
    if (depth := content.images.get("depth_sensor")) is not None:
        yield "have a confidence where no depth is measured", np.isnan(depth) & (confidence > 0)


def _check_normal(normal: NDArray[np.float32], content: _Content) -> Problems:
    length, sky = np.sqrt(np.einsum("...k,...k", normal, normal)), content.sky
    valid = np.abs(length - 1) <= _LENGTH_TOLERANCE
    if sky is None:
        yield "have a normal whose length is neither 1 nor 0", ~(valid | (length == 0))
    else:
        yield "have a normal whose length is not 1", ~valid & ~sky
        yield "have a normal where no surface is hit", sky & ~(length == 0)


def _check_uv(uv: NDArray[np.float32], content: _Content) -> Problems:
    valid = ((uv >= -_TOLERANCE) & (uv <= 1 + _TOLERANCE)).all(-1)
    background = (uv == -1).all(-1)
    # Without the sky, the background can be anywhere.
    sky = background if content.sky is None else content.sky
    yield "have surface coordinates outside 0 to 1", ~valid & ~sky
    yield "have surface coordinates where no surface is hit", ~background & sky


def _check_coverage(coverage: NDArray[np.float16], content: _Content) -> Problems:
    fractions = coverage.astype(np.float32)
    yield "have a class fraction outside 0 to 1", ~((fractions >= 0) & (fractions <= 1)).all(-1)
    total = fractions.sum(-1)
    wrong = np.abs(total - 1) > _COVERAGE_TOLERANCE
    if content.ignored:
        # The ignored part of a pixel's area is of no class.
        wrong &= total > 1
    yield "have class fractions whose sum is not 1", wrong


def _check_electrons(electrons: NDArray[np.float32], content: _Content) -> Problems:
    yield "have electrons that are not finite", ~np.isfinite(electrons).all(-1)
    yield "have fewer than 0 electrons", (electrons < 0).any(-1)
    yield "have no light at all", np.full(electrons.shape[:2], not electrons.any())


def _check_bands(values: NDArray[np.float32], content: _Content, finite: Any = False) -> Problems:
    yield "have a value that is not finite", ~(np.isfinite(values) | finite).all(-1)
    yield "have no light at all", np.full(values.shape[:2], not values.any())


def _check_radiance(radiance: NDArray[np.float32], content: _Content) -> Problems:
    yield from _check_bands(radiance, content)
    yield "have a radiance below 0", (radiance < 0).any(-1)


def _check_reflectance(values: NDArray[np.float32], content: _Content) -> Problems:
    # Where the white reference has no light, the reflectance is not a number.
    unlit = np.isin(np.arange(values.shape[2]), unlit_bands(content.metadata))
    yield from _check_bands(values, content, np.isnan(values) & unlit)


def _check_albedo(albedo: NDArray[np.float16], content: _Content) -> Problems:
    yield "have an albedo that is not finite", ~np.isfinite(albedo).all(-1)


def _check_raw(raw: NDArray[np.uint16], content: _Content) -> Problems:
    bits = camera_integer(content.metadata, "bits")
    if 0 < bits < 16:
        yield f"have a digital number above {bits} bits", raw >= 2**bits
    yield f"all have the digital number {raw.flat[0]}", np.full(raw.shape, raw.max() == raw.min())


def _check_flow(flow: NDArray[np.float32], content: _Content) -> Problems:
    """Pixels that are visible in the other image must be inside it."""
    visible = flow[..., 2] == 1
    yield "are neither visible nor hidden", ~visible & ~(flow[..., 2] == 0)
    height, width = visible.shape
    x = np.arange(width) + 0.5 + flow[..., 0]
    y = np.arange(height)[:, None] + 0.5 + flow[..., 1]
    inside = (x >= -_TOLERANCE) & (x <= width + _TOLERANCE)
    inside &= (y >= -_TOLERANCE) & (y <= height + _TOLERANCE)
    yield "are marked as visible outside the image", visible & ~inside


_CHECKS: Final[Mapping[str, Callable[[Any, _Content], Problems]]] = {
    "distance": _check_distance,
    "depth_z": _check_depth,
    "position": _check_position,
    "depth_sensor": _check_depth_sensor,
    "depth_confidence": _check_depth_confidence,
    "normal": _check_normal,
    "uv": _check_uv,
    "coverage": _check_coverage,
    "electrons": _check_electrons,
    "bands": _check_bands,
    "radiance": _check_radiance,
    "reflectance": _check_reflectance,
    "albedo": _check_albedo,
    "raw": _check_raw,
    "flow": _check_flow,
    "stereo": _check_flow,
}
"""What is checked of an output beyond `Output.limits`."""
