"""Checks of photographs (black, dark, overexposed, constant) and of measured values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset.store.band_channels import unlit_bands
from pepperscene.frame import BAND_OUTPUTS, TRAIT_OUTPUTS
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
_MOST: Final = {"ripeness": 1.0, "leaf_age": 1.0}
"""Greatest values of traits of tissue that have one."""
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


Problem = tuple[str, str, NDArray[np.bool_]]
"""Output, description, and the pixels that it concerns."""


def check_values(
    images: Mapping[str, Any], metadata: Mapping[str, Any], *, ignored: bool = False
) -> Iterator[tuple[str, str, str]]:
    """Yield kind, output and description of the problems of a frame's measured images.

    The images, by output name, have the right type and all one size; the metadata are the frame's JSON. With
    `ignored`, class fractions of a pixel may sum to less than 1.
    """
    # Where no surface is hit, by the distance or else the instances.
    sky = images["instance"] == 0 if "instance" in images else None
    if "distance" in images:
        sky = np.isinf(images["distance"])
    # Comparisons with nan are False, as required here, and need no warning.
    with np.errstate(invalid="ignore", over="ignore"):
        surfaces = partial(_check_surfaces, ignored=ignored)
        checks = (_check_distances, _check_measured_depth, surfaces, _check_traits, _check_light, _check_flow)
        for check in checks:
            for output, problem, pixels in check(images, sky, metadata):
                if pixels.any():
                    yield "value", output, f"{np.count_nonzero(pixels)} pixels {problem}"


def _check_distances(images: Mapping[str, Any], sky: Any, metadata: Mapping[str, Any]) -> Iterator[Problem]:
    distance, depth, position = (images.get(name) for name in ("distance", "depth_z", "position"))
    if distance is not None:
        yield "distance", "are not a number", np.isnan(distance)
        yield "distance", "have a distance of 0 or below", distance <= 0
        if "instance" not in images and np.isfinite(distance).all():
            yield "distance", "have all the same distance", np.full(distance.shape, np.ptp(distance) == 0)
    if depth is not None:
        yield "depth_z", "are not a number", np.isnan(depth)
        yield "depth_z", "have a depth of 0 or below", depth <= 0
        if sky is not None:
            yield (
                "depth_z",
                "have a depth where no surface is hit, or none where one is",
                np.isinf(depth) != sky,
            )
        if distance is not None:
            # The optical axis is the shortest way to a plane across it.
            yield "depth_z", "have a depth beyond their distance", depth > distance * (1 + _TOLERANCE)
    if position is not None:
        yield "position", "are not a number", np.isnan(position).any(-1)
        if sky is not None:
            wrong = sky == np.isfinite(position).all(-1)
            yield "position", "have a position where no surface is hit, or none where one is", wrong
        if distance is not None and (centres := camera_centres(metadata, len(distance))) is not None:
            difference = np.abs(np.sqrt(np.square(position - centres).sum(-1)) - distance)
            wrong = difference > _TOLERANCE * (1 + distance)
            yield "position", "have a position at another distance from the camera", wrong


def _check_measured_depth(
    images: Mapping[str, Any], sky: Any, metadata: Mapping[str, Any]
) -> Iterator[Problem]:
    depth, confidence = (images.get(name) for name in ("depth_sensor", "depth_confidence"))
    if depth is not None:
        # Holes are not a number.
        yield "depth_sensor", "have a depth of 0 or below, or an infinite one", (depth <= 0) | np.isinf(depth)
    if confidence is not None:
        wrong = ~((confidence >= 0) & (confidence <= 1))
        yield "depth_confidence", "have a confidence outside 0 to 1", wrong
        if depth is not None:
            wrong = np.isnan(depth) & (confidence > 0)
            yield "depth_confidence", "have a confidence where no depth is measured", wrong


def _check_surfaces(
    images: Mapping[str, Any], sky: Any, metadata: Mapping[str, Any], *, ignored: bool = False
) -> Iterator[Problem]:
    if "normal" in images:
        length = np.sqrt(np.einsum("...k,...k", images["normal"], images["normal"]))
        valid = np.abs(length - 1) <= _LENGTH_TOLERANCE
        if sky is None:
            yield "normal", "have a normal whose length is neither 1 nor 0", ~(valid | (length == 0))
        else:
            yield "normal", "have a normal whose length is not 1", ~valid & ~sky
            yield "normal", "have a normal where no surface is hit", sky & ~(length == 0)
    if "uv" in images:
        uv = images["uv"]
        valid = ((uv >= -_TOLERANCE) & (uv <= 1 + _TOLERANCE)).all(-1)
        background = (uv == -1).all(-1)
        if sky is None:
            yield "uv", "have surface coordinates outside 0 to 1", ~(valid | background)
        else:
            yield "uv", "have surface coordinates outside 0 to 1", ~valid & ~sky
            yield "uv", "have surface coordinates where no surface is hit", ~background & sky
    if "coverage" in images:
        fractions = images["coverage"].astype(np.float32)
        valid = ((fractions >= 0) & (fractions <= 1)).all(-1)
        yield "coverage", "have a class fraction outside 0 to 1", ~valid
        total = fractions.sum(-1)
        wrong = np.abs(total - 1) > _COVERAGE_TOLERANCE
        if ignored:
            # The ignored part of a pixel's area is of no class.
            wrong &= total > 1
        yield "coverage", "have class fractions whose sum is not 1", wrong


def _check_traits(images: Mapping[str, Any], sky: Any, metadata: Mapping[str, Any]) -> Iterator[Problem]:
    for output in sorted(TRAIT_OUTPUTS & images.keys()):
        # Where a surface has no such trait, the value is not a number.
        image, most = images[output], _MOST.get(output, np.finfo(np.float32).max)
        yield output, "have a value outside its range", (image < 0) | (image > most)
        if sky is not None:
            yield output, "have a value where no surface is hit", ~np.isnan(image) & sky


def _check_light(images: Mapping[str, Any], sky: Any, metadata: Mapping[str, Any]) -> Iterator[Problem]:
    if "electrons" in images:
        electrons = images["electrons"]
        yield "electrons", "have electrons that are not finite", ~np.isfinite(electrons).all(-1)
        yield "electrons", "have fewer than 0 electrons", (electrons < 0).any(-1)
        yield "electrons", "have no light at all", np.full(electrons.shape[:2], not electrons.any())
    for output in sorted(BAND_OUTPUTS.intersection(images)):
        values = images[output]
        finite = np.isfinite(values)
        if output == "reflectance":
            # Where the white reference has no light, the reflectance is not a number.
            finite |= np.isnan(values) & np.isin(np.arange(values.shape[2]), unlit_bands(metadata))
        yield output, "have a value that is not finite", ~finite.all(-1)
        yield output, "have no light at all", np.full(values.shape[:2], not values.any())
    if "radiance" in images:
        yield "radiance", "have a radiance below 0", (images["radiance"] < 0).any(-1)
    if "albedo" in images:
        yield "albedo", "have an albedo that is not finite", ~np.isfinite(images["albedo"]).all(-1)
    if "raw" in images:
        raw, bits = images["raw"], camera_integer(metadata, "bits")
        if 0 < bits < 16:
            yield "raw", f"have a digital number above {bits} bits", raw >= 2**bits
        constant = np.full(raw.shape, raw.max() == raw.min())
        yield "raw", f"all have the digital number {raw.flat[0]}", constant


def _check_flow(images: Mapping[str, Any], sky: Any, metadata: Mapping[str, Any]) -> Iterator[Problem]:
    """Pixels that are visible in the other image must be inside it."""
    for output in ("flow", "stereo"):
        if output in images:
            flow = images[output]
            visible = flow[..., 2] == 1
            yield output, "are neither visible nor hidden", ~visible & ~(flow[..., 2] == 0)
            height, width = visible.shape
            x = np.arange(width) + 0.5 + flow[..., 0]
            y = np.arange(height)[:, None] + 0.5 + flow[..., 1]
            inside = (x >= -_TOLERANCE) & (x <= width + _TOLERANCE)
            inside &= (y >= -_TOLERANCE) & (y <= height + _TOLERANCE)
            yield output, "are marked as visible outside the image", visible & ~inside
