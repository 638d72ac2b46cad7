"""A plant's parameters can be drawn, changed and built."""

import numpy as np
import pytest

from pepperscene.cultivar import Cultivar
from pepperscene.grammar import Plant, PlantParameters, build_plant, draw_parameters, grow


@pytest.fixture(scope="module")
def parameters(kaite: Cultivar) -> PlantParameters:
    return draw_parameters(kaite, np.random.default_rng(5))


def changed_organs(before: Plant, after: Plant) -> set[int]:
    pairs = enumerate(zip(before.organs, after.organs, strict=True))
    return {i for i, (a, b) in pairs if not np.array_equal(a.curve, b.curve) or a.measures != b.measures}


def test_growing_is_drawing_and_building(kaite: Cultivar, parameters: PlantParameters) -> None:
    assert not changed_organs(build_plant(parameters), grow(kaite, np.random.default_rng(5)))


def test_a_longer_leaf_changes_nothing_else(parameters: PlantParameters) -> None:
    laminae, row = parameters.organs["lamina"], 10
    longer = parameters.with_values("lamina", row, length=2.0 * laminae.values["length"][row])
    before, after = build_plant(parameters), build_plant(longer)
    number = int(laminae.number[row])
    assert changed_organs(before, after) == {number}
    assert after.organs[number].measures["length_m"] == 2.0 * before.organs[number].measures["length_m"]
    # The original parameters are unchanged.
    assert not changed_organs(before, build_plant(parameters))


def test_organs_on_a_rotated_shoot_rotate_with_it(parameters: PlantParameters) -> None:
    shoots, angle = parameters.organs["side_shoot"], 0.7
    rotated = parameters.with_values("side_shoot", 3, azimuth=float(shoots.values["azimuth"][3]) + angle)
    before, after = build_plant(parameters), build_plant(rotated)
    on_shoot = {int(shoots.number[3])}
    for number, organ in enumerate(before.organs):
        if organ.parent in on_shoot:
            on_shoot.add(number)
    assert changed_organs(before, after) == on_shoot
    # A rotation about the vertical.
    cos, sin = np.cos(angle), np.sin(angle)
    rotation = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    for index in on_shoot:
        a, b = before.organs[index], after.organs[index]
        steps = np.diff(a.curve, axis=0) @ rotation.T
        np.testing.assert_allclose(steps, np.diff(b.curve, axis=0), atol=1e-12)
        np.testing.assert_allclose(rotation @ a.up, b.up, atol=1e-12)


def test_a_larger_fruit_has_a_larger_calyx(parameters: PlantParameters) -> None:
    number = int(parameters.organs["fruit"].number[0])
    before = build_plant(parameters)
    after = build_plant(parameters.with_values("fruit", 0, diameter=0.3))
    assert changed_organs(before, after) == {number - 1, number}
    assert after.organs[number].measures["diameter_m"] == 0.3
    ratio = before.organs[number - 1].measures["radius_m"] / before.organs[number].measures["diameter_m"]
    assert after.organs[number - 1].measures["radius_m"] == pytest.approx(0.3 * ratio)


def test_raises_on_unknown_organs_and_numbers(parameters: PlantParameters) -> None:
    for kind, row in (("leaf", 0), ("lamina", 400), ("lamina", -1), ("lamina", 1.5)):
        with pytest.raises(ValueError, match="no organ"):
            parameters.with_values(kind, row, length=1.0)  # type: ignore[arg-type]
    for number in (np.nan, np.inf):
        with pytest.raises(ValueError, match="length must be a finite number"):
            parameters.with_values("lamina", 0, length=number)
    with pytest.raises(ValueError, match="lamina has no girth"):
        parameters.with_values("lamina", 0, girth=1.0)
