"""A trained network with what is needed to apply it to images of any size."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, Self, final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from pepperscene.atomic import write_file
from pepperscene.document import Document, validate
from pepperscene.errors import ArgumentError, InputError, SetupError
from pepperscene.learning.class_table import ClassTable
from pepperscene.learning.models.decision import Decision, DecisionDescription
from pepperscene.learning.models.detections import Detections
from pepperscene.learning.models.registry import build_model, without_initial_weights
from pepperscene.learning.options import LEAST_SIDE, MODELS, MOST_SIDE, is_built_in, parse_classes
from pepperscene.user_code import user_errors
from pepperscene.user_files import check_file
from pepperscene.version import __version__

if TYPE_CHECKING:
    import torch
    from torch import nn

MODEL_FILE: Final = "model.safetensors"
FORMAT: Final = "pepperscene model 1"
_MOST_DETECTED: Final = 12_500_000  # chosen: pixels of a photograph of 4096 x 3048, which takes some 8 GB


_Text = Annotated[str, Field(strict=True, min_length=1, max_length=1000)]


class ModelDescription(Document):
    """Of `model.safetensors`: see `TrainedModel`."""

    format: _Text
    model: _Text
    classes: _Text
    width: Annotated[int, Field(strict=True, ge=LEAST_SIDE, le=MOST_SIDE)] | None
    version: _Text = "unknown"
    decision: DecisionDescription | None = None
    training: dict[str, Any]
    task: Literal["segment", "detect"] = "segment"


@final
@dataclass(frozen=True, eq=False)
class TrainedModel:
    """A network that separates classes, or a detector that finds their objects.

    Attributes:
        module: takes images `(n, 3, h, w)` in sRGB, 0 to 1.
        model: text for `build_model`.
        classes: meaning of the network's outputs.
        width: width in pixels to which images are scaled before the network sees them; None for their own.
        training: how it was trained: sets with their digests, versions, steps, options.
        decision: how its logits become probabilities; None for a plain softmax.
        task: "segment" or "detect".
    """

    module: nn.Module
    model: str
    classes: ClassTable
    width: int | None = None
    training: Mapping[str, Any] = field(default_factory=dict)
    decision: Decision | None = None
    task: str = "segment"

    def probabilities(self, colour: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Probabilities of the classes `(k, h, w)` for an image `(h, w, 3)`.

        Raises:
            ArgumentError: the model is a detector.
        """
        import torch
        from torch.nn import functional

        self.check_task("segment")
        self.module.eval()
        with torch.inference_mode():
            logits = apply_model(self.module, self._network_input(colour))
            enlarged = functional.interpolate(
                logits, size=colour.shape[:2], mode="bilinear", align_corners=False
            )
            return self.decide(enlarged)[0].float().cpu().numpy()

    def with_regions(self, least_area: int = 0, grown_px: int = 0) -> Self:
        """The same network, with another size of its regions of fruit and peduncles (`Decision`).

        Raises:
            ArgumentError: the model is a detector.
        """
        self.check_task("segment")
        count = len(self.classes)
        decision = self.decision or Decision((1.0,) * count, (1.0 / count,) * count)
        return replace(self, decision=replace(decision, least_area=least_area, grown_px=grown_px))

    def decide(self, logits: torch.Tensor) -> torch.Tensor:
        """Probabilities `(..., k, h, w)` of logits of that shape."""
        return logits.softmax(dim=-3) if self.decision is None else self.decision.probabilities(logits)

    def detections(self, colour: NDArray[np.uint8]) -> Detections:
        """Objects in an image `(h, w, 3)`, the most certain first.

        Raises:
            ArgumentError: the model is no detector.
            InputError: the network would see too many pixels.
        """
        import torch

        from pepperscene.learning.models.detector import find_objects

        self.check_task("detect")
        self.module.eval()
        with torch.inference_mode():
            image = self._network_input(colour)
            if image.shape[-2] * image.shape[-1] > _MOST_DETECTED:
                problem = f"has more than {_MOST_DETECTED:,} pixels; train the detector with a --width"
                raise InputError("image", problem)
            found = find_objects(self.module(image), image.shape[-2:])
        arrays = (tensor.cpu().numpy() for tensor in found)
        return Detections.of_network(*arrays, seen=tuple(image.shape[-2:]), size=colour.shape[:2])

    def check_task(self, task: str) -> None:
        """Raise `ArgumentError` if the model was trained for another task."""
        if self.task != task:
            raise ArgumentError("model", f"was trained for the task {self.task}, not {task}")

    def _network_input(self, colour: NDArray[np.uint8]) -> torch.Tensor:
        """What the network sees of an image: `(1, 3, h, w)`, 0 to 1, at its width."""
        import torch
        from torch.nn import functional

        device = next(self.module.parameters()).device
        image = torch.from_numpy(np.array(colour)).to(device).permute(2, 0, 1)[None].float() / 255
        if self.width is None or image.shape[-1] == self.width:
            return image
        size = max(1, round(image.shape[-2] * self.width / image.shape[-1])), self.width
        return functional.interpolate(image, size=size, mode="bilinear", align_corners=False, antialias=True)

    def to(self, device: str) -> Self:
        """The same network on another device."""
        self.module.to(device)
        return self

    def save(self, file: Path) -> None:
        """Write weights and description as one safetensors file, atomically."""
        write_file(file, weights_as_bytes(self.module.state_dict(), self.description()))

    def description(self) -> dict[str, Any]:
        """What a file of weights says of them, as JSON values."""
        return {
            "format": FORMAT,
            "model": self.model,
            "classes": str(self.classes),
            "width": self.width,
            "version": __version__,
            # Shares belong to the images that are predicted.
            "decision": None if self.decision is None else self.decision.description(),
            "training": dict(self.training),
            **({} if self.task == "segment" else {"task": self.task}),
        }


