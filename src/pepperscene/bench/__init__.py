"""Benchmarks of this program on the user's machine."""

from pepperscene.bench.profile import profile_frames
from pepperscene.bench.records import BenchmarkFiles
from pepperscene.bench.run import run_benchmark
from pepperscene.bench.scaling import measure_scaling
from pepperscene.bench.scenes import SCENES, BenchScene, parse_size, select_scenes

__all__ = [
    "SCENES",
    "BenchScene",
    "BenchmarkFiles",
    "measure_scaling",
    "parse_size",
    "profile_frames",
    "run_benchmark",
    "select_scenes",
]
