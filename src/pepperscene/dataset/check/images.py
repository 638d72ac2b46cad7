"""Photographs that cannot be right: black, hardly lit, burnt out, of one value."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset.check import findings as told

_BLACK: Final = 2
"""Chosen: no grey value of a picture is above this, which no noise of a sensor leaves."""
_DARK: Final = 25
"""Grey value that 99 of 100 values of a picture reach at most. Of the paper's camera with the lens cap on it
is 21; a hundredth of the paper's light makes 22 to 25, a thirtieth 29 to 45."""
_BURNT: Final = 0.5
"""Chosen: more than half of a picture is burnt out; where the recipe expects less, that counts."""


@dataclass(frozen=True)
class ImageTone:
    """How bright a photograph is.

    Attributes:
        mean: of all its grey values, 0 to 255.
        saturated: share of pixels with a channel at 255.
    """

    mean: float
    saturated: float


def tone(picture: NDArray[np.uint8]) -> ImageTone:
    """How bright an `(h, w, 3)` photograph is."""
    full = picture[..., 0] == 255
    for channel in range(1, picture.shape[2]):
        full |= picture[..., channel] == 255
    return ImageTone(float(picture.mean()), float(np.count_nonzero(full) / full.size))


def picture_faults(picture: NDArray[np.uint8]) -> Iterator[tuple[str, str]]:
    """Kind and description of what is wrong with an `(h, w, 3)` photograph; at most one fault."""
    values = np.bincount(picture.ravel(), minlength=256)
    there = np.flatnonzero(values)
    if there[-1] <= _BLACK:
        yield "black", f"no grey value is above {there[-1]}"
    elif len(there) == 1:
        yield "constant", f"every grey value is {there[0]}"
    elif (usual := int(np.searchsorted(values.cumsum(), 0.99 * picture.size))) <= _DARK:
        yield "dark", f"99 % of its grey values are at most {usual} of 255"
    elif (share := tone(picture).saturated) > _BURNT:
        yield "saturated", f"{share:.0%} of its pixels have a channel at 255"


def flat(image: Any) -> bool:
    """Whether an image has one value only."""
    return isinstance(image, np.ndarray) and bool((image == image.flat[0]).all())


Problem = tuple[str, NDArray[np.bool_]]
"""What is wrong, and with which pixels."""

_UNIT: Final = 1e-3
"""Chosen: how far a direction's length may be from 1; float32 leaves 1e-6."""
_NEAR: Final = 1e-4
"""Chosen: metres, and share of the distance, that a position may be off; float32 leaves 1e-6."""
_SHARES: Final = 8 * 2.0**-11
"""The sum of eight shares in 16-bit floats, each rounded to half of 2^-10."""


