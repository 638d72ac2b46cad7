"""CPU time and error of a frame in many bands, against a frame of the colour camera.

Frames of one recipe are rendered by its camera, and by the same camera with a sensor of narrow bands in the
range of its flash, in the same light. Only `electrons` are rendered. Errors are taken against two
independent references without denoiser, as in `frame_error.py`: the product of the two differences cancels
the noise of the references. The squared error of each channel is divided by the square of its mean, and
channels are averaged. The ratio of CPU time times squared error is that of the times at equal error, if the
errors are about the same: so the bands have a target of their own.

    python benchmarks/bands.py --bands 30

It takes five minutes on two cores, most of them for the references.
"""

from __future__ import annotations

import argparse
import dataclasses
import statistics
import sys
import time
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import pepperscene as ps
from pepperscene.bench.records import describe_machine, machine_info, peak_memory_mib
from pepperscene.render import QUALITIES
from pepperscene.spectra import Spectrum

REFERENCE: Final = dataclasses.replace(QUALITIES["reference"], samples=64, soft=32, most=64, bounces=2)
"""Of each of the two references; the bounces are those of a standard frame."""
RANGE_NM: Final = (420.0, 720.0)
"""Chosen: where the flash of `barth2018`, a white LED, has at least a hundredth of its peak."""
EFFICIENCY: Final = 0.5  # of the bands at their centres; chosen, it only scales the light
TARGET: Final = 0.09
"""Of the bands. Chosen: 30 bands of `barth2018` then have the error of the colours, whose target is 0.15."""
TRIMMED: Final = 0.99  # as of `frame_error.py`

Measured = dict[str, float]


def band_camera(camera: ps.Camera, count: int) -> ps.Camera:
    """The camera with Gaussian bands side by side over `RANGE_NM`, whose half width is their distance."""
    edges = np.linspace(*RANGE_NM, count + 1)
    centres, width = 0.5 * (edges[1:] + edges[:-1]), edges[1] - edges[0]
    nm = np.arange(RANGE_NM[0] - 2 * width, RANGE_NM[1] + 2 * width, 0.5)
    curves = EFFICIENCY * np.exp(-4.0 * np.log(2.0) * ((nm - centres[:, None]) / width) ** 2)
    curves[curves < 1e-4 * EFFICIENCY] = 0.0
    binning, pitch = camera.sensor.binning, camera.sensor.pitch_m
    sensor = dataclasses.replace(
        camera.sensor,
        pattern="bands",
        quantum_efficiency=Spectrum(nm, curves),
        binning=binning,
        pitch_m=pitch,
    )
    return dataclasses.replace(camera, sensor=sensor)


def measure(
    renderer: ps.Renderer, camera: ps.Camera, runs: int, quality: str, target: float | None = None
) -> Measured:
    """Medians of the CPU time, the wall time and the errors of frames."""
    outputs = ("electrons",)
    renderer.render(camera, outputs, quality, 0, target)  # compiles kernels
    rows: list[tuple[float, float, ps.Frame]] = []
    for run in range(runs):
        start, wall = time.process_time(), time.perf_counter()
        frame = renderer.render(camera, outputs, quality, 1 + run, target)
        rows.append((time.process_time() - start, time.perf_counter() - wall, frame))
    peak_mib = peak_memory_mib()
    references = [
        renderer.render(camera, outputs, REFERENCE, 1_000_000 + half)["electrons"] for half in range(2)
    ]
    errors = [frame_errors(frame["electrons"], references, camera) for _, _, frame in rows]
    return {
        "cpu_s": statistics.median(row[0] for row in rows),
        "wall_s": statistics.median(row[1] for row in rows),
        "samples": rows[0][2].metadata["sampling"]["samples_per_pixel"],
        "peak_mib": peak_mib,
        **{name: statistics.median(error[name] for error in errors) for name in errors[0]},
    }


def frame_errors(electrons: NDArray[Any], references: Sequence[NDArray[Any]], camera: ps.Camera) -> Measured:
    """Root mean square errors in means of a channel: of all pixels, and without those of the largest."""
    # A band by itself, in double precision, so that many bands take little memory.
    squares, products = np.zeros(electrons.shape[:2]), np.zeros(electrons.shape[:2])
    for channel in range(electrons.shape[-1]):
        planes = [np.asarray(image[..., channel], float) for image in (electrons, *references)]
        image, *halves = (np.minimum(plane, camera.sensor.full_well_e) for plane in planes)
        mean = float(np.mean(halves))
        first, second = ((image - half) / mean for half in halves)
        products += first * second / electrons.shape[-1]
        squares += np.square(first + second)
    kept = products[squares <= np.quantile(squares, TRIMMED)]
    return {"relative": _root(products.mean()), "trimmed": _root(kept.mean())}


def _root(square: np.floating) -> float:
    return float(np.sqrt(max(float(square), 0.0)))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--recipe", default="barth2018", help="name or file (default: barth2018)")
    parser.add_argument("--frame", type=int, default=125, help="index of the frame (default: 125)")
    parser.add_argument("--bands", default="30", help="numbers of bands, with commas (default: 30)")
    parser.add_argument("--runs", type=int, default=3, help="runs of each frame (default: 3)")
    parser.add_argument("--quality", default="standard", help="of the frames (default: standard)")
    parser.add_argument(
        "--target-error", type=float, default=TARGET, help=f"of the bands (default: {TARGET:g})"
    )
    options = parser.parse_args()
    frames = ps.FrameRenderer(options.recipe)
    spec = frames.recipe.plan.frame(options.frame)
    renderer, camera = ps.Renderer(frames.scene(spec)), frames.camera(spec)
    sys.stdout.write(describe_machine(machine_info()) + "\n\n")
    rows = {"colours": measure(renderer, camera, options.runs, options.quality)}
    for count in (int(number) for number in options.bands.split(",")):
        banded = band_camera(camera, count)
        rows[f"{count} bands"] = measure(
            renderer, banded, options.runs, options.quality, options.target_error
        )

    head = ("frame", "CPU s", "wall s", "relative", "trimmed", "samples", "peak MiB")
    sys.stdout.write(f"| {' | '.join(head)} | ratio | at equal relative | at equal trimmed |\n")
    sys.stdout.write(f"|---|{'---:|' * (len(head) + 2)}\n")
    reference = rows["colours"]
    for name, row in rows.items():
        time_ratio = row["cpu_s"] / reference["cpu_s"]
        equal = [time_ratio * (row[error] / reference[error]) ** 2 for error in ("relative", "trimmed")]
        sys.stdout.write(
            f"| {name} | {row['cpu_s']:.2f} | {row['wall_s']:.2f} | {row['relative']:.4f} | "
            f"{row['trimmed']:.4f} | {row['samples']:.2f} | {row['peak_mib']:.0f} | {time_ratio:.2f} | "
            f"{equal[0]:.2f} | {equal[1]:.2f} |\n"
        )


if __name__ == "__main__":
    main()
