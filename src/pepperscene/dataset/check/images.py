"""Checks of photographs (black, dark, overexposed, constant) and of measured values."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset.check.findings import camera_integer, camera_pose
from pepperscene.truth import saturated_share

_BLACK: Final = 2
"""Chosen: highest grey value of a black photograph, below the noise of any sensor."""
_DARK: Final = 25
"""Highest 99th percentile of the grey values of a dark photograph. The paper's camera has 21 with its lens cap
on, 22 to 25 by a hundredth of the paper's light, 29 to 45 by a thirtieth."""
_SATURATED: Final = 0.5
"""Chosen: fraction of saturated pixels; the recipe can expect less."""


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
    elif (fraction := saturated_share(photo)) > _SATURATED:
        yield "saturated", f"{fraction:.0%} of its pixels have a channel at 255"


def is_constant(image: Any) -> bool:
    """Whether an image has only one value."""
    return isinstance(image, np.ndarray) and bool((image == image.flat[0]).all())


Problem = tuple[str, NDArray[np.bool_]]
"""Description, and the pixels that it concerns."""

_LENGTH_TOLERANCE: Final = 1e-3
"""Chosen: of a unit vector; float32 leaves 1e-6."""
_TOLERANCE: Final = 1e-4
"""Chosen: of positions, in metres and as a fraction of the distance; float32 leaves 1e-6."""
_COVERAGE_TOLERANCE: Final = 8 * 2.0**-11
"""Of the sum of eight fractions in 16-bit floats, each rounded to half of 2^-10."""


def check_values(images: Mapping[str, Any], metadata: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Yield kind, output and description of the problems of a frame's measured images.

    The images, by output name, have the right type and all one size; the metadata are the frame's JSON.
    """
    sky = _sky_mask(images)
    for output, rule in _RULES.items():
        if output in images:
            # Comparisons with nan are False, as required here, and need no warning.
            with np.errstate(invalid="ignore", over="ignore"):
                for problem, pixels in rule(images[output], sky, images, metadata):
                    if pixels.any():
                        yield "value", output, f"{np.count_nonzero(pixels)} pixels {problem}"


def _sky_mask(images: Mapping[str, Any]) -> NDArray[np.bool_] | None:
    """Where no surface is hit, by the distance or else the instances; None without both."""
    if "distance" in images:
        return np.isinf(images["distance"])
    return images["instance"] == 0 if "instance" in images else None


def _check_distance(distance: Any, sky: Any, images: Mapping[str, Any], metadata: Any) -> Iterator[Problem]:
    yield "are not a number", np.isnan(distance)
    yield "have a distance of 0 or below", distance <= 0
    if "instance" not in images and np.isfinite(distance).all():
        yield "have all the same distance", np.broadcast_to(np.ptp(distance) == 0, distance.shape)


def _check_depth(depth: Any, sky: Any, images: Mapping[str, Any], metadata: Any) -> Iterator[Problem]:
    yield "are not a number", np.isnan(depth)
    yield "have a depth of 0 or below", depth <= 0
    if sky is not None:
        yield "have a depth where no surface is hit, or none where one is", np.isinf(depth) != sky
    if "distance" in images:
        # The optical axis is the shortest way to a plane across it.
        yield "have a depth beyond their distance", depth > images["distance"] * (1 + _TOLERANCE)


def _check_normal(normal: Any, sky: Any, images: Any, metadata: Any) -> Iterator[Problem]:
    length = np.sqrt(np.einsum("...k,...k", normal, normal))
    is_unit = np.abs(length - 1) <= _LENGTH_TOLERANCE
    if sky is None:
        yield "have a normal whose length is neither 1 nor 0", ~(is_unit | (length == 0))
    else:
        yield "have a normal whose length is not 1", ~is_unit & ~sky
        yield "have a normal where no surface is hit", sky & ~(length == 0)


def _check_electrons(electrons: Any, sky: Any, images: Any, metadata: Any) -> Iterator[Problem]:
    yield "have electrons that are not finite", ~np.isfinite(electrons).all(-1)
    yield "have fewer than 0 electrons", (electrons < 0).any(-1)
    if not electrons.any():
        yield "have no light at all", np.ones(electrons.shape[:2], bool)


def _check_raw(raw: Any, sky: Any, images: Any, metadata: Mapping[str, Any]) -> Iterator[Problem]:
    bits = camera_integer(metadata, "bits")
    if 0 < bits < 16:
        yield f"have a digital number above {bits} bits", raw >= 2**bits
    if raw.max() == raw.min():
        yield f"all have the digital number {raw.flat[0]}", np.ones(raw.shape, bool)


def _check_coverage(coverage: Any, sky: Any, images: Any, metadata: Any) -> Iterator[Problem]:
    fractions = coverage.astype(np.float32)
    yield "have a class fraction outside 0 to 1", ~((fractions >= 0) & (fractions <= 1)).all(-1)
    yield "have class fractions whose sum is not 1", np.abs(fractions.sum(-1) - 1) > _COVERAGE_TOLERANCE


def _check_position(
    position: Any, sky: Any, images: Mapping[str, Any], metadata: Mapping[str, Any]
) -> Iterator[Problem]:
    yield "are not a number", np.isnan(position).any(-1)
    if sky is not None:
        infinite = ~np.isfinite(position).all(-1)
        yield "have a position where no surface is hit, or none where one is", infinite != sky
    pose = camera_pose(metadata)
    if "distance" in images and pose is not None:
        distance = images["distance"]
        expected = np.sqrt(np.square(position - pose[:3, 3]).sum(-1))
        wrong = np.abs(expected - distance) > _TOLERANCE * (1 + distance)
        yield "have a position at another distance from the camera", wrong


def _check_uv(uv: Any, sky: Any, images: Any, metadata: Any) -> Iterator[Problem]:
    inside = ((uv >= -_TOLERANCE) & (uv <= 1 + _TOLERANCE)).all(-1)
    background = (uv == -1).all(-1)
    if sky is None:
        yield "have surface coordinates outside 0 to 1", ~(inside | background)
    else:
        yield "have surface coordinates outside 0 to 1", ~inside & ~sky
        yield "have surface coordinates where no surface is hit", ~background & sky


def _check_flow(flow: Any, sky: Any, images: Any, metadata: Any) -> Iterator[Problem]:
    """Flow and stereo: what is visible in the other image is inside it."""
    visible = flow[..., 2] == 1
    yield "are neither visible nor hidden", ~visible & ~(flow[..., 2] == 0)
    height, width = flow.shape[:2]
    x = np.arange(width) + 0.5 + flow[..., 0]
    y = np.arange(height)[:, None] + 0.5 + flow[..., 1]
    low, right, bottom = -_TOLERANCE, width + _TOLERANCE, height + _TOLERANCE
    inside = (x >= low) & (x <= right) & (y >= low) & (y <= bottom)
    yield "are marked as visible outside the image", visible & ~inside


_RULES: Final[Mapping[str, Callable[..., Iterator[Problem]]]] = {
    "distance": _check_distance,
    "depth_z": _check_depth,
    "normal": _check_normal,
    "electrons": _check_electrons,
    "raw": _check_raw,
    "coverage": _check_coverage,
    "position": _check_position,
    "uv": _check_uv,
    "flow": _check_flow,
    "stereo": _check_flow,
}