def value_faults(images: Mapping[str, Any], facts: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Kind, output and description of what is wrong with a frame's measured images.

    Args:
        images: the frame's, by output name, those that are there; of the right type, all of one size.
        facts: the frame's JSON.
    """
    nothing = _nothing(images)
    for output, rule in _RULES.items():
        if output in images:
            # Comparisons with nan are False, as they should be, and need no warning.
            with np.errstate(invalid="ignore", over="ignore"):
                for what, wrong in rule(images[output], nothing, images, facts):
                    if wrong.any():
                        yield "value", output, f"{np.count_nonzero(wrong)} pixels {what}"


def _nothing(images: Mapping[str, Any]) -> NDArray[np.bool_] | None:
    """Where nothing is hit, after the distance or else the instances; None where neither tells."""
    if "distance" in images:
        return np.isinf(images["distance"])
    return images["instance"] == 0 if "instance" in images else None


def _distance(distance: Any, nothing: Any, images: Mapping[str, Any], facts: Any) -> Iterator[Problem]:
    yield "are not a number", np.isnan(distance)
    yield "have a distance of 0 or below", distance <= 0
    if "instance" not in images and np.isfinite(distance).all():
        yield "have all the same distance", np.broadcast_to(np.ptp(distance) == 0, distance.shape)


def _depth(depth: Any, nothing: Any, images: Mapping[str, Any], facts: Any) -> Iterator[Problem]:
    yield "are not a number", np.isnan(depth)
    yield "have a depth of 0 or below", depth <= 0
    if nothing is not None:
        yield "have a depth where nothing is hit, or none where something is", np.isinf(depth) != nothing
    if "distance" in images:
        # The optical axis is the shortest way to a plane across it.
        yield "have a depth beyond their distance", depth > images["distance"] * (1 + _NEAR)


def _normal(normal: Any, nothing: Any, images: Any, facts: Any) -> Iterator[Problem]:
    length = np.sqrt(np.einsum("...k,...k", normal, normal))
    unit = np.abs(length - 1) <= _UNIT
    if nothing is None:
        yield "have a normal whose length is neither 1 nor 0", ~(unit | (length == 0))
    else:
        yield "have a normal whose length is not 1", ~unit & ~nothing
        yield "have a normal where nothing is hit", nothing & ~(length == 0)


def _electrons(electrons: Any, nothing: Any, images: Any, facts: Any) -> Iterator[Problem]:
    yield "have electrons that are not finite", ~np.isfinite(electrons).all(-1)
    yield "have fewer than 0 electrons", (electrons < 0).any(-1)
    if not electrons.any():
        yield "have no light at all", np.ones(electrons.shape[:2], bool)


def _raw(raw: Any, nothing: Any, images: Any, facts: Mapping[str, Any]) -> Iterator[Problem]:
    bits = told.number(facts, "bits")
    if 0 < bits < 16:
        yield f"have a number beyond {bits} bits", raw >= 2**bits
    if raw.max() == raw.min():
        yield f"all have the number {raw.flat[0]}", np.ones(raw.shape, bool)


def _coverage(coverage: Any, nothing: Any, images: Any, facts: Any) -> Iterator[Problem]:
    shares = coverage.astype(np.float32)
    yield "have a share outside 0 to 1", ~((shares >= 0) & (shares <= 1)).all(-1)
    yield "have shares whose sum is not 1", np.abs(shares.sum(-1) - 1) > _SHARES


def _position(
    position: Any, nothing: Any, images: Mapping[str, Any], facts: Mapping[str, Any]
) -> Iterator[Problem]:
    yield "are not a number", np.isnan(position).any(-1)
    if nothing is not None:
        away = ~np.isfinite(position).all(-1)
        yield "have a position where nothing is hit, or none where something is", away != nothing
    pose = told.pose(facts)
    if "distance" in images and pose is not None:
        distance = images["distance"]
        reach = np.sqrt(np.square(position - pose[:3, 3]).sum(-1))
        yield (
            "have a position at another distance from the camera",
            np.abs(reach - distance) > _NEAR * (1 + distance),
        )


def _uv(uv: Any, nothing: Any, images: Any, facts: Any) -> Iterator[Problem]:
    inside = ((uv >= -_NEAR) & (uv <= 1 + _NEAR)).all(-1)
    none = (uv == -1).all(-1)
    if nothing is None:
        yield "have surface coordinates outside 0 to 1", ~(inside | none)
    else:
        yield "have surface coordinates outside 0 to 1", ~inside & ~nothing
        yield "have surface coordinates where nothing is hit", ~none & nothing


def _shift(shift: Any, nothing: Any, images: Any, facts: Any) -> Iterator[Problem]:
    """Flow and stereo: what is visible elsewhere lies inside the picture there."""
    visible = shift[..., 2] == 1
    yield "are neither visible nor hidden", ~visible & ~(shift[..., 2] == 0)
    height, width = shift.shape[:2]
    across = np.arange(width) + 0.5 + shift[..., 0]
    down = np.arange(height)[:, None] + 0.5 + shift[..., 1]
    inside = (across >= -_NEAR) & (across <= width + _NEAR) & (down >= -_NEAR) & (down <= height + _NEAR)
    yield "are said to be visible outside the picture", visible & ~inside


_RULES: Final[Mapping[str, Callable[..., Iterator[Problem]]]] = {
    "distance": _distance,
    "depth_z": _depth,
    "normal": _normal,
    "electrons": _electrons,
    "raw": _raw,
    "coverage": _coverage,
    "position": _position,
    "uv": _uv,
    "flow": _shift,
    "stereo": _shift,
}
