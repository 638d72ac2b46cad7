"""A changed bit in a file of a data set is found if it changes a value, and the next build repairs it."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
from data_sets import contents, set_without_plants
from disc_set import DiscRenderer
from pyarrow import ArrowException, parquet

from pepperscene.errors import OutputError
from pepperscene.review.check import check_dataset

OUTPUTS = ("colour", "class", "instance", "distance")
CHANGES = {"plan.rotations": 1, "plan.frames": 3, "camera.baseline_mm": 60.0}
FILES = (
    "manifest.parquet",
    "dataset.json",
    "frames/000001.json",
    "colour/000001.png",
    "distance/000001.exr",
)


def build_discs(folder):
    return set_without_plants(folder, range(3), OUTPUTS, DiscRenderer, CHANGES)


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    """A correct data set of three frames."""
    folder = tmp_path_factory.mktemp("flips") / "original"
    build_discs(folder)
    assert check_dataset(folder, workers=1).passed
    return folder


def values(path):
    """What a reader of the file gets; None if it cannot be read."""
    content = path.read_bytes()
    try:
        if path.suffix == ".parquet":
            table = parquet.read_table(path)
            return [(field.name, str(field.type)) for field in table.schema], table.to_pylist()
        return json.loads(content) if path.suffix == ".json" else content
    except (ArrowException, OSError, ValueError, LookupError, TypeError):
        return None


def flip(path, rng):
    content = bytearray(path.read_bytes())
    position, bit = int(rng.integers(len(content))), int(rng.integers(8))
    content[position] ^= 1 << bit
    path.write_bytes(content)
    return f"bit {bit} of byte {position}"


@pytest.mark.parametrize("flips", [3, pytest.param(100, marks=pytest.mark.long)])
@pytest.mark.parametrize("name", FILES)
def test_flipped_bits_are_found_and_repaired(original, tmp_path, name, flips):
    folder, rng = tmp_path / "set", np.random.default_rng(15)
    expected, images = values(original / name), contents(original)
    changed = 0
    for _ in range(flips):
        shutil.copytree(original, folder)
        where = flip(folder / name, rng)
        changed_value = values(folder / name) != expected
        result = check_dataset(folder, workers=1)
        assert not (changed_value and result.passed), f"{name}: {where} is not found"
        if "/" in name:
            assert {finding.index for finding in result.findings} - {None} == {1}
        changed += changed_value
        if name == "dataset.json" and not result.passed:
            with pytest.raises(OutputError, match=name):
                build_discs(folder)
        else:
            build_discs(folder)
            after = check_dataset(folder, workers=1)
            assert after.passed, f"{name}: {where} is not repaired: {after.findings}"
            assert contents(folder) == images, f"{name}: {where}"
        shutil.rmtree(folder)
    assert changed > flips // 4
