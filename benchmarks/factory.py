"""Build throughput: frames per second with one and two workers, and the overhead of a build over rendering.

Medians of several runs, interleaved. Run it from the top of the repository on an idle machine with at least
two cores:

    python benchmarks/factory.py
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import pepperscene as ps
from pepperscene.bench.records import describe_machine, machine_info
from pepperscene.building.execution.build import BuildProgress

TRUTH = ("class", "instance", "distance", "distance_code")


def build_rate(
    recipe: ps.Recipe, frames: Sequence[int], outputs: Sequence[str], workers: int | None
) -> float:
    """Frames per second of a complete build, including the start of workers and the manifest."""
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        ps.build(recipe, Path(folder) / "set", frames, outputs, ps.BuildOptions(workers=workers))
        return len(frames) / (time.perf_counter() - start)


def build_overhead(recipe: ps.Recipe, frames: Sequence[int]) -> float:
    """Overhead of a build of colour and labels over rendering the same frames in sequence, as a fraction.

    Both build the scene with an extra frame before the first. A build reports a frame when the next one is
    rendered, so its clock starts after the first.
    """
    outputs = ("colour", *TRUTH)
    renderer = ps.FrameRenderer(recipe)
    for index in (frames[0] - 1, frames[0]):
        renderer.render(recipe.plan.frame(index), outputs)
    start = time.perf_counter()
    for index in frames[1:]:
        renderer.render(recipe.plan.frame(index), outputs)
    render_s = time.perf_counter() - start
    times: list[float] = []

    def on_frame(_: BuildProgress) -> None:
        times.append(time.perf_counter())

    with tempfile.TemporaryDirectory() as folder:
        ps.build(recipe, Path(folder) / "set", [frames[0] - 1, *frames], outputs, on_frame=on_frame)
    return (times[-1] - times[0]) / render_s - 1.0


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=3, help="runs of each kind (default: 3)")
    parser.add_argument("--scenes", type=int, default=2, help="scenes of each build (default: 2)")
    parser.add_argument(
        "--colour-frames", type=int, default=40, help="frames of a scene with photographs (default: 40)"
    )
    options = parser.parse_args()
    sys.stdout.write(describe_machine(machine_info()) + "\n\n")
    _measure_workers("labels", TRUTH, options.runs, options.scenes, 250)
    photographs = ("colour", *TRUTH)
    _measure_workers(
        "photographs and labels", photographs, options.runs, options.scenes, options.colour_frames
    )
    _measure_overhead(options.runs)


def _measure_workers(what: str, outputs: Sequence[str], runs: int, scenes: int, steps: int) -> None:
    recipe = ps.load_recipe("barth2018")
    # Scenes of different sets, as a complete build distributes them.
    per_set = recipe.plan.rotations * recipe.plan.frames
    frames = [number * per_set + step for number in range(scenes) for step in range(steps)]
    # One core for each worker; the last has all cores.
    configurations: dict[str, int | None] = {
        "one worker": 1,
        "two workers": 2,
        "this process, all cores": None,
    }
    measured: dict[str, list[float]] = {name: [] for name in configurations}
    for _ in range(runs):
        for name, workers in configurations.items():
            os.environ.pop("PEPPERSCENE_THREADS", None)
            os.environ |= {} if workers is None else {"PEPPERSCENE_THREADS": "1"}
            measured[name].append(build_rate(recipe, frames, outputs, workers))
    os.environ.pop("PEPPERSCENE_THREADS", None)
    one_worker = measured["one worker"]
    sys.stdout.write(
        f"\n| {what} of {len(frames)} frames | frames/s | relative to one worker |\n|---|---:|---:|\n"
    )
    for name, rates in measured.items():
        ratio = statistics.median(a / b for a, b in zip(rates, one_worker, strict=True))
        spread = f"{statistics.median(rates):.3g} ({min(rates):.3g} to {max(rates):.3g})"
        sys.stdout.write(f"| {name} | {spread} | {ratio:.2f} |\n")


def _measure_overhead(runs: int) -> None:
    recipe = ps.load_recipe("barth2018")
    overheads = [100.0 * build_overhead(recipe, range(122, 134)) for _ in range(runs)]
    sys.stdout.write(
        f"\nA build of colour and labels takes {statistics.median(overheads):+.1f} % "
        f"({min(overheads):+.1f} to {max(overheads):+.1f}) longer than rendering alone.\n"
    )


if __name__ == "__main__":
    main()
