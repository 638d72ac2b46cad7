"""The state of a training on disk: all that is needed to go on as if it had not stopped."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import torch
from torch import nn

from pepperscene.dataset.store.atomic import write_file
from pepperscene.errors import InputError
from pepperscene.learning.models.trained_model import fill_module, read_weights, weights_as_bytes

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
        best: highest mean IoU of a validation; None before the first one, or without validation.
        best_step: at which it was reached.
        record: options, sets and versions, which must be the same to go on.
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
    found = description.get("record", {})
    for key in sorted({*record, *found}):
        if record.get(key) != found.get(key):
            problem = f"is {found.get(key)!r} there and {record.get(key)!r} here; choose another folder"
            raise InputError(file, f"holds another training: {key} {problem}")
    weights = {name[len(_MODEL) :]: value for name, value in tensors.items() if name.startswith(_MODEL)}
    fill_module(module, weights, file)
    step = int(description["step"])
    try:
        for name, parameter in module.named_parameters():
            if _FIRST + name in tensors:
                optimiser.state[parameter] = {
                    "step": torch.tensor(float(step)),
                    "exp_avg": tensors[_FIRST + name].to(parameter),
                    "exp_avg_sq": tensors[_SECOND + name].to(parameter),
                }
    except KeyError as error:
        raise InputError(file, f"lacks {error}") from None
    return TrainingState(step, description["best"], int(description["best_step"]), found)
