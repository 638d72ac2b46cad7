"""The page about harvest lists the columns of the table of fruit."""

from __future__ import annotations

import re
from pathlib import Path

from pepperscene.dataset.store.manifest import FRUIT_COLUMNS

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "harvest.md"


def test_the_page_lists_all_columns_with_their_types():
    section = PAGE.read_text(encoding="utf-8").partition("## Table of fruit")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| (`.*?) \| (\w+) \|", section, re.MULTILINE)
    listed = {name: kind for names, kind in rows for name in re.findall(r"`(\w+)`", names)}
    assert listed == dict(FRUIT_COLUMNS)
    assert list(listed) == list(FRUIT_COLUMNS)
