"""A plant's parameters can be taken, changed and built again."""

from __future__ import annotations

from dataclasses import FrozenInstanceError

import numpy as np
import pytest

from pepperscene.cultivar import Cultivar
from pepperscene.grammar import Plant, PlantParameters, build_plant, draw_parameters, grow


@pytest.fixture
def parameters(kaite: Cultivar) -> PlantParameters:
    return draw_parameters(kaite, np.random.default_rng(5))


def below(plant: Plant, index: int) -> set[int]:
    """An organ and all that grows on it."""
    found = {index}
    for number, organ in enumerate(plant.organs):
        if organ.parent in found:
            found.add(number)
    return found


def changed_organs(before: Plant, after: Plant) -> set[int]:
    pairs = enumerate(zip(before.organs, after.organs, strict=True))
    return {
        i
        for i, (one, other) in pairs
        if not np.array_equal(one.curve, other.curve) or one.measures != other.measures
    }


def test_growing_is_drawing_and_building(kaite: Cultivar, parameters: PlantParameters) -> None:
    assert not changed_organs(build_plant(parameters), grow(kaite, np.random.default_rng(5)))


def test_one_longer_leaf_leaves_all_else_as_it_was(parameters: PlantParameters) -> None:
    laminae = parameters.organs["lamina"]
    row = 10
    longer = parameters.changed("lamina", row, length=2.0 * laminae.values["length"][row])
    before, after = build_plant(parameters), build_plant(longer)
    number = int(laminae.number[row])
    assert changed_organs(before, after) == {number}
    assert after.organs[number].measures["length_m"] == 2.0 * before.organs[number].measures["length_m"]
    # The first plant's numbers are as they were.
    assert not changed_organs(before, build_plant(parameters))


def test_what_grows_on_a_turned_shoot_turns_with_it(parameters: PlantParameters) -> None:
    shoots, turn = parameters.organs["side_shoot"], 0.7
    azimuth = float(shoots.values["azimuth"][3])
    before, after = (
        build_plant(parameters),
        build_plant(parameters.changed("side_shoot", 3, azimuth=azimuth + turn)),
    )
    moved = below(before, int(shoots.number[3]))
    assert changed_organs(before, after) == moved
    # Seen from above, a level rotation of all that hangs on it.
    rotation = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    for index in moved:
        one, other = before.organs[index], after.organs[index]
        np.testing.assert_allclose(
            np.diff(one.curve, axis=0) @ rotation.T, np.diff(other.curve, axis=0), atol=1e-12
        )
        np.testing.assert_allclose(rotation @ one.up, other.up, atol=1e-12)


def test_a_larger_fruit_has_a_larger_calyx(parameters: PlantParameters) -> None:
    fruit = parameters.organs["fruit"]
    number = int(fruit.number[0])
    before = build_plant(parameters)
    after = build_plant(parameters.changed("fruit", 0, diameter=0.3))
    assert changed_organs(before, after) == {number - 1, number}
    assert after.organs[number].measures["diameter_m"] == 0.3
    ratio = before.organs[number - 1].measures["radius_m"] / before.organs[number].measures["diameter_m"]
    assert after.organs[number - 1].measures["radius_m"] == pytest.approx(0.3 * ratio)


def test_parameters_are_frozen(parameters: PlantParameters) -> None:
    with pytest.raises(FrozenInstanceError):
        parameters.cultivar = "other"  # type: ignore[misc]
    with pytest.raises(ValueError, match="read-only"):
        parameters.organs["lamina"].values["length"][0] = 1.0


def test_what_is_not_there_cannot_be_changed(parameters: PlantParameters) -> None:
    for kind, row in (("leaf", 0), ("lamina", 400), ("lamina", -1), ("lamina", 1.5)):
        with pytest.raises(ValueError, match="no organ"):
            parameters.changed(kind, row, length=1.0)  # type: ignore[arg-type]
    for number in (np.nan, np.inf):
        with pytest.raises(ValueError, match="length must be a finite number"):
            parameters.changed("lamina", 0, length=number)
    with pytest.raises(ValueError, match="lamina has no girth"):
        parameters.changed("lamina", 0, girth=1.0)
