"""The steps of a training, and its validation."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, final

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import softmax
from torch import nn

from pepperscene.atomic import remove_temporary_files, write_file
from pepperscene.classes import IGNORE_CLASS
from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.document import parse_json
from pepperscene.errors import ArgumentError, InputError, PepperError
from pepperscene.learning.class_table import ClassTable
from pepperscene.learning.evaluation.detection import evaluate_detector
from pepperscene.learning.evaluation.evaluate import predict_classes, sampled_probabilities
from pepperscene.learning.evaluation.measures import confusion_matrix, mean_intersection_over_union
from pepperscene.learning.models.decision import Decision, fit_factors, fit_temperature
from pepperscene.learning.models.registry import without_initial_weights
from pepperscene.learning.models.trained_model import MODEL_FILE, TrainedModel, apply_model, build_network
from pepperscene.learning.options import MEASURES, TrainingOptions, TrainingProgress
from pepperscene.learning.training.checkpoint import STATE_FILE, TrainingState, read_state, write_state
from pepperscene.learning.training.colour_matching import ColourMatching
from pepperscene.learning.training.detection_loss import DetectionLoss
from pepperscene.learning.training.samples import TrainingBatches, TrainingSamples
from pepperscene.learning.training.segmentation_loss import SegmentationLoss
from pepperscene.review.report.data import evenly_spaced
from pepperscene.user_files import read_file

LOG_FILE: Final = "training.jsonl"

_WARM_UP: Final = 0.05  # chosen: part of the steps until the learning rate of a cosine schedule is reached
_BETAS: Final = (0.9, 0.999)  # section 2.8 of the paper
_EPSILON: Final = 1e-8  # section 2.8 of the paper
_SEED_STRIDE: Final = 1_000_003  # chosen: a prime, more than trainings have steps


_COUNTED: Final = 200
"""Images whose pixels are counted for the frequencies of classes. Chosen: frequencies are known to some
percent."""

_MOST_WEIGHT: Final = 30.0
"""Of a class, times that of the most frequent one. Chosen: a class of a few pixels must not drown the
others."""

_CALIBRATED: Final = 32
"""Images in which temperature and factors are fitted. Chosen: some hundred sampled pixels of rare classes."""

_LEAST_PROBABILITY: Final = 1e-12  # chosen: of a class of which the network is certain that it is not there


def class_frequencies(sets: Sequence[ImageSet], labels: ClassTable) -> NDArray[np.float64]:
    """Shares `(k,)` of the classes in the labelled pixels of some images.

    Raises:
        InputError: no image has a pixel of any of the classes.
    """
    counts = np.zeros(len(labels))
    for images in sets:
        positions = evenly_spaced(len(images), _COUNTED // len(sets) + 1)
        for image in images.select("classes").take(positions):
            if image.classes is not None:
                counts += np.bincount(labels.indices(image.classes).ravel(), minlength=256)[: len(labels)]
    if not counts.any():
        names = ", ".join(images.name for images in sets)
        raise InputError(names, f"has no pixel of the classes {labels}")
    return np.asarray(counts / counts.sum())


def class_weights(frequencies: NDArray[np.float64], balance: float) -> NDArray[np.float64]:
    """Weights `(k,)` of classes: their frequency to the power of `-balance`, 1 on average over pixels."""
    weights = np.maximum(frequencies, frequencies.max() * 1e-9) ** -balance
    weights = np.minimum(weights, weights[frequencies.argmax()] * _MOST_WEIGHT)
    return np.asarray(weights / (weights * frequencies).sum())


def _decision(
    labels: ClassTable,
    outputs: ClassTable,
    weights: NDArray[np.float64],
    frequencies: NDArray[np.float64],
    origin: Decision | None,
) -> Decision:
    """What takes the weights of the loss back; `labels` merges the outputs of the network."""
    merging = labels.merging(outputs)
    is_labelled = merging.any(axis=0)
    # Members of a merged class keep the proportions that the network was started with.
    before = np.ones(len(outputs)) if origin is None else np.array(origin.frequencies)
    merged = np.maximum(merging @ before, np.finfo(float).tiny)
    shares = np.where(is_labelled, merging.T @ (frequencies / merged) * before, 0.0)
    factors = np.where(is_labelled, merging.T @ weights, 1.0)
    temperature = 1.0 if origin is None else origin.temperature
    return Decision(tuple(factors.tolist()), tuple(shares.tolist()), temperature)


@final
class TrainingLoop:
    """Network, loss and optimiser of a training, and its loop."""

    def __init__(
        self,
        options: TrainingOptions,
        sets: Sequence[ImageSet],
        labels: ClassTable,
        origin: TrainedModel | None,
        record: dict[str, Any],
        matching: ColourMatching | None = None,
    ) -> None:
        self.options, self.labels, self.record = options, labels, record
        self.device = _find_device(options.device)
        classes = labels if origin is None else origin.classes
        module = build_network(options.task, options.model, len(classes), allow_code=options.allow_code)
        if origin is not None:
            module.load_state_dict(origin.module.state_dict())
        module.to(self.device, memory_format=torch.channels_last)
        model = without_initial_weights(options.model)
        trained = TrainedModel(module, model, classes, options.width, record, task=options.task)
        self.loss: nn.Module
        if options.task == "detect":
            self.trained, self.loss = trained, DetectionLoss(len(labels), options.least_area)
        else:
            frequencies = class_frequencies(sets, labels)
            weights = class_weights(frequencies, options.balance or 0.0)
            before = None if origin is None else origin.decision
            decision = _decision(labels, classes, weights, frequencies, before)
            self.trained = replace(trained, decision=decision)
            loss = SegmentationLoss(labels, classes, weights, options.lovasz or 0.0)
            self.loss = loss.to(self.device)
        assert options.learning_rate is not None
        self.optimiser = torch.optim.Adam(
            module.parameters(), lr=options.learning_rate, betas=_BETAS, eps=_EPSILON
        )
        self.sets = tuple(sets)
        self.samples = TrainingSamples(sets, labels, options, matching)

    def run(
        self,
        folder: Path,
        validation: Sequence[ImageSet],
        on_progress: Callable[[TrainingProgress], None] | None,
    ) -> None:
        """Take all steps that are left; validate and write the state at intervals."""
        options = self.options
        assert options.steps is not None
        assert options.batch is not None
        assert options.validate is not None
        state = TrainingState(record=self.record)
        if (folder / STATE_FILE).is_file():
            state = read_state(folder, self.trained.module, self.optimiser, self.record)
        if folder.is_dir():
            remove_temporary_files(folder)
        log = folder / LOG_FILE
        if log.is_file():
            # Steps after the checkpoint are taken again.
            kept = [_log_line(entry) for entry in read_log(log) if entry["step"] <= state.step]
            write_file(log, "".join(kept).encode())
        batches = torch.utils.data.DataLoader(
            TrainingBatches(self.samples, options.batch),
            batch_size=None,
            sampler=range(state.step, options.steps),
            num_workers=options.workers,
        )
        start, begin, losses = state.step, time.monotonic(), []
        for step, batch in enumerate(batches, start=state.step + 1):
            if isinstance(batch, PepperError):
                raise batch
            losses.append(self._step(step, *batch))
            ends = step % options.validate == 0 or step == options.steps
            quality = None
            if ends:
                self.trained = replace(self.trained, decision=self._calibrated(validation or self.sets))
                quality = _known(self._validate(validation)) if validation else None
                state = self._checkpoint(folder, step, state, quality, float(np.mean(losses)))
            if on_progress is not None:
                rate = (step - start) * options.batch / (time.monotonic() - begin)
                left = (options.steps - step) * options.batch / rate
                values = {MEASURES[options.task]: quality}
                on_progress(
                    TrainingProgress(step, options.steps, float(np.mean(losses)), rate, left, **values)
                )
            losses = [] if ends else losses

    def _step(self, step: int, images: torch.Tensor, labels: torch.Tensor) -> float:
        """Adapt the weights to a batch; returns its loss."""
        # Dropout depends on the step alone, not on where a training was resumed.
        torch.manual_seed(self.options.seed * _SEED_STRIDE + step)
        for group in self.optimiser.param_groups:
            group["lr"] = _learning_rate(self.options, step)
        module = self.trained.module.train()
        inputs = images.to(self.device, memory_format=torch.channels_last).float() / 255
        with torch.autocast(
            self.device.type, torch.bfloat16, enabled=_uses_bfloat16(self.options, self.device)
        ):
            outputs = module(inputs) if self.options.task == "detect" else self._logits(module, inputs)
        loss = self.loss(outputs, labels.to(self.device).long())
        self.optimiser.zero_grad()
        loss.backward()
        self.optimiser.step()
        value = float(loss.detach())
        if not math.isfinite(value):
            raise ArgumentError("learning_rate", f"is too high: the loss is {value} at step {step}")
        return value

    def _logits(self, module: nn.Module, images: torch.Tensor) -> torch.Tensor:
        logits = apply_model(module, images)
        if logits.shape[1] != len(self.trained.classes):
            problem = f"must return logits of {len(self.trained.classes)} classes, not {logits.shape[1]}"
            raise ArgumentError("model", problem)
        return logits

    def _checkpoint(
        self, folder: Path, step: int, state: TrainingState, quality: float | None, loss: float
    ) -> TrainingState:
        """Write the network if it is the best one, the log, and last the state that a resumption reads."""
        folder.mkdir(parents=True, exist_ok=True)
        best, best_step = state.best, state.best_step
        # Without a known quality so far, as without validation, the last state is the best one.
        measure = MEASURES[self.options.task]
        if best is None or (quality is not None and quality > best):
            best, best_step = quality, step
            training = {**self.record, "step": step, f"validation_{measure}": quality}
            replace(self.trained, training=training).save(folder / MODEL_FILE)
        with (folder / LOG_FILE).open("a", encoding="utf-8") as log:
            log.write(_log_line({"step": step, "loss": loss, measure: quality}))
        state = TrainingState(step=step, best=best, best_step=best_step, record=self.record)
        write_state(folder, self.trained.module, self.optimiser, state)
        return state

    def _validate(self, validation: Sequence[ImageSet]) -> float:
        """Mean IoU over all images of the sets, in the classes of the labels; nan without labelled pixels.

        Of a detector, the mean AP50 of its masks.
        """
        if self.options.task == "detect":
            return evaluate_detector(self.trained, validation, classes=self.labels).mean_ap50
        merging = self.labels.merging(self.trained.classes)
        total = np.zeros((len(self.labels), len(self.labels)), np.int64)
        for colour, truth in self._labelled(validation):
            prediction = predict_classes(self.trained, colour, merging)
            total += confusion_matrix(truth, prediction, len(self.labels))
        return float(mean_intersection_over_union(total))

    def _calibrated(self, sets: Sequence[ImageSet]) -> Decision | None:
        """The decision with the temperature and the factors that suit some images of the sets best."""
        decision = self.trained.decision
        if decision is None:
            return None
        plain = replace(self.trained, decision=None)
        logits, labels = [], []
        for colour, truth in self._labelled(sets, _CALIBRATED):
            for part, probabilities in sampled_probabilities(plain, colour):
                known = truth[part] != IGNORE_CLASS
                logits.append(np.log(np.maximum(probabilities[:, known], _LEAST_PROBABILITY)).T)
                labels.append(truth[part][known])
        if not sum(map(len, labels)):
            return decision
        merging = self.labels.merging(self.trained.classes)
        values, truths = np.concatenate(logits), np.concatenate(labels)
        decision = replace(decision, temperature=fit_temperature(values, truths, decision.shift, merging))
        merged = softmax(values / decision.temperature + decision.shift, axis=1) @ merging.T
        factors = np.where(merging.any(axis=0), merging.T @ fit_factors(merged, truths), 1.0)
        return replace(decision, factors=tuple(factors.tolist()))

    def _labelled(
        self, sets: Sequence[ImageSet], most: int | None = None
    ) -> Iterator[tuple[NDArray[np.uint8], NDArray[np.uint8]]]:
        """Colour and class indices of the images of sets, or of at most so many, evenly spaced."""
        for images in sets:
            number = len(images) if most is None else -(-most // len(sets))
            positions = evenly_spaced(len(images), number)
            for image in images.select("colour", "classes").take(positions):
                if image.colour is None or image.classes is None:
                    raise InputError(images.name, f"{image.name} has no colour image or no mask")
                yield image.colour, self.labels.indices(image.classes)


def _known(quality: float) -> float | None:
    """None for nan, which is neither better nor worse than another value, and which JSON does not have."""
    return quality if math.isfinite(quality) else None


def _learning_rate(options: TrainingOptions, step: int) -> float:
    """The learning rate of a step, counted from 1."""
    assert options.learning_rate is not None
    assert options.steps is not None
    if options.schedule == "constant":
        return options.learning_rate
    warm_up = max(1, round(_WARM_UP * options.steps))
    if step <= warm_up:
        return options.learning_rate * step / warm_up
    fraction = (step - warm_up) / max(1, options.steps - warm_up)
    return options.learning_rate * (0.5 + 0.5 * math.cos(math.pi * fraction))


def _uses_bfloat16(options: TrainingOptions, device: torch.device) -> bool:
    if options.precision != "auto":
        return options.precision == "bfloat16"
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported()
    # Without such instructions, bfloat16 is emulated and slower.
    supported = getattr(torch.cpu, "_is_avx512_bf16_supported", lambda: False)
    return bool(supported())


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Seed torch's generators, and give them back as they were."""
    with torch.random.fork_rng(devices=range(torch.cuda.device_count())):
        torch.manual_seed(seed)
        yield


def _find_device(name: str | None) -> torch.device:
    """A device of torch; raises `ArgumentError` if this machine does not have it."""
    name = name or ("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
        float(torch.zeros(1, device=device))
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        reason = str(error).strip().split("\n")[0]
        raise ArgumentError("device", f"{name} cannot be used ({reason})") from None
    return device


def read_log(file: Path) -> list[dict[str, Any]]:
    """Loss and validations of a training, of the complete lines of its log; none if there is no log."""
    entries = []
    for line in read_file(file, "log").splitlines() if file.is_file() else ():
        with suppress(ValueError, TypeError):
            entry = dict(parse_json(line))
            # Not a line with a number that JSON does not have.
            _log_line(entry)
            entries.append(entry)
    return [entry for entry in entries if isinstance(entry.get("step"), int)]


def _log_line(entry: Mapping[str, Any]) -> str:
    return json.dumps(entry, sort_keys=True, allow_nan=False) + "\n"
