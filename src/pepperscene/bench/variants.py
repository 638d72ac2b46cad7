"""The other variants of Mitsuba that run here: each is measured in a process of its own.

A process keeps the variant that it began with, so that another one cannot be measured in turn with it.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pepperscene.bench.measure import BenchResult, measure_settings
from pepperscene.bench.reference import Errors, converged
from pepperscene.bench.scenes import SCENES, bench_subject
from pepperscene.bench.settings import NAMED, settings
from pepperscene.errors import SetupError


def other_variants() -> tuple[str, ...]:
    """The variants that run on this machine, but for the one that this process renders with."""
    from pepperscene.render.variant import VARIANTS, choose_variant, variant_name

    found = []
    for name in VARIANTS:
        try:
            found.append(choose_variant(name))
        except SetupError:
            continue
    return tuple(name for name in found if name != variant_name())


def measure_variant(
    variant: str, scene: str, size: tuple[int, int] | None, runs: int, references: Path, *, quick: bool
) -> list[BenchResult]:
    """The named qualities of a scene with another variant.

    Raises:
        SetupError: its process failed.
    """
    asked = {"scene": scene, "size": size, "runs": runs, "references": str(references), "quick": quick}
    done = subprocess.run(
        [sys.executable, "-m", "pepperscene.bench.variants", json.dumps(asked)],
        env={**os.environ, "PEPPERSCENE_VARIANT": variant},
        capture_output=True,
        text=True,
    )
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no word"])[-1]
        raise SetupError(f"{variant} failed in a process of its own: {last}")
    return [
        BenchResult(**{**one, "errors": Errors(**one["errors"]), "seconds": tuple(one["seconds"])})
        for one in json.loads(done.stdout.splitlines()[-1])
    ]


def _child(asked: dict[str, Any]) -> list[dict[str, Any]]:
    size = tuple(asked["size"]) if asked["size"] else None
    measured_at = bench_subject(SCENES[asked["scene"]], size, asked["runs"])
    # The parent has rendered the reference; what is there is taken as it is.
    reference = converged(measured_at, Path(asked["references"]), limit_s=0.0)
    chosen = [one for one in settings(quick=asked["quick"]) if one.family == NAMED]
    found = [asdict(one) for one in measure_settings(measured_at, chosen, reference, asked["runs"])]
    return [{**one, "family": f"{NAMED}, {one['variant']}"} for one in found]


if __name__ == "__main__":
    sys.stdout.write(json.dumps(_child(json.loads(sys.argv[1]))) + "\n")
