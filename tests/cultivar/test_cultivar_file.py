"""Cultivar files: the shipped one says what Table 1 says, and each fault of a file is told by its key."""

from __future__ import annotations

import copy
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from pepperscene.cultivar import Cultivar, Distribution, load_cultivar
from pepperscene.document import read_toml
from pepperscene.errors import InputError
from pepperscene.shipped import shelf

KAITE = shelf("plants") / "kaite.toml"


@pytest.fixture(scope="module")
def kaite() -> Cultivar:
    return load_cultivar("kaite")


@pytest.fixture
def table() -> dict[str, Any]:
    return copy.deepcopy(read_toml(KAITE))


def load(table: dict[str, Any], folder: Path) -> Cultivar:
    path = folder / "plant.toml"
    path.write_text(tomli_w.dumps(table), encoding="utf-8")
    return load_cultivar(path)


# Barth et al. 2018, Table 1, with L-4 and L-5 as the cultivar file mends them.
TABLE_1 = {
    "node.internode_length": (99, 14),
    "node.width": (16, 2),
    "leaf.petiole_length": (97, 12),
    "leaf.length": (135, 16),
    "leaf.width": (112, 11),
    "side_shoot.length": (48, 30),
    "shoot_leaf.petiole_length": (97, 12),
    "shoot_leaf.length": (123, 16),
    "shoot_leaf.width": (102, 12),
    "peduncle.length": (46, 6),
    "fruit.diameter": (84, 11),
    "plant.stem_diameter": (9, 1),
}


@pytest.mark.parametrize("name", TABLE_1)
def test_table_1_stands_in_the_file_with_its_source(kaite: Cultivar, name: str) -> None:
    section, key = name.split(".")
    found: Distribution = getattr(getattr(kaite, section), key)
    mean, sd = TABLE_1[name]
    assert (1e3 * found.mean, 1e3 * found.sd) == (pytest.approx(mean), pytest.approx(sd))
    assert "Table 1" in found.source


def test_the_garbled_rows_are_kept_as_printed(kaite: Cultivar) -> None:
    for found in (kaite.leaf.petiole_length, kaite.leaf.length):
        assert found.as_printed
        assert found.used


def test_every_distribution_has_an_origin(kaite: Cultivar) -> None:
    sections = (
        "plant",
        "node",
        "around",
        "leaf",
        "shoot_leaf",
        "blade",
        "side_shoot",
        "peduncle",
        "fruit",
        "cut",
    )
    for section in sections:
        for name, value in getattr(kaite, section):
            if isinstance(value, Distribution):
                assert value.source or value.chosen, f"{section}.{name}"


def test_pigments_run_from_start_to_end(kaite: Cultivar) -> None:
    assert sorted(kaite.pigments) == ["calyx", "fruit", "leaf", "peduncle", "petiole", "stem"]
    for path in kaite.pigments.values():
        found = path.at([0.0, 1.0])
        for name, values in found.items():
            assert values.tolist() == [getattr(path.start, name), getattr(path.end, name)]


def test_ripening_fruit_loses_its_chlorophyll(kaite: Cultivar) -> None:
    fruit = kaite.pigments["fruit"].at(np.linspace(0.0, 1.0, 50))
    assert np.all(np.diff(fruit["chlorophyll_ug_cm2"]) < 0)


