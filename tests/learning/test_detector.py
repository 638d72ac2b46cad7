"""The detector: targets, losses, the objects that it finds, and what it learns."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from object_set import SIZE, object_set, paint_objects
from painted_bands import bands_set

from pepperscene.classes import IGNORE_CLASS
from pepperscene.errors import ArgumentError, InputError
from pepperscene.learning.class_table import ClassTable
from pepperscene.learning.options import TrainingOptions, parse_classes

torch = pytest.importorskip("torch", reason="the extra `learn` installs torch")
pytest.importorskip("safetensors", reason="the extra `learn` installs safetensors")
pytest.importorskip("pycocotools", reason="the extra `export` installs pycocotools")

from pepperscene.learning.evaluation.detection import evaluate_detector  # noqa: E402
from pepperscene.learning.models import build_model, load_model  # noqa: E402
from pepperscene.learning.models.detections import Detections  # noqa: E402
from pepperscene.learning.models.detector import (  # noqa: E402
    Detector,
    ObjectMaps,
    box_iou,
    find_objects,
    mask_logits,
)
from pepperscene.learning.objects import labelled_objects, object_indices  # noqa: E402
from pepperscene.learning.training import train  # noqa: E402
from pepperscene.learning.training.detection_loss import (  # noqa: E402
    DetectionLoss,
    generalised_iou,
    object_targets,
)
from pepperscene.learning.training.samples import TrainingSamples  # noqa: E402

TINY = TrainingOptions(
    task="detect", model="small,width=0.3", steps=4, batch=2, size=SIZE, width=None, augmentation=0,
    precision="float32", learning_rate=1e-2, validate=2, least_area=20,
)  # fmt: skip
FRUIT = parse_classes("detect", None)


# --- labelled objects and targets ---------------------------------------------------------------------------


def test_objects_are_the_instances_of_each_class_and_small_ones_are_ignored():
    classes, instances = np.zeros((20, 30), np.uint8), np.zeros((20, 30), np.uint16)
    classes[2:8, 3:11], instances[2:8, 3:11] = 2, 7  # fruit of 48 pixels
    classes[8:12, 5:7], instances[8:12, 5:7] = 3, 7  # its peduncle has the same number
    classes[15:17, 20:22], instances[15:17, 20:22] = 2, 9  # a fragment
    classes[0, 25:30] = 3  # without an instance
    classes[19, :5] = IGNORE_CLASS
    classes[12:15, 12:20], instances[12:15, 12:20] = 1, 3  # a leaf
    indices = object_indices(FRUIT, classes)
    found, ignored = labelled_objects(indices, instances, 2, 8)
    assert found.labels.tolist() == [0, 1]
    np.testing.assert_array_equal(found.boxes, [[3, 2, 11, 8], [5, 8, 7, 12]])
    np.testing.assert_array_equal(found.masks[0], (classes == 2) & (instances == 7))
    expected = (classes == IGNORE_CLASS) | (instances == 9) | ((classes == 3) & (instances == 0))
    np.testing.assert_array_equal(ignored, expected)


def labels_of(boxes, size=(64, 96)):
    """Labels of rectangles: class index and sides of each."""
    labels = np.full((2, *size), 2, np.int64)
    labels[1] = 0
    for number, (index, left, top, right, bottom) in enumerate(boxes, start=1):
        labels[0, top:bottom, left:right], labels[1, top:bottom, left:right] = index, number
    return torch.from_numpy(labels)


def test_targets_are_gaussians_at_the_centres_of_boxes():
    target = object_targets(labels_of([(0, 8, 4, 48, 28), (1, 60, 40, 68, 56)]), (16, 24), 2, 20)
    np.testing.assert_array_equal(target.boxes, [[8, 4, 48, 28], [60, 40, 68, 56]])
    # The middle (28, 16) is at the corner of four cells; the lower right one has the centre.
    rows, columns = np.mgrid[:16, :24]
    sigmas = (0.54 * 40 / 4 + 1) / 6, (0.54 * 24 / 4 + 1) / 6
    expected = np.exp(-(((columns - 7) / sigmas[0]) ** 2 + ((rows - 4) / sigmas[1]) ** 2) / 2)
    np.testing.assert_allclose(target.centres[0], expected, atol=1e-6)
    assert np.argwhere(target.centres[1].numpy() == 1).tolist() == [[12, 16]]
    # All sides are multiples of 4, so that each cell is inside of an object or outside.
    assert target.masks.unique().tolist() == [0, 1]
    assert target.masks.sum(dim=(1, 2)).tolist() == [10 * 6, 2 * 4]
    assert target.counts.all()


def test_cells_beside_ignored_pixels_do_not_count_unless_they_are_centres():
    labels = labels_of([(0, 8, 4, 48, 28), (0, 80, 40, 84, 44)])
    labels[0, 16:20, 28:32] = IGNORE_CLASS
    target = object_targets(labels, (16, 24), 2, 20)
    assert target.boxes.tolist() == [[8, 4, 48, 28]]
    expected = np.ones((16, 24), bool)
    expected[3:6, 6:9] = False
    expected[9:12, 19:22] = False  # the fragment of 16 pixels
    expected[4, 7] = True
    np.testing.assert_array_equal(target.counts, expected)


def test_crops_without_objects_have_targets_and_a_loss():
    target = object_targets(labels_of([]), (16, 24), 2, 20)
    assert target.boxes.shape == (0, 4)
    assert not target.centres.any()
    maps = perfect_maps(target)
    assert float(DetectionLoss(2, 20)(maps, labels_of([])[None])) == pytest.approx(0, abs=1e-6)


def perfect_maps(target):
    """Maps that agree with a target, whose objects are far apart: one prototype has all of their masks."""
    height, width = target.counts.shape
    logits = torch.where(target.centres == 1, 20.0, -20.0)
    distances = torch.zeros(4, height, width)
    weights, prototypes = torch.zeros(22, height, width), torch.zeros(16, height, width)
    rows, columns = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    if len(target.boxes):
        nearest = target.nearness.argmax(dim=0)
        middles = torch.stack([columns, rows], dim=-1) * 4 + 2
        boxes = target.boxes[nearest]
        distances = torch.cat([middles - boxes[..., :2], boxes[..., 2:] - middles], dim=-1).permute(2, 0, 1)
        prototypes[0], weights[0] = 40.0 * target.masks.amax(dim=0) - 20.0, 1.0
    return ObjectMaps(logits[None], distances[None], weights[None], prototypes[None])


def test_the_loss_is_zero_for_perfect_maps_and_grows_with_each_error():
    labels = labels_of([(0, 8, 4, 48, 28), (1, 60, 40, 68, 56)])
    target, loss = object_targets(labels, (16, 24), 2, 20), DetectionLoss(2, 20)
    maps = perfect_maps(target)
    # Cells far from all objects are not asked for boxes; probabilities of 20 in the logit are nearly 1.
    assert float(loss(maps, labels[None])) == pytest.approx(0, abs=1e-3)
    assert float(loss(maps._replace(centres=-maps.centres), labels[None])) > 5
    # Boxes of twice the area have an IoU of a half, and so has the smallest box around both.
    wider = target.boxes.clone()
    wider[:, 2] += wider[:, 2] - wider[:, 0]
    np.testing.assert_allclose(generalised_iou(target.boxes, wider), [0.5, 0.5])
    worse = maps._replace(weights=-maps.weights)
    assert float(loss(worse, labels[None])) > 10


def test_generalised_iou_against_its_definition():
    first = torch.tensor([[0.0, 0, 2, 2], [0, 0, 1, 1], [0, 0, 4, 2]])
    second = torch.tensor([[1.0, 1, 3, 3], [3, 0, 4, 1], [0, 0, 4, 2]])
    np.testing.assert_allclose(generalised_iou(first, second), [1 / 7 - 2 / 9, -0.5, 1.0], rtol=1e-6)


# --- found objects ------------------------------------------------------------------------------------------


def random_maps(seed=0, classes=2, cells=(12, 16)):
    rng = np.random.default_rng(seed)
    draw = lambda *shape: torch.tensor(rng.normal(0, 1, (1, *shape, *cells)), dtype=torch.float32)  # noqa: E731
    return ObjectMaps(draw(classes), draw(4).abs() * 8, draw(22), draw(16))


def test_found_objects_against_a_loop_over_cells():
    """Peaks, boxes, repeats and masks, cell by cell with NumPy."""
    maps, size = random_maps(), (45, 62)
    found = find_objects(maps, size)
    centres = 1 / (1 + np.exp(-maps.centres[0].double().numpy()))
    expected = []
    for label, row, column in np.ndindex(*centres.shape):
        around = centres[label, max(0, row - 1) : row + 2, max(0, column - 1) : column + 2]
        if centres[label, row, column] == around.max():
            left, top, right, bottom = maps.distances[0, :, row, column].double().numpy()
            x, y = 4 * column + 2, 4 * row + 2
            box = np.clip([x - left, y - top, x + right, y + bottom], 0, [62, 45, 62, 45])
            expected.append((centres[label, row, column], label, box, maps.weights[0, :, row, column]))
    expected.sort(key=lambda item: -item[0])
    for number, (score, label, box, weights) in enumerate(expected):
        assert int(found.labels[number]) == label
        np.testing.assert_allclose(found.boxes[number], box, atol=1e-4)
        overlaps = [iou(box, other) for _, own, other, _ in expected[:number] if own == label]
        kept = 0 if max(overlaps, default=0) > 0.6 else score
        assert float(found.scores[number]) == pytest.approx(kept, abs=1e-6)
        np.testing.assert_allclose(found.masks[number], mask_of(maps, box, weights), atol=2e-4)


def iou(first, second):
    sides = np.minimum(first[2:], second[2:]) - np.maximum(first[:2], second[:2])
    area = lambda box: (box[2] - box[0]) * (box[3] - box[1])  # noqa: E731
    common = np.prod(np.maximum(sides, 0))
    return common / max(area(first) + area(second) - common, 1e-6)


def mask_of(maps, box, weights):
    """Probabilities of a mask by the formula, in double precision."""
    prototypes, weights = maps.prototypes[0].double().numpy(), weights.double().numpy()
    rows, columns = np.mgrid[: prototypes.shape[1], : prototypes.shape[2]] * 4.0 + 2
    halves = [max((box[2] - box[0]) / 2, 2), max((box[3] - box[1]) / 2, 2)]
    x = (columns - (box[0] + box[2]) / 2) / halves[0]
    y = (rows - (box[1] + box[3]) / 2) / halves[1]
    near = (abs(x) * halves[0] <= (box[2] - box[0]) / 2 + 4) & (
        abs(y) * halves[1] <= (box[3] - box[1]) / 2 + 4
    )
    x, y = np.clip(x, -2, 2), np.clip(y, -2, 2)
    terms = np.stack([np.ones_like(x), x, y, x * x, y * y, x * y])
    logits = np.tensordot(weights[:16], prototypes, 1) + np.tensordot(weights[16:], terms, 1)
    return near / (1 + np.exp(-logits))


def test_the_overlap_of_boxes_against_pycocotools():
    from pycocotools import mask as coder

    rng = np.random.default_rng(3)
    boxes = rng.uniform(0, 50, (20, 4))
    boxes[:, 2:] = boxes[:, :2] + rng.uniform(1, 40, (20, 2))
    by_size = np.concatenate([boxes[:, :2], boxes[:, 2:] - boxes[:, :2]], axis=1)
    expected = coder.iou(by_size, by_size, [0] * 20)
    np.testing.assert_allclose(box_iou(torch.from_numpy(boxes)), expected, atol=1e-9)


def test_masks_are_interpolated_at_the_size_of_the_image():
    """An image of twice the network's size: bilinear values between the middles of cells, as of torch."""
    cells = np.random.default_rng(1).random((1, 12, 16)).astype(np.float32)
    box, size, seen = np.array([[20.5, 13.0, 101.0, 80.2]], np.float32), (96, 128), (48, 64)
    found = Detections(box, np.ones(1, np.float32), np.zeros(1, np.int64), size, seen, cells)
    whole = torch.nn.functional.interpolate(
        torch.from_numpy(cells)[None], size=size, mode="bilinear", align_corners=False
    )[0, 0].numpy()
    expected = np.zeros(size, bool)
    expected[13:81, 20:101] = whole[13:81, 20:101] > 0.5
    mask = found.mask(0)
    unclear = abs(whole - 0.5) < 1e-5
    np.testing.assert_array_equal(mask[~unclear], expected[~unclear])
    assert 0 < mask.sum() < mask.size


