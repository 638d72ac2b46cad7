"""The command `visibility`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pepperscene.cli.application import CodeOption, RecipeArgument, SeedOption, SetOption, command
from pepperscene.cli.options import parse_numbers
from pepperscene.cli.progress import echo_progress, image_progress
from pepperscene.errors import ArgumentError
from pepperscene.options import Option
from pepperscene.truth.fruit_visibility import SAMPLES

if TYPE_CHECKING:
    from pepperscene.building.viewpoints.recipe_visibility import SceneVisibility, ViewpointOptions
    from pepperscene.recipe.views.workspace import BoxWorkspace, Workspace


@dataclass(frozen=True)
class ViewpointRequest:
    """The poses to observe from, and what to compute, in millimetres."""

    poses: Annotated[
        Path | None,
        Option("Observe from the poses of a file: TUM, CSV, nerfstudio or COLMAP.", "FILE"),
    ] = None
    random: Annotated[int | None, Option("Observe from N random positions in the workspace.", "N")] = None
    spacing: Annotated[
        float | None, Option("Observe from a lattice of positions in the workspace.", "MM")
    ] = None
    box: Annotated[
        str | None, Option("Workspace of the camera: a box, in millimetres.", "X0,X1,Y0,Y1,Z0,Z1")
    ] = None
    sphere: Annotated[str | None, Option("Workspace of the camera: a ball, in millimetres.", "X,Y,Z,R")] = (
        None
    )
    clearance: Annotated[float, Option("Least distance of a reachable camera from any surface.", "MM")] = 0.0
    views: Annotated[int, Option("Find the K next best views among the reachable poses.", "K")] = 0
    samples: Annotated[int, Option("Points on each fruit, a multiple of 64.", "N")] = SAMPLES
    occluders: Annotated[bool, Option("List what hides each fruit.")] = True

    def options(self) -> ViewpointOptions:
        """The options in metres; raises `ArgumentError` if they do not fit each other."""
        from pepperscene.building.viewpoints.recipe_visibility import ViewpointOptions

        options = ViewpointOptions(
            poses=self.poses,
            random=self.random,
            spacing_m=None if self.spacing is None else self.spacing / 1e3,
            workspace=_workspace(self.box, self.sphere),
            clearance_m=self.clearance / 1e3,
            views=self.views,
            samples=self.samples,
            occluders=self.occluders,
        )
        if self.clearance and options.workspace is None:
            raise ArgumentError("clearance", "needs a workspace: --box or --sphere")
        return options


@command
def visibility(
    *,
    out: Annotated[Path, typer.Option(metavar="FILE", help="Parquet file of the table.")],
    recipe: RecipeArgument = "demo",
    frames: Annotated[
        str | None,
        typer.Option(
            metavar="A:B",
            help="Frames A to B - 1, counted from 0, whose cameras observe the fruit; with other poses, the "
            "first one sets the scene. Default: the recipe's.",
        ),
    ] = None,
    request: ViewpointRequest,
    seed: SeedOption = None,
    set: SetOption = None,
    allow_code: CodeOption = False,
) -> None:
    """Compute what cameras see of each fruit, what hides it, and the next best views, without images."""
    from pepperscene.building.viewpoints.recipe_visibility import recipe_visibility
    from pepperscene.building.viewpoints.table import check_table_path, write_visibility
    from pepperscene.recipe.resolve.load import parse_changes, resolve_recipe

    check_table_path(out)
    options = request.options()
    changes = parse_changes(set or ()) | ({} if seed is None else {"seed": seed})
    resolved = resolve_recipe(recipe, changes, allow_code=allow_code)
    lines: list[str] = []

    def described(scene: SceneVisibility) -> SceneVisibility:
        lines.extend(_describe(scene))
        return scene

    with image_progress("observed", "poses") as on_progress:
        scenes = recipe_visibility(resolved, options, frames, on_stage=echo_progress, on_progress=on_progress)
        rows = write_visibility(out, resolved, options, map(described, scenes))
    for line in lines:
        typer.echo(line)
    typer.echo(f"{rows:,} rows: {out}")


def parse_box(text: str) -> BoxWorkspace:
    """The workspace of a text "X0,X1,Y0,Y1,Z0,Z1" in millimetres."""
    from pepperscene.recipe.views.workspace import BoxWorkspace

    x0, x1, y0, y1, z0, z1 = (value / 1e3 for value in parse_numbers(text, "box", 6))
    return BoxWorkspace((x0, y0, z0), (x1, y1, z1))


def _workspace(box: str | None, sphere: str | None) -> Workspace | None:
    from pepperscene.recipe.views.workspace import SphereWorkspace

    if box is not None and sphere is not None:
        raise ArgumentError("sphere", "cannot be combined with box")
    if box is not None:
        return parse_box(box)
    if sphere is not None:
        x, y, z, radius = (value / 1e3 for value in parse_numbers(sphere, "sphere", 4))
        return SphereWorkspace((x, y, z), radius)
    return None


def _describe(scene: SceneVisibility) -> list[str]:
    """Lines about a scene: how much is seen, and the next best views."""
    seen, poses = scene.visibility, scene.visibility.poses
    counted = f"{len(poses):,} poses"
    if scene.reachable is not None:
        counted += f", {int(scene.reachable.sum()):,} reachable"
    found = int((scene.best >= 0).sum())
    lines = [f"scene {scene.spec.scene}: {counted}; {found} of {len(seen.fruit)} fruit are seen"]
    if scene.views is None:
        return lines
    for number, (pose, coverage) in enumerate(
        zip(scene.views.poses, scene.views.coverage, strict=True), start=1
    ):
        x, y, z = 1e3 * poses[pose, :3, 3]
        lines.append(
            f"view {number}: pose {pose} at ({x:.0f}, {y:.0f}, {z:.0f}) mm, "
            f"{coverage:.1%} of the fruit's surface seen"
        )
    return lines
