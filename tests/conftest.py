"""A cultivar and grown rows for all tests, marks of the tiers, examples of properties, and durations."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from pepperscene.building.scenes.row_cache import CACHE
from pepperscene.cultivar import Cultivar, load_cultivar

pytest_plugins = ["dataset_fixtures"]

TESTS = Path(__file__).parent
DURATIONS = TESTS.parent / "out" / "durations.txt"
"""Seconds of each test of the last run, which `make durations` prints."""
UNIT = {
    "camera", "colour", "cultivar", "document", "geometry", "grammar", "materials", "scene", "spectra",
    "truth",
}  # fmt: skip
"""Folders whose tests neither render nor start processes."""
LONGEST = {"test_docs.py", "test_notebooks.py", "test_memory_growth.py"}
"""Files with tests of about a minute."""
ROWS = "PEPPERSCENE_TEST_ROWS"
"""Variable with the folder of rows, which the first of several test processes creates and removes."""


# Examples of properties are the same in every run: chance never decides whether a change passes.
settings.register_profile(
    "ci",
    derandomize=True,
    database=None,
    deadline=None,
    max_examples=25,
    suppress_health_check=list(HealthCheck),
)
settings.register_profile("long", settings.get_profile("ci"), max_examples=300)
settings.load_profile("ci")


def pytest_configure(config: pytest.Config) -> None:
    # With this variable, pytest shows the whole difference of unequal images, which takes hours.
    os.environ.pop("CI", None)
    # Rows are grown where tests do not ask for others.
    os.environ[CACHE] = "none"
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


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    seconds: Counter[str] = Counter()
    for reports in terminalreporter.stats.values():
        for report in reports:
            if isinstance(report, pytest.TestReport):
                seconds[report.nodeid] += report.duration
    if len(seconds) > 1000:  # a whole tier
        DURATIONS.parent.mkdir(exist_ok=True)
        lines = [f"{duration:9.2f} {name}\n" for name, duration in seconds.most_common()]
        DURATIONS.write_text("".join(lines), encoding="utf-8")
