"""How long frames take: the first of a new scene by stage, the next ones, labels alone, and the start-up.

Every figure is a median over runs. What a process does only once (imports, compilation, the first frame) is
measured in a process of its own for each run. Run it from the top of the repository:

    python benchmarks/first_frames.py --json benchmarks/first_frames.json
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from time import perf_counter
from typing import Any, Final

LABELS: Final = ("class", "instance", "distance")
PACKAGES: Final = ("pepperscene", "mitsuba", "drjit", "numpy", "pyoidn", "karellen-llvm-core")
LEAST_RUNS: Final = 5
PLANT_STAGES: Final = ("grow", "mesh", "twine", "settle plants")

Times = dict[str, float]


@contextmanager
def timed(times: Times, what: str) -> Iterator[None]:
    """Add the seconds that the block takes to `times[what]`."""
    start = perf_counter()
    yield
    times[what] = times.get(what, 0.0) + perf_counter() - start


# --- what a child process measures ------------------------------------------------------------------------


def new_scene(recipe_name: str, quality: str, runs: int) -> dict[str, Any]:
    """The first frame of a new scene in a new process, stage by stage; `runs` is not used."""
    times: Times = {}
    whole = perf_counter()
    with timed(times, "import what is needed"):
        import numpy as np

        import pepperscene as ps
        from pepperscene.dataset.equipment import cover_of, surface_grid
        from pepperscene.dataset.planting import Planting
        from pepperscene.dataset.seeds import Stream, generator
        from pepperscene.dataset.stage import Stage
        from pepperscene.render import renderer
        from pepperscene.render.variant import kernel
    with timed(times, "start Mitsuba"):
        kernel()

    recipe = ps.load_recipe(recipe_name)
    stage = Stage(recipe)
    clock_plants(times)
    with timed(times, "place and settle row"):
        mesh = Planting(recipe, stage.cultivar).scene(0, 0).mesh
    times["place and settle row"] -= sum(times[what] for what in PLANT_STAGES)
    with timed(times, "surfaces"):
        nm = surface_grid(stage.camera(recipe.plan.shot(0)).sensor)
        surfaces = {**ps.organ_surfaces(stage.cultivar, nm), **ps.greenhouse_surfaces(nm)}
    sky = None
    if recipe.daylight is not None and recipe.daylight.illuminance_lx > 0:
        light = recipe.daylight
        with timed(times, "sky"):
            sky = ps.partly_cloudy(
                generator(recipe.seed, Stream.SKY, 0),
                illuminance_lx=light.illuminance_lx,
                sun_azimuth_rad=float(np.radians(light.sun_azimuth_deg)),
                sun_elevation_rad=float(np.radians(light.sun_elevation_deg)),
                sun_fraction=light.sun_fraction,
                cloud_cover=light.cloud_cover,
                cover=cover_of(recipe),
            )
    scene = ps.assemble(mesh, surfaces, sky)

    # The renderer makes its kernel scene when it is first needed: clock that call where it is made.
    renderer.light_scene = clocked(times, "kernel scene", renderer.light_scene)
    camera = stage.camera(recipe.plan.shot(0))
    with timed(times, "compile and render"):
        ps.Renderer(scene).render(camera, ps.DEFAULT_OUTPUTS, quality)
    times["compile and render"] -= times["kernel scene"]
    times["all stages"] = perf_counter() - whole
    return {"times": {name: [value] for name, value in times.items()}, "triangles": len(mesh.faces)}


def next_frames(recipe_name: str, quality: str, runs: int) -> dict[str, Any]:
    """Frames of a scene after its first, all default outputs; rendering and encoding apart."""
    import pepperscene as ps
    from pepperscene.frame import DEFAULT_OUTPUTS, OUTPUTS
    from pepperscene.render import variant_name

    recipe = ps.load_recipe(recipe_name)
    stage, steps = ps.Stage(recipe), spread(recipe.plan.frames, runs + 1)
    stage.render(recipe.plan.shot(steps[0]), DEFAULT_OUTPUTS, quality)
    renders, encodes = [], []
    with tempfile.TemporaryDirectory() as folder:
        for step in steps[1:]:
            times: Times = {}
            with timed(times, "render"):
                frame = stage.render(recipe.plan.shot(step), DEFAULT_OUTPUTS, quality)
            with timed(times, "encode"):
                for name, image in frame.images.items():
                    ps.write_image(Path(folder) / f"{name}{OUTPUTS[name].suffix}", image, name)
            renders.append(times["render"])
            encodes.append(times["encode"])
    return {
        "times": {"render": renders, "encode": encodes},
        "peak_mib": peak_mib(),
        "variant": variant_name(),
        "size": list(frame["class"].shape[::-1]),
    }


def labels_alone(recipe_name: str, quality: str, runs: int) -> dict[str, Any]:
    """Ground truth without light, in a process that never renders colour."""
    import pepperscene as ps

    recipe = ps.load_recipe(recipe_name)
    stage, steps = ps.Stage(recipe), spread(recipe.plan.frames, runs + 1)
    stage.render(recipe.plan.shot(steps[0]), LABELS, quality)
    labels = []
    for step in steps[1:]:
        times: Times = {}
        with timed(times, "labels"):
            stage.render(recipe.plan.shot(step), LABELS, quality)
        labels.append(times["labels"])
    return {"times": {"labels": labels}, "peak_mib": peak_mib()}


CHILDREN: Final[Mapping[str, Callable[[str, str, int], dict[str, Any]]]] = {
    "new_scene": new_scene,
    "next_frames": next_frames,
    "labels_alone": labels_alone,
}


def clock_plants(times: Times) -> None:
    """Clock what makes a plant wherever it is called from here on; `settle` of single plants alone."""
    from pepperscene import geometry, grammar, scene

    grammar.grow = clocked(times, "grow", grammar.grow)
    geometry.mesh_plant = clocked(times, "mesh", geometry.mesh_plant)
    scene.with_twine = clocked(times, "twine", scene.with_twine)
    settle = geometry.settle

    def settled(*args: Any, between_plants: bool = False, **kwargs: Any) -> Any:
        if between_plants:
            return settle(*args, between_plants=True, **kwargs)
        with timed(times, "settle plants"):
            return settle(*args, **kwargs)

    geometry.settle = settled


def clocked(times: Times, what: str, inner: Callable[..., Any]) -> Callable[..., Any]:
    """The function, with its time added up."""

    def call(*args: Any, **kwargs: Any) -> Any:
        with timed(times, what):
            return inner(*args, **kwargs)

    return call


def spread(frames: int, count: int) -> list[int]:
    """Steps spread over the camera's path."""
    return [round(number * (frames - 1) / (count - 1)) for number in range(count)]


