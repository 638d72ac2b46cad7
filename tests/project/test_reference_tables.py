"""Tables of keys on the page of recipe files, written from the data classes by running this file."""

from __future__ import annotations

import dataclasses
import inspect
import re
import textwrap
import types
import typing
from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from typing import Any

from annotated_types import Ge, Le, MaxLen, MinLen, MultipleOf

from pepperscene.camera import ImageProcessor, StereoMatching
from pepperscene.recipe import views_tables
from pepperscene.recipe.camera_tables import AutoExposureTable
from pepperscene.recipe.tables import GrowthTable, LampTable, WhiteReferenceTable
from pepperscene.scene import CalibrationChart, Daylight, DoubleRow, Greenhouse, Stand, Twine
from pepperscene.units import Name, Unit, ZeroOrAtLeast, file_key, is_table

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "recipe.md"
TABLES = {
    "`[growth]`": GrowthTable,
    "`[row]`": DoubleRow,
    **{
        f'`kind = "{name.lower()}"`': getattr(views_tables, f"{name}Views")
        for name in ("Arc", "Protocol", "Grid", "Path", "Random", "Function")
    },
    '`kind = "poses"`': views_tables.PoseViews,
    "`[auto_exposure]`": AutoExposureTable,
    "`[depth_camera]`": StereoMatching,
    "`[white_reference]`": WhiteReferenceTable,
    "`[developing.isp]`": ImageProcessor,
    "`[daylight]`": Daylight,
    "`[[lamps]]`": LampTable,
    "`[twine]`": Twine,
    "`[greenhouse]`": Greenhouse,
    "`[stand]`": Stand,
    "`[[stand.charts]]`": CalibrationChart,
}
"""Headings of the page, and what the last table of keys below each of them holds."""
LINKS = {
    "while it exposes": "../how-to/motion.md",
    "path of a cultivar file": "cultivar.md",
    "path of a TOML, `.ies` or `.ldt` file": "devices.md#lamp",
    "kind of an organ": "cultivar.md#organs",
    "a class in lower case": "outputs.md#classes",
    "file of camera poses": "pose_files.md",
    "are in labels": "#labels-of-far-rows",
    "`polyethylene_film`": "devices.md#cover",
    "name or path of a file with the values": "devices.md#image-signal-processor",
    "a CSV file of spectra": "devices.md#spectra",
    "marker boards, ColorCheckers and scale bars": "#standcharts",
}
"""Phrases of descriptions that the page links."""
COUNTS = {2: "two", 3: "three"}
_TABLE = re.compile(r"^\| key[^\n]*\n\|---\|---\|---\|\n((?:\|.*\n)+)", re.MULTILINE)
POWERS = {1e-6: "10⁻⁶", 1e-4: "10⁻⁴"}


def number(value: float) -> str:
    """A number as the page shows it."""
    if value in POWERS:
        return POWERS[value]
    text = f"{value:,.10g}" if abs(value) >= 10_000 else f"{value:.10g}"
    return text.replace("-", "−")


def parts(annotation: Any) -> Iterator[Any]:
    """The rules of an annotated type, from the innermost."""
    for rule in getattr(annotation, "__metadata__", ()):
        yield from getattr(rule, "metadata", None) or (rule,)


def value_text(annotation: Any) -> str:
    """What a type allows, in words."""
    if annotation == Name:
        return "text"
    rules = list(parts(annotation))
    if typing.get_origin(annotation) is typing.Annotated:
        annotation = typing.get_args(annotation)[0]
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        kinds = [kind for kind in typing.get_args(annotation) if kind is not types.NoneType]
        return ", or ".join(map(value_text, kinds))
    if typing.get_origin(annotation) is tuple:
        return _list_text(typing.get_args(annotation), rules)
    if typing.get_origin(annotation) is typing.Literal:
        return _choice(typing.get_args(annotation))
    if isinstance(annotation, type) and issubclass(annotation, StrEnum):
        return _choice(annotation)
    if annotation is bool:
        return "`true` or `false`"
    if annotation is str:
        return "text"
    if annotation not in (int, float):
        return annotation.__name__
    bound = {type(rule): rule for rule in rules}
    low, high = bound[Ge].ge, bound[Le].le
    if ZeroOrAtLeast in bound:
        return f"0, or {number(bound[ZeroOrAtLeast].least)} to {number(high)}"
    multiple = f", a multiple of {bound[MultipleOf].multiple_of}" if MultipleOf in bound else ""
    return f"{number(low)} to {number(high)}{multiple}"


