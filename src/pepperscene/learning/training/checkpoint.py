"""The state of a training on disk: all that is needed to resume it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import torch
from torch import nn

from pepperscene.atomic import write_file
from pepperscene.errors import InputError, short_repr
from pepperscene.learning.models.trained_model import (
    StateDescription,
    check_description,
    fill_module,
    read_weights,
    weights_as_bytes,
)

STATE_FILE: Final = "state.safetensors"
FORMAT: Final = "pepperscene training 1"

_MODEL: Final = "model."
_FIRST: Final = "first_moment."
_SECOND: Final = "second_moment."


@dataclass(frozen=True)
class TrainingState:
    """Where a training is.

    Attributes:
        step: number of finished steps.
        best: highest mean IoU of a validation; None as long as there is none.
        best_step: at which it was reached.
        record: options, sets and versions, which must be the same to resume.
    """

    step: int
    best: float | None
    best_step: int
    record: Mapping[str, Any]


def write_state(folder: Path, module: nn.Module, optimiser: torch.optim.Adam, state: TrainingState) -> None:
    """Write the state of a training, atomically."""
    tensors = {_MODEL + name: value for name, value in module.state_dict().items()}
    for name, parameter in module.named_parameters():
        moments = optimiser.state.get(parameter)
        if moments:
            tensors[_FIRST + name], tensors[_SECOND + name] = moments["exp_avg"], moments["exp_avg_sq"]
    description = {
        "format": FORMAT,
        "step": state.step,
        "best": state.best,
        "best_step": state.best_step,
        "record": dict(state.record),
    }
    write_file(folder / STATE_FILE, weights_as_bytes(tensors, description))


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
    description = check_description(file, description, StateDescription)
    found = description["record"]
    check_record(file, found, record)
    weights = {name[len(_MODEL) :]: value for name, value in tensors.items() if name.startswith(_MODEL)}
    fill_module(module, weights, file)
    step = description["step"]
    try:
        for name, parameter in module.named_parameters():
            if _FIRST + name in tensors:
                # Moments have the memory format of their weights, as those that Adam makes.
                optimiser.state[parameter] = {
                    "step": torch.tensor(float(step)),
                    "exp_avg": torch.empty_like(parameter).copy_(tensors[_FIRST + name]).detach(),
                    "exp_avg_sq": torch.empty_like(parameter).copy_(tensors[_SECOND + name]).detach(),
                }
    except KeyError as error:
        raise InputError(file, f"lacks {error}") from None
    except RuntimeError:
        raise InputError(file, "holds moments that do not have the shapes of its weights") from None
    return TrainingState(step, description["best"], description["best_step"], found)


def check_record(file: Path, found: Any, record: Mapping[str, Any]) -> None:
    """Raise `InputError` if a file was written by another training; the first difference is named."""
    difference = first_difference(found, record)
    if difference is not None:
        key, there, here = difference
        problem = f"{key} is {short_repr(there)} there and {short_repr(here)} here"
        raise InputError(file, f"holds another training: {problem}; choose another folder")


def first_difference(found: Any, here: Any, key: str = "") -> tuple[str, Any, Any] | None:
    """Dotted key and values of the first difference of two JSON values."""
    if isinstance(found, list) and isinstance(here, list):
        if len(found) != len(here):
            return f"number of {key}", len(found), len(here)
        if not any(isinstance(value, Mapping) for value in found):
            return None if found == here else (key, found, here)
        found, here = dict(enumerate(found)), dict(enumerate(here))
    if not (isinstance(found, Mapping) and isinstance(here, Mapping)):
        return None if found == here else (key, found, here)
    for name in sorted({*found, *here}):
        path = f"{key}.{name}" if key else str(name)
        difference = first_difference(found.get(name), here.get(name), path)
        if difference is not None:
            return difference
    return None
