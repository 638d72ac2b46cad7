"""A cultivar and grown rows for all tests; marks the tests that `make check` leaves out."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

import pytest

from pepperscene.cultivar import Cultivar, load_cultivar

pytest_plugins = ["dataset_fixtures"]

TESTS = Path(__file__).parent
UNIT = {
    "camera", "colour", "cultivar", "document", "geometry", "grammar", "materials", "scene", "spectra",
    "truth",
}  # fmt: skip
"""Folders whose tests neither render nor start processes."""
LONGEST = {"test_docs.py", "test_notebooks.py", "test_memory_growth.py"}
"""Files with tests of about a minute."""
ROWS = "PEPPERSCENE_TEST_ROWS"
"""Variable with the folder of rows, which the first of several test processes creates and removes."""


def pytest_configure(config: pytest.Config) -> None:
    # With this variable, pytest shows the whole difference of unequal images, which takes hours.
    os.environ.pop("CI", None)
    if not hasattr(config, "workerinput"):
        os.environ[ROWS] = tempfile.mkdtemp(prefix="pepperscene-rows-")


def pytest_unconfigure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):
        shutil.rmtree(os.environ.pop(ROWS, ""), ignore_errors=True)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    # The longest tests come first: at the end one of them would leave the other processes without work.
    items.sort(key=lambda item: item.path.name not in LONGEST)
    for item in items:
        if item.path.relative_to(TESTS).parts[0] not in UNIT:
            item.add_marker("slow")


@pytest.fixture(scope="session")
def kaite() -> Cultivar:
    return load_cultivar("kaite")


@pytest.fixture(scope="session")
def rows() -> Path:
    """Folder of the rows of plants that examples have grown, in any of the test processes."""
    return Path(os.environ[ROWS])
