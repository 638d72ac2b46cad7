"""The sources of the package as syntax trees, each parsed once a process."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import pepperscene

PACKAGE = Path(pepperscene.__file__).parent
SOURCES = sorted(PACKAGE.rglob("*.py"))


def name_of(path: Path) -> str:
    """Path relative to the package; the name of a file elsewhere."""
    return path.relative_to(PACKAGE).as_posix() if path.is_relative_to(PACKAGE) else path.name


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def nodes(path: Path) -> tuple[ast.AST, ...]:
    """All nodes of a file."""
    return tuple(ast.walk(tree(path)))


@cache
def calls(path: Path) -> tuple[tuple[str, ast.Call], ...]:
    """All calls of a file, each with the dotted name of what is called; "" stands for an expression in it."""
    return tuple((_dotted_name(node.func), node) for node in nodes(path) if isinstance(node, ast.Call))


def _dotted_name(node: ast.expr) -> str:
    if isinstance(node, ast.Attribute):
        return f"{_dotted_name(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


def keywords_of(call: ast.Call) -> dict[str | None, str]:
    """The keyword arguments of a call: constants as text, "" for others."""
    values = {keyword.arg: keyword.value for keyword in call.keywords}
    return {name: repr(v.value) if isinstance(v, ast.Constant) else "" for name, v in values.items()}
