"""colour-science is imported in one module, without its warning."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pepperscene
from pepperscene.spectra import colour_science

PACKAGE = Path(pepperscene.__file__).parent


def imported_packages(path):
    """Top-level packages that a file imports anywhere."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (name.name.partition(".")[0] for name in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield (node.module or "").partition(".")[0]


def test_one_module_imports_colour():
    modules = {
        path.relative_to(PACKAGE).as_posix()
        for path in PACKAGE.rglob("*.py")
        if "colour" in imported_packages(path)
    }
    assert modules == {"spectra/lights.py"}


def test_returns_the_package():
    import colour

    assert colour_science() is colour


def test_only_the_matplotlib_warning_is_suppressed():
    # What the colour correction of a camera needs of it.
    code = (
        "import sys; sys.modules['matplotlib'] = None\n"
        "import warnings\n"
        "from pepperscene.spectra import colour_science\n"
        "colour = colour_science()\n"
        "lab = colour.XYZ_to_Lab(colour.MSDS_CMFS['CIE 1931 2 Degree Standard Observer'].values[50])\n"
        "assert colour.delta_E(lab, lab, method='CIE 2000') == 0\n"
        "assert not any(f[1] and 'Matplotlib' in f[1].pattern for f in warnings.filters)\n"
        "warnings.warn('something else')\n"
    )
    command = [sys.executable, "-W", "always", "-c", code]
    result = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert result.returncode == 0, result.stderr
    warnings = [line for line in result.stderr.splitlines() if "Warning" in line]
    assert len(warnings) == 1
    assert "something else" in warnings[0]