FAULTS: dict[str, tuple[str, dict[str, Any], str]] = {
    "unknown key": ("node.girth", {"mean_mm": 1, "sd_mm": 0.1, "chosen": "x"}, "not a known key"),
    "unknown key of a distribution": ("node.width", {"men_mm": 1, "chosen": "x"}, "not a known key"),
    "angle for a length": ("node.width", {"mean_deg": 16, "sd_deg": 2, "chosen": "x"}, "wrong unit"),
    "length for an angle": ("plant.lean", {"mean_mm": 0, "sd_mm": 2, "chosen": "x"}, "wrong unit"),
    "centimetres": ("node.width", {"mean_cm": 1.6, "sd_cm": 0.2, "chosen": "x"}, "wrong unit"),
    "unit on a ratio": ("fruit.taper", {"value_mm": 0.8, "chosen": "x"}, "wrong unit"),
    "no unit on a length": ("node.width", {"value": 0.8, "chosen": "x"}, "wrong unit"),
    "no origin": ("node.width", {"mean_mm": 16, "sd_mm": 2}, "needs a source"),
    "two laws": ("node.width", {"value_mm": 16, "mean_mm": 16, "chosen": "x"}, "only one of them"),
    "mean alone": ("node.width", {"mean_mm": 16, "chosen": "x"}, "only one of them"),
    "spread of nothing": ("node.width", {"mean_mm": 16, "sd_mm": 0, "chosen": "x"}, "greater than 0"),
    "bounds that exclude the mean": (
        "node.width", {"mean_mm": 16, "sd_mm": 2, "low_mm": 17, "chosen": "x"}, "must lie between"
    ),
    "bounds too narrow for the sd": (
        "node.width", {"mean_mm": 16, "sd_mm": 2, "low_mm": 15, "high_mm": 17, "chosen": "x"}, "no normal"
    ),
    "negative lengths": ("node.width", {"mean_mm": 16, "sd_mm": 20, "chosen": "x"}, "needs low_mm"),
    "text for a number": ("node.width", {"value_mm": "16", "chosen": "x"}, "finite number"),
    "infinite": ("node.width", {"value_mm": math.inf, "chosen": "x"}, "finite number"),
    "beyond a kilometre": ("node.width", {"mean_mm": 1e7, "sd_mm": 1, "chosen": "x"}, "must lie within"),
    "bounds that leave no room": (
        "node.width", {"mean_mm": 1e-9, "sd_mm": 1, "low_mm": 0, "high_mm": 1e-8, "chosen": "x"}, "no normal"
    ),
    "histogram that does not sum to 1": (
        "around.leaf", {"histogram_deg": [[0, 180, 0.5], [180, 360, 0.49]], "chosen": "x"}, "sum to 0.99"
    ),
    "histogram with a negative weight": (
        "around.leaf", {"histogram_deg": [[0, 180, 1.5], [180, 360, -0.5]], "chosen": "x"}, "at least 0"
    ),
    "histogram that overlaps": (
        "around.leaf", {"histogram_deg": [[0, 180, 0.5], [170, 360, 0.5]], "chosen": "x"}, "without overlap"
    ),
    "histogram row too short": ("around.leaf", {"histogram_deg": [[0, 180]], "chosen": "x"}, "3 numbers"),
    "negative probability": (
        "branching.node_leaf", {"leaf": 1.2, "none": -0.2, "chosen": "x"}, "less than or equal to 1"
    ),
    "probabilities that do not sum to 1": (
        "branching.node_leaf", {"leaf": 0.9, "none": 0.2, "chosen": "x"}, "sum to 1.1"
    ),
    "flush too strong": ("branching.flush_strength", {"value": 0.99, "chosen": "x"}, "at most 1"),
    "ripe share beyond 1": ("fruit.ripe_descent", {"value": 0.6, "chosen": "x"}, "within [0, 1]"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_told_by_its_key(table: dict[str, Any], tmp_path: Path, fault: str) -> None:
    name, value, allowed = FAULTS[fault]
    section, key = name.split(".")
    table[section][key] = value
    with pytest.raises(InputError) as caught:
        load(table, tmp_path)
    message = str(caught.value)
    assert allowed in message
    assert section in caught.value.key
    assert "plant.toml" in message


@pytest.mark.parametrize(
    "name", ["node.width", "branching.node_leaf", "blade.droop", "pigments.leaf", "fruit"]
)
def test_what_is_missing_is_told(table: dict[str, Any], tmp_path: Path, name: str) -> None:
    *above, key = name.split(".")
    holder = table
    for section in above:
        holder = holder[section]
    del holder[key]
    with pytest.raises(InputError, match="required but missing") as caught:
        load(table, tmp_path)
    assert caught.value.key == name


def test_an_unknown_name_lists_the_shipped_ones() -> None:
    with pytest.raises(InputError, match="kaite"):
        load_cultivar("keite")


def test_pigment_knots_must_ascend(table: dict[str, Any], tmp_path: Path) -> None:
    table["pigments"]["fruit"]["path"].reverse()
    with pytest.raises(InputError, match="must ascend"):
        load(table, tmp_path)
