"""Units of files: exact conversion both ways, keys and bounds of every table of a recipe."""

from __future__ import annotations

import math
import typing

import numpy as np
import pytest

from pepperscene.camera import Developing
from pepperscene.document import validate
from pepperscene.errors import InputError
from pepperscene.recipe.recipe import Recipe
from pepperscene.scene import Daylight, DoubleRow, Greenhouse, Twine
from pepperscene.units import (
    DEGREES,
    MICROSECONDS,
    MILLIMETRES,
    Unit,
    file_key,
    file_values,
    is_table,
    table_fields,
)

ROW = {"plants_front": 3, "plants_back": 0, "spacing_mm": 210, "gap_mm": 35.5, "shift_mm": -0.1}


@pytest.mark.parametrize(
    ("unit", "expected"),
    [(MILLIMETRES, lambda x: x / 1e3), (DEGREES, np.radians), (MICROSECONDS, lambda x: x / 1e6)],
)
def test_numbers_of_files_are_exact_both_ways(unit, expected):
    rng = np.random.default_rng(1)
    for value in (*rng.uniform(-400, 400, 2000).tolist(), 0.0, 33.3, 1e-5, 123456.789):
        assert unit.to_si(value) == expected(value)
        assert unit.to_si(unit.in_file(unit.to_si(value))) == unit.to_si(value)
        assert unit.in_file(unit.to_si(round(value, 4))) == round(value, 4)


def test_keys_name_the_unit():
    keys = ("gap_m", "lean_rad", "speed_m_s", "exposure_s", "turns_per_m", "gain", "frame_rate_hz")
    expected = ["gap_mm", "lean_deg", "speed_mm_s", "exposure_us", "turns_per_m", "gain", "frame_rate_hz"]
    assert [file_key(key) for key in keys] == expected


def _units(annotation):
    found = [rule for rule in getattr(annotation, "__metadata__", ()) if isinstance(rule, Unit)]
    return found + [unit for part in typing.get_args(annotation) for unit in _units(part)]


def _tables(annotation):
    if is_table(annotation):
        yield annotation
        for part in table_fields(annotation).values():
            yield from _tables(part)
    for part in typing.get_args(annotation):
        yield from _tables(part)


def test_every_key_with_a_unit_is_converted_from_it():
    expected = {"_mm": MILLIMETRES, "_mm_s": MILLIMETRES, "_deg": DEGREES, "_us": MICROSECONDS}
    tables = set(_tables(Recipe))
    assert {Greenhouse, DoubleRow, Twine, Daylight, Developing} < tables
    keys = {(table, key): hint for table in tables for key, hint in table_fields(table).items()}
    assert len(keys) > 100
    for (table, key), hint in keys.items():
        end = next((end for end in expected if key.endswith(end)), "")
        units = set(_units(hint)) if not is_table(hint) else set()
        if key != "hfov_deg":
            assert units == ({expected[end]} if end else units & {MILLIMETRES}), (table, key)


def test_tables_of_files_are_in_si_units_and_back():
    row = validate(DoubleRow, ROW, "mine.toml")
    assert row == DoubleRow(3, 0, 0.21, 0.0355, -0.0001)
    assert file_values(row) == ROW
    assert math.isclose(validate(Greenhouse, {"row_lean_deg": 4}, "x").row_lean_rad, 0.0698131700797732)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"gap_mm": 5001}, "gap_mm = 5001: must be less than or equal to 5000"),
        ({"gap_mm": True}, "gap_mm"),
        ({"gap_m": 0.1}, "gap_m: is not a known key"),
        ({"plants_front": 0}, "plants_front"),
    ],
)
def test_errors_are_in_the_unit_and_the_keys_of_the_file(change, message):
    with pytest.raises(InputError, match=message):
        validate(DoubleRow, ROW | change, "mine.toml")
