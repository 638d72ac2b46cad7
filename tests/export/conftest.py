"""Exports and data sets that several formats share; to be read, not changed."""

from __future__ import annotations

import pytest
from label_set import FRAMES, BorderPainter
from painted_set import ALL, make_painted_set
from traced_set import ROLLING, make_traced_set

from pepperscene.export import export_dataset


@pytest.fixture(scope="package")
def exported(traced, tmp_path_factory):
    """Exports of a traced data set by format and name of the lens, each made once."""
    made = {}

    def export(format_name, lens="pinhole"):
        if (format_name, lens) not in made:
            out = tmp_path_factory.mktemp("exports") / f"{format_name}-{lens}"
            made[format_name, lens] = export_dataset(traced(lens).folder, format_name, out).folder
        return made[format_name, lens]

    return export


@pytest.fixture(scope="package")
def two_scenes(tmp_path_factory):
    """Two frames of each of two scenes."""
    changes = {"plan.sets": 2, "plan.frames": 2}
    return make_traced_set(tmp_path_factory.mktemp("scenes") / "set", frames=(0, 1, 2, 3), **changes)


@pytest.fixture(scope="package")
def ignoring(tmp_path_factory):
    """Frames with ignored pixels."""
    changes = {"greenhouse.far_rows_as": "ignore"}
    return make_traced_set(tmp_path_factory.mktemp("ignoring") / "set", **changes)


@pytest.fixture(scope="package")
def rolling(tmp_path_factory):
    """Frames whose rows have poses of their own."""
    return make_traced_set(tmp_path_factory.mktemp("rolling") / "set", "brown", rolling=ROLLING)


@pytest.fixture(scope="package")
def borders(tmp_path_factory):
    """Fruit at the borders of the image."""
    return make_painted_set(tmp_path_factory.mktemp("borders") / "set", ALL, FRAMES[:1], BorderPainter)
