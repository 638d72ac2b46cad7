"""colour-science is imported in one place, in silence."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pepperscene
from pepperscene.spectra import colour_science

PACKAGE = Path(pepperscene.__file__).parent


def imported(path):
    """The top-level packages that a file imports anywhere in it."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (name.name.partition(".")[0] for name in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield (node.module or "").partition(".")[0]


def test_there_is_one_door():
    doors = {
        path.relative_to(PACKAGE).as_posix() for path in PACKAGE.rglob("*.py") if "colour" in imported(path)
    }
    assert doors == {"spectra/colorimetry.py"}


def test_it_is_the_package():
    import colour

    assert colour_science() is colour
    assert colour_science() is colour_science()


def run(code):
    command = [sys.executable, "-W", "always", "-c", f"import sys; sys.modules['matplotlib'] = None\n{code}"]
    return subprocess.run(command, capture_output=True, text=True, timeout=120)


def test_nothing_is_said_without_matplotlib():
    # What a build asks of it: the brightness of a light and the colour correction of a camera.
    code = (
        "from pepperscene.camera import load_sensor\n"
        "from pepperscene.camera.colorimetry import correction, daylight\n"
        "from pepperscene.spectra import illuminance\n"
        "assert illuminance(daylight()) > 0\n"
        "assert correction(load_sensor('ueye_ui5250re'), daylight()).mean_delta_e_2000 > 0\n"
    )
    done = run(code)
    assert (done.returncode, done.stderr) == (0, "")


def test_other_warnings_are_left_alone():
    done = run(
        "import warnings\n"
        "from pepperscene.spectra import colour_science\n"
        "colour_science()\n"
        "assert [f for f in warnings.filters if f[1] and 'Matplotlib' in f[1].pattern] == []\n"
        "warnings.warn('something else')\n"
    )
    assert done.returncode == 0, done.stderr
    assert "something else" in done.stderr
