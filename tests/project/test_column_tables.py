"""Tables of columns on the page of tables, written from their declarations by running this file."""

from __future__ import annotations

import re
from collections.abc import Mapping
from itertools import groupby
from pathlib import Path

from pepperscene.building.scenes.light_tables import LIGHT_TABLES
from pepperscene.building.scenes.trait_tables import TABLES
from pepperscene.dataset.store.manifest import FRUIT_TABLE, TableColumn

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "tables.md"
SECTIONS = {"## Fruit of the frames": FRUIT_TABLE} | {f"### `{name}`": TABLES[name] for name in TABLES}
SECTIONS |= {f"### `{name}` of light": table for name, table in LIGHT_TABLES.items()}
"""Headings of the page, and the columns of the table below each of them."""
_HEAD = "| column | type | meaning |\n|---|---|---|\n"


def lines(table: Mapping[str, TableColumn]) -> str:
    """The lines of a table; neighbouring columns of the same meaning share one."""
    groups = groupby(table.items(), lambda item: item[1])
    return "".join(
        f"| {', '.join(f'`{name}`' for name, _ in group)} | {column.kind} | {column.meaning} |\n"
        for column, group in groups
    )


def page_with_tables(text: str) -> str:
    """The page with all tables written anew."""
    for heading, table in SECTIONS.items():
        pattern = rf"(^{re.escape(heading)}\n(?:(?!\|).*\n)*{re.escape(_HEAD)})(?:\|.*\n)*"
        text, count = re.subn(pattern, lambda match, table=table: match[1] + lines(table), text, flags=re.M)
        assert count == 1, heading
    return text


def test_tables_of_the_page_are_those_of_the_declarations() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert page_with_tables(text) == text, f"run {Path(__file__).name}"


def test_columns_with_a_unit_name_it() -> None:
    """A length, an area, a volume or an angle has its unit at the end of the name."""
    plain = {
        "along", "approach", "approach_world", "cut_u", "cut_v", "ripeness", "visible_fraction", "leaf_age",
        "leaf_area_index", "red_far_red",
    }  # fmt: skip
    for table in SECTIONS.values():
        for name, column in table.items():
            if column.kind == "double" and re.sub("_[xyz]$", "", name) not in plain:
                assert re.search("_(m|m2|m3|deg|W|s|h|lx)$", name), name


if __name__ == "__main__":
    PAGE.write_text(page_with_tables(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
