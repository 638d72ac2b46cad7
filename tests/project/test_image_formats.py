"""Image formats are named wherever a file is opened: Pillow starts another program for some of the others."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

SOURCES = Path(__file__).resolve().parents[2] / "src"

REQUIRED = {"Image.open": "formats", "trimesh.load": "skip_materials"}
"""Keyword argument that a call must have: materials of a mesh name images, which Pillow opens."""

FORBIDDEN = frozenset({"imread", "imopen", "mimread", "imread_collection"})
"""Functions of image libraries that choose the format by the content."""


def problems(text: str) -> list[str]:
    """Calls that open an image of any format."""
    found = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and node.module in ("PIL.Image", "trimesh"):
            # Such an import would hide the calls from this check.
            names = {alias.name for alias in node.names} & {"open", "load"}
            found += [f"line {node.lineno}: import of {name} from {node.module}" for name in sorted(names)]
        if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute | ast.Name):
            continue
        name = ast.unparse(node.func)
        keywords = {keyword.arg for keyword in node.keywords}
        for call, keyword in REQUIRED.items():
            if (name == call or name.endswith(f".{call}")) and keyword not in keywords:
                found.append(f"line {node.lineno}: {name} without {keyword}")
        if name.rpartition(".")[2] in FORBIDDEN:
            found.append(f"line {node.lineno}: {name}")
    return found


def test_no_module_opens_an_image_of_any_format() -> None:
    modules = sorted(SOURCES.rglob("*.py"))
    found = [f"{path}: {problem}" for path in modules for problem in problems(path.read_text("utf-8"))]
    assert modules
    assert found == []


@pytest.mark.parametrize(
    "line",
    [
        "Image.open(path)",
        "PIL.Image.open(path)",
        "from PIL.Image import open",
        "imageio.v3.imread(path)",
        "trimesh.load(path)",
    ],
)
def test_each_way_to_open_an_image_of_any_format_is_found(line: str) -> None:
    assert len(problems(line)) == 1


def test_named_formats_are_allowed() -> None:
    assert problems("Image.open(path, formats=['PNG'])\ntrimesh.load(path, skip_materials=True)") == []
