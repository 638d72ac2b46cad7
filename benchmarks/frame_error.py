"""CPU time and error of complete standard frames, and their ratios to another version.

Frames along the camera path of one scene are rendered with all default outputs. Their errors are taken
against two independent references of the same version, without denoiser: the product of the two differences
cancels the noise of the references. Electrons above the full well count as the full well. The squared error
of a Monte Carlo method is inversely proportional to its time, so the ratio of CPU time times squared error is
that of the times at equal error.

    python benchmarks/frame_error.py --json old.json                    # of the installed version
    PYTHONPATH=OTHER/src python benchmarks/frame_error.py --against old.json

It takes six minutes on two cores, most of them for the references.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import statistics
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import pepperscene as ps
from pepperscene.bench.image_errors import develop_codes
from pepperscene.bench.records import describe_machine, machine_info, peak_memory_mib
from pepperscene.outputs import DEFAULT_OUTPUTS
from pepperscene.render import QUALITIES

REFERENCE: Final = dataclasses.replace(QUALITIES["reference"], samples=64, soft=32, most=64)
"""Of each of the two references. Chosen: the product of the differences to them then varies by 2 %."""

TRIMMED: Final = 0.99
"""Chosen: quantile of the squared error beyond which pixels are left out of the trimmed error."""

COLUMNS: Final = ("cpu_s", "relative", "trimmed", "codes", "samples")
EQUAL_ERROR: Final = ("relative", "trimmed", "codes")

Measured = dict[str, float]


def measure_frames(
    recipe: str, indices: Sequence[int], runs: int, target: float | None, *, stray_light: bool
) -> dict[str, Any]:
    """Medians of the runs of each frame, and the peak memory of the first run."""
    frames = ps.FrameRenderer(recipe)
    views = {index: frames.recipe.plan.frame(index) for index in indices}
    renderer = ps.Renderer(frames.scene(views[indices[0]]))
    cameras = {index: frames.camera(view) for index, view in views.items()}
    if not stray_light:
        cameras = {index: without_stray_light(camera) for index, camera in cameras.items()}
    outputs = (*DEFAULT_OUTPUTS, "electrons")
    for camera in cameras.values():  # compiles kernels; the number of samples of a kernel differs
        renderer.render(camera, outputs, "standard", 0, target)
    peak_mib = peak_memory_mib()

    rendered: dict[int, list[tuple[float, ps.Frame]]] = {index: [] for index in indices}
    for run in range(runs):
        for index, camera in cameras.items():
            start = time.process_time()
            frame = renderer.render(camera, outputs, "standard", 1 + run, target)
            rendered[index].append((time.process_time() - start, frame))

    result: dict[str, Measured] = {}
    for index, camera in cameras.items():
        references = [
            renderer.render(camera, ("electrons",), REFERENCE, 1_000_000 + half)["electrons"]
            for half in range(2)
        ]
        rows = [
            {"cpu_s": cpu_s, "samples": frame.metadata["sampling"]["samples_per_pixel"]}
            | frame_errors(frame["electrons"], references, camera)
            for cpu_s, frame in rendered[index]
        ]
        result[str(index)] = {name: statistics.median(row[name] for row in rows) for name in COLUMNS}
    return {"frames": result, "peak_mib": peak_mib}


def without_stray_light(camera: ps.Camera) -> ps.Camera:
    """The camera without the stray light of its lens, which older versions do not have."""
    if not getattr(camera.developing, "stray_light", False):
        return camera
    return dataclasses.replace(camera, developing=dataclasses.replace(camera.developing, stray_light=False))


def frame_errors(electrons: NDArray[Any], references: Sequence[NDArray[Any]], camera: ps.Camera) -> Measured:
    """Root mean square errors of a frame against two references.

    "relative" is in means of the reference, "trimmed" the same without the pixels of the largest error,
    "codes" in 8-bit codes of the developed image.
    """
    well = camera.sensor.full_well_e
    image, *clipped = (np.minimum(np.asarray(part, float), well) for part in (electrons, *references))
    first, second = (image - part for part in clipped)
    products = (first * second).mean(axis=-1)
    squares = np.square(first + second).mean(axis=-1)
    kept = products[squares <= np.quantile(squares, TRIMMED)]
    mean = float(np.mean(clipped))
    codes, *converged = (develop_codes(part, camera) for part in (electrons, *references))
    in_codes = np.mean((codes - converged[0]) * (codes - converged[1]))
    return {
        "relative": _root(products.mean()) / mean,
        "trimmed": _root(kept.mean()) / mean,
        "codes": _root(in_codes),
    }


def _root(square: np.floating) -> float:
    return float(np.sqrt(max(float(square), 0.0)))


def at_equal_error(new: Measured, old: Measured, error: str) -> float:
    """Ratio of CPU time times squared error."""
    return new["cpu_s"] / old["cpu_s"] * (new[error] / old[error]) ** 2


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--recipe", default="barth2018", help="name or file (default: barth2018)")
    parser.add_argument(
        "--frames", default="125,140,155,170,185,200", help="of one scene (default: every 15th from 125 on)"
    )
    parser.add_argument("--runs", type=int, default=3, help="runs of each frame (default: 3)")
    parser.add_argument("--target", type=float, help="target error instead of that of the quality")
    parser.add_argument(
        "--no-stray-light", action="store_true", help="leave out stray light, which smooths the error"
    )
    parser.add_argument("--json", type=Path, help="file for the figures")
    parser.add_argument("--against", type=Path, help="figures of another version, for ratios")
    options = parser.parse_args()
    indices = [int(number) for number in options.frames.split(",")]
    sys.stdout.write(describe_machine(machine_info()) + "\n\n")
    measured = measure_frames(
        options.recipe, indices, options.runs, options.target, stray_light=not options.no_stray_light
    )
    if options.json:
        options.json.write_text(json.dumps(measured), encoding="utf-8")
    head = ("frame", "CPU s", "relative", "trimmed", "codes", "samples")
    sys.stdout.write(f"| {' | '.join(head)} |\n|---|{'---:|' * (len(head) - 1)}\n")
    rows = measured["frames"] | {"median": _median(measured["frames"].values())}
    for name, row in rows.items():
        sys.stdout.write(
            f"| {name} | {row['cpu_s']:.2f} | {row['relative']:.4f} | {row['trimmed']:.4f} | "
            f"{row['codes']:.2f} | {row['samples']:.2f} |\n"
        )
    sys.stdout.write(f"\nPeak memory {measured['peak_mib']:.0f} MiB.\n")
    if options.against:
        _print_ratios(measured, json.loads(options.against.read_text(encoding="utf-8")))


def _median(rows: Any) -> Measured:
    rows = list(rows)
    return {name: statistics.median(row[name] for row in rows) for name in COLUMNS}


def _print_ratios(new: dict[str, Any], old: dict[str, Any]) -> None:
    """Ratios frame by frame, and their medians."""
    names = [name for name in new["frames"] if name in old["frames"]]
    pairs = [(new["frames"][name], old["frames"][name]) for name in names]
    ratios = [
        [a["cpu_s"] / b["cpu_s"]]
        + [a[error] / b[error] for error in EQUAL_ERROR]
        + [at_equal_error(a, b, error) for error in EQUAL_ERROR]
        for a, b in pairs
    ]
    ratios.append([statistics.median(column) for column in zip(*ratios, strict=True)])
    head = ["ratio", "CPU s", *EQUAL_ERROR, *(f"CPU s at equal {error}" for error in EQUAL_ERROR)]
    sys.stdout.write(f"\n| {' | '.join(head)} |\n|---|{'---:|' * (len(head) - 1)}\n")
    for name, row in zip([*names, "median"], ratios, strict=True):
        sys.stdout.write(f"| {name} | {' | '.join(f'{value:.3f}' for value in row)} |\n")
    sys.stdout.write(f"\nPeak memory: {new['peak_mib'] / old['peak_mib']:.3f}.\n")


if __name__ == "__main__":
    main()
