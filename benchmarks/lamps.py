"""Cost of many lamps: error and time of a frame under 1 and under 40 lamps of the same total flux.

Both are measured in one run.

    python benchmarks/lamps.py [--plants 3] [--size 240x180] [--runs 3]

The error is the root mean square difference of electrons to a frame with many samples, over the mean. Cost at
equal error is time times the square of the error: it falls as the number of samples rises.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.recipe.resolve.load import resolve_recipe
from pepperscene.render import Quality, Renderer

REFERENCE = Quality(samples=512, soft=512, most=512, bounces=2, target=None, denoise=False, most_bounces=64)
PLACE = {"lamp": "led_panel_600mm", "position_mm": [0, -600, 4500]}
GRIDS = {
    "1 lamp": {**PLACE, "flux_lm": 400_000},
    "40 lamps": {**PLACE, "flux_lm": 10_000, "count": [8, 5], "spacing_mm": [500, 400]},
}


def renderer(lamps: dict[str, object], plants: int, size: tuple[int, int]) -> tuple[Renderer, object]:
    """The renderer of the first scene of `barth2018` at night, and its camera."""
    changes = {
        "lamps": [lamps],
        "daylight.illuminance_lx": 0,
        "camera.flash": "none",
        "camera.exposure_us": 2000,
        "camera.width": size[0],
        "camera.height": size[1],
        "developing.white_balance": "daylight",
        "row.plants_front": plants,
        "row.plants_back": 0,
    }
    frames = FrameRenderer(resolve_recipe("barth2018", changes))
    spec = frames.recipe.plan.frame(125)
    return Renderer(frames.scene(spec)), frames.camera(spec)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plants", type=int, default=3)
    parser.add_argument("--size", default="240x180")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--quality", default="standard")
    options = parser.parse_args()
    width, height = (int(part) for part in options.size.split("x"))
    costs = []
    print(f"{'':10}{'time, s':>10}{'error, %':>10}{'time x error^2':>16}")
    for name, lamps in GRIDS.items():
        made, camera = renderer(lamps, options.plants, (width, height))
        true = made.render(camera, ["electrons"], REFERENCE, seed=99)["electrons"].astype(float)
        made.render(camera, ["electrons"], options.quality)  # compiles
        times, errors = [], []
        for seed in range(options.runs):
            start = time.process_time()
            image = made.render(camera, ["electrons"], options.quality, seed)["electrons"]
            times.append(time.process_time() - start)
            errors.append(float(np.sqrt(np.mean((image - true) ** 2)) / true.mean()))
        seconds, error = float(np.median(times)), float(np.median(errors))
        costs.append(seconds * error**2)
        print(f"{name:10}{seconds:10.2f}{100 * error:10.2f}{1e4 * costs[-1]:16.3f}")
    print(f"40 lamps cost {costs[1] / costs[0]:.2f} times one lamp at equal error")


if __name__ == "__main__":
    main()
