"""Training a network on labelled images."""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch

from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.dataset.store.atomic import check_can_create, is_temporary, write_error, write_file
from pepperscene.errors import ArgumentError, InputError, OutputError
from pepperscene.learning.class_table import ClassTable
from pepperscene.learning.evaluation.confusion import confusion_matrix, mean_intersection_over_union
from pepperscene.learning.evaluation.segmenter import predict_classes
from pepperscene.learning.models.registry import build_model
from pepperscene.learning.models.trained_model import MODEL_FILE, TrainedModel, apply_model, load_model
from pepperscene.learning.training.checkpoint import STATE_FILE, TrainingState, read_state, write_state
from pepperscene.learning.training.loss import SegmentationLoss, class_weights
from pepperscene.learning.training.samples import TrainingSamples
from pepperscene.learning.training_options import TrainingOptions
from pepperscene.version import __version__

LOG_FILE: Final = "training.jsonl"

_WARM_UP: Final = 0.05  # chosen: part of the steps until the learning rate of a cosine schedule is reached
_BETAS: Final = (0.9, 0.999)  # section 2.8 of the paper
_EPSILON: Final = 1e-8  # section 2.8 of the paper


@dataclass(frozen=True)
class TrainingProgress:
    """A finished step.

    Attributes:
        step, steps: number of finished steps, and of all.
        loss: mean since the last call.
        images_per_s: since the start or the resumption.
        left_s: estimated time to the end, in seconds.
        mean_iou: of a validation after this step; None if there was none.
    """

    step: int
    steps: int
    loss: float
    images_per_s: float
    left_s: float
    mean_iou: float | None = None


def train(
    sets: Sequence[ImageSet],
    out: str | Path,
    options: TrainingOptions | None = None,
    *,
    validation: Sequence[ImageSet] = (),
    start: TrainedModel | str | Path | None = None,
    resume: bool = False,
    workers: int = 0,
    device: str | None = None,
    on_progress: Callable[[TrainingProgress], None] | None = None,
) -> TrainedModel:
    """Train a network, and write it into a folder.

    The folder holds `model.safetensors` (the network, after the best validation or else the last step),
    `state.safetensors` (all that a resumption needs) and `training.jsonl` (loss and validations). A training
    that was killed and is resumed ends with the same bytes as one that was not, on the same machine with the
    same number of threads: crops and dropout depend on the seed and the number of the step alone.

    Args:
        sets: labelled images. A set that occurs twice counts twice.
        out: new or empty folder, or that of the training to resume.
        options: see `TrainingOptions`.
        validation: images by which the best state of the network is chosen; none for the last one.
        start: a trained model to start from. Its model and its classes are kept, so that `options.classes`,
            in which the labels are read, must be the same or mergers of them.
        resume: go on with the training in the folder, if there is one.
        workers: processes that read images; 0 for this one. They do not change the result.
        device: of torch, such as "cpu" or "cuda:0"; None for a GPU if there is one.
        on_progress: is called after some steps, at least at each validation.

    Returns:
        The network that was written.

    Raises:
        InputError: sets hold no images, no masks, or no pixel of the classes; an option is not allowed; or
            the folder holds another training.
        OutputError: the folder is not empty, or cannot be written to.
    """
    chosen, folder = options or TrainingOptions(), Path(out)
    origin = load_model(start) if isinstance(start, str | Path) else start
    if origin is not None:
        # The defaults are those of the model that is adapted, not those of the small one.
        chosen = replace(chosen, model=origin.model, classes=chosen.classes or str(origin.classes))
    chosen = chosen.completed()
    labels = ClassTable.parse(chosen.classes)
    _check_sets(sets, "sets")
    _check_sets(validation, "validation")
    _check_folder(folder, resume)
    record = _record(chosen, sets, validation, origin)
    with _determinism(chosen.seed):
        training = _Training(chosen, sets, labels, origin, device, record)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            training.run(folder, validation, workers, on_progress)
        except OSError as error:
            raise write_error(error, folder) from None
        finally:
            # A training that failed before its first checkpoint leaves nothing.
            with suppress(OSError):
                folder.rmdir()
    return load_model(folder)


