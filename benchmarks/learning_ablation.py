"""Which parts of the renderer help a network on photographs: sets that lack one thing each.

One recipe is rendered several times at the same indices of frames, each time with one thing removed. Networks
are trained on each set with the same seeds and steps, without a choice by validation, and tested on
photographs. The table has IoU with 95 % intervals over photographs, and the paired difference to the full
recipe. Sets of fewer frames are parts of the full one, or of sets of the full recipe that exist already
(`--curve`). Run the same command again to resume.

    python benchmarks/learning_ablation.py --real photographs --labels published --out out/ablation

At the defaults it renders 9,000 frames and trains 36 networks, which takes days on two cores. Gloss, relief
and spectral light cannot be switched off by a recipe: their variants change the surfaces of each scene before
it is rendered.
"""

from __future__ import annotations

import argparse
import csv
import io
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.atomic import write_file
from pepperscene.building.execution.build import build
from pepperscene.building.execution.job import BuildOptions
from pepperscene.building.scenes.frame_renderer import mitsuba_renderer
from pepperscene.cli.progress import echo_progress
from pepperscene.dataset.readers import open_images
from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.errors import PepperError
from pepperscene.learning.class_table import FRUIT_CLASSES, ClassTable
from pepperscene.learning.experiments.jobs import JobRunner, NetworkJob, NetworkTest
from pepperscene.learning.experiments.results import ExperimentResult, collect_result, compare_results
from pepperscene.learning.experiments.sets import OUTPUTS, spread_frames
from pepperscene.learning.options import TrainingOptions
from pepperscene.materials import Surface
from pepperscene.recipe.resolve.load import parse_changes, resolve_recipe
from pepperscene.render import Renderer
from pepperscene.review.report.data import evenly_spaced
from pepperscene.scene import Scene

FULL: Final = "full"
FEWER_FRAMES: Final = (30, 100, 300, 1000, 3000)
FEWER_PLANTS: Final = 4  # chosen: a tenth of the sets of plants of `randomised`

WEAR: Final = (("lamina", "residue"), ("fruit", "residue"), ("lamina", "ageing"))
"""Organs and their keys that make a crop look used."""

ABLATIONS: Final[Mapping[str, Mapping[str, Any]]] = MappingProxyType(
    {
        "no sensor noise": {"developing.shot_noise": False, "developing.read_noise": False},
        "no far rows": {"greenhouse.far_rows": 0},
    }
)
"""Changes of the recipe by name of the variant; those of other variants depend on the recipe."""

BAND_EDGES_NM: Final = (490.0, 585.0)
"""Between blue, green and red: chosen, where the sensitivities of cameras to two of them are about equal."""


def without_gloss(surface: Surface) -> Surface:
    """A surface without a cuticle: its body is matt."""
    return replace(surface, ior=1.0, wide_roughness=None)


def without_relief(surface: Surface) -> Surface:
    """A surface whose normals are those of the mesh."""
    return replace(surface, relief_mm=None)


def in_three_bands(surface: Surface) -> Surface:
    """A surface of three reflectances, as a renderer in RGB has: the means over each band."""
    wavelength_nm = surface.wavelength_nm
    band = np.searchsorted(BAND_EDGES_NM, wavelength_nm, side="right")
    visible = (wavelength_nm >= 400) & (wavelength_nm <= 700)

    def banded(spectra: NDArray[np.float64]) -> NDArray[np.float64]:
        means = np.stack([spectra[..., visible & (band == which)].mean(axis=-1) for which in range(3)], -1)
        return means[..., band]

    return replace(
        surface, reflectance=banded(surface.reflectance), transmittance=banded(surface.transmittance)
    )


def render_with(change: Callable[[Surface], Surface], scene: Scene) -> Renderer:
    """The renderer of a scene whose surfaces are changed."""
    return mitsuba_renderer(replace(scene, surfaces=tuple(change(surface) for surface in scene.surfaces)))


SURFACES: Final[Mapping[str, Callable[[Surface], Surface]]] = MappingProxyType(
    {"no gloss": without_gloss, "no relief": without_relief, "RGB light": in_three_bands}
)
"""Changes of surfaces by name of the variant."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Build, train, test, and print the table."""
    options = parse_arguments(arguments)
    try:
        sets = {name: (build_variant(name, changes, options),) for name, changes in variants(options).items()}
        curve = [open_images(folder) for folder in options.curve]
        sets |= fewer_frames(curve or sets[FULL])
        sets |= {f"{count_images(curve):,} frames": tuple(curve)} if curve else {}
        jobs = schedule(sets, options)
        runner = JobRunner(options.out, jobs, jobs[0].options, print_message)
        runner.run()
        results = {name: collect(name, jobs, runner) for name in sets}
    except PepperError as error:
        echo_progress(f"error: {error}")
        return 2
    rows = table_rows({name: count_images(parts) for name, parts in sets.items()}, results)
    write_file(options.out / "ablation.csv", as_csv(rows).encode())
    write_file(options.out / "ablation.md", as_markdown(rows).encode())
    print(as_markdown(rows))
    return 0


