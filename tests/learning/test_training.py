"""Training: what it learns, on what it depends, and what it writes."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from memory_set import MemorySet
from painted_bands import CLASSES, SIZE, bands_set, write_bands
from toy_models import image_set

from pepperscene.classes import IGNORE_CLASS
from pepperscene.dataset.readers import open_images
from pepperscene.dataset.readers.image_set import LabelledImage
from pepperscene.errors import ArgumentError, InputError
from pepperscene.learning.class_table import ClassTable
from pepperscene.learning.evaluation.evaluate import evaluate

torch = pytest.importorskip("torch", reason="the extra `learn` installs torch")
safetensors = pytest.importorskip("safetensors.torch", reason="the extra `learn` installs safetensors")
from safetensors import safe_open  # noqa: E402

from pepperscene.learning.models import load_model  # noqa: E402
from pepperscene.learning.options import TrainingOptions  # noqa: E402
from pepperscene.learning.training import train  # noqa: E402
from pepperscene.learning.training.loop import LOG_FILE, _learning_rate  # noqa: E402
from pepperscene.learning.training.samples import TrainingSamples  # noqa: E402

TABLE = ClassTable.parse(CLASSES)
PLAIN = TrainingOptions(
    classes=CLASSES, size=SIZE, width=None, augmentation=0, precision="float32", balance=0.5
)  # fmt: skip
LEARN = replace(PLAIN, model="small,width=0.34", steps=160, batch=4, learning_rate=1e-2)
TINY = replace(PLAIN, model="small,width=0.3", steps=4, batch=2, size=(32, 48), validate=2)


def log_of(folder):
    return [json.loads(line) for line in (folder / LOG_FILE).read_text().splitlines()]


def weights_of(model):
    return {name: value.numpy() for name, value in model.module.state_dict().items()}


# --- learning -----------------------------------------------------------------------------------------------


def check_learned(model, images, folder):
    assert evaluate(model, images).measures.mean_iou.value > 0.95
    losses = [entry["loss"] for entry in log_of(folder)]
    assert losses[-1] < 0.5 * losses[0]


@pytest.fixture(scope="module")
def learned(tmp_path_factory):
    """Folder of the small network that has learned eight images."""
    folder = tmp_path_factory.mktemp("learned") / "model"
    train(bands_set(8), folder, LEARN)
    return folder


def test_the_small_network_learns_eight_images_by_heart(learned):
    check_learned(load_model(learned), bands_set(8), learned)


# From random weights the network of the paper needs more than its 5e-5.
@pytest.mark.long
@pytest.mark.parametrize(
    ("model", "steps", "learning_rate"),
    [
        ("deeplab_vgg16,width=0.125", 80, 1e-3),
        ("deeplab_vgg16,width=0.125,field=224", 90, 1e-3),
        ("deeplab_vgg16", 60, 1e-4),
    ],
)
def test_the_network_of_the_paper_learns_eight_images_by_heart(model, steps, learning_rate, tmp_path):
    options = replace(PLAIN, model=model, steps=steps, batch=4, learning_rate=learning_rate)
    check_learned(train(bands_set(8), tmp_path / "model", options), bands_set(8), tmp_path / "model")


def test_the_learning_rate_follows_its_schedule():
    constant = replace(TINY, schedule="constant", learning_rate=0.01).completed()
    assert {_learning_rate(constant, step) for step in (1, 2, 4)} == {0.01}
    cosine = replace(TINY, schedule="cosine", learning_rate=0.01, steps=1000).completed()
    rates = [_learning_rate(cosine, step) for step in range(1, 1001)]
    np.testing.assert_allclose(rates[:50], 0.01 * np.arange(1, 51) / 50)
    assert np.all(np.diff(rates[50:]) < 0)
    # Half of the way down at half of the steps after the warm-up.
    assert rates[525 - 1] == pytest.approx(0.005, rel=1e-3)
    assert rates[-1] == pytest.approx(0, abs=1e-15)


# --- reproducibility ----------------------------------------------------------------------------------------


def test_training_depends_on_the_seed_alone_and_leaves_global_generators_as_they_are(tmp_path):
    images, results = bands_set(3), []
    for number, (seed, start) in enumerate([(1, 10), (1, 20), (2, 10)]):
        torch.manual_seed(start)
        before, numbers = torch.get_rng_state(), np.random.get_state()[1].copy()  # noqa: NPY002
        train(images, tmp_path / str(number), replace(TINY, seed=seed), validation=images)
        assert torch.equal(torch.get_rng_state(), before)
        np.testing.assert_array_equal(np.random.get_state()[1], numbers)  # noqa: NPY002
        results.append((tmp_path / str(number) / "model.safetensors").read_bytes())
    assert results[0] == results[1]
    assert results[0] != results[2]


def test_crops_do_not_depend_on_workers(tmp_path):
    """The same bytes with two processes and none."""
    images = open_images(write_bands(tmp_path / "set", 5))
    for workers in (0, 2):
        train(images, tmp_path / f"{workers}", replace(TINY, augmentation=1.0, workers=workers))
    for name in ("model.safetensors", "state.safetensors", LOG_FILE):
        assert (tmp_path / "0" / name).read_bytes() == (tmp_path / "2" / name).read_bytes(), name


def numbered_set(count, name="numbered"):
    """Images of a single colour, which is their number."""
    images = [
        LabelledImage(f"{k}", np.full((40, 50, 3), k, np.uint8), np.ones((40, 50), np.uint8))
        for k in range(count)
    ]
    return MemorySet(name=name, items=tuple(images))


def test_every_image_occurs_once_in_each_epoch():
    first, second = numbered_set(7), numbered_set(10).take([7, 8, 9])
    samples = TrainingSamples([first, second], TABLE, replace(TINY, size=(32, 32)))
    orders = []
    for epoch in range(4):
        shown = [int(samples[10 * epoch + place][0].max()) for place in range(10)]
        assert sorted(shown) == list(range(10))
        orders.append(tuple(shown))
    assert len(set(orders)) == 4
    # A set that occurs twice counts twice.
    twice = TrainingSamples([second, second], TABLE, replace(TINY, size=(32, 32)))
    assert sorted(int(twice[place][0].max()) for place in range(6)) == [7, 7, 8, 8, 9, 9]


def test_labels_fit_images_in_crops():
    """Classes are those of the colours, also where images are scaled, mirrored and padded with void."""
    images = bands_set(4)
    colours = {
        index: np.mean([image.colour[TABLE.indices(image.classes) == index].mean(0) for image in images], 0)
        for index in range(4)
    }
    options = replace(TINY, augmentation=1.0, size=(64, 96), width=64)
    samples = TrainingSamples([images], TABLE, options)
    # Geometry alone: colours change at random otherwise.
    samples._augmentation = replace(samples._augmentation, steps=samples._augmentation.steps[:2])
    padded = 0
    for number in range(16):
        image, labels = (tensor.numpy() for tensor in samples[number])
        void = labels == IGNORE_CLASS
        assert not image[:, void].any()
        padded += void.any()
        distances = [np.abs(image.transpose(1, 2, 0) - colours[index]).sum(axis=2) for index in range(4)]
        fits = np.argmin(distances, axis=0) == labels
        assert fits[~void].mean() > 0.9
    assert padded


# --- classes, validation, start -----------------------------------------------------------------------------


def test_a_start_keeps_its_classes_where_labels_are_merged(learned, tmp_path):
    """Photographs know fruit only; the network still separates leaves from stems afterwards."""
    images, merged = bands_set(8), "other=background+leaf+stem,fruit=pepper"
    before, weights = load_model(learned), weights_of(load_model(learned))
    options = replace(LEARN, classes=merged, steps=16, learning_rate=1e-3)
    adapted = train(images, tmp_path / "adapted", options, start=before, validation=images[:4])
    assert (adapted.classes, adapted.model) == (TABLE, before.model)
    assert evaluate(adapted, images).measures.mean_iou.value > 0.9
    assert adapted.training["validation_mean_iou"] > 0.9
    assert adapted.training["options"]["classes"] == merged
    # Weights were adapted, and the given model was not.
    assert any((weights_of(adapted)[name] != value).any() for name, value in weights.items())
    assert all((weights_of(before)[name] == value).all() for name, value in weights.items())


def test_a_start_determines_model_defaults_and_classes(tmp_path):
    images = bands_set(2)
    options = replace(TINY, model="deeplab_vgg16,width=0.02")
    start = train(images, tmp_path / "start", options)
    adapted = train(images, tmp_path / "b", replace(TINY, classes=None, steps=1), start=start)
    assert adapted.classes == TABLE
    used = adapted.training["options"]
    assert (used["model"], used["learning_rate"], used["schedule"]) == (options.model, 5e-5, "constant")
    mixed = train(images, tmp_path / "c", replace(TINY, classes="other=leaf+stem,rest=pepper+background"))
    with pytest.raises(InputError, match="the model's class other is only partly in leaf"):
        train(images, tmp_path / "d", replace(TINY, classes="leaf,stem"), start=mixed)


def test_a_trained_model_does_not_need_the_file_of_its_initial_weights(tmp_path):
    from pepperscene.learning.models import build_model

    features = build_model("deeplab_vgg16,width=0.02", 2).features.state_dict()
    file = tmp_path / "vgg.safetensors"
    safetensors.save_file({f"features.{name}": value for name, value in features.items()}, file)
    options = replace(TINY, model=f"deeplab_vgg16,width=0.02,weights={file}")
    model = train(bands_set(2), tmp_path / "model", options)
    assert model.training["options"]["model"] == options.model
    file.unlink()
    assert load_model(tmp_path / "model").model == "deeplab_vgg16,width=0.02"
    train(bands_set(2), tmp_path / "next", TINY, start=tmp_path / "model")


@pytest.fixture
def validations(monkeypatch):
    """Function that makes validations have these results."""

    def install(results):
        values = iter(results)
        name = "pepperscene.learning.training.loop.TrainingLoop._validate"
        monkeypatch.setattr(name, lambda *_: next(values))

    return install


def test_validation_chooses_the_best_state(tmp_path, validations):
    images, results = bands_set(3), [0.3, 0.8, 0.8, 0.5]
    # The network of step 4 is that of a training whose last step is the fourth.
    constant = replace(TINY, steps=4, schedule="constant")
    shorter = train(images, tmp_path / "b", constant)
    assert (shorter.training["step"], shorter.training["validation_mean_iou"]) == (4, None)
    stored = safetensors.load_file(tmp_path / "b" / "state.safetensors")
    assert all(
        (stored[f"model.{name}"].numpy() == value).all() for name, value in weights_of(shorter).items()
    )
    validations(results)
    longer = train(images, tmp_path / "c", replace(constant, steps=8), validation=images)
    assert (longer.training["step"], longer.training["validation_mean_iou"]) == (4, 0.8)
    assert [entry["mean_iou"] for entry in log_of(tmp_path / "c")] == results
    assert all((weights_of(longer)[name] == value).all() for name, value in weights_of(shorter).items())


@pytest.mark.parametrize(
    ("results", "step", "best"),
    [
        ([math.nan, 0.3, 0.8, 0.5], 6, 0.8),
        ([0.3, math.nan, 0.2, math.nan], 2, 0.3),
        ([math.nan, math.nan, math.nan, math.nan], 8, None),
    ],
)
def test_unknown_validations_are_neither_better_nor_worse(results, step, best, tmp_path, validations):
    validations(results)
    images = bands_set(3)
    model = train(images, tmp_path, replace(TINY, steps=8), validation=images)
    assert (model.training["step"], model.training["validation_mean_iou"]) == (step, best)

    # No file has a number that JSON does not have.
    def refuse(constant):
        raise AssertionError(constant)

    lines = (tmp_path / "training.jsonl").read_text().splitlines()
    logged = [json.loads(line, parse_constant=refuse)["mean_iou"] for line in lines]
    assert logged == [None if math.isnan(value) else value for value in results]
    for name in ("model.safetensors", "state.safetensors"):
        with safe_open(tmp_path / name, "np") as content:
            json.loads(content.metadata()["description"], parse_constant=refuse)


def test_validation_is_the_mean_iou_of_an_evaluation(tmp_path):
    images, others = bands_set(3, name="some"), bands_set(4, seed=9, name="other")
    options = replace(TINY, steps=2, width=64)
    model = train(images, tmp_path / "a", options, validation=others)
    # A model states how it was trained.
    training = json.loads(json.dumps(model.training, allow_nan=False))
    stored = {**training["options"], "size": tuple(training["options"]["size"])}
    assert TrainingOptions(**stored) == options.completed()
    assert [(item["name"], item["images"]) for item in training["sets"]] == [("some", 3)]
    assert [item["name"] for item in training["validation"]] == ["other"]
    assert training["versions"]["torch"] == str(torch.__version__)
    assert training["start"] is None
    expected = evaluate(model, others).measures.mean_iou.value
    # The validated network has another memory layout, in which sums are rounded differently.
    assert model.training["validation_mean_iou"] == pytest.approx(expected, abs=2e-3)


# --- files and progress -------------------------------------------------------------------------------------


def test_log_and_progress(tmp_path):
    images, seen = bands_set(3), []
    train(images, tmp_path / "a", replace(TINY, steps=5), validation=images[:1], on_progress=seen.append)
    assert sorted(path.name for path in (tmp_path / "a").iterdir()) == [
        "model.safetensors", "model_card.md", "state.safetensors", LOG_FILE,
    ]  # fmt: skip
    entries = log_of(tmp_path / "a")
    assert [entry["step"] for entry in entries] == [2, 4, 5]
    assert all(set(entry) == {"step", "loss", "mean_iou"} for entry in entries)
    assert all(entry["loss"] > 0 and 0 <= entry["mean_iou"] <= 1 for entry in entries)
    assert [(progress.step, progress.steps) for progress in seen] == [(k, 5) for k in range(1, 6)]
    assert [progress.mean_iou is None for progress in seen] == [True, False, True, False, False]
    assert [seen[k].mean_iou for k in (1, 3, 4)] == [entry["mean_iou"] for entry in entries]
    assert [seen[k].loss for k in (1, 3, 4)] == [entry["loss"] for entry in entries]
    assert all(progress.images_per_s > 0 and progress.left_s >= 0 for progress in seen)
    assert seen[-1].left_s == 0


# --- errors -------------------------------------------------------------------------------------------------


def test_rejects_options_that_are_not_allowed(tmp_path):
    nan = float("nan")
    for name, values, message in (
        ("steps", (0,), "must be 1 or more"),
        ("batch", (-1, 4097), "must be 1 to 4096"),
        ("validate", (0,), "must be 1 or more"),
        ("size", ((16, 64),), "must be two numbers of pixels, 32 to 8192"),
        ("width", (8,), "must be 32 to 8192"),
        ("learning_rate", (0.0, nan), "must be above 0"),
        ("schedule", ("step",), "must be constant or cosine"),
        ("balance", (2.0, nan), "must be 0 to 1"),
        ("augmentation", (-0.1, 2.1), "must be 0 to 2"),
        ("seed", (-1, 2**32), "must be 0 to 4294967295"),
        ("precision", ("float64",), "must be auto, float32, bfloat16"),
    ):
        for value in values:
            with pytest.raises(ArgumentError) as caught:
                train(bands_set(2), tmp_path / "out", replace(TINY, **{name: value}))
            assert str(caught.value) == f"{name}: {message}, not {value!r}"
    for changes, message in (
        ({"classes": "leaf"}, "classes: there must be two classes or more, not 1"),
        ({"device": "meta"}, "device: meta cannot be used"),
        ({"device": "cuda:99"}, "device: cuda:99 cannot be used"),
    ):
        with pytest.raises(ArgumentError, match=message):
            train(bands_set(2), tmp_path / "out", replace(TINY, **changes))
    assert not (tmp_path / "out").exists()


def test_rejects_a_learning_rate_with_which_the_loss_is_not_finite(tmp_path):
    options = replace(TINY, model="deeplab_vgg16,width=0.02", learning_rate=1e30, steps=20)
    with pytest.raises(ArgumentError, match="learning_rate: is too high: the loss is"):
        train(bands_set(2), tmp_path / "out", options)


def test_rejects_sets_without_images_or_pixels_of_the_classes(tmp_path):
    images, void = bands_set(2), image_set(np.full((40, 50), IGNORE_CLASS), name="void")
    out, no_pixel = tmp_path / "out", "void: has no pixel of the classes background,leaf,pepper,stem"
    with pytest.raises(ArgumentError, match="sets: must hold at least one set"):
        train([], out, TINY)
    # Validations before the first step, not after hours.
    for sets, validation, message in (
        (image_set(), (), "toy: holds no images"),
        (void, (), no_pixel),
        (images, void, no_pixel),
        (images, [images, image_set()], "toy: holds no images"),
    ):
        with pytest.raises(InputError, match=message):
            train(sets, out, TINY, validation=validation)
    assert not out.exists()
