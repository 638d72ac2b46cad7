"""Time to make plants: a single one of forty nodes, a row of thirteen, and the same row at its next rotation.

One process on one core, except where two processes are named; medians over plants and rows of different
seeds; the first of each kind warms up and is not counted. Run it from the top of the repository:

    OMP_NUM_THREADS=1 python benchmarks/plants.py
"""

from __future__ import annotations

import argparse
import sys

from pepperscene.bench.frames_child import PLANT_STAGES, Times, time_plants, timed
from pepperscene.bench.records import machine_info
from pepperscene.bench.report import time_table
from pepperscene.bench.run import DEFAULT_RUNS


def time_single_plants(cultivar: str, runs: int, detail: float) -> dict[str, list[float]]:
    """Seconds to grow and mesh single plants, and to resolve their contacts."""
    import numpy as np

    import pepperscene as ps

    model, all_times = ps.load_cultivar(cultivar), list[Times]()
    for seed in range(runs + 1):
        times: Times = {}
        with timed(times, "grow"):
            plant = ps.grow(model, np.random.default_rng(seed))
        with timed(times, "mesh"):
            mesh = ps.mesh_plant(plant, detail)
        times["grow and mesh"] = times["grow"] + times["mesh"]
        with timed(times, "resolve contacts"):
            ps.resolve_contacts(mesh, np.random.default_rng(seed))
        all_times.append(times)
    return by_stage(all_times[1:])


def time_rows(recipe_name: str, runs: int) -> dict[str, list[float]]:
    """Seconds to make and place the plants of a recipe's row, by stage, and to place them a second time."""
    import pepperscene as ps
    from pepperscene.building.scenes.scene_builder import SceneBuilder

    all_times = []
    stage_times: Times = {}
    time_plants(stage_times)
    for seed in range(runs + 1):
        stage_times.clear()
        recipe = ps.load_recipe(recipe_name).with_seed(seed)
        cultivar, times = ps.load_cultivar(recipe.cultivar), Times()
        builder = SceneBuilder(recipe, cultivar, 1)
        with timed(times, "total"):
            builder.scene(0, 0)
        # Far rows, if the recipe has them, are grown and meshed too and count towards their stages.
        stages = {name: stage_times.get(name, 0.0) for name in PLANT_STAGES}
        placing = times["total"] - sum(stages.values())
        times = {**stages, "place row and resolve contacts": placing, **times}
        with timed(times, "the next rotation"):
            builder.scene(0, 1)
        with timed(times, "total in two processes"):
            SceneBuilder(recipe, cultivar, 2).scene(0, 0)
        all_times.append(times)
    return by_stage(all_times[1:])


def by_stage(all_times: list[Times]) -> dict[str, list[float]]:
    """Times of each stage over the runs."""
    return {name: [times[name] for times in all_times] for name in all_times[0]}


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cultivar", default="kaite")
    parser.add_argument("--recipe", default="barth2018", help="recipe of the row (default: barth2018)")
    parser.add_argument("--detail", type=float, default=1.0, help="mesh resolution of the single plants")
    parser.add_argument("--runs", type=int, default=DEFAULT_RUNS, help=f"at least {DEFAULT_RUNS}")
    options = parser.parse_args()
    if options.runs < DEFAULT_RUNS:
        parser.error(f"--runs must be at least {DEFAULT_RUNS}: a median of fewer is unreliable")
    machine = machine_info()
    sys.stdout.write(
        f"On one of {machine['cores']} cores of {machine['cpu']}, {machine['system']}; "
        f"Python {machine['python']}, numpy {machine['packages']['numpy']}.\n\n"
    )
    plants = time_single_plants(options.cultivar, 4 * options.runs, options.detail)
    table = {f"one plant of {options.cultivar}: {stage}": times for stage, times in plants.items()}
    table |= {
        f"row of {options.recipe}: {stage}": t for stage, t in time_rows(options.recipe, options.runs).items()
    }
    sys.stdout.write(time_table(table.items()) + "\n")


if __name__ == "__main__":
    main()