def parse_arguments(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--recipe", default="randomised")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="change all variants")
    parser.add_argument("--real", type=Path, required=True, help="photographs with masks")
    parser.add_argument("--labels", help="meaning of their masks")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--variants", help="comma-separated; default: all")
    parser.add_argument("--frames", type=int, default=1000, help="of each set")
    parser.add_argument(
        "--curve",
        action="append",
        default=[],
        metavar="SET",
        help="sets of the full recipe, to train on parts",
    )
    parser.add_argument("--size", default="400x300")
    parser.add_argument("--quality", default="standard")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--steps", type=int, default=2000)
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--crop", default="256x256")
    parser.add_argument("--width", type=int, default=400, help="to which images are scaled, in pixels")
    parser.add_argument("--model", default="small")
    parser.add_argument("--classes", default=FRUIT_CLASSES)
    parser.add_argument("--workers", type=int, default=0, help="processes that read images")
    parser.add_argument("--build-workers", type=int, help="processes that render; default: one")
    parser.add_argument("--device")
    return parser.parse_args(arguments)


def variants(options: argparse.Namespace) -> dict[str, Mapping[str, Any]]:
    """Changes of the recipe by name, those that the user has chosen; the full recipe is first."""
    recipe = resolve_recipe(options.recipe, common_changes(options)).recipe
    plan = recipe.plan
    found: dict[str, Mapping[str, Any]] = {
        FULL: {},
        **ABLATIONS,
        **{name: {} for name in SURFACES},
        "no residue or ageing": clean_crop(recipe),
        "no variation": typical_values(recipe),
    }
    if plan.sets > FEWER_PLANTS:
        # As many frames in the plan, of fewer plants.
        frames = plan.frames * plan.sets // FEWER_PLANTS
        found["fewer plants"] = {"plan.sets": FEWER_PLANTS, "plan.frames": frames}
    if options.variants is None:
        return found
    chosen = [name.strip() for name in options.variants.split(",")]
    unknown = [name for name in chosen if name not in found]
    if unknown:
        raise SystemExit(f"--variants: {unknown[0]} is none of {', '.join(found)}")
    return {FULL: {}, **{name: found[name] for name in chosen}}


def clean_crop(recipe: Any) -> dict[str, Any]:
    """Changes that remove residue and ageing; they have the form of what the recipe overrides already."""
    changes: dict[str, Any] = {}
    for organ, name in WEAR:
        below = recipe.override.get("organs", {}).get(organ, {}).get(name, {})
        key = f"override.organs.{organ}.{name}"
        if "uniform" in below:
            changes[f"{key}.uniform"] = [0.0, 1e-6]
        elif "histogram" in below:
            changes[f"{key}.histogram"] = [[0.0, 1e-6, 1.0]]
        else:
            changes[key] = {"value": 0.0, "chosen": "left out to measure what it is good for"}
    return changes


def typical_values(recipe: Any) -> dict[str, Any]:
    """Fixed values for all that varies from frame to frame or from row to row, apart from views and plants.

    They are those in the middle of each distribution. The plants of a row still differ from each other.
    """
    changes: dict[str, Any] = {}
    for name in (varied.name for varied in recipe.variation):
        parts = name.split(".")
        if parts[0] in ("override", "views"):
            continue
        value = recipe
        for part in parts:
            value = getattr(value, part, None)
        # Elements of lists have no key of their own.
        changes |= {name: value} if value is not None else {".".join(parts[:-1]): [1.0, 1.0, 1.0]}
    return changes


def common_changes(options: argparse.Namespace) -> dict[str, Any]:
    """Changes of all variants."""
    width, _, height = options.size.partition("x")
    return {"camera.width": int(width), "camera.height": int(height), **parse_changes(options.set)}


def build_variant(name: str, changes: Mapping[str, Any], options: argparse.Namespace) -> ImageSet:
    """Render the missing frames of a variant, at the indices of all others."""
    recipe = resolve_recipe(options.recipe, {**common_changes(options), **changes})
    folder = options.out / "sets" / name.replace(" ", "_")
    frames = spread_frames(recipe.recipe.plan, options.frames)
    result = build(
        recipe,
        folder,
        frames,
        OUTPUTS,
        BuildOptions(
            quality=options.quality,
            workers=options.build_workers,
            renderer=partial(render_with, SURFACES[name]) if name in SURFACES else None,
        ),
        on_frame=lambda progress: print_message(f"{name}: frame {progress.done} of {progress.total}", True),
    )
    return open_images(result.dataset.folder)


def fewer_frames(sets: Sequence[ImageSet]) -> dict[str, tuple[ImageSet, ...]]:
    """Parts of sets of the full recipe, each with its share of the frames."""
    total = count_images(sets)
    counts = [count for count in FEWER_FRAMES if count < total]
    return {
        f"{count} frames": tuple(
            images.take(evenly_spaced(len(images), round(count * len(images) / total))) for images in sets
        )
        for count in counts
    }


def count_images(sets: Sequence[ImageSet]) -> int:
    """Number of images of several sets."""
    return sum(len(images) for images in sets)


def schedule(sets: Mapping[str, Sequence[ImageSet]], options: argparse.Namespace) -> list[NetworkJob]:
    """A network for each seed and set, tested on all photographs."""
    real = open_images(options.real, labels=options.labels)
    test = NetworkTest("B", (real,), ClassTable.parse(options.classes))
    width, _, height = options.crop.partition("x")
    size = (int(height), int(width))
    return [
        NetworkJob(
            f"seed{seed}_{name.replace(' ', '_')}",
            name,
            seed,
            None,
            TrainingOptions(
                options.model,
                None,
                options.steps,
                options.batch,
                size,
                options.width,
                seed=seed,
                workers=options.workers,
                device=options.device,
            ).completed(),
            tuple(parts),
            tests=(test,),
        )
        for seed in range(1, options.seeds + 1)
        for name, parts in sets.items()
    ]


def collect(name: str, jobs: Sequence[NetworkJob], runner: JobRunner) -> ExperimentResult:
    """The result of a variant."""
    own = [job for job in jobs if job.experiment == name]
    return collect_result(name, {job.seed: [runner.result(job, job.tests[0])] for job in own})


def table_rows(frames: Mapping[str, int], results: Mapping[str, ExperimentResult]) -> list[dict[str, Any]]:
    """A row for each variant and class, with the difference to the full recipe."""
    rows = []
    for name, result in results.items():
        differences = compare_results(result, results[FULL]).measures
        for measure, (_, difference) in zip(result.measures(), differences, strict=True):
            estimate = measure.estimate
            rows.append(
                {
                    "variant": name, "frames": frames[name], "class": measure.name,
                    "iou": estimate.value, "low": estimate.low, "high": estimate.high,
                    "sd_over_seeds": measure.deviation, "difference": difference.value,
                    "difference_low": difference.low, "difference_high": difference.high,
                }
            )  # fmt: skip
    return rows


def as_csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """All numbers, one row for each variant and class."""
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, rows[0])
    writer.writeheader()
    writer.writerows(rows)
    return buffer.getvalue()


