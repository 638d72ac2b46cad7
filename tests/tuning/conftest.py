"""Views of different recipes share grown rows: they differ in light, camera and pigments."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from row_cache import rows_from


@pytest.fixture(scope="module", autouse=True)
def _shared_rows(rows: Path) -> Iterator[None]:
    with rows_from(rows):
        yield
