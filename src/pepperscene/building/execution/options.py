"""Options of a build."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pepperscene.options import Option


@dataclass(frozen=True)
class BuildOptions:
    """Options of a build; the content of its frames is defined by the recipe.

    Attributes:
        target_error: error of the traced light over the sensor's noise at which sampling stops, or None for
            that of the quality; see `pepperscene.render.render_scene`.
        seed: replaces the recipe's seed, unless None.
        workers: processes on this machine, each with an equal part of the cores and one scene; None makes all
            frames in this process, with all cores.
        scheduler: address of a running Dask scheduler, whose workers see the output folder under the same
            path; needs the extra `cluster`.
        slurm: TOML file that describes the Slurm jobs to submit; needs the extra `cluster`.
        renderer: makes the renderer of a scene; None for Mitsuba. Workers need one that can be pickled.
        on_notice: called with a sentence for the user, such as that a worker was lost.
        on_start: called once with the number of frames to build and that of the plan, after all arguments
            have been checked.
        allow_code: whether the recipe's code may run: views of the kind "function".
    """

    quality: Annotated[str, Option("Rendering quality: draft, standard or reference.", "NAME")] = "standard"
    target_error: Annotated[
        float | None,
        Option(
            "Rendering error relative to the sensor noise at which sampling stops. Overrides the quality's."
        ),
    ] = None
    seed: Annotated[int | None, Option("Random seed. Overrides the recipe's.")] = None
    workers: Annotated[
        int | None, Option("Processes on this machine, which share its cores. Default: one.", "N")
    ] = None
    scheduler: Annotated[
        str | None, Option("Scheduler of a Dask cluster that can access the folder.", "ADDRESS")
    ] = None
    slurm: Annotated[
        str | Path | None, Option("TOML file that describes the Slurm jobs to submit.", "FILE")
    ] = None
    renderer: Callable[..., Any] | None = None
    on_notice: Callable[[str], None] | None = None
    on_start: Callable[[int, int], None] | None = None
    allow_code: Annotated[
        bool, Option('Allow the code of the recipe to run, which views of the kind "function" need.')
    ] = False