def test_boxes_are_those_of_the_image_and_uncertain_objects_are_left_out():
    boxes = np.array([[4, 8, 20, 24], [0, 0, 64, 48], [1, 1, 2, 2]], np.float32)
    scores, labels = np.array([0.9, 0.3, 0.04], np.float32), np.array([1, 0, 1])
    masks = np.ones((3, 12, 16), np.float32)
    found = Detections.of_network(boxes, scores, labels, masks, seen=(48, 64), size=(97, 130))
    assert len(found) == 2
    expected = np.array([4, 8, 20, 24]) * np.tile([130 / 64, 97 / 48], 2)
    np.testing.assert_allclose(found.boxes[0], expected, rtol=1e-6)
    assert found.mask(1).all()


# --- networks and learning ----------------------------------------------------------------------------------


@pytest.mark.parametrize("model", ["small,width=0.3", "efficientnet_lite0"])
def test_maps_have_a_quarter_of_the_size(model):
    network = Detector(model, 3).eval()
    with torch.inference_mode():
        maps = network(torch.zeros(1, 3, 50, 70))
    heights = {tensor.shape[-2:] for tensor in maps}
    multiple = 16 if "small" in model else 32
    assert heights == {(-(-50 // multiple) * multiple // 4, -(-70 // multiple) * multiple // 4)}
    assert [tensor.shape[1] for tensor in maps] == [3, 4, 22, 16]
    # All layers are used.
    network.train()(torch.rand(2, 3, 64, 64)).centres.sum().backward()
    unused = [name for name, value in network.named_parameters() if value.grad is None and "network" in name]
    assert unused == []


def test_features_of_a_detector_are_those_of_the_segmentation():
    network = build_model("small,width=0.3", 4).eval()
    images = torch.rand(1, 3, 64, 96)
    with torch.inference_mode():
        before = network.quarter_features(images)
        assert before.shape == (1, network.quarter_channels, 16, 24)
        np.testing.assert_array_equal(network.without_last_layers().quarter_features(images), before)


@pytest.fixture(scope="module")
def learned(tmp_path_factory):
    """Folder of a detector that has learned four images."""
    folder = tmp_path_factory.mktemp("detector") / "model"
    train(object_set(4), folder, replace(TINY, steps=70, validate=70, learning_rate=8e-3))
    return folder


def test_learns_four_images_by_heart(learned):
    model = load_model(learned)
    assert (model.task, model.classes) == ("detect", FRUIT)
    result = evaluate_detector(model, object_set(4))
    for item in result.classes:
        assert item.boxes.ap50 > 0.9
        assert item.masks.ap50 > 0.9
        assert item.decided.counts.truth == 8
    assert result.mean_ap50 > 0.9


def test_detections_do_not_depend_on_earlier_images(learned):
    model, image = load_model(learned), paint_objects(1)
    first = model.detections(image.colour)
    model.detections(paint_objects(2).colour)
    second = model.detections(image.colour)
    np.testing.assert_array_equal(first.boxes, second.boxes)
    np.testing.assert_array_equal(first.mask(0), second.mask(0))
    assert len(first) >= 4
    assert (np.diff(first.scores) <= 0).all()


def test_resumed_trainings_end_with_the_same_bytes(tmp_path):
    images = object_set(3)
    train(images, tmp_path / "whole", replace(TINY, augmentation=1.0), validation=images[:1])

    def stop(progress):
        if progress.step == 3:
            raise KeyboardInterrupt

    options = replace(TINY, augmentation=1.0)
    with pytest.raises(KeyboardInterrupt):
        train(images, tmp_path / "parts", options, validation=images[:1], on_progress=stop)
    assert not (tmp_path / "parts" / "model_card.md").exists()
    train(images, tmp_path / "parts", options, validation=images[:1], resume=True)
    names = sorted(path.name for path in (tmp_path / "whole").iterdir())
    assert names == ["model.safetensors", "model_card.md", "state.safetensors", "training.jsonl"]
    for name in names:
        assert (tmp_path / "whole" / name).read_bytes() == (tmp_path / "parts" / name).read_bytes(), name
    entries = [json.loads(line) for line in (tmp_path / "whole" / "training.jsonl").read_text().splitlines()]
    assert [set(entry) for entry in entries] == [{"step", "loss", "ap50"}] * 2


def test_a_start_keeps_its_task_and_classes(learned, tmp_path):
    images = object_set(2)
    adapted = train(images, tmp_path / "a", replace(TINY, steps=1), start=learned)
    assert (adapted.task, adapted.classes) == ("detect", FRUIT)
    with pytest.raises(ArgumentError, match="classes: must be those of the detector to start from"):
        train(images, tmp_path / "b", replace(TINY, classes="pepper"), start=learned)
    with pytest.raises(ArgumentError, match="start: was trained for the task detect, not segment"):
        train(images, tmp_path / "c", replace(TINY, task="segment"), start=learned)


def test_samples_have_instances_that_fit_the_image():
    options = replace(TINY, augmentation=1.0, width=72)
    samples = TrainingSamples([object_set(3)], FRUIT, options)
    samples._augmentation = replace(samples._augmentation, steps=samples._augmentation.steps[:2])
    for number in range(6):
        image, labels = samples[number]
        assert labels.shape == (2, *SIZE)
        indices, instances = labels.numpy()
        assert set(np.unique(indices)) <= {0, 1, 2, IGNORE_CLASS}
        inside = (indices < 2) & (indices != IGNORE_CLASS)
        assert ((instances > 0) == inside)[indices != IGNORE_CLASS].all()
        # Fruit are redder than all else.
        red = image[0].int() - image[1].int()
        if (indices == 0).any():
            assert red.numpy()[indices == 0].mean() > 50


# --- wrong input --------------------------------------------------------------------------------------------


def test_rejects_options_that_do_not_suit_a_detector(tmp_path, learned):
    images, out = object_set(2), tmp_path / "out"
    for changes, message in (
        ({"task": "count"}, "task: must be segment or detect, not 'count'"),
        ({"model": "deeplab_vgg16"}, "model: must be small or efficientnet_lite0 for a detector"),
        ({"classes": "other=background+leaf,pepper"}, "classes: must be classes of objects"),
        ({"classes": "apple"}, "'apple' is none of background"),
        ({"least_area": 0}, "least_area: must be 1 or more, not 0"),
    ):
        with pytest.raises(ArgumentError, match=message):
            train(images, out, replace(TINY, **changes))
    with pytest.raises(InputError, match="bands: image0 has no image of instances, which training needs"):
        train(bands_set(1), out, TINY)
    model = load_model(learned)
    with pytest.raises(ArgumentError, match="model: was trained for the task detect, not segment"):
        model.probabilities(images[0].colour)
    assert ClassTable.parse("pepper", least=1).names == ("pepper",)


def test_a_segmentation_finds_no_objects(tmp_path):
    options = TrainingOptions(model="small,width=0.3", steps=1, batch=1, size=(32, 32), width=None)
    model = train(bands_set(1), tmp_path / "model", options)
    with pytest.raises(ArgumentError, match="model: was trained for the task segment, not detect"):
        model.detections(bands_set(1)[0].colour)
    assert "task" not in model.description()
    assert "task" not in model.training["options"]


def test_masks_use_the_prototypes():
    """Weights of one prototype alone: its values are the logits."""
    prototypes = torch.rand(16, 5, 6)
    weights = torch.zeros(1, 22)
    weights[0, 3] = 2.0
    logits = mask_logits(prototypes, weights, torch.tensor([[0.0, 0.0, 24.0, 20.0]]))
    np.testing.assert_allclose(logits[0], 2 * prototypes[3], rtol=1e-6)
