"""The models of this package, and the training that suits each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final


@dataclass(frozen=True)
class ModelDefaults:
    """A model and the training that suits it.

    Attributes:
        steps, batch: number of steps and images per step.
        learning_rate: of Adam.
        schedule: of the learning rate: "constant", or "cosine" with a warm-up.
        balance: exponent of the inverse frequency by which the loss weights classes.
    """

    steps: int
    batch: int
    learning_rate: float
    schedule: str
    balance: float


MODELS: Final[Mapping[str, ModelDefaults]] = MappingProxyType(
    {
        # Chosen: 16,000 crops take less than half an hour on two cores.
        "small": ModelDefaults(2000, 8, 2e-3, "cosine", 0.5),
        # Chosen: as `small`, at half the rate, so that weights learned on photographs change little.
        "efficientnet_lite0": ModelDefaults(2000, 8, 1e-3, "cosine", 0.5),
        # Section 2.8 of the paper.
        "deeplab_vgg16": ModelDefaults(30_000, 10, 5e-5, "constant", 0.0),
    }
)
"""Models of this package by name."""

_OTHER: Final = ModelDefaults(2000, 8, 1e-3, "cosine", 0.5)
"""Training of a model of the user's, unless options say otherwise. Chosen: as `small`, at half the rate."""


def model_defaults(model: str) -> ModelDefaults:
    """The defaults of a model, which is a text as for `build_model`."""
    return MODELS.get(_name(model), _OTHER)


def is_built_in(model: str) -> bool:
    """Whether a text as for `build_model` names a model of this package."""
    return _name(model) in MODELS


def _name(model: str) -> str:
    return model.partition(",")[0].strip()
