"""Depth completion: from a photograph and the depth that a camera measured to the depth of every pixel.

RMSE, MAE, the relative error and the share of pixels within a factor are those of the field (Uhrig et al.
2017, "Sparsity invariant CNNs", 3DV; Sajjan et al. 2020, "ClearGrasp: 3D shape estimation of transparent
objects for manipulation", ICRA, whose factors are used here). All pixels of all frames count alike.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.errors import ArgumentError, InputError
from pepperscene.learning.tasks.depth_baselines import BASELINES, DepthMethod
from pepperscene.learning.tasks.frames import PredictionFolder, TaskSplit, open_task_frames
from pepperscene.learning.tasks.result import Score, TaskMeasure, TaskResult
from pepperscene.user_code import user_errors

DEPTH_OUTPUTS: Final = ("colour", "instance", "depth_z", "depth_sensor")
"""Outputs that the frames of a data set must have."""

FARTHEST_M: Final = 1.5
"""Chosen: the row in front of the camera; squared errors of what is farther would hide those of the crop."""

SENSOR: Final = "sensor"
"""Method of the table that leaves holes as they are."""

_MILLIMETRE: Final = 1e-3  # of a PNG file's values, as in the export rgbd_sensor

OnProgress = Callable[[int, int], None]
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


def evaluate_depth(
    folder: str | Path,
    methods: Mapping[str, DepthMethod] | None = None,
    predictions: Sequence[str | Path] = (),
    *,
    split: str | None = None,
    farthest_m: float = FARTHEST_M,
    on_progress: OnProgress | None = None,
) -> TaskResult:
    """Score methods that complete depth, and folders of predictions, on the frames of the split "test".

    Args:
        folder: a data set with the outputs `DEPTH_OUTPUTS`.
        methods: by name; None for all `BASELINES`, unless there are predictions.
        predictions: folders with `000012.npy` or `.exr`, in metres, or `.png` of 16 bits, in millimetres.
        split: as for an export, see `open_task_frames`.
        farthest_m: pixels whose exact depth is larger do not count.
        on_progress: called after each frame with the number done and of all.

    Raises:
        InputError: the data set or a prediction is not as it must be.
        SetupError: a baseline needs OpenCV.
    """
    if not (np.isfinite(farthest_m) and farthest_m > 0):
        raise ArgumentError("farthest", f"must be a distance above 0, not {farthest_m:g} m")
    folders = [PredictionFolder(Path(path)) for path in predictions]
    used = (BASELINES if not folders else {}) if methods is None else methods
    frames = open_task_frames(folder, DEPTH_OUTPUTS, split)
    names = [SENSOR, *used, *(one.name for one in folders)]
    sums = {name: np.zeros((len(REGIONS), 4 + len(FACTORS))) for name in names}
    if len(sums) < len(names):
        raise ArgumentError("predictions", f"must have names of their own, not {', '.join(names)}")

    for done, index in enumerate(frames.test.indices, start=1):
        colour, instances, truth, sensor = (frames.test.read(index, name) for name in DEPTH_OUTPUTS)
        _check_frame(frames, index, colour, truth, sensor)
        regions = depth_regions(truth, sensor, instances, farthest_m)
        seen = {name: mask & np.isfinite(sensor) for name, mask in regions.items()}
        sums[SENSOR] += _region_sums(sensor, truth, seen)
        for name, method in used.items():
            sums[name] += _region_sums(_apply(name, method, colour, sensor, regions["all"]), truth, regions)
        for one in folders:
            depth = one.read_map(index, regions["all"], png_unit=_MILLIMETRE, positive=True)
            sums[one.name] += _region_sums(depth, truth, regions)
        if on_progress is not None:
            on_progress(done, len(frames.test))
    return _result(frames, sums, farthest_m)


def _apply(
    name: str,
    method: DepthMethod,
    colour: NDArray[np.uint8],
    sensor: NDArray[np.float32],
    counted: NDArray[np.bool_],
) -> NDArray[np.floating[Any]]:
    """The depth that a method computes; raises `InputError` if it is of no use."""
    with user_errors(name):
        depth = np.asarray(method(colour, sensor.copy()))
    if depth.shape != sensor.shape or depth.dtype.kind != "f":
        problem = f"must return real numbers of the shape {sensor.shape}, not {depth.dtype} of {depth.shape}"
        raise InputError(name, problem)
    if not (np.isfinite(depth[counted]) & (depth[counted] > 0)).all():
        raise InputError(name, "must return a finite depth above 0 for each pixel that counts")
    return depth


def _region_sums(
    depth: NDArray[Any], truth: NDArray[np.float32], regions: Mapping[str, NDArray[np.bool_]]
) -> NDArray[np.float64]:
    return np.stack([error_sums(depth, truth, regions[name]) for name in REGIONS])


def _check_frame(frames: TaskSplit, index: int, *images: NDArray[Any]) -> None:
    if len({image.shape[:2] for image in images}) > 1:
        raise InputError(frames.test.dataset.frame_path(index), "has images that differ in size")
    if not np.isfinite(images[-1]).any():
        path = frames.test.dataset.path(index, "depth_sensor")
        raise InputError(path, "has no measured depth at all, from which a hole could be filled")


def _result(frames: TaskSplit, sums: Mapping[str, NDArray[np.float64]], farthest_m: float) -> TaskResult:
    others = [name for name in sums if name != SENSOR]
    reference = sums[others[0]] if others else sums[SENSOR]
    total = float(reference[0, 0])
    if total == 0:
        raise InputError(
            frames.test.dataset.folder, f"has no surface nearer than {farthest_m:g} m in its test frames"
        )
    scores = [
        Score(method, region, errors_of_sums(sums[method][REGIONS.index(region)], total))
        for region in REGIONS
        for method in sums
        if method != SENSOR or region in ("measured", "borders")
    ]
    title = f"Depth completion: {frames.title}, surfaces up to {farthest_m:g} m"
    note = f"{SENSOR}: the measured depth itself, without its holes"
    return TaskResult(
        "depth_completion", title, DEPTH_MEASURES, tuple(scores), "pixels of", (note, *frames.notes)
    )


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
