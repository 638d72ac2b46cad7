"""Training: it fits its images, and depends on the seed and the step alone."""

from __future__ import annotations

import json
from itertools import islice

import numpy as np
import pytest
from shapes import shapes
from toy_models import ListedImages

torch = pytest.importorskip("torch")

from pepperscene.dataset.readers.image_set import LabelledImage  # noqa: E402
from pepperscene.errors import ArgumentError, InputError, OutputError  # noqa: E402
from pepperscene.learning.class_table import ClassTable  # noqa: E402
from pepperscene.learning.evaluation.evaluate import evaluate  # noqa: E402
from pepperscene.learning.model_names import MODELS  # noqa: E402
from pepperscene.learning.training import train  # noqa: E402
from pepperscene.learning.training.loop import LOG_FILE  # noqa: E402
from pepperscene.learning.training.samples import TrainingSamples  # noqa: E402
from pepperscene.learning.training_options import TrainingOptions  # noqa: E402

SHAPES = "background,leaf,pepper,stem"
QUICK = TrainingOptions(
    model="small,width=0.25", steps=4, batch=2, size=(32, 32), width=None, validate=2, precision="float32"
)


def quick(**changes):
    return TrainingOptions(**{**QUICK.as_record(), "size": (32, 32), **changes})


def weights(model):
    return {name: value.clone() for name, value in model.module.state_dict().items()}


def test_defaults_of_the_large_model_are_those_of_the_paper():
    options = TrainingOptions(model="deeplab_vgg16").completed()
    assert (options.steps, options.batch, options.learning_rate) == (30_000, 10, 5e-5)
    assert (options.schedule, options.balance) == ("constant", 0)
    assert set(MODELS) == {"small", "deeplab_vgg16"}


def test_the_small_network_fits_eight_images(tmp_path):
    images = shapes(8)
    options = quick(
        model="small,width=0.5", classes=SHAPES, steps=250, batch=8, size=(64, 64), augmentation=0.0,
        learning_rate=5e-3, validate=250,
    )  # fmt: skip
    model = train([images], tmp_path / "model", options)
    assert evaluate(model, images).measures.mean_iou.value > 0.95


def test_the_papers_network_fits_eight_images(tmp_path):
    images = shapes(8)
    options = quick(
        model="deeplab_vgg16,width=0.125,field=224", classes=SHAPES, steps=160, batch=8, size=(64, 64),
        augmentation=0.0, learning_rate=1e-3, schedule="cosine", validate=160,
    )  # fmt: skip
    model = train([images], tmp_path / "model", options)
    # At stride 8, edges of shapes of 30 pixels are not exact; `long` tests take larger images.
    assert evaluate(model, images).measures.mean_iou.value > 0.8


def test_crops_depend_on_seed_and_number_alone():
    table, images = ClassTable.parse(SHAPES), shapes(5)
    samples = TrainingSamples([images], table, quick(seed=3).completed())
    again = TrainingSamples([images], table, quick(seed=3).completed())
    other = TrainingSamples([images], table, quick(seed=4).completed())
    assert torch.equal(samples[7][0], again[7][0])
    assert torch.equal(samples[7][1], again[7][1])
    assert not all(torch.equal(samples[number][0], other[number][0]) for number in range(5))
    batches = []
    for workers in (0, 1, 2):
        loader = torch.utils.data.DataLoader(samples, batch_size=2, sampler=range(10), num_workers=workers)
        batches.append(list(loader))
    for others in batches[1:]:
        for (image, mask), (other_image, other_mask) in zip(batches[0], others, strict=True):
            assert torch.equal(image, other_image)
            assert torch.equal(mask, other_mask)


def test_every_image_occurs_once_before_one_occurs_again():
    # Images of one colour each, so that a crop says which image it is of.
    images = [
        LabelledImage(f"{n}", np.full((40, 40, 3), 20 * n + 10, np.uint8), np.full((40, 40), n, np.uint8))
        for n in range(7)
    ]
    first, second = (
        ListedImages(name=name, items=tuple(part)) for name, part in (("a", images[:3]), ("b", images[3:]))
    )
    samples = TrainingSamples([first, second], ClassTable.organs(), quick(augmentation=0.0).completed())
    found = [int(samples[number][1].max()) for number in range(21)]
    for epoch in range(3):
        assert sorted(found[7 * epoch : 7 * epoch + 7]) == list(range(7))
    assert found[:7] != found[7:14]


def test_training_is_deterministic_and_leaves_the_generators_alone(tmp_path):
    state, numpy_state = torch.get_rng_state(), np.random.get_state()[1].copy()  # noqa: NPY002
    first = train([shapes(4)], tmp_path / "a", quick(seed=1))
    assert torch.equal(torch.get_rng_state(), state)
    assert (np.random.get_state()[1] == numpy_state).all()  # noqa: NPY002
    second = train([shapes(4)], tmp_path / "b", quick(seed=1), workers=1)
    third = train([shapes(4)], tmp_path / "c", quick(seed=2))
    assert all(torch.equal(value, weights(second)[name]) for name, value in weights(first).items())
    assert any(not torch.equal(value, weights(third)[name]) for name, value in weights(first).items())
    for name in ("model.safetensors", "state.safetensors", LOG_FILE):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_fine_tuning_keeps_the_networks_classes(tmp_path):
    origin = train([shapes(4)], tmp_path / "origin", quick(classes=SHAPES))
    merged = "other=background+leaf+stem,fruit=pepper"
    model = train([shapes(4, seed=1)], tmp_path / "tuned", quick(classes=merged), start=tmp_path / "origin")
    assert model.classes == origin.classes == ClassTable.parse(SHAPES)
    assert model.model == origin.model
    assert any(not torch.equal(value, weights(model)[name]) for name, value in weights(origin).items())
    # Classes that are no mergers of the network's have no loss.
    with pytest.raises(InputError, match="the model knows nothing of wire"):
        train([shapes(4)], tmp_path / "no", quick(classes="leaf,wire"), start=origin)
    assert not (tmp_path / "no").exists()