def _choice(values: Any) -> str:
    *others, last = (f"`{value}`" for value in values)
    return f"{', '.join(others)} or {last}"


def _list_text(elements: tuple[Any, ...], rules: list[Any]) -> str:
    bound = {type(rule): rule for rule in rules}
    element = elements[0]
    if is_table(element):
        return f"up to {bound[MaxLen].max_length} tables"
    if Ellipsis in elements:
        count = f"{bound[MinLen].min_length} to {bound[MaxLen].max_length}"
    else:
        count = COUNTS[len(elements)]
    if typing.get_origin(element) is tuple:
        inner = typing.get_args(element)
        names = "pairs" if len(inner) == 2 else "points of three numbers"
        return f"{count} {names}, {value_text(inner[0])}"
    return f"{count} numbers, {value_text(element)}"


def default_text(field: dataclasses.Field[Any], annotation: Any) -> str:
    """The default of a field in the unit of the file."""
    if field.default is dataclasses.MISSING or field.default is None:
        return ""
    value = in_file(field.default, annotation)
    if isinstance(value, bool):
        return f"; default `{str(value).lower()}`"
    if isinstance(value, str):
        return f"; default `{value}`"
    if isinstance(value, tuple):
        return f"; default `[{', '.join(f'{item:g}' for item in value)}]`"
    return f"; default {number(value)}"


def in_file(value: Any, annotation: Any) -> Any:
    """A value in SI units as a file holds it."""
    if isinstance(value, tuple):
        inner = annotation
        while typing.get_origin(inner) is not tuple:
            inner = typing.get_args(inner)[0]
        return tuple(in_file(item, typing.get_args(inner)[0]) for item in value)
    unit = next((rule for rule in parts(annotation) if isinstance(rule, Unit)), None)
    return unit.in_file(value) if unit is not None else value


def descriptions(table: type) -> dict[str, str]:
    """The attributes' descriptions in a docstring."""
    text = inspect.getdoc(table) or ""
    section = textwrap.dedent(text.partition("Attributes:\n")[2])
    entries = re.findall(r"^(\w+): (.*(?:\n +.*)*)", section, re.MULTILINE)
    return {name: re.sub(r"\s*\n\s*", " ", entry).rstrip(".") for name, entry in entries}


def rows(table: type) -> list[str]:
    """The lines of a table of keys."""
    hints = typing.get_type_hints(table, include_extras=True)
    texts = descriptions(table)
    fields = {field.name: field for field in dataclasses.fields(table) if field.name != "kind"}
    assert texts.keys() == fields.keys(), table
    lines = []
    for name, field in fields.items():
        meaning = re.sub(r"`(\w+)`", lambda match: f"`{_key(match[1], fields)}`", texts[name])
        for phrase, target in LINKS.items():
            meaning = meaning.replace(phrase, f"[{phrase}]({target})")
        optional = ", optional" if field.default is None else ""
        value = value_text(hints[name]) + optional
        lines.append(f"| `{file_key(name)}` | {value} | {meaning}{default_text(field, hints[name])} |")
    return lines


def _key(name: str, fields: dict[str, Any]) -> str:
    return file_key(name) if name in fields else name


def page_with_tables(text: str) -> str:
    """The page with all tables written anew."""
    for heading, table in TABLES.items():
        start = re.search(rf"^#+ {re.escape(heading)}$", text, re.MULTILINE)
        assert start, heading
        following = re.search(r"^##", text[start.end() :], re.MULTILINE)
        end = start.end() + following.start() if following else len(text)
        section = text[start.end() : end]
        place = list(_TABLE.finditer(section))[-1]
        section = section[: place.start(1)] + "\n".join(rows(table)) + "\n" + section[place.end(1) :]
        text = text[: start.end()] + section + text[end:]
    return text


def test_tables_of_the_page_are_those_of_the_data_classes() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert page_with_tables(text) == text, f"run {Path(__file__).name}"


if __name__ == "__main__":
    PAGE.write_text(page_with_tables(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
