"""Draw the figure of the page about benchmark tasks into docs/images.

    python docs/figures/tasks.py

It shows a frame of the test of depth completion, which is cached in the folder `pepperscene_tasks` of the
system's folder for temporary files, and what baselines make of it.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Final

import numpy as np
from depth import IMAGES, depth_colours, panel, sheet

import pepperscene as ps
from pepperscene.learning.tasks.depth_baselines import BASELINES

CACHE: Final = Path(tempfile.gettempdir()) / "pepperscene_tasks"
FRAME: Final = 15
CHANGES: Final = {"camera.width": 640, "camera.height": 360}


def main() -> None:
    """Build the frame, and draw photograph, measured and exact depth, and that of three baselines."""
    recipe = ps.load_recipe("realsense_depth", CHANGES)
    outputs = ["colour", "depth_z", "depth_sensor"]
    dataset = ps.build(recipe, CACHE, [FRAME], outputs, ps.BuildOptions("draft")).dataset
    colour, exact, measured = (dataset.image(FRAME, name) for name in outputs)
    shown = ("nearest", "ip_basic", "guided_filter")
    filled = [panel(depth_colours(np.asarray(BASELINES[name](colour, measured))), name) for name in shown]
    panels = [
        [
            panel(colour, "colour"),
            panel(depth_colours(measured), "depth_sensor"),
            panel(depth_colours(exact), "depth_z"),
        ],
        filled,
    ]
    picture = sheet(panels)
    picture.resize((picture.width * 2 // 3, picture.height * 2 // 3)).save(
        IMAGES / "task_depth.jpg", quality=88, optimize=True
    )


if __name__ == "__main__":
    main()
