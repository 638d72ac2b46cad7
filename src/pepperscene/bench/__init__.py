"""Measures the program: against itself, against the reference and against its peers."""

from pepperscene.bench.against_error import Bench, bench
from pepperscene.bench.costs import scaling
from pepperscene.bench.scenes import SCENES, BenchScene, scenes_named, size_of
from pepperscene.bench.stages import profile

__all__ = ["SCENES", "Bench", "BenchScene", "bench", "profile", "scaling", "scenes_named", "size_of"]
