"""Files that extend files, kinds that are like other kinds, and which file an error names."""

from pathlib import Path
from typing import Any

import pytest
import tomli_w

from pepperscene.cultivar import Cultivar, cultivar_files, load_cultivar
from pepperscene.errors import InputError
from pepperscene.shipped import shipped_folder


def write(folder: Path, name: str = "child.toml", **tables: Any) -> Path:
    path = folder / name
    defaults = {"extends": "kaite", "name": "Child", "source": "x"}
    path.write_text(tomli_w.dumps(defaults | tables), encoding="utf-8")
    return path


def test_distributions_are_replaced_and_tables_merged(kaite: Cultivar, tmp_path: Path) -> None:
    width = {"value_mm": 20, "chosen": "x"}
    child = load_cultivar(write(tmp_path, organs={"node": {"width": width}}, stem={"parts": 7}))
    changed = child.organs["node"].distributions["width"]
    assert (changed.family, changed.mean, changed.source) == ("value", 0.02, "")
    assert child.organs["node"].distributions["length"] == kaite.organs["node"].distributions["length"]
    assert child.stem == kaite.stem.model_copy(update={"parts": 7})
    assert child.organs["node"].bears == kaite.organs["node"].bears


def test_slots_are_merged_by_name(kaite: Cultivar, tmp_path: Path) -> None:
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


def test_an_empty_list_removes_all_slots(kaite: Cultivar, tmp_path: Path) -> None:
    assert kaite.organs["peduncle"].bears
    child = load_cultivar(write(tmp_path, organs={"peduncle": {"bears": []}}))
    assert child.organs["peduncle"].bears == ()
    assert "fruit" not in child.present_kinds


def test_a_slot_with_an_inherited_descent_can_be_emptied(kaite: Cultivar, tmp_path: Path) -> None:
    slots = [{"name": "fruit", "what": {"none": 1, "chosen": "x"}}]
    child = load_cultivar(write(tmp_path, organs={"node": {"bears": slots}}))
    assert child.organs["node"].bears[2].descent is not None
    assert set(kaite.present_kinds) - set(child.present_kinds) >= {"peduncle", "fruit", "cut"}


def test_like_refers_to_the_overridden_kind(kaite: Cultivar, tmp_path: Path) -> None:
    fold = {"value_deg": 3, "chosen": "x"}
    organs = load_cultivar(write(tmp_path, organs={"lamina": {"fold": fold}})).organs
    lamina, shoot_lamina = (organs[kind].distributions for kind in ("lamina", "shoot_lamina"))
    assert shoot_lamina["fold"] == lamina["fold"]
    assert shoot_lamina["width"] == kaite.organs["shoot_lamina"].distributions["width"]
    assert organs["shoot_petiole"].bears[0].kinds == ("shoot_lamina",)


def test_paths_are_relative_to_their_file(tmp_path: Path) -> None:
    (tmp_path / "below").mkdir()
    (tmp_path / "below" / "fruit.PLY").write_text("ply")
    parent = write(tmp_path / "below", "parent.toml", organs={"fruit": {"scan": "fruit.PLY"}})
    child = write(tmp_path, extends="below/parent.toml")
    (scan,) = load_cultivar(child).kinds["fruit"].scans.files
    assert scan == (tmp_path / "below" / "fruit.PLY").resolve()
    assert cultivar_files(child) == (child, parent, shipped_folder("plants") / "kaite.toml", scan)


def test_several_scans_have_weights_and_are_files_of_the_cultivar(tmp_path: Path) -> None:
    for name in ("a.glb", "b.ply"):
        (tmp_path / name).write_text("scan")
    scans = {"scan": ["a.glb", "b.ply"], "scan_weights": [2, 1], "scan_unit": "mm", "scan_colour": True}
    parent = write(tmp_path, "parent.toml", organs={"fruit": scans})
    fruit = load_cultivar(parent).kinds["fruit"].scans
    assert fruit is not None
    files = ((tmp_path / "a.glb").resolve(), (tmp_path / "b.ply").resolve())
    assert (fruit.files, fruit.weights, fruit.unit, fruit.colour) == (files, (2.0, 1.0), "mm", True)
    assert cultivar_files(parent)[-2:] == files
    # A child replaces them by one, or by none.
    one = {"scan": "b.ply", "scan_weights": []}
    child = load_cultivar(write(tmp_path, extends="parent.toml", organs={"fruit": one})).kinds["fruit"].scans
    assert child is not None
    assert (child.files, child.weights) == (files[1:], ())
    none = load_cultivar(write(tmp_path, extends="parent.toml", organs={"fruit": {**one, "scan": []}}))
    assert none.kinds["fruit"].scans is None


