"""Measures the program: against itself, against the reference and against its peers."""

from pepperscene.bench.profile import profile_frames
from pepperscene.bench.run import BenchmarkFiles, run_benchmark
from pepperscene.bench.scaling import measure_scaling
from pepperscene.bench.scenes import SCENES, BenchScene, scenes_named, size_of

__all__ = [
    "SCENES",
    "BenchScene",
    "BenchmarkFiles",
    "measure_scaling",
    "profile_frames",
    "run_benchmark",
    "scenes_named",
    "size_of",
]
