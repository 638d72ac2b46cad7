"""Stores grown rows in a folder, so that pages, notebooks and tests of tuning grow each row once.

Pages and notebooks run in new processes, and most show frames of the same set of plants: growing them takes
half of the time of an example. Everything else of an example runs as for a reader.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import pickle
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from importlib.abc import MetaPathFinder
from pathlib import Path
from types import ModuleType
from typing import Any

BUILDER = "pepperscene.building.scenes.scene_builder"


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

    The module that grows them is changed when an example imports it: imported here, it would hide that an
    example lacks an import.
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
            for name, method in _stored_methods(self._folder, module.SceneBuilder).items():
                setattr(module.SceneBuilder, name, method)

        spec.loader.exec_module = execute_and_wrap
        return spec


@contextmanager
def rows_from(folder: Path) -> Iterator[None]:
    """Within the context, this process takes rows from a folder and adds those that it grows."""
    import pytest

    from pepperscene.building.scenes.scene_builder import SceneBuilder

    with pytest.MonkeyPatch.context() as patch:
        for name, method in _stored_methods(folder, SceneBuilder).items():
            patch.setattr(SceneBuilder, name, method)
        yield


def _stored_methods(folder: Path, builder: type) -> dict[str, Callable[..., Any]]:
    return {name: _stored(folder, getattr(builder, name)) for name in ("scene", "plants")}


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