def require_torch() -> None:
    """Raise `SetupError` if torch or safetensors is not installed."""
    for name in ("torch", "safetensors"):
        if find_spec(name) is None:
            raise SetupError(f"{name} is not installed; install it with `pip install 'pepperscene[learn]'`")


def build_network(task: str, model: str, classes: int, *, allow_code: bool = False) -> nn.Module:
    """A network with random weights for a task; see `build_model` for the rest."""
    if task == "detect":
        from pepperscene.learning.models.detector import Detector

        return Detector(model, classes)
    return build_model(model, classes, allow_code=allow_code)


def apply_model(module: nn.Module, images: torch.Tensor) -> torch.Tensor:
    """Logits `(n, classes, h, w)` at the size of the images, whatever form the model returns them in."""
    import torch
    from torch.nn import functional

    is_built_in = type(module).__module__.startswith("pepperscene.")
    with nullcontext() if is_built_in else user_errors("the network", "model"):
        logits = module(images)
        if isinstance(logits, Mapping):
            logits = logits.get("out")
    if not isinstance(logits, torch.Tensor) or logits.ndim != 4 or len(logits) != len(images):
        raise ArgumentError("model", 'must return logits (n, classes, h, w), or a dict with these as "out"')
    if logits.shape[-2:] != images.shape[-2:]:
        logits = functional.interpolate(logits, size=images.shape[-2:], mode="bilinear", align_corners=False)
    return logits


def load_model(path: str | Path, *, factory: str | None = None, allow_code: bool = False) -> TrainedModel:
    """Read a model that `train` wrote.

    A file can only name a model of this package. The factory of another one is given again, by the caller.

    Args:
        path: folder of a training, or a file of weights.
        factory: the `module:factory`, with its options, of a network that is none of this package; it is not
            used for one that is.
        allow_code: whether the factory may be imported and called.

    Raises:
        InputError: there is no model, the file is damaged, its weights do not fit the model that it names, or
            that is none of this package and there is no factory.
        ArgumentError: the factory cannot be imported or called, or code is not allowed.
        SetupError: torch is not installed.
    """
    require_torch()
    import torch

    file = Path(path)
    file = file / MODEL_FILE if file.is_dir() else file
    if not file.is_file():
        raise InputError(file, "does not exist; `pepperscene train` writes it")
    tensors, content = read_weights(file, FORMAT)
    description = validate(ModelDescription, content, file)
    try:
        classes = parse_classes(description.task, description.classes)
    except ArgumentError as error:
        raise InputError(file, error.problem, key=error.where) from None
    recorded = model = without_initial_weights(description.model)
    if not is_built_in(recorded):
        if factory is None:
            problem = f"is none of {', '.join(MODELS)}; a network of your own needs --factory module:name"
            problem += " and --allow-code (in Python, factory= and allow_code=)"
            raise InputError(file, problem, key="model", value=recorded)
        model = factory
    try:
        # Random weights are replaced; torch's generator stays as it is.
        with torch.random.fork_rng(devices=[]):
            allowed = allow_code and not is_built_in(recorded)
            module = build_network(description.task, model, len(classes), allow_code=allowed)
    except ArgumentError as error:
        if model == factory:
            raise
        raise InputError(file, error.problem, key=error.where) from None
    fill_module(module, tensors, file)
    decision, count = None, len(classes)
    if (learned := description.decision) is not None:
        if {len(learned.weights), len(learned.frequencies), len(learned.factors)} != {count}:
            raise InputError(file, f"must hold lists of {count} numbers, one for each class", key="decision")
        decision = Decision(**dict(learned))
    return TrainedModel(
        module, model, classes, description.width, description.training, decision, description.task
    )


def fill_module(module: nn.Module, tensors: Mapping[str, torch.Tensor], file: Path) -> None:
    """Copy weights into a module; raises `InputError` if they do not fit."""
    try:
        module.load_state_dict(dict(tensors))
    except RuntimeError as error:
        raise InputError(
            file, f"holds weights of another model ({str(error).splitlines()[-1].strip()})"
        ) from None


def weights_as_bytes(tensors: Mapping[str, torch.Tensor], description: Mapping[str, Any]) -> bytes:
    """A safetensors file with a description in its header."""
    import torch
    from safetensors.torch import save

    # Copies, because tensors of a module may share memory, which safetensors does not allow.
    contiguous = {
        name: tensor.detach().cpu().clone(memory_format=torch.contiguous_format)
        for name, tensor in tensors.items()
    }
    return save(contiguous, {"description": json.dumps(description, sort_keys=True, allow_nan=False)})


def read_weights(file: Path, form: str) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    """Tensors and description of a safetensors file of a format; raises `InputError` if it is damaged."""
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(check_file(file, "weights"), framework="pt") as content:
            description = json.loads((content.metadata() or {}).get("description", "{}"))
            tensors = {name: content.get_tensor(name) for name in content.keys()}  # noqa: SIM118
    except (SafetensorError, OSError, ValueError, RecursionError) as error:
        raise InputError(file, f"cannot be read as safetensors ({' '.join(str(error).split())})") from None
    if not isinstance(description, dict) or description.get("format") != form:
        raise InputError(file, f"is not of the format {form!r}")
    return tensors, description
