"""A cultivar and grown rows for all tests; marks the tests that `make check` leaves out."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from pepperscene.cultivar import Cultivar, load_cultivar

TESTS = Path(__file__).parent
UNIT = {
    "camera", "colour", "cultivar", "document", "geometry", "grammar", "materials", "scene", "spectra",
    "truth",
}  # fmt: skip
"""Folders whose tests neither render nor start processes."""


def pytest_configure() -> None:
    # With this variable, pytest shows the whole difference of unequal images, which takes hours.
    os.environ.pop("CI", None)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.path.relative_to(TESTS).parts[0] not in UNIT:
            item.add_marker("slow")


@pytest.fixture(scope="session")
def kaite() -> Cultivar:
    return load_cultivar("kaite")


@pytest.fixture(scope="session")
def rows(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Folder of the rows of plants that examples have grown; they take gigabytes."""
    folder = tmp_path_factory.mktemp("rows")
    yield folder
    shutil.rmtree(folder)
