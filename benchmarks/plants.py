"""How long plants take: one of forty nodes, a row of thirteen, and the row after its plants have moved on.

One process, one core, but where two processes are named; medians over plants and rows of different seeds; the
first of each kind warms up and is not counted. Run it from the top of the repository:

    OMP_NUM_THREADS=1 python benchmarks/plants.py
"""

from __future__ import annotations

import argparse
import statistics
import sys
from collections.abc import Mapping

from pepperscene.bench.frames_child import PLANT_STAGES, Times, clock_plants, timed
from pepperscene.bench.records import machine_info
from pepperscene.bench.run import LEAST_RUNS


def single_plants(cultivar: str, runs: int, detail: float) -> dict[str, list[float]]:
    """Seconds to grow, mesh and settle single plants."""
    import numpy as np

    import pepperscene as ps

    model, found = ps.load_cultivar(cultivar), list[Times]()
    for seed in range(runs + 1):
        times: Times = {}
        with timed(times, "grow"):
            plant = ps.grow(model, np.random.default_rng(seed))
        with timed(times, "mesh"):
            mesh = ps.mesh_plant(plant, detail)
        times["grow and mesh"] = times["grow"] + times["mesh"]
        with timed(times, "settle"):
            ps.resolve_contacts(mesh, np.random.default_rng(seed))
        found.append(times)
    return columns(found[1:])


def rows(recipe_name: str, runs: int) -> dict[str, list[float]]:
    """Seconds to make the plants of a recipe's row and to place it, by stage; and to place it once more."""
    import pepperscene as ps
    from pepperscene.dataset.scenes.scene_builder import SceneBuilder

    found = []
    clocks: Times = {}
    clock_plants(clocks)
    for seed in range(runs + 1):
        clocks.clear()
        recipe = ps.load_recipe(recipe_name).with_seed(seed)
        cultivar, times = ps.load_cultivar(recipe.cultivar), Times()
        planting = SceneBuilder(recipe, cultivar, 1)
        with timed(times, "all of it"):
            planting.scene(0, 0)
        # Far rows are grown and meshed too where a recipe has them; they count to their stages.
        stages = {name: clocks.get(name, 0.0) for name in PLANT_STAGES}
        times = {**stages, "place and settle row": times["all of it"] - sum(stages.values()), **times}
        with timed(times, "the next rotation"):
            planting.scene(0, 1)
        with timed(times, "all of it in two processes"):
            SceneBuilder(recipe, cultivar, 2).scene(0, 0)
        found.append(times)
    return columns(found[1:])


def columns(found: list[Times]) -> dict[str, list[float]]:
    """Times of each stage over the runs."""
    return {name: [times[name] for times in found] for name in found[0]}


def lines(title: str, seconds: Mapping[str, list[float]]) -> list[str]:
    """Rows of a Markdown table."""
    return [
        f"| {title}: {name} | "
        + " | ".join(f"{1e3 * one:,.0f} ms" for one in (statistics.median(every), min(every), max(every)))
        + f" | {len(every)} |"
        for name, every in seconds.items()
    ]


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cultivar", default="kaite")
    parser.add_argument("--recipe", default="barth2018", help="whose row to plant")
    parser.add_argument("--detail", type=float, default=1.0, help="of the single plants")
    parser.add_argument("--runs", type=int, default=LEAST_RUNS, help=f"at least {LEAST_RUNS}")
    options = parser.parse_args()
    if options.runs < LEAST_RUNS:
        parser.error(f"--runs must be at least {LEAST_RUNS}: a median of fewer says little")
    on = machine_info()
    told = [f"On one of {on['cores']} cores of {on['cpu']}, {on['system']}; Python {on['python']}, "]
    told[0] += f"numpy {on['packages']['numpy']}."
    told += ["", "| what | median | least | most | runs |", "|---|---:|---:|---:|---:|"]
    told += lines(
        f"one plant of {options.cultivar}", single_plants(options.cultivar, 4 * options.runs, options.detail)
    )
    told += lines(f"row of {options.recipe}", rows(options.recipe, options.runs))
    sys.stdout.write("\n".join(told) + "\n")


if __name__ == "__main__":
    main()
