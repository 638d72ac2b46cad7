"""Render the figures of the page about colour into docs/images.

Run it after a change that affects them:

python docs/figures/tuning.py
"""

from __future__ import annotations

import shutil
import tempfile
from datetime import date
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from overview import GAP, IMAGES, Picture, side_by_side
from PIL import Image

from pepperscene import load_recipe
from pepperscene.colour import Patch
from pepperscene.tuning import RunInfo, TuningTarget, fit_parameters, simulate_patches, write_tuned
from pepperscene.tuning.views import OrganView

KINDS: Final = ("leaf", "pepper.unripe", "pepper.ripe", "peduncle", "stem", "shoot")
SCALE: Final = 3
"""Factor by which views are enlarged."""
HIDDEN: Final[dict[str, ArrayLike]] = {
    "leaf.chlorophyll": 38.0,
    "fruit.chlorophyll": 11.0,
    "fruit.capsanthin": 12.0,
    "white_balance": [1.1, 0.88],
}
"""True values of the simulated patches. Chosen: visibly different, and well within the bounds."""


def enlarged_view(view: OrganView, patch: Patch) -> Picture:
    """The organ of a view on white."""
    picture = np.full((*view.mask.shape, 3), 255, np.uint8)
    picture[view.mask] = patch.codes
    return picture.repeat(SCALE, axis=0).repeat(SCALE, axis=1)


def views() -> Picture:
    """The views of a fit: three organs of each kind, at their positions in the picture and in its light."""
    recipe = load_recipe("barth2018", {"cultivar": "red_blocky"})
    patches = simulate_patches(recipe, {}, KINDS)
    target = TuningTarget(recipe, patches, registered=True)
    by_name = {patch.name: patch for patch in patches.patches}
    columns: dict[str, list[Picture]] = {}
    for view in target.views:
        columns.setdefault(view.kind, []).append(enlarged_view(view, by_name[view.name]))
    gap = ((0, GAP), (0, 0), (0, 0))
    return side_by_side(
        [
            np.vstack([np.pad(picture, gap, constant_values=255) for picture in column])
            for column in columns.values()
        ]
    )


def write_fit_figure(path: Path) -> None:
    """Fit simulated patches, and write the figure of this fit."""
    recipe = load_recipe("barth2018", {"cultivar": "red_blocky"})
    patches = simulate_patches(recipe, HIDDEN, KINDS[:3], organs=1)
    target = TuningTarget(recipe, patches, registered=True, organs=1)
    fit = fit_parameters(target, target.problem(list(HIDDEN)))
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "tuned"
        write_tuned(recipe, fit, out, RunInfo.of(patches, date(2026, 1, 31)), extends="barth2018")
        shutil.copy(out / "before_after.png", path)


if __name__ == "__main__":
    Image.fromarray(views()).save(IMAGES / "tuning_views.png", optimize=True)
    write_fit_figure(IMAGES / "before_after.png")
