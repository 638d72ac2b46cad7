"""What files of weights say of their network and their training, checked before anything is built from it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, FiniteFloat

from pepperscene.document import Document, validate
from pepperscene.learning.options import LEAST_SIDE, MOST_SIDE

_Text = Annotated[str, Field(strict=True, min_length=1, max_length=1000)]
_Count = Annotated[int, Field(strict=True, ge=0, lt=2**63)]


class ModelDescription(Document):
    """Of `model.safetensors`: see `TrainedModel`."""

    format: _Text
    model: _Text
    classes: _Text
    width: Annotated[int, Field(strict=True, ge=LEAST_SIDE, le=MOST_SIDE)] | None
    version: _Text = "unknown"
    training: dict[str, Any]


class StateDescription(Document):
    """Of `state.safetensors`: see `TrainingState`."""

    format: _Text
    step: _Count
    best: Annotated[FiniteFloat, Field(strict=True)] | None
    best_step: _Count
    record: dict[str, Any]


def check_description(
    file: Path, description: Mapping[str, Any], kind: type[ModelDescription | StateDescription]
) -> dict[str, Any]:
    """The values of a description; raises `InputError` for the first that is missing or not allowed."""
    return dict(validate(kind, description, file))
