"""A data set of a few tiny frames with all outputs that exports use."""

from __future__ import annotations

import numpy as np
from set_files import set_without_plants
from stand_in import StandIn

from pepperscene.frame import Frame

OUTPUTS = ("colour", "class", "instance", "distance", "harvest")
FRAMES = 9

CUT = {"camera_m": [0.1, 0.0, 0.4], "world_m": [0.0, 0.0, 1.0], "px": [3.5, 1.25], "visible": True}
FRUIT = {
    "instance": 412, "plant": 3, "phytomer": 17, "kind": "fruit", "ripeness": 0.75, "ripeness_spread": 0.1,
    "length_m": 0.08, "diameter_m": 0.075, "pose": np.eye(4).tolist(),
    "box": [1, 2, 5, 4], "amodal_box": [0, 2, 6, 5], "visible_pixels": 7, "amodal_pixels": 14,
    "visible_fraction": 0.5, "truncated": False, "occluders": [{"instance": 88, "pixels": 7}],
    "amodal": {"size": [6, 8], "counts": [0, 14, 34]},
    "peduncle": {"instance": 411, "attachment": CUT, "cut": CUT},
    "approach": {"camera": [0.0, 0.0, 1.0], "world": [0.0, 1.0, 0.0]},
}  # fmt: skip
HIDDEN = {
    **FRUIT, "instance": 500, "box": None, "visible_pixels": 0, "visible_fraction": 0.0, "peduncle": None,
}  # fmt: skip
HARVEST = {"format": "pepperscene harvest 1", "fruit": [FRUIT, HIDDEN], "graph": {"nodes": [], "edges": []}}


class HarvestRenderer(StandIn):
    """Renders the same two fruit, and a corner of sky, in every frame."""

    def render(self, camera, outputs=(), quality="standard", seed=0, **others):
        images = [name for name in outputs if name != "harvest"]
        frame = super().render(camera, images, quality, seed, **others)
        frame.images["distance"][0, 0] = np.inf
        return Frame({**frame.images, "harvest": HARVEST}, frame.metadata)


def make_small_set(folder):
    """Nine frames of three scenes."""
    return set_without_plants(folder, range(FRAMES), OUTPUTS, HarvestRenderer)
