"""The bench itself: run time against error on each scene, with a plot, tables and every single time."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any, Final

from pepperscene.bench.measure import BenchResult, Told, measure_settings
from pepperscene.bench.peers import check_peers, measure_cycles
from pepperscene.bench.plot import pareto
from pepperscene.bench.records import FORMAT, csv_text, machine_info, plain, row, sentence, write_all
from pepperscene.bench.reference import Converged, check_extra, converged
from pepperscene.bench.scenes import SCENES, BenchScene, RendererFactory, bench_subject
from pepperscene.bench.settings import settings
from pepperscene.bench.tables import error_table, ratio_table, ratios
from pepperscene.bench.variants import measure_variant, other_variants
from pepperscene.camera import Camera
from pepperscene.dataset.store.atomic import canonical_json
from pepperscene.dataset.store.folder import check_can_create
from pepperscene.errors import ArgumentError, OutputError
from pepperscene.render import QUALITIES

LEAST_RUNS: Final = 5
"""Rounds of a whole bench: a median of fewer says little."""

REFERENCES: Final = "references"
"""Folder of the converged pictures, inside the bench's own."""

_REFERENCE_SHARE: Final = 0.5
"""Chosen: of a time limit, what the reference may take where it is not there yet."""

_QUICK: Final = dataclasses.replace(QUALITIES["reference"], samples=64, soft=64, most=64)
"""Of the two pictures that a quick bench takes for its reference."""


@dataclass(frozen=True)
class BenchmarkFiles:
    """What came out.

    Attributes:
        files: that were written.
        markdown: the tables.
    """

    files: tuple[Path, ...]
    markdown: str


@dataclass(frozen=True, eq=False)
class _SceneResult:
    scene: BenchScene
    camera: Camera
    triangles: int
    of_triangles: int
    reference: Converged
    measured: tuple[BenchResult, ...]
    cycles_floor: float | None


def run_benchmark(
    out: str | Path,
    scenes: Sequence[BenchScene] = tuple(SCENES.values()),
    size: tuple[int, int] | None = None,
    *,
    runs: int = LEAST_RUNS,
    budget_s: float | None = None,
    quick: bool = False,
    peers: bool = False,
    factory: RendererFactory | None = None,
    told: Told = lambda _: None,
) -> BenchmarkFiles:
    """Measure run time against error and write what came of it.

    Args:
        out: folder; made when missing. Files of an earlier bench are replaced, its references are used.
        scenes: to render.
        size: of the pictures, or None for the cameras' own.
        runs: timed frames of each setting.
        budget_s: about how long all of it may take, shared out over the scenes; None takes what it takes.
        quick: few settings and a coarse reference, to see that all works.
        peers: whether Cycles is measured as well; it does not count for the budget.
        factory: makes the renderer of a scene; None for the render room's.
        told: is told how it goes.

    Raises:
        InputError: an argument is out of range.
        OutputError: the folder cannot be written to.
        SetupError: the machine lacks an extra or cannot render; nothing is written.
    """
    folder = Path(out)
    check_arguments(folder, runs, budget_s)
    check_extra()
    if peers:
        check_peers()
    on = machine_info()
    share = None if budget_s is None else budget_s / len(scenes)
    results = []
    for scene in scenes:
        results.append(_measured(scene, folder, size, runs, share, quick, peers, factory, told))
    found = {
        "format": FORMAT,
        "machine": on,
        "asked": {"size": size, "runs": runs, "budget_s": budget_s, "quick": quick, "peers": peers},
        "scenes": {one.scene.name: _about(one) for one in results},
        "measured": [row(one) for result in results for one in result.measured],
        "ratios": {one.scene.name: ratios(one.measured) for one in results},
    }
    markdown = "\n\n".join([sentence(on), *(_chapter(one) for one in results)]) + "\n"
    files = {
        "results.json": canonical_json(plain(found)),
        "results.csv": csv_text([one for result in results for one in result.measured]).encode(),
        "results.md": markdown.encode(),
    }
    for one in results:
        files |= _plots(one)
    return BenchmarkFiles(write_all(folder, files), markdown)


