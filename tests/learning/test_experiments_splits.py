"""Splits of images, frames to build, and results of the experiments."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from painted_bands import bands_set, write_bands

pytest.importorskip("torch")

from pepperscene.dataset.readers.open import PublishedSet, RenderedSet
from pepperscene.errors import ArgumentError, InputError
from pepperscene.learning.class_table import FRUIT_CLASSES
from pepperscene.learning.experiments import ExperimentOptions, run_experiments
from pepperscene.learning.experiments.page import format_measure
from pepperscene.learning.experiments.results import collect_result, compare_results
from pepperscene.learning.experiments.sets import SplitSet, spread_frames
from pepperscene.learning.experiments.splits import has_paper_numbers, plant_sets, real_folds, split_synthetic
from pepperscene.learning.options import TrainingOptions
from pepperscene.learning.training import train
from pepperscene.recipe.plan import Plan

QUICK = TrainingOptions("small,width=0.25", None, 2, 2, (32, 32), None, precision="float32")


def rendered(sets, frames, rotations=2):
    info = {"recipe": {"plan": {"sets": sets, "rotations": rotations, "frames": frames // rotations}}}
    return RenderedSet(name="rendered", dataset=SimpleNamespace(info=info), items=tuple(range(sets * frames)))


def published(half, count):
    return PublishedSet(
        name=half, folder=Path("/data"), half=half, items=tuple(range(1, count + 1)), files={}
    )


@pytest.mark.parametrize(("sets", "kept"), [(3, 1), (10, 1), (20, 2), (40, 4)])
def test_plants_of_a_rendered_set_are_in_one_part(sets, kept):
    images = rendered(sets, 4)
    split = split_synthetic(images)
    plants = plant_sets(images)
    parts = [{plants[position] for position in part} for part in (split.train, split.test, split.validation)]
    assert [len(part) for part in parts] == [sets - 2 * kept, kept, kept]
    assert set.union(*parts) == set(range(sets))
    assert max(parts[0]) < min(parts[1])
    assert max(parts[1]) < min(parts[2])


def test_two_sets_of_plants_or_one():
    split = split_synthetic(rendered(2, 4))
    assert (split.train, split.test, split.validation) == ((0, 1, 2, 3), (4, 5), (6, 7))
    split = split_synthetic(rendered(1, 20))
    assert [len(part) for part in (split.train, split.test, split.validation)] == [16, 2, 2]
    assert "shows one set of plants only, so that frames are split" in split.rule
    assert "does not say which plants it shows" in split_synthetic(bands_set(3)).rule
    with pytest.raises(InputError, match="three images or more"):
        split_synthetic(bands_set(2))


def test_folds_of_photographs():
    images = bands_set(7)
    first, second = real_folds(images)
    assert (first.train, first.test) == ((0, 1, 2), (3, 4, 5, 6))
    assert (second.train, second.test) == (first.test, first.train)
    with pytest.raises(InputError, match="two images with masks or more"):
        real_folds(bands_set(1))


def test_the_published_set_has_the_papers_numbers():
    synthetic, real = published("synthetic", 10_500), published("empirical", 50)
    assert has_paper_numbers(synthetic, real)
    assert not has_paper_numbers(synthetic, published("empirical", 49))
    assert not has_paper_numbers(bands_set(3), real)
    split = SplitSet(synthetic, split_synthetic(synthetic, as_paper=True))
    parts = [split.part(name).names() for name in ("train", "validation", "test")]
    assert [(part[0], part[-1], len(part)) for part in parts] == [
        ("1", "8750", 8750), ("8751", "8800", 50), ("8851", "8900", 50),
    ]  # fmt: skip
    (fold,) = real_folds(real, as_paper=True)
    assert (fold.train, fold.validation) == (tuple(range(30)), tuple(range(30, 40)))
    assert fold.test == tuple(range(40, 50))


def test_frames_are_spread_over_scenes_at_varied_views():
    plan = Plan(sets=40, rotations=1, frames=50)
    specs = [plan.frame(index) for index in spread_frames(plan, 240)]
    numbers = np.bincount([spec.scene for spec in specs], minlength=40)
    # Few frames are of some scenes only, from the first to the last without a gap of three.
    assert set(numbers.tolist()) == {0, 10}
    assert np.count_nonzero(numbers) == 24
    assert np.diff(np.flatnonzero(numbers)).max() <= 3
    assert len({spec.step for spec in specs}) > 40
    # No frame twice, and as many as asked, where scenes have few.
    for count in (3, 19, 21, 100, 119):
        frames = spread_frames(Plan(sets=40, rotations=1, frames=3), count)
        assert len(set(frames)) == len(frames) == count
    plan = Plan(sets=6, rotations=2, frames=50)
    assert spread_frames(plan, 600) == spread_frames(plan, 9999) == tuple(range(600))


def evaluation(matrices):
    images = [
        {"set": "real", "name": str(number), "confusion": matrix} for number, matrix in enumerate(matrices)
    ]
    return {"classes": [{"name": "other"}, {"name": "fruit"}], "images": images}


def test_matrices_are_added_and_differences_are_paired():
    good, bad = [[8, 0], [0, 2]], [[6, 2], [1, 1]]
    first = collect_result("E", {1: [evaluation([good] * 4)], 2: [evaluation([good, good, bad, good])]})
    second = collect_result("C", {1: [evaluation([bad] * 4)], 2: [evaluation([bad] * 4)]})
    other, fruit, mean = first.measures()
    assert first.totals.tolist() == [[62, 2], [1, 15]]
    assert other.estimate.value == pytest.approx(62 / 65)
    assert fruit.estimate.value == pytest.approx(15 / 18)
    assert mean.estimate.value == pytest.approx((62 / 65 + 15 / 18) / 2)
    assert mean.seeds[0] == 1
    assert mean.deviation == pytest.approx(np.std(mean.seeds, ddof=1))
    assert second.measures()[0].deviation == 0
    measure = {"value": 0.5, "low": 0.4, "high": 0.6, "sd_over_seeds": 0.02}
    assert format_measure(measure) == "50.0 [40.0, 60.0] ± 2.0"
    with pytest.raises(ValueError, match="not tested on the same images"):
        collect_result("C", {1: [evaluation([bad])], 2: [evaluation([])]})

    name, difference = compare_results(first, second).measures[-1]
    assert name == "mean"
    assert difference.value == pytest.approx(mean.estimate.value - second.measures()[-1].estimate.value)
    assert difference.low < difference.value < difference.high
    _, same = compare_results(first, first).measures[-1]
    assert (same.value, same.low, same.high) == (0, 0, 0)


def test_defaults_of_fine_tuning():
    options = ExperimentOptions().completed()
    assert (options.real_steps, options.fine_steps) == (options.training.steps, options.training.steps // 4)
    assert options.fine_rate == pytest.approx(options.training.learning_rate / 5)
    assert options.fine_tuning(1, 2).completed().classes == FRUIT_CLASSES
    assert options.synthetic(2).seed == 2
    with pytest.raises(ArgumentError, match="must be 1 or more, not 0"):
        ExperimentOptions(fine_steps=0).completed()


@pytest.mark.long
@pytest.mark.parametrize(("other", "start"), [("set", "seed1_D_start"), ("model", "model")])
def test_an_unrelated_set_or_model_starts_d(tmp_path, other, start):
    write_bands(tmp_path / "synthetic", 4)
    write_bands(tmp_path / "real", 2, seed=5)
    write_bands(tmp_path / "set", 3, seed=7)
    model = train([bands_set(2)], tmp_path / "model", QUICK)
    assert model.classes.names[0] == "background"
    files = run_experiments(
        [tmp_path / "synthetic"], tmp_path / "real", tmp_path / "out", ExperimentOptions(QUICK, seeds=1),
        other=tmp_path / other, labels="published",
    )  # fmt: skip
    assert files.content["other"]["kind"] == other
    assert {item["key"]: item["ran"] for item in files.content["experiments"]}["D"]
    trainings = [item for item in files.content["trainings"] if item["experiment"] == "D"]
    assert [item["start"] for item in trainings] == [start, start]
    assert "E above D by" in files.page.read_text()


def test_a_model_of_other_classes_is_rejected_before_anything_is_written(tmp_path):
    write_bands(tmp_path / "synthetic", 4)
    train([bands_set(2)], tmp_path / "model", TrainingOptions(**{**vars(QUICK), "classes": "leaf,stem"}))
    with pytest.raises(InputError, match="the model knows nothing of fruit"):
        run_experiments(
            [tmp_path / "synthetic"], tmp_path / "synthetic", tmp_path / "out",
            other=tmp_path / "model", labels="published",
        )  # fmt: skip
    assert not (tmp_path / "out").exists()