def test_a_training_killed_at_its_first_checkpoint_is_resumed(tmp_path):
    train([shapes(4)], tmp_path / "a", quick())
    train([shapes(4)], tmp_path / "b", quick())
    (tmp_path / "b" / "state.safetensors").unlink()
    (tmp_path / "b" / ".state.safetensors.host.1.00.tmp").write_bytes(b"half")
    with pytest.raises(OutputError, match="holds no training"):
        train([shapes(4)], tmp_path / "b", quick())
    train([shapes(4)], tmp_path / "b", quick(), resume=True)
    for name in ("model.safetensors", "state.safetensors", LOG_FILE):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_defaults_of_fine_tuning_are_those_of_the_model_it_starts_from(tmp_path):
    options = quick(model="deeplab_vgg16,width=0.05", classes=SHAPES)
    train([shapes(4)], tmp_path / "start", options)
    default = TrainingOptions(steps=2, batch=2, size=(32, 32), width=None)
    model = train([shapes(4)], tmp_path / "tuned", default, start=tmp_path / "start")
    assert model.training["options"]["learning_rate"] == 5e-5
    assert model.training["options"]["classes"] == SHAPES


def test_the_best_state_is_kept_and_progress_is_reported(tmp_path):
    reports = []
    model = train(
        [shapes(4)],
        tmp_path / "m",
        quick(steps=7),
        validation=[shapes(2, seed=5)],
        on_progress=reports.append,
    )
    assert [report.step for report in reports] == list(range(1, 8))
    validated = {report.step: report.mean_iou for report in reports if report.mean_iou is not None}
    assert list(validated) == [2, 4, 6, 7]
    assert all(report.images_per_s > 0 and np.isfinite(report.loss) for report in reports)
    assert reports[-1].left_s == 0
    best = max(validated, key=validated.get)
    assert model.training["step"] == best
    assert model.training["validation_mean_iou"] == validated[best]
    log = [json.loads(line) for line in (tmp_path / "m" / LOG_FILE).read_text().splitlines()]
    assert {entry["step"]: entry["mean_iou"] for entry in log} == validated


def test_the_model_says_how_it_was_trained(tmp_path):
    model = train([shapes(4)], tmp_path / "m", quick(seed=9))
    assert model.training["options"]["seed"] == 9
    assert model.training["sets"][0]["images"] == 4
    assert set(model.training["versions"]) == {"pepperscene", "torch", "numpy"}
    assert model.training["start"] is None


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"steps": 0}, "steps: must be 1 or more, not 0"),
        ({"batch": -1}, "batch: must be 1 or more"),
        ({"size": (16, 64)}, "size: must be two numbers of pixels, 32 or more"),
        ({"width": 8}, "width: must be 32 or more, not 8"),
        ({"learning_rate": float("nan")}, "learning_rate: must be above 0"),
        ({"schedule": "linear"}, "schedule: must be constant or cosine, not 'linear'"),
        ({"balance": 2.0}, "balance: must be 0 to 1"),
        ({"augmentation": 5.0}, "augmentation: must be 0 to 2"),
        ({"seed": -1}, "seed: must be 0 or more"),
        ({"precision": "half"}, "precision: must be auto, float32, bfloat16"),
        ({"classes": "leaf"}, "classes: there must be two classes or more"),
    ],
)
def test_options_that_are_not_allowed_are_rejected(tmp_path, changes, message):
    with pytest.raises(ArgumentError) as error:
        train([shapes(2)], tmp_path / "m", quick(**changes))
    assert message in str(error.value)
    assert not (tmp_path / "m").exists()


def test_sets_that_cannot_be_used_are_rejected(tmp_path):
    out = tmp_path / "m"
    unlabelled = ListedImages(
        name="photos", items=tuple(LabelledImage(image.name, image.colour, None) for image in shapes(2))
    )
    for sets, message in (
        ([], "must hold at least one set"),
        ([shapes(0)], "holds no images"),
        ([unlabelled], "has no pixel of the classes"),
    ):
        with pytest.raises(InputError, match=message):
            train(sets, out, QUICK)
    with pytest.raises(InputError, match="shapes: has no pixel of the classes wire,cut"):
        train([shapes(2)], out, quick(classes="wire,cut"))
    with pytest.raises(InputError, match="photos: shapes0 has no colour image or no mask"):
        train([shapes(2)], out, QUICK, validation=[unlabelled])
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match="is not empty and holds no training"):
        train([shapes(2)], tmp_path / "full", QUICK)


def test_a_loss_that_is_not_finite_ends_the_training(tmp_path):
    with pytest.raises(ArgumentError, match="learning_rate: is too high: the loss is"):
        train([shapes(2)], tmp_path / "m", quick(learning_rate=1e30, schedule="constant", steps=20))


def test_labels_are_not_interpolated_when_images_are_scaled():
    samples = TrainingSamples([shapes(4, (90, 90))], ClassTable.parse(SHAPES), quick(width=40).completed())
    for number in islice(range(100), 12):
        assert set(samples[number][1].unique().tolist()) <= {0, 1, 2, 3, 255}
