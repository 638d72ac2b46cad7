"""The state of a training on disk: all that is needed to resume it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final

import torch
from pydantic import Field, FiniteFloat
from torch import nn

from pepperscene.atomic import write_file
from pepperscene.document import Document, validate
from pepperscene.errors import InputError, short_repr
from pepperscene.learning.models.trained_model import fill_module, read_weights, weights_as_bytes

STATE_FILE: Final = "state.safetensors"
FORMAT: Final = "pepperscene training 1"

_MODEL: Final = "model."
_FIRST: Final = "first_moment."
_SECOND: Final = "second_moment."

_Count = Annotated[int, Field(strict=True, ge=0, lt=2**63)]


class TrainingState(Document):
    """Where a training is.

    Attributes:
        step: number of finished steps.
        best: highest mean IoU of a validation; None as long as there is none.
        best_step: at which it was reached.
        record: options, sets and versions, which must be the same to resume.
    """

    step: _Count = 0
    best: Annotated[FiniteFloat, Field(strict=True)] | None = None
    best_step: _Count = 0
    record: dict[str, Any]
    format: str = FORMAT


def write_state(folder: Path, module: nn.Module, optimiser: torch.optim.Adam, state: TrainingState) -> None:
    """Write the state of a training, atomically."""
    tensors = {_MODEL + name: value for name, value in module.state_dict().items()}
    for name, parameter in module.named_parameters():
        moments = optimiser.state.get(parameter)
        if moments:
            tensors[_FIRST + name], tensors[_SECOND + name] = moments["exp_avg"], moments["exp_avg_sq"]
    write_file(folder / STATE_FILE, weights_as_bytes(tensors, state.model_dump()))


def read_state(
    folder: Path, module: nn.Module, optimiser: torch.optim.Adam, record: Mapping[str, Any]
) -> TrainingState:
    """Fill network and optimiser with the state of a training.

    Raises:
        InputError: the file is damaged, or the training had other options, sets or versions; the first
            difference is named.
    """
    file = folder / STATE_FILE
    tensors, description = read_weights(file, FORMAT)
    state = validate(TrainingState, description, file)
    check_record(file, state.record, record)
    weights = {name[len(_MODEL) :]: value for name, value in tensors.items() if name.startswith(_MODEL)}
    fill_module(module, weights, file)
    try:
        for name, parameter in module.named_parameters():
            if _FIRST + name in tensors:
                # Moments have the memory format of their weights, as those that Adam makes.
                optimiser.state[parameter] = {
                    "step": torch.tensor(float(state.step)),
                    "exp_avg": torch.empty_like(parameter).copy_(tensors[_FIRST + name]).detach(),
                    "exp_avg_sq": torch.empty_like(parameter).copy_(tensors[_SECOND + name]).detach(),
                }
    except KeyError as error:
        raise InputError(file, f"lacks {error}") from None
    except RuntimeError:
        raise InputError(file, "holds moments that do not have the shapes of its weights") from None
    return state


def check_record(file: Path, found: Any, record: Mapping[str, Any]) -> None:
    """Raise `InputError` if a file was written by another training; the first difference is named."""
    if difference := first_difference(found, record):
        raise InputError(file, f"holds another training: {difference}; choose another folder")


def first_difference(found: Any, here: Any, key: str = "") -> str:
    """Dotted key and values of the first difference of two JSON values, in words; "" if they are equal."""
    if isinstance(found, list) and isinstance(here, list):
        if len(found) != len(here):
            found, here, key = len(found), len(here), f"number of {key}"
        elif any(isinstance(value, Mapping) for value in found):
            found, here = dict(enumerate(found)), dict(enumerate(here))
    if not (isinstance(found, Mapping) and isinstance(here, Mapping)):
        return "" if found == here else f"{key} is {short_repr(found)} there and {short_repr(here)} here"
    for name in sorted({*found, *here}):
        path = f"{key}.{name}" if key else str(name)
        if difference := first_difference(found.get(name), here.get(name), path):
            return difference
    return ""
