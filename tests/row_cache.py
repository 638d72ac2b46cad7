"""Stores grown rows in a folder, so that pages and notebooks grow each row once.

Each of them runs in a new process, and most show frames of the same set of plants: growing them takes half of the
time of an example. Everything else of an example runs as for a reader.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import pickle
import sys
from collections.abc import Callable
from functools import wraps
from importlib.abc import MetaPathFinder
from pathlib import Path
from types import ModuleType
from typing import Any

BUILDER = "pepperscene.dataset.scenes.scene_builder"


def install_code(folder: Path) -> str:
    """Code for the beginning of a process that takes rows from a folder."""
    tests = str(Path(__file__).parent)
    return f"""
import sys
sys.path.insert(1, {tests!r})
import row_cache
row_cache.install({str(folder)!r})
sys.path.remove({tests!r})
del row_cache, sys
"""


def install(folder: str) -> None:
    """Let this process take rows from a folder and add those that it grows.

    The module that grows them is changed when an example imports it: imported here, it would hide that an example
    lacks an import.
    """
    sys.meta_path.insert(0, _Finder(Path(folder)))


class _Finder(MetaPathFinder):
    """Wraps the functions of the builder's module after its import."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def find_spec(self, name: str, path: Any = None, target: ModuleType | None = None) -> Any:
        if name != BUILDER:
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        assert spec is not None
        assert spec.loader is not None
        execute = spec.loader.exec_module

        def execute_and_wrap(module: ModuleType) -> None:
            execute(module)
            builder = module.SceneBuilder
            for method in ("scene", "plants"):
                setattr(builder, method, _stored(self._folder, getattr(builder, method)))

        spec.loader.exec_module = execute_and_wrap  # type: ignore[method-assign]
        return spec


def _stored(folder: Path, method: Callable[..., Any]) -> Callable[..., Any]:
    """A method of the builder whose results are stored, by everything that they depend on."""

    @wraps(method)
    def read_or_make(builder: Any, *indices: int) -> Any:
        recipe = builder.recipe
        inputs = (builder.cultivar, recipe.row, recipe.greenhouse, recipe.twine, recipe.seed, indices)
        key = hashlib.sha256(repr((method.__name__, *inputs)).encode()).hexdigest()
        file = folder / f"{key}.pickle"
        if file.exists():
            return pickle.loads(file.read_bytes())
        result = method(builder, *indices)
        unfinished = folder / f"{key}.{os.getpid()}"
        unfinished.write_bytes(pickle.dumps(result))
        unfinished.replace(file)
        return result

    return read_or_make