def as_markdown(rows: Sequence[Mapping[str, Any]]) -> str:
    """A table for people: IoU of all classes in percent, and the difference of the mean."""
    names = list(dict.fromkeys(row["class"] for row in rows))
    lines = [
        f"| variant | frames | {' | '.join(names)} | mean against {FULL} |",
        f"|---|---:|{'---:|' * (len(names) + 1)}",
    ]
    for variant in dict.fromkeys(row["variant"] for row in rows):
        own = [row for row in rows if row["variant"] == variant]
        cells = [percent(row["iou"], row["low"], row["high"]) for row in own]
        mean = own[-1]
        difference = percent(mean["difference"], mean["difference_low"], mean["difference_high"], "+")
        cells.append("" if variant == FULL else difference)
        lines.append(f"| {variant} | {own[0]['frames']:,} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def percent(value: float | None, low: float | None, high: float | None, sign: str = "") -> str:
    """A value with its interval in percent."""
    if value is None:
        return "-"
    text = f"{100 * value:{sign}.1f}"
    return text if low is None or high is None else f"{text} [{100 * low:{sign}.1f}, {100 * high:{sign}.1f}]"


def print_message(text: str, _is_frequent: bool) -> None:
    """Print what is being done."""
    echo_progress(text)


if __name__ == "__main__":
    # Workers unpickle the renderer by the name of its module, which must be one that they can import.
    from learning_ablation import main as run_main

    sys.exit(run_main())
