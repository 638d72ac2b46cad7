"""Traits from bands: samples of organs, regressions against closed forms and other libraries."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest
from commands import rejected, run
from task_sets import painted_set

from pepperscene.dataset.store.dataset import open_dataset
from pepperscene.errors import InputError
from pepperscene.learning.tasks.frames import PredictionFolder
from pepperscene.learning.tasks.trait_regression import REGRESSIONS, has_bands, partial_least_squares
from pepperscene.learning.tasks.trait_task import (
    OrganSamples,
    join_samples,
    organ_samples,
    regression_errors,
    score_maps,
    score_regressions,
)

BANDS = np.array([475.0, 560.0, 668.0, 717.0, 840.0])
INDEX_BANDS = np.array([475.0, 560.0, 668.0, 720.0, 800.0])
needs_scikit_learn = pytest.mark.skipif(
    find_spec("sklearn") is None, reason="the extra `learn` installs scikit-learn"
)


def samples_of(reflectance, trait):
    count = len(trait)
    numbers = np.arange(count)
    return OrganSamples(reflectance, trait, np.zeros(count, int), numbers + 1)


def random_bands(seed, count=60, bands=5):
    return np.random.default_rng(seed).uniform(0.02, 0.6, (count, bands))


def test_an_organ_is_the_mean_of_its_pixels():
    instances = np.repeat([[0, 3, 7, 9]], 10, axis=0)
    reflectance = np.zeros((10, 4, 2))
    reflectance[:, 1] = [0.1, 0.2]
    reflectance[:5, 2], reflectance[5:, 2] = [0.3, 0.4], [0.5, 0.8]
    trait = np.array([np.nan, 0.25, 0.5, np.nan]) * np.ones((10, 4))
    found = organ_samples(4, reflectance, trait, instances, np.ones((10, 4), bool), smallest_px=10)
    assert found.instance.tolist() == [3, 7]
    assert found.frame.tolist() == [4, 4]
    np.testing.assert_allclose(found.reflectance, [[0.1, 0.2], [0.4, 0.6]])
    np.testing.assert_allclose(found.trait, [0.25, 0.5])
    assert len(join_samples([found, found])) == 4


def test_small_organs_and_pixels_without_a_value_do_not_count():
    instances = np.full((4, 4), 1)
    instances[0] = 2
    trait, reflectance = np.ones((4, 4)), np.ones((4, 4, 3))
    trait[1, 0] = 5.0
    reflectance[1, 0, 1] = np.nan
    found = organ_samples(0, reflectance, trait, instances, np.ones((4, 4), bool), smallest_px=5)
    assert (found.instance.tolist(), found.trait.tolist()) == ([1], [1.0])


def test_a_perfect_prediction_has_no_error_and_the_mean_explains_nothing():
    truth = np.random.default_rng(0).uniform(0, 1, 30)
    perfect = regression_errors(truth, truth)
    assert (perfect["rmse"], perfect["bias"], perfect["r2"]) == (0, 0, 1)
    constant = regression_errors(np.full(30, truth.mean()), truth)
    assert constant["r2"] == pytest.approx(0)
    assert constant["rmse"] == pytest.approx(truth.std())
    other = np.random.default_rng(1).uniform(0, 1, 30)
    found = regression_errors(other, truth)
    assert found["r2"] == pytest.approx(
        1 - ((other - truth) ** 2).sum() / ((truth - truth.mean()) ** 2).sum()
    )
    assert found["rmse"] == pytest.approx(np.sqrt(((other - truth) ** 2).mean()))
    shifted = regression_errors(truth + 0.1, truth)
    assert (shifted["rmse"], shifted["bias"]) == (pytest.approx(0.1), pytest.approx(0.1))


@pytest.mark.parametrize("name", ["ridge", "pls"])
@needs_scikit_learn
def test_a_linear_trait_is_recovered(name):
    slopes = np.array([0.3, -0.8, 0.1, 0.5, 0.2])
    train, test = random_bands(0), random_bands(1)
    given, asked = samples_of(train, 0.2 + train @ slopes), samples_of(test, 0.2 + test @ slopes)
    (score,) = score_regressions(given, asked, BANDS, {name: REGRESSIONS[name]})
    assert score.values["r2"] > 0.99999


@pytest.mark.parametrize(("name", "pair"), [("ndvi", (4, 2)), ("ndre", (4, 3)), ("best_index", (1, 3))])
def test_a_line_on_an_index_is_recovered(name, pair):
    def trait(bands):
        a, b = bands[:, pair[0]], bands[:, pair[1]]
        return 3.0 - 2.0 * (a - b) / (a + b)

    train, test = random_bands(0), random_bands(1)
    given, asked = samples_of(train, trait(train)), samples_of(test, trait(test))
    (score,) = score_regressions(given, asked, INDEX_BANDS, {name: REGRESSIONS[name]})
    assert score.values["rmse"] == pytest.approx(0, abs=1e-9)


@needs_scikit_learn
def test_partial_least_squares_with_all_components_are_least_squares():
    rng = np.random.default_rng(6)
    train, trait = random_bands(6), rng.uniform(0, 1, 60)
    design = np.column_stack([np.ones(60), train])
    expected = design @ np.linalg.lstsq(design, trait, rcond=None)[0]
    np.testing.assert_allclose(partial_least_squares(train, trait, BANDS, components=5)(train), expected)
    # Fewer components fit less well, and the first is along the covariances.
    first = partial_least_squares(train, trait, BANDS, components=1)(train) - trait.mean()
    standard = (train - train.mean(axis=0)) / train.std(axis=0)
    direction = standard @ (standard.T @ (trait - trait.mean()))
    assert abs(np.corrcoef(first, direction)[0, 1]) == pytest.approx(1)


def test_a_constant_trait_is_predicted():
    pytest.importorskip("sklearn", reason="the extra `learn` installs scikit-learn")
    for name in ("mean", "ridge", "pls", "best_index"):
        predictor = REGRESSIONS[name](random_bands(2), np.full(60, 0.3), BANDS)
        np.testing.assert_allclose(predictor(random_bands(3)), 0.3)


def test_indices_need_bands_near_their_wavelengths():
    assert has_bands("ndvi", np.array([660.0, 815.0]))
    assert not has_bands("ndvi", np.array([660.0, 740.0]))
    assert not has_bands("pri", BANDS)
    assert not has_bands("best_index", np.array([500.0]))
    with pytest.raises(InputError, match="pri: needs a band from 526 to 536 nm"):
        REGRESSIONS["pri"](random_bands(0), np.ones(60), BANDS)


def test_maps_are_scored_by_the_mean_over_each_organ(tmp_path):
    instances = np.repeat([[0, 3, 7]], 4, axis=0).astype(np.uint16)
    truth = OrganSamples(np.zeros((2, 1)), np.array([0.3, 0.9]), np.zeros(2, int), np.array([3, 7]))
    found = np.full((4, 3), np.nan)
    found[:, 1], found[:2, 2], found[2:, 2] = 0.4, 0.7, 0.9
    np.save(tmp_path / "000000.npy", found)
    score = score_maps(PredictionFolder(tmp_path), truth, {0: instances})
    assert score.values["rmse"] == pytest.approx(0.1)
    assert score.values["bias"] == pytest.approx(0.0)
    found[0, 1] = np.nan
    np.save(tmp_path / "000000.npy", found)
    with pytest.raises(InputError, match="in each pixel that counts, not nan at row 0, column 1"):
        score_maps(PredictionFolder(tmp_path), truth, {0: instances})


def test_a_split_without_organs_is_rejected():
    none = samples_of(np.zeros((0, 5)), np.zeros(0))
    with pytest.raises(InputError, match="test: has no organ that is large enough"):
        score_regressions(samples_of(random_bands(0), np.ones(60)), none, BANDS)


def paint_fruit(seed, size):
    """Three fruit whose reflectance is linear in their ripeness."""
    rng = np.random.default_rng(seed)
    instances = np.zeros(size, np.uint16)
    for number in range(3):
        instances[2:12, 2 + 10 * number : 10 + 10 * number] = 5 + number
    ripe = np.zeros(8)
    ripe[5:] = rng.uniform(0, 1, 3)
    bands = 0.1 + ripe[instances][..., None] * [0.1, 0.2, 0.5, 0.4, 0.3]
    return {
        "instance": instances,
        "class": np.where(instances > 0, 2, 0).astype(np.uint8),
        "ripeness": np.where(instances > 0, ripe[instances], np.nan).astype(np.float32),
        "reflectance": bands.astype(np.float32),
    }


@needs_scikit_learn
def test_the_command_learns_from_the_training_plants(tmp_path):
    outputs = ("reflectance", "instance", "class", "ripeness")
    changes = {"plan.select": [0, 1, 2, 3]}
    folder = painted_set(tmp_path / "set", outputs, paint_fruit, changes, "multispectral").folder
    mine = tmp_path / "mine"
    mine.mkdir()
    for index in (2, 3):
        np.save(mine / f"{index:06d}.npy", open_dataset(folder).image(index, "ripeness") + 0.1)
    done = run("task", "ripeness", folder, "--baseline", "pls", "--predictions", mine)
    assert done.exit_code == 0, done.output
    rows = {line.split()[0]: line.split()[1:] for line in done.stdout.splitlines()[2:4]}
    assert rows["pls"] == ["6", "0.000", "0.000", "1.000"]
    assert rows["mine"][:3] == ["6", "0.100", "0.100"]
    error = rejected("task", "ripeness", folder, "--baseline", "pri")
    assert "pri: needs a band from 526 to 536 nm" in error