class _Training:
    """Network, loss and optimiser of a training, and its loop."""

    def __init__(
        self,
        options: TrainingOptions,
        sets: Sequence[ImageSet],
        labels: ClassTable,
        origin: TrainedModel | None,
        device: str | None,
        record: Mapping[str, Any],
    ) -> None:
        self.options, self.labels, self.record = options, labels, record
        self.device = torch.device(device or ("cuda" if torch.cuda.is_available() else "cpu"))
        classes = labels if origin is None else origin.classes
        module = build_model(options.model, len(classes))
        if origin is not None:
            module.load_state_dict(origin.module.state_dict())
        module.to(self.device, memory_format=torch.channels_last)
        self.trained = TrainedModel(module, options.model, classes, options.width, record)
        weights = class_weights(sets, labels, options.balance or 0.0)
        self.loss = SegmentationLoss(labels, classes, weights).to(self.device)
        assert options.learning_rate is not None
        self.optimiser = torch.optim.Adam(
            module.parameters(), lr=options.learning_rate, betas=_BETAS, eps=_EPSILON
        )
        self.samples = TrainingSamples(sets, labels, options)

    def run(
        self,
        folder: Path,
        validation: Sequence[ImageSet],
        workers: int,
        on_progress: Callable[[TrainingProgress], None] | None,
    ) -> None:
        """Take all steps that are left; validate and write the state at intervals."""
        options = self.options
        assert options.steps is not None
        assert options.batch is not None
        assert options.validate is not None
        state = TrainingState(0, None, 0, self.record)
        if (folder / STATE_FILE).is_file():
            state = read_state(folder, self.trained.module, self.optimiser, self.record)
        _truncate_log(folder / LOG_FILE, state.step)
        start, begin, losses = state.step, time.monotonic(), []
        for step, batch in enumerate(self._batches(state.step, workers), start=state.step + 1):
            losses.append(self._step(step, *batch))
            ends = step % options.validate == 0 or step == options.steps
            mean_iou = None
            if ends:
                mean_iou = self._validate(validation) if validation else None
                state = self._checkpoint(folder, step, state, mean_iou, float(np.mean(losses)))
            if on_progress is not None:
                rate = (step - start) * options.batch / (time.monotonic() - begin)
                left = (options.steps - step) * options.batch / rate
                on_progress(
                    TrainingProgress(step, options.steps, float(np.mean(losses)), rate, left, mean_iou)
                )
            losses = [] if ends else losses

    def _batches(self, first: int, workers: int) -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
        """Images and labels of all steps from a number on."""
        options = self.options
        assert options.steps is not None
        assert options.batch is not None
        loader = torch.utils.data.DataLoader(
            self.samples,
            batch_size=options.batch,
            sampler=range(first * options.batch, options.steps * options.batch),
            num_workers=workers,
        )
        yield from loader

    def _step(self, step: int, images: torch.Tensor, labels: torch.Tensor) -> float:
        """Adapt the weights to a batch; returns its loss."""
        # Dropout depends on the step alone, not on where a training was resumed.
        torch.manual_seed(self.options.seed * 1_000_003 + step)
        for group in self.optimiser.param_groups:
            group["lr"] = _learning_rate(self.options, step)
        module = self.trained.module.train()
        inputs = images.to(self.device, memory_format=torch.channels_last).float() / 255
        with torch.autocast(
            self.device.type, torch.bfloat16, enabled=_uses_bfloat16(self.options, self.device)
        ):
            logits = apply_model(module, inputs)
        loss = self.loss(logits, labels.to(self.device).long())
        self.optimiser.zero_grad()
        loss.backward()
        self.optimiser.step()
        value = float(loss.detach())
        if not math.isfinite(value):
            raise ArgumentError("learning_rate", f"is too high: the loss is {value} at step {step}")
        return value

    def _checkpoint(
        self, folder: Path, step: int, state: TrainingState, mean_iou: float | None, loss: float
    ) -> TrainingState:
        """Write the network if it is the best one, the log, and last the state that a resumption reads."""
        best, best_step = state.best, state.best_step
        if mean_iou is None or best is None or mean_iou > best:
            best, best_step = mean_iou, step
            training = {**self.record, "step": step, "validation_mean_iou": mean_iou}
            replace(self.trained, training=training).save(folder / MODEL_FILE)
        _append_log(folder / LOG_FILE, {"step": step, "loss": loss, "mean_iou": mean_iou})
        state = TrainingState(step, best, best_step, self.record)
        write_state(folder, self.trained.module, self.optimiser, state)
        return state

    def _validate(self, validation: Sequence[ImageSet]) -> float:
        """Mean IoU over all images of the sets, in the classes of the labels."""
        merging = self.labels.merging(self.trained.classes)
        total = np.zeros((len(self.labels), len(self.labels)), np.int64)
        for images in validation:
            for image in images.select("colour", "classes"):
                if image.colour is None or image.classes is None:
                    raise InputError(images.name, f"{image.name} has no colour image or no mask")
                prediction = predict_classes(self.trained, image.colour, merging)
                total += confusion_matrix(self.labels.indices(image.classes), prediction, len(self.labels))
        return float(mean_intersection_over_union(total))


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
    return options.learning_rate * (0.5 + 0.5 * math.cos(math.pi * fraction)) + 1e-9


