"""A data set of fruit at the borders of the image."""

from __future__ import annotations

import pytest
from label_set import FRAMES, BorderPainter
from painted_set import ALL, make_painted_set


@pytest.fixture(scope="package")
def borders(tmp_path_factory):
    return make_painted_set(tmp_path_factory.mktemp("borders") / "set", ALL, FRAMES[:1], BorderPainter)
