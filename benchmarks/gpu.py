"""Tests, benchmark and speed of a build on an NVIDIA GPU, with one command.

    python benchmarks/gpu.py --out out/gpu

1. The tests of `tests/laws` and `tests/render` with the variant `cuda_ad_spectral`.
2. `pepperscene bench` on the scene `flash`, with both variants in one table.
3. A build of `barth2018` with all default outputs by each variant: frames per second, from the second frame.
4. The stages of a frame with each variant: what remains on the processor limits the rate.

Without a GPU that can render it says why, and ends with exit code 0.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

from pepperscene.bench.records import describe_machine, machine_info
from pepperscene.errors import SetupError
from pepperscene.render.variant import VARIANTS, choose_variant

GPU: Final = "cuda_ad_spectral"

BUILD_RATE: Final = """
import sys, time
import pepperscene as ps

out, frames = sys.argv[1], int(sys.argv[2])
times = []
ps.build("barth2018", out, range(frames), on_frame=lambda _: times.append(time.perf_counter()))
print((len(times) - 1) / (times[-1] - times[0]))
"""
"""A frame is reported while the next one is rendered, so the first one with its scene does not count."""


def run(command: list[str], variant: str) -> subprocess.CompletedProcess[str]:
    """Run Python with a variant of Mitsuba; the output of programs is printed as it comes."""
    environment = {**os.environ, "PEPPERSCENE_VARIANT": variant}
    return subprocess.run([sys.executable, "-P", *command], env=environment, text=True, check=False)


def build_rate(variant: str, frames: int) -> float:
    """Frames per second of a build in one process."""
    with tempfile.TemporaryDirectory() as folder:
        completed = subprocess.run(
            [sys.executable, "-P", "-c", BUILD_RATE, str(Path(folder) / "set"), str(frames)],
            env={**os.environ, "PEPPERSCENE_VARIANT": variant},
            capture_output=True,
            text=True,
            check=True,
        )
    return float(completed.stdout.splitlines()[-1])


def main() -> None:
    """Measure and print; the exit code is that of the tests."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True, help="folder for tables and plots")
    parser.add_argument("--frames", type=int, default=60, help="frames of each build (default: 60)")
    parser.add_argument(
        "--budget", type=float, default=300.0, help="seconds for the benchmark (default: 300)"
    )
    parser.add_argument("--no-tests", action="store_true", help="leave out the tests")
    options = parser.parse_args()
    sys.stdout.write(describe_machine(machine_info()) + "\n\n")
    try:
        choose_variant(GPU)
    except SetupError as error:
        sys.stdout.write(f"Skipped: {error}.\n")
        return

    status = 0
    if not options.no_tests:
        root = Path(__file__).resolve().parents[1]
        tests = [str(root / "tests" / part) for part in ("laws", "render")]
        status = run(["-m", "pytest", "-q", *tests], GPU).returncode
    bench = ["-m", "pepperscene", "bench", "--scene", "flash", "--out", str(options.out)]
    run([*bench, "--budget", f"{options.budget:g}"], GPU)
    for variant in VARIANTS:
        sys.stdout.write(
            f"{variant}: {build_rate(variant, options.frames):.2f} frames per second of a build\n"
        )
        run([*bench, "--profile"], variant)
    raise SystemExit(status)


if __name__ == "__main__":
    main()
