"""Times of a living scene: opening it, views, and picking fruit one after the other.

The scene is opened twice with an empty folder for grown rows, each time in a new process. Then, in this one,
label views are rendered, and fruit are picked, the most visible first, with a label view after each:

    python benchmarks/live_scene.py --recipe barth2018 --frame 125 --picks 20
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable

import numpy as np

import pepperscene as ps
from pepperscene.bench.records import describe_machine, machine_info, peak_memory_mib
from pepperscene.building.scenes.row_cache import CACHE

SIZE = {"camera.width": 640, "camera.height": 480}


def timed(call: Callable[[], object]) -> float:
    """Seconds that a call takes."""
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def main() -> None:
    """Measure, and print a line for each figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--recipe", default="barth2018")
    parser.add_argument("--frame", type=int, default=125)
    parser.add_argument("--picks", type=int, default=20)
    parser.add_argument("--views", type=int, default=100)
    options = parser.parse_args()
    print(describe_machine(machine_info()))
    with tempfile.TemporaryDirectory() as folder:
        os.environ[CACHE] = folder
        code = (
            f"import pepperscene as ps; ps.open_scene({options.recipe!r}, {options.frame}, **{SIZE}).render()"
        )
        command = [sys.executable, "-P", "-c", code]
        for name in ("first label view of a new process, empty folder", "again"):
            print(f"{name}: {timed(lambda: subprocess.run(command, check=True)):.1f} s")
        scene = ps.open_scene(options.recipe, options.frame, **SIZE)
    scene.render()
    poses = np.array([scene.camera.pose] * options.views)
    poses[:, 0, 3] += np.linspace(-0.1, 0.1, options.views)
    print(f"label views: {options.views / timed(lambda: scene.render(poses)):.1f} per second")
    print(
        f"draft photograph: {min(timed(lambda: scene.render(outputs=('colour',))) for _ in range(3)):.2f} s"
    )

    def pick(instance: int) -> None:
        scene.pick(instance)
        scene.render()

    fruit = sorted(scene.fruit, key=lambda one: -one.visible_fraction)[: options.picks]
    seconds = [timed(lambda: pick(one.instance)) for one in fruit]  # noqa: B023
    print(f"pick and label view: median {np.median(seconds):.2f} s, longest {max(seconds):.2f} s")
    print(f"reset and label view: {timed(lambda: (scene.reset(), scene.render())):.2f} s")
    print(f"peak memory: {peak_memory_mib():.0f} MiB")


if __name__ == "__main__":
    main()
