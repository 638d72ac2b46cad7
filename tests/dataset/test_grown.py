"""A single plant from Python: what it may be made of, and which arguments are refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pepperscene.cultivar import Cultivar, interpolate_cultivars, load_cultivar
from pepperscene.dataset import GrownPlant, grow_plant
from pepperscene.errors import InputError


@pytest.fixture(scope="module")
def february() -> Cultivar:
    return load_cultivar("kaite_february")


def same(one: GrownPlant, other: GrownPlant) -> bool:
    return one.mesh.vertices.tobytes() == other.mesh.vertices.tobytes()


def test_a_name_and_its_cultivar_grow_the_same_plant(february: Cultivar) -> None:
    by_name = grow_plant("kaite_february", 2, detail=0.05)
    assert same(by_name, grow_plant(february, 2, detail=0.05))
    assert same(by_name, grow_plant(february, np.int64(2), detail=0.05))  # type: ignore[arg-type]


def test_a_stage_left_open_lies_half_way(february: Cultivar) -> None:
    middle = interpolate_cultivars(february, load_cultivar("kaite"), 0.5)
    plant = grow_plant("kaite_february", 2, detail=0.05, until="kaite")
    assert same(plant, grow_plant(middle, 2, detail=0.05))
    assert len(plant.plant.of_form("internode")) == middle.stem.parts


@pytest.mark.parametrize(
    ("arguments", "allowed"),
    [
        ({"seed": -1}, "at least 0 and below"),
        ({"seed": 1.5}, "must be a whole number"),
        ({"seed": True}, "must be a whole number"),
        ({"seed": 2**63}, "below 2\\^63"),
        ({"share": 0.5}, "needs until"),
        ({"share": 2, "until": "kaite"}, r"must lie in \[0, 1\]"),
        ({"share": float("nan"), "until": "kaite"}, r"must lie in \[0, 1\]"),
        ({"until": "tomato"}, "species: must be the same in both"),
        ({"until": "kaiter"}, "no such file"),
    ],
)
def test_wrong_arguments_are_told(february: Cultivar, arguments: dict[str, Any], allowed: str) -> None:
    with pytest.raises(InputError, match=allowed):
        grow_plant(february, **arguments)


@pytest.mark.parametrize("detail", [0.0, -1.0, float("nan"), float("inf")])
def test_a_detail_of_nothing_is_an_error(february: Cultivar, detail: float) -> None:
    with pytest.raises(ValueError, match="detail"):
        grow_plant(february, detail=detail)