def _uses_bfloat16(options: TrainingOptions, device: torch.device) -> bool:
    if options.precision != "auto":
        return options.precision == "bfloat16"
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported()
    # Without such instructions, bfloat16 is emulated and slower.
    supported = getattr(torch.cpu, "_is_avx512_bf16_supported", lambda: False)
    return bool(supported())


@contextmanager
def _determinism(seed: int) -> Iterator[None]:
    """Seed torch's generators, and give them back as they were."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        yield


def _check_sets(sets: Sequence[ImageSet], where: str) -> None:
    if where == "sets" and not sets:
        raise ArgumentError(where, "must hold at least one set")
    for images in sets:
        if len(images) == 0:
            raise InputError(images.name, "holds no images")


def _check_folder(folder: Path, resume: bool) -> None:
    check_can_create(folder)
    names = {path.name for path in folder.iterdir() if not is_temporary(path)} if folder.is_dir() else set()
    # A training that was killed at its first checkpoint may have left a model or a log, but no state.
    if not names or (resume and names <= {MODEL_FILE, LOG_FILE}):
        return
    if not (folder / STATE_FILE).is_file():
        raise OutputError(f"{folder}: is not empty and holds no training; choose another folder")
    if not resume:
        raise OutputError(f"{folder}: holds a training; resume it with --resume, or choose another folder")


def _record(
    options: TrainingOptions,
    sets: Sequence[ImageSet],
    validation: Sequence[ImageSet],
    origin: TrainedModel | None,
) -> dict[str, Any]:
    """What defines the result of a training: a resumption must agree with it."""
    return {
        "options": options.as_record(),
        "sets": [_describe_set(images) for images in sets],
        "validation": [_describe_set(images) for images in validation],
        "start": None if origin is None else _digest_weights(origin),
        "versions": {"pepperscene": __version__, "torch": str(torch.__version__), "numpy": np.__version__},
    }


def _describe_set(images: ImageSet) -> dict[str, Any]:
    names = hashlib.sha256("\n".join(images.names()).encode("utf-8", "surrogateescape")).hexdigest()
    info = getattr(getattr(images, "dataset", None), "info", None)
    recipe = info.get("recipe_sha256") if isinstance(info, Mapping) else None
    return {"name": images.name, "images": len(images), "names_sha256": names, "recipe_sha256": recipe}


def _digest_weights(segmenter: TrainedModel) -> str:
    content = hashlib.sha256(str(segmenter.classes).encode())
    for name, tensor in sorted(segmenter.module.state_dict().items()):
        content.update(name.encode())
        content.update(tensor.cpu().contiguous().numpy().tobytes())
    return content.hexdigest()


def _truncate_log(file: Path, step: int) -> None:
    """Drop lines of steps that a resumption takes again, and an incomplete one."""
    if not file.is_file():
        return
    kept = []
    for line in file.read_text(encoding="utf-8").splitlines():
        try:
            if json.loads(line)["step"] <= step:
                kept.append(line + "\n")
        except (ValueError, KeyError, TypeError):
            continue
    write_file(file, "".join(kept).encode())


def _append_log(file: Path, entry: Mapping[str, Any]) -> None:
    with file.open("a", encoding="utf-8") as log:
        log.write(json.dumps(entry, sort_keys=True) + "\n")
