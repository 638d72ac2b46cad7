"""Draws docs/images/chemistry.jpg: a photograph beside the maps of the traits of its tissue.

python docs/figures/chemistry.py
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from pepperscene import FrameRenderer, load_recipe

IMAGE: Final = Path(__file__).parents[1] / "images" / "chemistry.jpg"
RECIPE: Final = "demo"
FRAME: Final = 6137
CHANGES: Final[dict[str, Any]] = {"cultivar": "kaite_old"}
MAPS: Final[dict[str, tuple[str, str, float]]] = {
    "chlorophyll": ("chlorophyll, ug/cm2", "viridis", 60.0),
    "carotenoids": ("carotenoids, ug/cm2", "YlOrBr", 14.0),
    "water": ("water, g/cm2", "Blues", 0.03),
    "ripeness": ("ripeness", "RdYlGn_r", 1.0),
    "leaf_age": ("leaf age", "cividis", 1.0),
}
"""Caption, colours and largest value of each map."""
NOTHING: Final = "0.85"
"""Grey of pixels without a value."""


def draw(images: dict[str, NDArray[Any]]) -> None:
    """Write the figure."""
    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 3, figsize=(13.5, 7.0), layout="constrained")
    for axis in axes.flat:
        axis.set_xticks([])
        axis.set_yticks([])
    photograph, *others = axes.flat
    photograph.imshow(images["colour"])
    photograph.set_title("colour")
    for axis, (name, (caption, colours, largest)) in zip(others, MAPS.items(), strict=True):
        palette = mpl.colormaps[colours].with_extremes(bad=NOTHING)
        drawn = axis.imshow(np.ma.masked_invalid(images[name]), cmap=palette, vmin=0.0, vmax=largest)
        axis.set_title(caption)
        figure.colorbar(drawn, ax=axis, shrink=0.9)
    figure.savefig(IMAGE, dpi=100, pil_kwargs={"quality": 85})


def main() -> None:
    """Render the frame and draw it."""
    renderer = FrameRenderer(load_recipe(RECIPE, CHANGES))
    frame = renderer.render(renderer.recipe.plan.frame(FRAME), ["colour", *MAPS])
    draw(dict(frame.images))


if __name__ == "__main__":
    main()
