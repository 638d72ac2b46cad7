"""Rows of plants that examples and tests share, so that each is grown once.

Pages and notebooks run in new processes, and most show frames of the same set of plants: growing them takes
half of the time of an example. Everything else of an example runs as for a reader.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pepperscene.building.scenes.row_cache import CACHE


def install_code(folder: Path) -> str:
    """Code for the beginning of a process that takes rows from a folder."""
    return f"import os\nos.environ[{CACHE!r}] = {str(folder)!r}\ndel os\n"


@contextmanager
def rows_from(folder: Path) -> Iterator[None]:
    """Within the context, this process takes rows from a folder and adds those that it grows."""
    import pytest

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(CACHE, str(folder))
        yield
