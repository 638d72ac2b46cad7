"""Every room hands on its public names, says what they are, and is light to enter."""

from __future__ import annotations

import ast
import importlib
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import pepperscene

PACKAGE = Path(pepperscene.__file__).parent
ROOMS = [
    "pepperscene",
    *sorted(f"pepperscene.{folder.parent.name}" for folder in PACKAGE.glob("*/__init__.py")),
]
HEAVY = {
    "mitsuba",
    "drjit",
    "colour",
    "torch",
    "scipy",
    "skimage",
    "trimesh",
    "pyoidn",
    "OpenEXR",
    "matplotlib",
}


def _order(name: str) -> tuple[int, str]:
    """Constants, then classes, then functions, each by the alphabet, as ruff sorts them (RUF022)."""
    return (0 if name.isupper() else 1 if name[0].isupper() else 2), name


@pytest.mark.parametrize("room", ROOMS)
def test_the_public_names_are_sorted_and_there(room: str) -> None:
    module = importlib.import_module(room)
    assert list(module.__all__) == sorted(set(module.__all__), key=_order)
    for name in module.__all__:
        thing = getattr(module, name)
        # What can carry a docstring of its own does.
        if inspect.isclass(thing) or inspect.isfunction(thing):
            assert inspect.getdoc(thing), f"{room}.{name} has no docstring"


@pytest.mark.parametrize("room", ROOMS[1:])
def test_an_init_only_hands_on_names(room: str) -> None:
    source = inspect.getsource(importlib.import_module(room))
    docstring, *rest = ast.parse(source).body
    assert isinstance(docstring, ast.Expr)
    assert isinstance(docstring.value, ast.Constant)
    for statement in rest:
        names_all = isinstance(statement, ast.Assign) and ast.unparse(statement.targets[0]) == "__all__"
        assert names_all or isinstance(statement, ast.ImportFrom), ast.unparse(statement)


def test_importing_the_package_loads_nothing_heavy() -> None:
    code = f"import sys, pepperscene; print(sorted({HEAVY!r} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[]"
