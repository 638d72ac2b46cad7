"""Draw the figure of the page about visibility into docs/images.

Run it after a change that affects it:

python docs/figures/visibility.py

It prints the numbers of the page: the coverage after each view.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Final

import numpy as np
from harvest import amodal_outlines
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from overview import IMAGES

import pepperscene as ps
from pepperscene.recipe.plan import frame_seed

ROW: Final = {"row.plants_front": 5, "row.plants_back": 4, "camera.width": 480, "camera.height": 360}
PLANT: Final = 2  # in the middle of the front row
VIEWS: Final = 12
CANDIDATES: Final = 600
INK, ORANGE, BLUE, GREEN = "#333333", "#d98c21", "#2c6fbb", "#3c7a32"
OUTLINE: Final = "#ff30ff"
BRIGHTER: Final = 1.2  # the flash leaves the distance dark
LEAST_VISIBLE: Final = 0.1  # chosen: a part of the fruit is to be seen in the worst view as well
NEAR_M: Final = (0.4, 0.6)
"""Distances of the views that are shown. Chosen: the fruit is large, and leaves are in between."""


@dataclass(frozen=True)
class Example:
    """The fruit that is shown, and two poses that face it."""

    instance: int
    best: int
    worst: int


def most_different(observer: ps.FruitObserver, seen: ps.FruitVisibility, fruit: np.ndarray) -> Example:
    """The large fruit whose views from nearby differ most; each view has it in the middle of the image."""
    distance = np.linalg.norm(
        observer.points.skin_centres[seen.fruit_index] - seen.poses[seen.pose_index, :3, 3], axis=1
    )
    towards = observer.points.skin_centres[seen.fruit_index] - seen.poses[seen.pose_index, :3, 3]
    centred = np.einsum("ri,ri->r", towards, seen.poses[seen.pose_index, :3, 2]) > 0.9999 * distance
    large = fruit[observer.points.area_m2[fruit] > np.median(observer.points.area_m2[fruit])]
    near = centred & (NEAR_M[0] < distance) & (distance < NEAR_M[1]) & np.isin(seen.fruit_index, large)
    near &= seen.visible_fraction > LEAST_VISIBLE
    examples = []
    for number in np.unique(seen.fruit_index[near]):
        rows = np.flatnonzero(near & (seen.fruit_index == number))
        order = rows[np.argsort(seen.visible_fraction[rows])]
        gain = float(seen.visible_fraction[order[-1]] - seen.visible_fraction[order[0]])
        poses = seen.pose_index[order[[-1, 0]]].tolist()
        examples.append((gain, Example(int(seen.fruit[number]), *poses)))
    return max(examples, key=lambda one: one[0])[1]


def show_view(axes: Axes, frames: ps.FrameRenderer, pose: np.ndarray, instance: int, title: str) -> None:
    """Render a photograph from a pose, with the outline that the fruit would have alone."""
    spec = frames.recipe.plan.frame(0)
    renderer = ps.Renderer(frames.scene(spec))
    camera = frames.camera(spec).at_pose(pose)
    seed = frame_seed(frames.recipe.seed, spec.index)
    frame = renderer.render(camera, ["colour", "harvest"], seed=seed)
    axes.imshow(np.clip(frame.colour.astype(float) * BRIGHTER, 0, 255).astype(np.uint8))
    fruit = next(one for one in frame["harvest"]["fruit"] if one["instance"] == instance + 1)
    for outline in amodal_outlines(fruit):
        axes.plot(*(outline.T - 0.5), color=OUTLINE, lw=1.5)
    axes.set_title(f"{title}: {fruit['visible_fraction']:.0%} of the fruit visible", fontsize=9, color=INK)
    axes.set_axis_off()


def draw_coverage(axes: Axes, result: ps.PlannerComparison) -> None:
    """Draw coverage against the number of views."""
    views = np.arange(VIEWS) + 1
    low, high = np.quantile(result.random, [0.05, 0.95], axis=0)
    axes.axhline(100 * result.most, color=INK, lw=0.8, ls=":")
    axes.text(VIEWS, 100 * result.most, f"all {CANDIDATES} candidates", ha="right", va="bottom", fontsize=7.5)
    axes.plot(views, 100 * result.oracle, "o-", color=GREEN, ms=3.5, label="oracle: next best view")
    axes.plot(views, 100 * result.random.mean(axis=0), "o-", color=BLUE, ms=3.5, label="random, 5 to 95 %")
    axes.fill_between(views, 100 * low, 100 * high, color=BLUE, alpha=0.18, lw=0)
    axes.plot(views, 100 * result.arc, "o-", color=ORANGE, ms=3.5, label="fixed arc")
    axes.set_xlabel("number of views", fontsize=9)
    axes.set_ylabel("surface of the fruit seen, %", fontsize=9)
    axes.set_xticks(views[::2])
    axes.set_ylim(0, None)
    axes.tick_params(labelsize=8)
    axes.legend(fontsize=7.5, frameon=False, loc="lower right")
    axes.spines[["top", "right"]].set_visible(False)


def main() -> None:
    """Compare planners for the fruit of the middle plant, and show two views of a fruit."""
    recipe = ps.load_recipe("barth2018", ROW)
    frames = ps.FrameRenderer(recipe, culled=False)
    scene = frames.scene(recipe.plan.frame(0), traced=False)
    camera = frames.camera(recipe.plan.frame(0))
    observer = ps.FruitObserver(scene)
    fruit = np.flatnonzero([scene.mesh.instances[one].plant == PLANT for one in observer.points.fruit])
    centres = observer.points.skin_centres[fruit]

    # The workspace of an arm on a cart in the aisle, in front of the plant.
    low, high = centres[:, 2].min() - 0.2, centres[:, 2].max() + 0.2
    box = ps.BoxWorkspace((-0.5, -0.7, low), (0.5, -0.2, high))
    reach = ps.ReachTest(box, scene.mesh, clearance_m=0.05)
    candidates = ps.random_poses(reach, centres, CANDIDATES, np.random.default_rng(1))
    arc = ps.arc_path(VIEWS, 0.5, (-np.pi / 4, np.pi / 4), (low + 0.2, high - 0.2), 0.0)
    result = ps.compare_planners(
        observer, camera, candidates, arc, np.random.default_rng(2), fruit=fruit, draws=200
    )
    for name, values in (
        ("random", result.random.mean(axis=0)),
        ("arc", result.arc),
        ("oracle", result.oracle),
    ):
        sys.stdout.write(f"{name} {' '.join(f'{100 * value:.1f}' for value in values)}\n")
    sys.stdout.write(f"all candidates {100 * result.most:.1f}, {len(fruit)} fruit\n")

    figure = Figure(figsize=(11.0, 2.75), layout="constrained")
    chart, best, worst = figure.subplots(1, 3, width_ratios=[0.95, 1.0, 1.0])
    draw_coverage(chart, result)
    example = most_different(observer, observer.observe(camera, candidates), fruit)
    show_view(best, frames, candidates[example.best], example.instance, "best view")
    show_view(worst, frames, candidates[example.worst], example.instance, "worst view")
    figure.savefig(IMAGES / "visibility.png", dpi=110, pil_kwargs={"optimize": True})


if __name__ == "__main__":
    main()
