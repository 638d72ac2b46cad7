"""Docstrings name only attributes and arguments that exist."""

from __future__ import annotations

import ast
import re
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[2] / "src" / "pepperscene"
ENTRY = re.compile(r"([\w*]+(?:, [\w*]+)*)(?: \([^)]*\))?:(?:\s|$)")


def entries(docstring: str | None, section: str) -> list[str]:
    """The names that a section such as "Args" lists."""
    names: list[str] = []
    base = indent = None
    for line in (docstring or "").splitlines():
        depth = len(line) - len(line.lstrip())
        if line.strip() == f"{section}:":
            base, indent = depth, None
        elif base is not None and line.strip():
            if depth <= base:
                break
            indent = depth if indent is None else indent
            if depth == indent and (found := ENTRY.match(line.strip())):
                names += [name.strip("* ") for name in found[1].split(",")]
    return names


def members(node: ast.ClassDef, classes: dict[str, ast.ClassDef]) -> set[str]:
    """Names of a class and its bases: fields, methods, and what methods assign to `self`."""
    names: set[str] = set()
    for base in node.bases:
        if isinstance(base, ast.Name) and base.id in classes:
            names |= members(classes[base.id], classes)
    for item in ast.walk(node):
        if isinstance(item, ast.Name) and isinstance(item.ctx, ast.Store):
            names.add(item.id)
        elif isinstance(item, ast.Attribute) and isinstance(item.ctx, ast.Store):
            names.add(item.attr)
        elif isinstance(item, ast.FunctionDef):
            names.add(item.name)
    return names


def arguments(node: ast.FunctionDef | None) -> set[str]:
    return set() if node is None else {item.arg for item in ast.walk(node.args) if isinstance(item, ast.arg)}


def test_docstrings_name_what_exists():
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for path in sorted(SOURCE.rglob("*.py"))}
    nodes = [(path, node) for path, tree in trees.items() for node in ast.walk(tree)]
    classes = {node.name: node for _, node in nodes if isinstance(node, ast.ClassDef)}
    missing, read = [], 0
    for path, node in nodes:
        if isinstance(node, ast.ClassDef):
            makers = [
                item for item in node.body if isinstance(item, ast.FunctionDef) and item.name == "__init__"
            ]
            known = members(node, classes) | arguments(makers[0] if makers else None)
            named = entries(ast.get_docstring(node), "Attributes") + entries(ast.get_docstring(node), "Args")
        elif isinstance(node, ast.FunctionDef):
            known, named = arguments(node), entries(ast.get_docstring(node), "Args")
        else:
            continue
        read += len(named)
        missing += [f"{path.name}: {node.name}: {name}" for name in named if name not in known]
    assert missing == []
    assert read > 1000
