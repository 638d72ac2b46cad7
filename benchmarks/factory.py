"""What the factory adds to rendering: frames in a second by one and by two workers, and what a build takes
beyond the time that its frames are rendered in.

Ratios of runs side by side, in turns, medians of several. Run it from the top of the repository on an idle
machine of at least two cores:

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
from pepperscene.bench.records import machine_info, sentence
from pepperscene.dataset import BuildProgress

TRUTH = ("class", "instance", "distance", "distance_code")


def rate(recipe: ps.Recipe, frames: Sequence[int], workers: int | None) -> float:
    """Frames in a second of a whole build of labels, the start of workers and the manifest included."""
    with tempfile.TemporaryDirectory() as folder:
        begun = time.perf_counter()
        ps.build(recipe, Path(folder) / "set", frames, TRUTH, ps.BuildOptions(workers=workers))
        return len(frames) / (time.perf_counter() - begun)


def overhead(recipe: ps.Recipe, frames: Sequence[int]) -> float:
    """What a build of colour and labels takes beyond rendering the same frames one after the other, a share.

    Both have made their scene ready with the frame before the first. A build tells of a frame once the next
    one is rendered, so that its clock begins behind the first.
    """
    outputs = ("colour", *TRUTH)
    stage = ps.FrameRenderer(recipe)
    for index in (frames[0] - 1, frames[0]):
        stage.render(recipe.plan.frame(index), outputs)
    begun = time.perf_counter()
    for index in frames[1:]:
        stage.render(recipe.plan.frame(index), outputs)
    alone = time.perf_counter() - begun
    told: list[float] = []

    def note(_: BuildProgress) -> None:
        told.append(time.perf_counter())

    with tempfile.TemporaryDirectory() as folder:
        ps.build(recipe, Path(folder) / "set", [frames[0] - 1, *frames], outputs, on_frame=note)
    return (told[-1] - told[0]) / alone - 1.0


def main() -> None:
    """Measure and print."""
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--runs", type=int, default=3, help="of each kind (default 3)")
    asked.add_argument("--scenes", type=int, default=2, help="of 250 frames each, for labels (default 2)")
    given = asked.parse_args()
    sys.stdout.write(sentence(machine_info()) + "\n\n")
    _labels(given.runs, given.scenes)
    _colour(given.runs)


def _labels(runs: int, scenes: int) -> None:
    recipe = ps.load_recipe("barth2018")
    # Scenes of different sets, as a whole build hands them out.
    per_set = recipe.plan.rotations * recipe.plan.frames
    frames = [which * per_set + step for which in range(scenes) for step in range(recipe.plan.frames)]
    # A core each, but for the last; what one core leaves of writing another one may do.
    ways: dict[str, int | None] = {"one worker": 1, "two workers": 2, "this process, all cores": None}
    found: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(runs):
        for name, workers in ways.items():
            os.environ.pop("PEPPERSCENE_THREADS", None)
            os.environ |= {} if workers is None else {"PEPPERSCENE_THREADS": "1"}
            found[name].append(rate(recipe, frames, workers))
    os.environ.pop("PEPPERSCENE_THREADS", None)
    one = found["one worker"]
    sys.stdout.write(f"| labels of {len(frames)} frames | frames/s | against one worker |\n|---|---:|---:|\n")
    for name, rates in found.items():
        ratio = statistics.median(mine / its for mine, its in zip(rates, one, strict=True))
        spread = f"{statistics.median(rates):.1f} ({min(rates):.1f} to {max(rates):.1f})"
        sys.stdout.write(f"| {name} | {spread} | {ratio:.2f} |\n")


def _colour(runs: int) -> None:
    recipe = ps.load_recipe("barth2018")
    shares = [100.0 * overhead(recipe, range(122, 134)) for _ in range(runs)]
    sys.stdout.write(
        f"\nA build of colour and labels takes {statistics.median(shares):+.1f} % "
        f"({min(shares):+.1f} to {max(shares):+.1f}) of what rendering alone takes on top.\n"
    )


if __name__ == "__main__":
    main()