ERRORS: dict[str, tuple[dict[str, Any], str, str]] = {
    "no such parent": ({"extends": "keite"}, "extends", "kaite"),
    "no such file": ({"extends": "keite.toml"}, "extends", "no such file"),
    "extends itself": ({"extends": "child.toml"}, "extends", "forms a cycle"),
    "no such scan": ({"organs": {"fruit": {"scan": "fruit.obj"}}}, "organs.fruit.scan", "is not a file"),
    "unknown scan format": ({"organs": {"fruit": {"scan": "a.gltf"}}}, "organs.fruit.scan", ".ply, .stl"),
}  # fmt: skip


@pytest.mark.parametrize("error", ERRORS)
def test_errors_of_a_child_name_its_key(error: str, tmp_path: Path) -> None:
    tables, key, message = ERRORS[error]
    with pytest.raises(InputError) as caught:
        load_cultivar(write(tmp_path, **tables))
    assert caught.value.key == key
    assert message in str(caught.value)
    assert "child.toml" in caught.value.where


def test_raises_on_a_cycle_or_a_long_chain(tmp_path: Path) -> None:
    write(tmp_path, "parent.toml", extends="child.toml")
    with pytest.raises(InputError, match=r"parent\.toml: extends = 'child\.toml': forms a cycle"):
        load_cultivar(write(tmp_path, extends="parent.toml"))
    # With kaite, 20 files are allowed.
    chain = [write(tmp_path, "0.toml")]
    chain += [write(tmp_path, f"{i}.toml", extends=f"{i - 1}.toml") for i in range(1, 20)]
    assert len(cultivar_files(chain[18])) == 20
    with pytest.raises(InputError, match="or is longer than 20 files"):
        load_cultivar(chain[19])


# --- faults -------------------------------------------------------------------------------------------------


INCOMPLETE_PIGMENTS = """
[pigments.fruit]
chosen = "x"
ior = 1.45
roughness = [0.1, 0.1]
start.structure_n = 1.0
start.chlorophyll_ug_cm2 = 10
start.carotenoid_ug_cm2 = 4
start.water_cm = 0.02
start.dry_matter_g_cm2 = 0.004
"""
# The extended file, a fault, its key, and for faults of a parent the text of its child.
FAULTS = {
    "incomplete pigments": ("red_blocky", INCOMPLETE_PIGMENTS, "pigments.fruit.end"),
    "another form": ("tomato", '[organs.lamina]\nform = "stalk"', "organs.lamina.length"),
    "like another form": (
        "kaite",
        '[organs.bract]\nlike = "lamina"\nform = "peduncle"\n',
        "organs.bract.diameter",
    ),
    "new slot without an azimuth": (
        "kaite",
        '[[organs.node.bears]]\nname = "second"\nwhat = { petiole = 1, chosen = "x" }',
        "organs.node.bears.5.azimuth",
    ),
    "new kind without a form": ("kaite", "[organs.thorn]\nsize_correlation = 0.5", "organs.thorn"),
    "stem of an unknown node": ("kaite", '[stem]\nnode = "nod"', "stem.node"),
    "teeth of a pinnate blade": (
        "kaite",
        '[organs.lamina]\nteeth = { value = 20, chosen = "x" }',
        "organs.lamina",
    ),
    "unknown table": ("kaite", "[leaf]\nlength = 3", "leaf"),
    "pigments of a parent": ("kaite", INCOMPLETE_PIGMENTS, "pigments.fruit.end", ""),
    "organ of the same form": (
        "kaite",
        "[organs.fruit.diameter]\nmean_mm = -3",
        "organs.fruit.diameter",
        '[organs.fruit]\nform = "fruit"',
    ),
    "slot": (
        "kaite",
        '[[organs.node.bears]]\nname = "leaf"\nlift = "up"',
        "organs.node.bears.0.lift",
        '[[organs.node.bears]]\nname = "leaf"\nfirst = 3',
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_names_the_file_that_has_it(fault: str, tmp_path: Path) -> None:
    extended, text, key, *below = FAULTS[fault]
    faulty = loaded = tmp_path / "faulty.toml"
    faulty.write_text(f'extends = "{extended}"\n{text}\n')
    for good in below:
        loaded = tmp_path / "mine.toml"
        loaded.write_text(f'extends = "faulty.toml"\n{good}\n')
    with pytest.raises(InputError) as caught:
        load_cultivar(loaded)
    assert (caught.value.where, caught.value.key) == (str(faulty), key)
