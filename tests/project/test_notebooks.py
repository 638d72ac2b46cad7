"""Notebooks run from top to bottom and are stored without outputs."""

from __future__ import annotations

import ast
import importlib
import json
import subprocess
import sys
from pathlib import Path

import pytest
import row_cache

import pepperscene

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.name)
def test_notebook_has_no_outputs_and_uses_names_that_exist(notebook: Path) -> None:
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert code
    assert all(not cell["outputs"] and cell["execution_count"] is None for cell in code)
    for node in ast.walk(ast.parse("\n".join("".join(cell["source"]) for cell in code))):
        if isinstance(node, ast.Attribute) and ast.unparse(node.value) in ("ps", "pepperscene"):
            assert hasattr(pepperscene, node.attr), node.attr
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("pepperscene"):
            module = importlib.import_module(str(node.module))
            assert [alias.name for alias in node.names if not hasattr(module, alias.name)] == []


@pytest.mark.long
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.name)
def test_notebook_runs(notebook: Path, tmp_path: Path, rows: Path) -> None:
    # In a subprocess, because kernels and their sockets emit warnings, which are errors here.
    code = (
        "import sys, nbformat, nbclient\n"
        "notebook = nbformat.read(sys.argv[1], as_version=4)\n"
        "notebook.cells.insert(0, nbformat.v4.new_code_cell(sys.argv[3]))\n"
        "resources = {'metadata': {'path': sys.argv[2]}}\n"
        "nbclient.NotebookClient(notebook, timeout=600, resources=resources).execute()\n"
    )
    command = [sys.executable, "-c", code, str(notebook), str(tmp_path), row_cache.install_code(rows)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr[-4000:]
