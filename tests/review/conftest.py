"""A browser for the pages of reports."""

from __future__ import annotations

import pytest
from chromium import Browser


@pytest.fixture(scope="module")
def started(tmp_path_factory):
    browser = Browser(tmp_path_factory.mktemp("profile"))
    yield browser
    browser.close()
