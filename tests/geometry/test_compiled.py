"""Functions that Numba compiles."""

from __future__ import annotations

import subprocess
import sys

from pepperscene.geometry.contacts.compiled import compiled


def test_functions_without_a_folder_for_their_code_are_compiled() -> None:
    """The code of a function that was not read from a file has no folder."""
    names: dict[str, object] = {}
    exec("def add(a, b):\n    return a + b", names)
    assert compiled(names["add"])(2, 3) == 5


def test_numba_is_imported_with_the_first_contacts_only() -> None:
    code = "import sys, pepperscene as ps; ps.mesh_plant; print('numba' in sys.modules)"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.split() == ["False"]
