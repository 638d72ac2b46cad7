"""Models by name: those of this package, and any `module:factory` that makes a `torch.nn.Module`."""

from __future__ import annotations

import importlib
import inspect
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from pepperscene.errors import ArgumentError

if TYPE_CHECKING:
    from torch import nn


@dataclass(frozen=True)
class ModelDefaults:
    """A model and the training that suits it.

    Attributes:
        factory: `module:name` of a callable that takes the number of classes and the model's options.
        steps, batch: number of steps and images per step.
        learning_rate: of Adam.
        schedule: of the learning rate: "constant", or "cosine" with a warm-up.
        balance: exponent of the inverse frequency by which the loss weights classes.
    """

    factory: str
    steps: int
    batch: int
    learning_rate: float
    schedule: str
    balance: float


MODELS: Final[Mapping[str, ModelDefaults]] = MappingProxyType(
    {
        # Chosen: 16,000 crops take less than half an hour on two cores.
        "small": ModelDefaults(
            "pepperscene.learning.models.small:SmallNetwork", 2000, 8, 2e-3, "cosine", 0.5
        ),
        # Section 2.8 of the paper.
        "deeplab_vgg16": ModelDefaults(
            "pepperscene.learning.models.deeplab:DeepLab", 30_000, 10, 5e-5, "constant", 0.0
        ),
    }
)
"""Models of this package by name."""

_OTHER: Final = ("", 2000, 8, 1e-3, "cosine", 0.5)
"""Training of a model of the user's, unless options say otherwise."""


def model_defaults(model: str) -> ModelDefaults:
    """The defaults of a model, which is a text as for `build_model`."""
    name = model.partition(",")[0].strip()
    return MODELS[name] if name in MODELS else ModelDefaults(name, *_OTHER[1:])


def build_model(model: str, classes: int) -> nn.Module:
    """Make a model with random weights from torch's generator.

    Args:
        model: name of `MODELS`, or `module:factory` of a callable that takes the number of classes and
            returns a `torch.nn.Module`; then options, as in `small,width=0.5`. The module takes images `(n,
            3, h, w)` in sRGB, 0 to 1, and returns logits `(n, classes, h', w')`, or a dict with these as
            "out", as torchvision's models do. Logits of another size are enlarged to that of the images.
        classes: number of classes.

    Raises:
        ArgumentError: the model is unknown or does not take the options, or it is no `nn.Module`.
    """
    from torch import nn

    name, *options = (part.strip() for part in model.split(","))
    module = _find_factory(name)(classes, **_parse_options(model, options, name))
    if not isinstance(module, nn.Module):
        raise ArgumentError("model", f"{name} must return a torch.nn.Module, not {type(module).__name__}")
    return module


def _find_factory(name: str) -> Callable[..., Any]:
    path = MODELS[name].factory if name in MODELS else name
    module, _, attribute = path.partition(":")
    if not module or not attribute:
        raise ArgumentError("model", f"must be {', '.join(MODELS)} or module:factory, not {name!r}")
    # A module in the current folder, as `python` itself would find it.
    if "" not in sys.path:
        sys.path.append("")
    try:
        factory = getattr(importlib.import_module(module), attribute)
    except ImportError as error:
        raise ArgumentError("model", f"{module} cannot be imported ({error})") from None
    except AttributeError:
        raise ArgumentError("model", f"{module} has no {attribute}") from None
    if not callable(factory):
        raise ArgumentError("model", f"{path} is not callable")
    return factory


def _parse_options(model: str, options: list[str], name: str) -> dict[str, Any]:
    """Options as keyword arguments: numbers where they look like numbers, else text."""
    values: dict[str, Any] = {}
    for option in options:
        key, equals, value = (part.strip() for part in option.partition("="))
        if not equals or not key.isidentifier() or key in values:
            raise ArgumentError(
                "model", f"options are key=value, each once, as in small,width=0.5; not {model!r}"
            )
        values[key] = _parse_value(value)
    parameters = inspect.signature(_find_factory(name)).parameters
    takes_any = any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values())
    unknown = [] if takes_any else [key for key in values if key not in parameters]
    if unknown:
        known = ", ".join(list(parameters)[1:]) or "none"
        raise ArgumentError("model", f"{name} has no option {unknown[0]}; its options are {known}")
    return values


def _parse_value(text: str) -> Any:
    for number in (int, float):
        try:
            return number(text)
        except ValueError:
            continue
    return text