def peak_mib() -> float:
    """The most memory that this process has held at once."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)


# --- the parent -------------------------------------------------------------------------------------------


def in_child(what: str, options: argparse.Namespace) -> dict[str, Any]:
    """What a child process found."""
    command = [sys.executable, __file__, "--child", what, "--recipe", options.recipe]
    command += ["--quality", options.quality, "--runs", str(options.runs)]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def seconds_of(command: list[str], runs: int) -> list[float]:
    """Wall-clock seconds of a command, from its start to its end."""
    found = []
    for _ in range(runs):
        start = perf_counter()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        found.append(perf_counter() - start)
    return found


def measured(options: argparse.Namespace) -> dict[str, Any]:
    """Everything, JSON-ready: times in seconds by what they are of, and what they were taken on."""
    before = os.getloadavg() if hasattr(os, "getloadavg") else None
    python, runs = sys.executable, options.runs
    # One run more than counted: the first warms the disk's cache and that of compiled kernels.
    first = [in_child("new_scene", options) for _ in range(runs + 1)][1:]
    following, labels = in_child("next_frames", options), in_child("labels_alone", options)
    width, height = following["size"]
    frame = f"{options.quality} frame"
    times = {
        f"{frame}: render": following["times"]["render"],
        f"{frame}: encode": following["times"]["encode"],
        "labels only": labels["times"]["labels"],
        **{
            f"first frame: {stage}": [seconds for run in first for seconds in run["times"][stage]]
            for stage in first[0]["times"]
        },
        "python -c pass": seconds_of([python, "-c", "pass"], runs),
        "import pepperscene": seconds_of([python, "-c", "import pepperscene"], runs),
        "pepperscene --help": seconds_of([python, "-m", "pepperscene", "--help"], runs),
    }
    return {
        "what": {
            "recipe": options.recipe,
            "quality": options.quality,
            "size": f"{width}x{height}",
            "triangles": first[0]["triangles"],
        },
        "machine": {**machine(), "variant": following["variant"], "load_average_before": before},
        "seconds": times,
        "peak_mib": {frame: following["peak_mib"], "labels only": labels["peak_mib"]},
    }


def machine() -> dict[str, Any]:
    """What the figures were taken on."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {
        "cpu": cpu_model(),
        "cores": cores,
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "packages": {name: version(name) for name in PACKAGES},
    }


def cpu_model() -> str:
    """The processor's name as the system tells it."""
    told = Path("/proc/cpuinfo")
    if told.is_file():
        for line in told.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def version(package: str) -> str:
    """The installed version of a package, or that there is none."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


def table(found: Mapping[str, Any]) -> str:
    """The findings as Markdown."""
    what, on = found["what"], found["machine"]
    packages = ", ".join(f"{name} {number}" for name, number in on["packages"].items())
    lines = [
        f"Recipe `{what['recipe']}`, {what['size']}, {what['triangles']:,} triangles, on {on['cores']} cores "
        f"of {on['cpu']}, {on['system']}, {on['variant']}; Python {on['python']}, {packages}.",
        "",
        "| what | median | least | most | runs |",
        "|---|---:|---:|---:|---:|",
    ]
    for name, seconds in found["seconds"].items():
        middle = statistics.median(seconds)
        spans = [f"{1e3 * value:,.0f} ms" for value in (middle, min(seconds), max(seconds))]
        lines.append(f"| {name} | {' | '.join(spans)} | {len(seconds)} |")
    lines += [
        f"| {name}: peak memory | {peak:,.0f} MiB | | | 1 |" for name, peak in found["peak_mib"].items()
    ]
    return "\n".join(lines)


def main() -> None:
    """Measure, print the table, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recipe", default="barth2018", help="whose scene and camera path to take")
    parser.add_argument("--quality", default="standard")
    parser.add_argument("--runs", type=int, default=LEAST_RUNS, help=f"at least {LEAST_RUNS}")
    parser.add_argument("--json", type=Path, metavar="FILE", help="where to write every single time")
    parser.add_argument("--child", choices=CHILDREN, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        found = CHILDREN[options.child](options.recipe, options.quality, options.runs)
        sys.stdout.write(json.dumps(found) + "\n")
        return
    if options.runs < LEAST_RUNS:
        parser.error(f"--runs must be at least {LEAST_RUNS}: a median of fewer says little")
    found = measured(options)
    sys.stdout.write(table(found) + "\n")
    if options.json is not None:
        options.json.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
