"""Measures the program: against itself, against the reference and against its peers."""

from pepperscene.bench.profile import profile
from pepperscene.bench.run import Bench, bench
from pepperscene.bench.scaling import scaling
from pepperscene.bench.scenes import SCENES, BenchScene, scenes_named, size_of

__all__ = ["SCENES", "Bench", "BenchScene", "bench", "profile", "scaling", "scenes_named", "size_of"]
