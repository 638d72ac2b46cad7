"""Renders the pictures of the page on colour into docs/images; run it after a change that they show.

python docs/figures/colour.py
"""

from __future__ import annotations

import shutil
import tempfile
from datetime import date
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from overview import GAP, IMAGES, Picture, beside
from PIL import Image

from pepperscene import load_recipe
from pepperscene.colour import Patch
from pepperscene.tuning import TuningTarget, fit_parameters, simulate_patches, write_tuned
from pepperscene.tuning.model.views import OrganView

KINDS: Final = ("leaf", "pepper.unripe", "pepper.ripe", "peduncle", "stem", "shoot")
LARGER: Final = 3
"""Times that a pixel of a view is shown."""
HIDDEN: Final[dict[str, ArrayLike]] = {
    "leaf.chlorophyll": 38.0,
    "fruit.chlorophyll": 11.0,
    "fruit.capsanthin": 12.0,
    "white_balance": [1.1, 0.88],
}
"""Of the twin on the sheet: chosen to be seen, and well within the bounds."""


def shown(view: OrganView, patch: Patch) -> Picture:
    """A view's organ on white."""
    picture = np.full((*view.mask.shape, 3), 255, np.uint8)
    picture[view.mask] = patch.codes
    return picture.repeat(LARGER, axis=0).repeat(LARGER, axis=1)


def views() -> Picture:
    """What a fit looks at: three organs of each kind, each at its place of the picture and in its light."""
    recipe = load_recipe("barth2018", {"cultivar": "red_blocky"})
    patches = simulate_patches(recipe, {}, KINDS)
    subject = TuningTarget(recipe, patches, registered=True)
    by_name = {patch.name: patch for patch in patches.patches}
    rows: dict[str, list[Picture]] = {}
    for view in subject.views:
        rows.setdefault(view.kind, []).append(shown(view, by_name[view.name]))
    white = ((0, GAP), (0, 0), (0, 0))
    columns = [np.vstack([np.pad(one, white, constant_values=255) for one in row]) for row in rows.values()]
    return beside(columns)


def sheet(path: Path) -> None:
    """The picture that a fit leaves behind, of a twin."""
    recipe = load_recipe("barth2018", {"cultivar": "red_blocky"})
    twin = simulate_patches(recipe, HIDDEN, KINDS[:3], organs=1)
    subject = TuningTarget(recipe, twin, registered=True, organs=1)
    fit = fit_parameters(subject, subject.problem(list(HIDDEN)))
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "tuned"
        write_tuned(recipe, fit, out, patches=twin, when=date(2026, 1, 31), extends="barth2018")
        shutil.copy(out / "before_after.png", path)


if __name__ == "__main__":
    Image.fromarray(views()).save(IMAGES / "tuning_views.png", optimize=True)
    sheet(IMAGES / "before_after.png")
