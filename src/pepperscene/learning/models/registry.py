"""Models by name: those of this package, and any `module:factory` that makes a `torch.nn.Module`."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from pepperscene.errors import ArgumentError, PepperError
from pepperscene.learning.options import MODELS
from pepperscene.user_code import describe_error, import_callable

if TYPE_CHECKING:
    from torch import nn


def build_model(model: str, classes: int, *, allow_code: bool = False) -> nn.Module:
    """Make a model with random weights from torch's generator.

    Args:
        model: name of `MODELS`, or `module:factory` of a callable that takes the number of classes and
            returns a `torch.nn.Module`; then options, as in `small,width=0.5`. The module takes images `(n,
            3, h, w)` in sRGB, 0 to 1, and returns logits `(n, classes, h', w')`, or a dict with these as
            "out", as torchvision's models do. Logits of another size are enlarged to that of the images.
        classes: number of classes.
        allow_code: whether a `module:factory` may be imported and called.

    Raises:
        ArgumentError: the model is unknown or does not take the options, it is no `nn.Module`, or it is a
            `module:factory` and code is not allowed.
    """
    from torch import nn

    name, *options = (part.strip() for part in model.split(","))
    factory = _find_factory(name, allow_code)
    values = _parse_options(model, options, name, factory)
    try:
        module = factory(classes, **values)
    except (KeyboardInterrupt, MemoryError, PepperError):
        raise
    except BaseException as error:
        # A value of an option that the factory does not expect, such as text for a number; a factory of the
        # user's may raise anything.
        if name in MODELS and not isinstance(error, TypeError | ValueError | ArithmeticError):
            raise
        raise ArgumentError("model", f"{model} cannot be made ({describe_error(error)})") from None
    if not isinstance(module, nn.Module):
        raise ArgumentError("model", f"{name} must return a torch.nn.Module, not {type(module).__name__}")
    if not any(parameter.requires_grad for parameter in module.parameters()):
        raise ArgumentError("model", f"{name} has no weights to train")
    return module


def without_initial_weights(model: str) -> str:
    """The text of a model without the file of its initial weights, which a trained model does not need."""
    name, *options = (part.strip() for part in model.split(","))
    if name in MODELS:
        options = [option for option in options if option.partition("=")[0].strip() != "weights"]
    return ",".join((name, *options))


def _find_factory(name: str, allow_code: bool) -> Callable[..., Any]:
    """The class of a model of this package, or the callable that the user names."""
    if name == "small":
        from pepperscene.learning.models.small import SmallNetwork

        return SmallNetwork
    if name == "efficientnet_lite0":
        from pepperscene.learning.models.efficientnet import EfficientNetLite0

        return EfficientNetLite0
    if name == "deeplab_vgg16":
        from pepperscene.learning.models.deeplab import DeepLab

        return DeepLab
    module, _, attribute = name.partition(":")
    if not module or not attribute:
        raise ArgumentError("model", f"must be {', '.join(MODELS)} or module:factory, not {name!r}")
    return import_callable(name, "model", allow_code=allow_code)


def _parse_options(model: str, options: list[str], name: str, factory: Callable[..., Any]) -> dict[str, Any]:
    """Options as keyword arguments: numbers where they look like numbers, else text."""
    values: dict[str, Any] = {}
    for option in options:
        key, equals, value = (part.strip() for part in option.partition("="))
        if not equals or not key.isidentifier() or key in values:
            raise ArgumentError(
                "model", f"options are key=value, each once, as in small,width=0.5; not {model!r}"
            )
        values[key] = _parse_value(value)
    try:
        parameters = inspect.signature(factory).parameters
    except (TypeError, ValueError):
        # A callable without a signature, which is written in C.
        return values
    # The first parameter is the number of classes.
    known = list(parameters)[1:]
    takes_any = any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values())
    unknown = [] if takes_any else [key for key in values if key not in known]
    if unknown:
        text = ", ".join(known) or "none"
        raise ArgumentError("model", f"{name} has no option {unknown[0]}; its options are {text}")
    return values


def _parse_value(text: str) -> Any:
    for number in (int, float):
        try:
            return number(text)
        except ValueError:
            continue
    return text
