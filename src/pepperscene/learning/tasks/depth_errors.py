"""Errors of completed depth: the measures of the field, in regions of the image.

RMSE, MAE, the relative error and the share of pixels within a factor are those of depth completion (Uhrig et
al. 2017, "Sparsity invariant CNNs", 3DV; Sajjan et al. 2020, "ClearGrasp: 3D shape estimation of transparent
objects for manipulation", ICRA, whose factors are used here). All pixels of all frames count alike.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.learning.tasks.result import TaskMeasure

FloatArray = NDArray[np.float64]
Mask = NDArray[np.bool_]

FACTORS: Final = (1.05, 1.10, 1.25)
"""The ratio of prediction and truth, or its inverse, is below these in accurate pixels."""

REGIONS: Final = ("all", "holes", "measured", "borders")

BORDER_PX: Final = 3
"""Pixels up to this number of steps from another organ are at a border. Chosen: a stereo block of 7 pixels
covers both organs there."""

DEPTH_MEASURES: Final = (
    TaskMeasure("share", "pixels, %", 1, 100.0),
    TaskMeasure("rmse_mm", "RMSE, mm"),
    TaskMeasure("mae_mm", "MAE, mm"),
    TaskMeasure("rel", "REL, %", 2, 100.0),
    *(TaskMeasure(f"within_{factor:.2f}", f"δ {factor:.2f}, %", 1, 100.0) for factor in FACTORS),
)

SUMS: Final = 4 + len(FACTORS)


def error_sums(prediction: NDArray[Any], truth: NDArray[Any], mask: Mask) -> FloatArray:
    """`(7,)` sums over the pixels of a mask: their number, squared error, absolute error, relative error, and
    the numbers of pixels within each of `FACTORS`.

    Args:
        prediction: `(h, w)` metres, above 0 where the mask is.
        truth: `(h, w)` metres, finite and above 0 where the mask is.
        mask: `(h, w)` pixels that count.
    """
    estimate, exact = prediction[mask].astype(np.float64), truth[mask].astype(np.float64)
    error = estimate - exact
    ratio = np.maximum(estimate / exact, exact / estimate)
    within = [float(np.count_nonzero(ratio < factor)) for factor in FACTORS]
    sums = [float(len(error)), float((error**2).sum()), float(np.abs(error).sum())]
    return np.array([*sums, float((np.abs(error) / exact).sum()), *within])


def errors_of_sums(sums: FloatArray, total: float) -> dict[str, float]:
    """The measures by name, of sums over all frames; nan if there is no pixel.

    Args:
        sums: `(7,)` of one region.
        total: number of pixels of all regions.
    """
    count = float(sums[0])
    if count == 0.0:
        return {one.name: 0.0 if one.name == "share" else float("nan") for one in DEPTH_MEASURES}
    squared, absolute, relative, *within = (sums[1:] / count).tolist()
    return {
        "share": count / total,
        "rmse_mm": 1e3 * float(np.sqrt(squared)),
        "mae_mm": 1e3 * absolute,
        "rel": relative,
        **{f"within_{factor:.2f}": share for factor, share in zip(FACTORS, within, strict=True)},
    }


def depth_regions(
    truth: NDArray[np.float32],
    sensor: NDArray[np.float32],
    instances: NDArray[np.integer[Any]],
    farthest_m: float,
) -> dict[str, Mask]:
    """The pixels `(h, w)` of each of `REGIONS`.

    Args:
        truth: exact depth, metres; inf for the background.
        sensor: measured depth, metres; nan for holes.
        instances: number of the organ at each pixel.
        farthest_m: pixels beyond do not count.
    """
    counted = np.isfinite(truth) & (truth > 0) & (truth <= farthest_m)
    hole = ~np.isfinite(sensor)
    border = organ_borders(instances)
    return dict(zip(REGIONS, (counted, counted & hole, counted & ~hole, counted & border), strict=True))


def organ_borders(instances: NDArray[np.integer[Any]], width_px: int = BORDER_PX) -> Mask:
    """`(h, w)` pixels up to some steps, right, left, up or down, from a pixel of another organ."""
    from scipy import ndimage

    border = np.zeros(instances.shape, bool)
    across, down = instances[:, 1:] != instances[:, :-1], instances[1:] != instances[:-1]
    border[:, 1:] |= across
    border[:, :-1] |= across
    border[1:] |= down
    border[:-1] |= down
    return np.asarray(ndimage.binary_dilation(border, iterations=width_px - 1) if width_px > 1 else border)
