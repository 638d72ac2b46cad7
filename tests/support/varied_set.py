"""Data sets with drawn values, twins and two cameras on a rig, built without plants and without Mitsuba."""

from __future__ import annotations

from data_sets import set_without_plants
from disc_set import DiscRenderer

TWINS = {"developing.white_balance": ["flash", "none"]}
RIG = [{"name": "right", "position_mm": [60.0, 0.0, 0.0]}]
VARIED = {
    "camera.exposure_us": {"low": 20.0, "high": 2000.0, "scale": "log"},
    "camera.focus_mm": {"mean": 500.0, "sd": 50.0, "per": "scene"},
    "camera.bits": {"in_turn": [8, 10, 12]},
    "camera.filter": {"none": 1.0},
    "developing.shot_noise": {"true": 0.5, "false": 0.5},
}
PLAN = {"plan.sets": 2, "plan.rotations": 1, "plan.frames": 3}
FRAMES = 2 * 1 * 3 * 2 * 2
"""Sets, rotations, steps, twins and cameras."""

OUTPUTS = ("colour", "class", "instance", "distance")
COLUMNS = (
    "moment", "twin", "rig_camera", "drawn.camera.bits", "drawn.camera.exposure_us", "drawn.camera.filter",
    "drawn.camera.focus_mm", "drawn.developing.shot_noise", "drawn.developing.white_balance", "exposure_us",
    "gain",
)  # fmt: skip
"""Of the manifest, behind those of every manifest."""


class PlantDiscRenderer(DiscRenderer):
    """Renders discs that belong to a plant, as exports need them."""

    def render(self, *args, **kwargs):
        frame = super().render(*args, **kwargs)
        for entry in frame.metadata["instances"].values():
            entry.update(plant=0, phytomer=1)
        return frame


def make_varied_set(folder, frames=range(FRAMES), outputs=OUTPUTS, **changes):
    """Build frames of a recipe that varies values of each kind, without expectations."""
    recipe = {**PLAN, **VARIED, "twins": TWINS, "rig": RIG, **changes}
    return set_without_plants(folder, frames, outputs, PlantDiscRenderer, recipe)
