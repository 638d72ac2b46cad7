"""The page on cultivar files tells every key, and the files that it shows load."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from pydantic import BaseModel, TypeAdapter

from pepperscene.cultivar import (
    Angle,
    Blade,
    Cultivar,
    Cut,
    Descent,
    Flower,
    Flush,
    Fruit,
    Internode,
    Length,
    Node,
    Origin,
    Peduncle,
    PigmentPath,
    Pigments,
    Ratio,
    Slot,
    Stalk,
    Stem,
    load_cultivar,
)
from pepperscene.shipped import shipped_folder

PAGE = (Path(__file__).parents[2] / "docs" / "reference" / "cultivar.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```toml\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
FILES = {name: block for block in BLOCKS for name in re.findall(r"\A# (\w+\.toml)\n", block)}
MODELS: tuple[type[BaseModel], ...] = (
    Cultivar, Stem, Origin, Slot, Flush, Descent, Internode, Node, Stalk, Blade, Peduncle, Fruit, Cut, Flower,
    PigmentPath, Pigments,
)  # fmt: skip


@pytest.mark.parametrize("model", MODELS)
def test_every_key_is_told(model: type[BaseModel]) -> None:
    keys = {field.alias or name for name, field in model.model_fields.items()} | {
        "extends",
        "like",
        "with_height",
    }
    assert [key for key in sorted(keys) if not re.search(rf"(?<![a-z_]){key}(?![a-z_])", PAGE)] == []


@pytest.mark.parametrize("name", FILES)
def test_files_that_are_shown_load(name: str, tmp_path: Path) -> None:
    (tmp_path / "fruit.ply").write_text("ply")
    (tmp_path / name).write_text(FILES[name], encoding="utf-8")
    assert load_cultivar(tmp_path / name).name


def test_every_law_that_is_shown_is_one() -> None:
    units = {"_mm": TypeAdapter(Length), "_deg": TypeAdapter(Angle), "": TypeAdapter(Ratio)}
    shown = tomllib.loads(BLOCKS[0])
    assert len(shown) == 5
    for law in shown.values():
        first = next(iter(law))
        unit = next(unit for unit in units if first.endswith(unit))
        units[unit].validate_python(law)


def test_every_shipped_cultivar_is_told() -> None:
    for file in shipped_folder("plants").glob("*.toml"):
        assert f"`{file.stem}`" in PAGE


def test_the_crop_that_is_shown_has_one_fruit_and_one_leaf_at_a_node(tmp_path: Path) -> None:
    (tmp_path / "cucumber.toml").write_text(FILES["cucumber.toml"], encoding="utf-8")
    crop = load_cultivar(tmp_path / "cucumber.toml")
    # Nothing of the crop that it extends grows, but for the sections of the stem.
    assert set(crop.grown) - set(tomllib.loads(FILES["cucumber.toml"])["organs"]) == {crop.stem.internode}


def test_the_pigments_that_are_shown_are_valid() -> None:
    shown = [tomllib.loads(block)["pigments"] for block in BLOCKS if block.startswith("[pigments.")]
    for paths in shown:
        for path in paths.values():
            PigmentPath.model_validate(path)
    assert shown
