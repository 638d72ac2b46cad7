"""Files that extend files, kinds that are like kinds: what is inherited, and where a fault is told of."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import tomli_w

from pepperscene.cultivar import Cultivar, cultivar_files, load_cultivar
from pepperscene.errors import InputError
from pepperscene.shipped import shipped_folder


def write(folder: Path, name: str = "child.toml", **tables: Any) -> Path:
    path = folder / name
    path.write_text(
        tomli_w.dumps({"extends": "kaite", "name": "Child", "source": "x"} | tables), encoding="utf-8"
    )
    return path


@pytest.fixture(scope="module")
def kaite() -> Cultivar:
    return load_cultivar("kaite")


def test_a_file_that_says_nothing_more_is_its_parent(kaite: Cultivar, tmp_path: Path) -> None:
    child = load_cultivar(write(tmp_path))
    assert child.name == "Child"
    assert (child.organs, child.stem, child.pigments) == (kaite.organs, kaite.stem, kaite.pigments)


def test_laws_are_replaced_whole_and_tables_merged(kaite: Cultivar, tmp_path: Path) -> None:
    width = {"value_mm": 20, "chosen": "x"}
    child = load_cultivar(write(tmp_path, organs={"node": {"width": width}}, stem={"parts": 7}))
    changed = child.organs["node"].distributions["width"]
    assert (changed.law, changed.mean, changed.source) == ("value", 0.02, "")
    assert child.organs["node"].distributions["length"] == kaite.organs["node"].distributions["length"]
    assert child.stem == kaite.stem.model_copy(update={"parts": 7})
    assert child.organs["node"].bears == kaite.organs["node"].bears


def test_slots_are_told_by_their_names(kaite: Cultivar, tmp_path: Path) -> None:
    slots = [
        {
            "name": "fruit",
            "what": {"cut": 0.5, "none": 0.5, "chosen": "x"},
            "descent": {"of": "cut", "by": {"value": 0, "chosen": "x"}},
        },
        {"name": "more", "what": {"cut": 1, "chosen": "x"}, "azimuth": {"value_deg": 0, "chosen": "x"}},
    ]
    child = load_cultivar(write(tmp_path, organs={"node": {"bears": slots}}))
    before, after = kaite.organs["node"].bears, child.organs["node"].bears
    assert [slot.name for slot in after] == [*(slot.name for slot in before), "more"]
    assert after[:2] == before[:2]
    assert after[2].what.probabilities == {"cut": 0.5, "none": 0.5}
    assert after[2].azimuth == before[2].azimuth


def test_an_empty_list_takes_all_slots_away(kaite: Cultivar, tmp_path: Path) -> None:
    assert kaite.organs["peduncle"].bears
    child = load_cultivar(write(tmp_path, organs={"peduncle": {"bears": []}}))
    assert child.organs["peduncle"].bears == ()
    assert "fruit" not in child.grown


def test_a_slot_can_be_emptied_though_it_inherits_a_descent(kaite: Cultivar, tmp_path: Path) -> None:
    slots = [{"name": "fruit", "what": {"none": 1, "chosen": "x"}}]
    child = load_cultivar(write(tmp_path, organs={"node": {"bears": slots}}))
    assert child.organs["node"].bears[2].descent is not None
    assert set(kaite.grown) - set(child.grown) >= {"peduncle", "fruit", "cut"}


def test_a_kind_that_is_like_another_follows_it_through_files(kaite: Cultivar, tmp_path: Path) -> None:
    fold = {"value_deg": 3, "chosen": "x"}
    child = load_cultivar(write(tmp_path, organs={"lamina": {"fold": fold}}))
    assert child.organs["shoot_lamina"].distributions["fold"] == child.organs["lamina"].distributions["fold"]
    assert (
        child.organs["shoot_lamina"].distributions["width"]
        == kaite.organs["shoot_lamina"].distributions["width"]
    )
    assert child.organs["shoot_petiole"].bears[0].kinds == ("shoot_lamina",)


def test_paths_are_seen_from_the_file_that_says_them(tmp_path: Path) -> None:
    (tmp_path / "below").mkdir()
    (tmp_path / "below" / "fruit.PLY").write_text("ply")
    write(tmp_path / "below", "parent.toml", organs={"fruit": {"scan": "fruit.PLY"}})
    child = write(tmp_path, extends="below/parent.toml")
    scan = load_cultivar(child).kinds["fruit"].scan
    assert scan == (tmp_path / "below" / "fruit.PLY").resolve()
    assert cultivar_files(child) == (
        child, tmp_path / "below" / "parent.toml", shipped_folder("plants") / "kaite.toml", scan
    )  # fmt: skip


FAULTS: dict[str, tuple[dict[str, Any], str, str]] = {
    "no such parent": ({"extends": "keite"}, "extends", "kaite"),
    "no such file": ({"extends": "keite.toml"}, "extends", "is no file"),
    "a parent of two names": ({"extends": ["kaite"]}, "extends", "must be the name"),
    "itself": ({"extends": "child.toml"}, "extends", "lead back"),
    "no such scan": ({"organs": {"fruit": {"scan": "fruit.obj"}}}, "organs.fruit.scan", "is no file"),
    "a scan of another kind": ({"organs": {"fruit": {"scan": "a.glb"}}}, "organs.fruit.scan", ".ply, .stl"),
    "a fault of its own": ({"stem": {"parts": 0}}, "stem.parts", "greater than or equal to 1"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_of_a_child_is_told_by_its_key(fault: str, tmp_path: Path) -> None:
    tables, key, allowed = FAULTS[fault]
    with pytest.raises(InputError) as caught:
        load_cultivar(write(tmp_path, **tables))
    assert caught.value.key == key
    assert allowed in str(caught.value)
    assert "child.toml" in caught.value.where


def test_a_circle_of_files_ends(tmp_path: Path) -> None:
    write(tmp_path, "parent.toml", extends="child.toml")
    with pytest.raises(InputError, match=r"parent\.toml: extends = 'child\.toml': must not lead back"):
        load_cultivar(write(tmp_path, extends="parent.toml"))


def test_a_fault_of_the_parent_is_told_of_the_parent(tmp_path: Path) -> None:
    write(tmp_path, "parent.toml", organs={"node": {"width": {"value_mm": -1, "chosen": "x"}}})
    with pytest.raises(InputError, match=r"parent\.toml: organs\.node\.width"):
        load_cultivar(
            write(
                tmp_path, extends="parent.toml", organs={"node": {"length": {"value_mm": 9, "chosen": "x"}}}
            )
        )
