"""The page on cultivar files names every key, and the files that it shows are valid."""

import re
import tomllib
from pathlib import Path

import pytest
from pydantic import BaseModel, TypeAdapter

from pepperscene.cultivar import Cultivar, Origin, PigmentPath, Pigments, Slot, Stem, load_cultivar
from pepperscene.cultivar.notation import Angle, Length, Ratio
from pepperscene.cultivar.organs import MODELS
from pepperscene.cultivar.slot import Descent, Flush
from pepperscene.shipped import shipped_folder

PAGE = (Path(__file__).parents[2] / "docs" / "reference" / "cultivar.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```toml\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
FILES = {name: block for block in BLOCKS for name in re.findall(r"\A# (\w+\.toml)\n", block)}
TABLES: tuple[type[BaseModel], ...] = (
    Cultivar, Stem, Origin, Slot, Flush, Descent, PigmentPath, Pigments, *MODELS.values()
)  # fmt: skip


@pytest.mark.parametrize("model", TABLES)
def test_names_every_key(model: type[BaseModel]) -> None:
    keys = {field.alias or name for name, field in model.model_fields.items()}
    keys |= {"extends", "like", "with_height"}
    assert [key for key in sorted(keys) if not re.search(rf"(?<![a-z_]){key}(?![a-z_])", PAGE)] == []


def test_names_every_shipped_cultivar() -> None:
    for file in shipped_folder("plants").glob("*.toml"):
        assert f"`{file.stem}`" in PAGE


@pytest.mark.parametrize("name", FILES)
def test_shown_files_load(name: str, tmp_path: Path) -> None:
    for scan in ("blocky.ply", "pointed.ply"):
        (tmp_path / scan).write_text("ply")
    (tmp_path / name).write_text(FILES[name], encoding="utf-8")
    load_cultivar(tmp_path / name)


def test_files_of_the_guide_make_another_crop(tmp_path: Path) -> None:
    """Each extends the one before, and of the crop that the first extends only the internodes grow."""
    page = (Path(__file__).parents[2] / "docs" / "how-to" / "own_crop.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```toml\n(# (my_\w+\.toml)\n.*?)^```", page, re.MULTILINE | re.DOTALL)
    kinds = set()
    for text, name in blocks:
        (tmp_path / name).write_text(text, encoding="utf-8")
        kinds |= set(tomllib.loads(text)["organs"])
    cultivar = load_cultivar(tmp_path / blocks[-1][1])
    assert set(cultivar.present_kinds) == kinds
    assert {"fruit", "blade", "node"} <= {cultivar.organs[kind].form for kind in kinds}


def test_shown_distributions_are_valid() -> None:
    types = {"_mm": TypeAdapter(Length), "_deg": TypeAdapter(Angle), "": TypeAdapter(Ratio)}
    tables = tomllib.loads(BLOCKS[0])
    assert len(tables) == 6
    for table in tables.values():
        unit = next(unit for unit in types if next(iter(table)).endswith(unit))
        types[unit].validate_python(table)


def test_shown_pigments_are_valid() -> None:
    tables = [tomllib.loads(block)["pigments"] for block in BLOCKS if block.startswith("[pigments.")]
    assert tables
    for paths in tables:
        for path in paths.values():
            PigmentPath.model_validate(path)
