"""Errors of cultivar files that extend others name the file that has to be changed."""

from __future__ import annotations

from pathlib import Path

import pytest

from pepperscene.cultivar import load_cultivar
from pepperscene.errors import InputError

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
OWN_FAULTS = {
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
}


@pytest.mark.parametrize("fault", OWN_FAULTS)
def test_a_fault_of_the_extending_file_names_that_file(fault: str, tmp_path: Path) -> None:
    extended, text, key = OWN_FAULTS[fault]
    mine = tmp_path / "mine.toml"
    mine.write_text(f'extends = "{extended}"\n{text}\n')
    with pytest.raises(InputError) as caught:
        load_cultivar(mine)
    assert caught.value.where == str(mine)
    assert caught.value.key == key


PARENT_FAULTS = {
    "pigments": (INCOMPLETE_PIGMENTS, "", "pigments.fruit.end"),
    "organ of the same form": (
        "[organs.fruit.diameter]\nmean_mm = -3",
        '[organs.fruit]\nform = "fruit"',
        "organs.fruit.diameter",
    ),
    "slot": (
        '[[organs.node.bears]]\nname = "leaf"\nlift = "up"',
        '[[organs.node.bears]]\nname = "leaf"\nfirst = 3',
        "organs.node.bears.0.lift",
    ),
}


@pytest.mark.parametrize("fault", PARENT_FAULTS)
def test_a_fault_of_the_extended_file_names_that_file(fault: str, tmp_path: Path) -> None:
    faulty, good, key = PARENT_FAULTS[fault]
    parent, mine = tmp_path / "parent.toml", tmp_path / "mine.toml"
    parent.write_text(f'extends = "kaite"\n{faulty}\n')
    mine.write_text(f'extends = "parent.toml"\n{good}\n')
    with pytest.raises(InputError) as caught:
        load_cultivar(mine)
    assert caught.value.where == str(parent)
    assert caught.value.key == key