def check_arguments(folder: Path, runs: int, budget_s: float | None = None) -> None:
    """Find out before anything is measured what is wrong with the arguments.

    Raises:
        InputError: one is out of range.
        OutputError: the folder cannot be written to.
    """
    if runs < 1:
        raise ArgumentError("runs", f"{runs} must be at least 1")
    if budget_s is not None and not budget_s > 0.0:
        raise ArgumentError("budget", f"{budget_s:g} must be above 0 seconds")
    check_can_create(folder)


def _measured(
    scene: BenchScene,
    folder: Path,
    size: tuple[int, int] | None,
    runs: int,
    share: float | None,
    quick: bool,
    peers: bool,
    factory: RendererFactory | None,
    told: Told,
) -> _SceneResult:
    told(f"{scene.name}: {scene.meaning}")
    start = perf_counter()
    here = bench_subject(scene, size, runs, factory)
    references = folder / REFERENCES
    limit = 0.0 if quick else None if share is None else _REFERENCE_SHARE * share
    effort = _QUICK if quick else QUALITIES["reference"]
    reference = _kept(lambda: converged(here, references, effort, limit_s=limit, told=told), references)
    limit = None
    if share is not None:
        # What a reference out of the cache leaves is for the measuring.
        limit = max(share - (perf_counter() - start), _REFERENCE_SHARE * share)
    found = measure_settings(here, settings(quick=quick), reference, runs, limit_s=limit, told=told)
    if factory is None:
        for variant in other_variants():
            told(f"{scene.name}: {variant}")
            found += measure_variant(variant, scene.name, size, runs, references, quick=quick)
    floor = None
    if peers:
        theirs, floor = _kept(
            lambda: measure_cycles(here, references, runs, quick=quick, told=told), references
        )
        found += theirs
    # The renderer and all that it holds go before the next scene comes.
    triangles, of = (len(one.mesh.faces) for one in (here.scene, here.whole))
    return _SceneResult(scene, here.camera, triangles, of, reference, tuple(found), floor)


def _kept(make: Callable[[], Any], folder: Path) -> Any:
    """What is made with the cache, whose faults are the output folder's."""
    try:
        return make()
    except OSError as fault:
        raise OutputError(f"{fault.filename or folder}: cannot be written ({fault.strerror})") from None


def _about(one: _SceneResult) -> dict[str, Any]:
    camera, reference = one.camera, one.reference
    return {
        "recipe": one.scene.recipe,
        "changes": dict(one.scene.changes),
        "frame": one.scene.index,
        "meaning": one.scene.meaning,
        "size": [camera.width, camera.height],
        "triangles": one.triangles,
        "of_triangles": one.of_triangles,
        "reference": {
            "pictures": reference.renders,
            "seconds": reference.seconds,
            "error_codes": reference.error_codes,
            "relative_mse": reference.relative_mse,
        },
        "cycles_reference_error_codes": one.cycles_floor,
    }


def _chapter(one: _SceneResult) -> str:
    """A scene's tables with what must be said of them."""
    compared = ratios(one.measured)
    starred = any(ratio["beyond"] for ratio in compared)
    parts = [f"#### {one.scene.name.capitalize()}", _head(one), error_table(one.measured)]
    if compared:
        parts += ["The same error:", ratio_table(compared)]
    if starred:
        parts.append("\\* beyond what was measured: the line through the two outermost points, drawn on.")
    return "\n\n".join(parts)


def _head(one: _SceneResult) -> str:
    camera, reference = one.camera, one.reference
    theirs = (
        ""
        if one.cycles_floor is None
        else f" Cycles is compared with its own, whose error is {one.cycles_floor:.2f} codes."
    )
    return (
        f"{one.scene.meaning[0].upper()}{one.scene.meaning[1:]} (frame {one.scene.index} of "
        f"`{one.scene.recipe}`), {camera.width}x{camera.height}, "
        f"{one.triangles:,} triangles out of the whole scene's {one.of_triangles:,}. The reference, of the "
        f"whole scene, is the mean of "
        f"{reference.renders} pictures, not denoised; its own error is "
        f"{reference.error_codes:.3f} codes.{theirs}"
    )


def _plots(one: _SceneResult) -> dict[str, bytes]:
    camera = one.camera
    made = pareto(
        one.measured,
        f"Run time against error: {one.scene.name}",
        f"{one.scene.meaning}; {camera.width}x{camera.height}",
        one.reference.error_codes,
    )
    return {f"pareto_{one.scene.name}.{kind}": content for kind, content in made.items()}
