"""The page about realism: its table is that of the script, and its quick figures are those of today."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
FIGURES = ROOT / "docs" / "figures"
PAGE = ROOT / "docs" / "explanation" / "realism.md"


@pytest.fixture(scope="module")
def script():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(FIGURES))
        yield importlib.import_module("realism")


@pytest.fixture(scope="module")
def targets(script):
    return importlib.import_module("realism_targets")


@pytest.fixture(scope="module")
def lines(script):
    """Rows of the table between the markers."""
    text = PAGE.read_text(encoding="utf-8")
    assert text.count(script.BEGIN) == text.count(script.END) == 1
    table = text.partition(script.BEGIN)[2].partition(script.END)[0]
    return [line for line in table.splitlines() if line.startswith("| ")]


def test_quick_figures_are_those_of_the_functions(targets, lines):
    stale = [cells for row in targets.ROWS if (cells := row.cells(row.measure())) not in lines]
    assert stale == [], "run docs/figures/realism.py"


def test_table_has_a_finite_value_in_every_row(targets, lines):
    assert lines[0] == "| measure | target | reached | within |"
    rows = [line.strip("| ").split(" | ") for line in lines[1:]]
    assert len(rows) == len(targets.ROWS) + 11
    for name, _, value, within in rows:
        assert np.isfinite(float(value)), name
        assert within in ("yes", "no")
    assert len({row[0] for row in rows}) == len(rows)


def test_pictures_exist_and_are_small(script):
    pictures = [script.IMAGES / f"realism_{pair.recipe}.jpg" for pair in script.PAIRS]
    assert sum(picture.stat().st_size for picture in pictures) < 3_000_000
    text = PAGE.read_text(encoding="utf-8")
    for picture in pictures:
        assert f"../images/{picture.name}" in text
    assert "CC BY-SA 4.0" in text
    shown = {pair.photo for pair in script.PAIRS} | set(script.TEST_PHOTOS)
    licence = (script.PHOTOS / "LICENCE.txt").read_text(encoding="utf-8")
    assert "`img6.png` to `img12.png`" in licence
    assert all(6 <= int(re.sub(r"\D", "", name)) <= 12 for name in shown)


def test_crops_have_the_same_scale(script):
    stripes = np.zeros((300, 400, 3), np.uint8)
    stripes[:, ::20] = 255
    # Stripes 20 pixels apart, 1 mm a pixel: 5 in 100 mm, wherever the centre is.
    for centre in ((200, 150), (0, 0), (399, 299)):
        part = np.asarray(script.crop(stripes, centre, 100.0, 1.0))[150, :, 0]
        assert part.shape == (script.CELL[0],)
        edges = np.count_nonzero((part[1:] > 100) & (part[:-1] <= 100))
        assert edges in (4, 5)
    whole = script.crop(stripes, (200, 150), np.inf, 1.0)
    assert whole.size == script.CELL
