"""Options of commands from option models: a parameter whose type is a model stands for all of its options."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Final, get_args, get_origin

import typer

from pepperscene.errors import ArgumentError, InputError
from pepperscene.options import NestedOptions, Option, declarations

OPTION_NAMES: Final = {
    "changes": "set",
    "form": "format",
    "frame_rate_hz": "frame_rate",
    "least_visible": "min_visibility",
    "names": "fit",
    "picture": "drawing",
    "ripe_from": "ripe",
    "smallest_px": "smallest",
}
"""Names of options that differ from the argument that they set."""


@dataclass(frozen=True)
class Only:
    """Restricts a parameter `Annotated[Model, Only("quality")]` to some options of its model."""

    names: tuple[str, ...]

    def __init__(self, *names: str) -> None:
        object.__setattr__(self, "names", names)


def expand_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """A command whose parameters of option models are replaced by the options of these models.

    Options are in the order of the fields. The command gets the models made from the given values.
    """
    signature = inspect.signature(command, eval_str=True)
    parameters: list[inspect.Parameter] = []
    groups: dict[str, _Group] = {}
    for parameter in signature.parameters.values():
        model, *extras = get_args(parameter.annotation) or (parameter.annotation,)
        if not is_dataclass(model):
            parameters.append(parameter)
            continue
        chosen = next((extra.names for extra in extras if isinstance(extra, Only)), None)
        groups[parameter.name] = group = _Group(model, chosen=chosen)
        parameters += group.parameters()

    @functools.wraps(command)
    def run(**values: Any) -> Any:
        for name, group in groups.items():
            values[name] = group.make(values)
        return command(**values)

    keywords = [parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY) for parameter in parameters]
    run.__signature__ = signature.replace(parameters=keywords)  # type: ignore[attr-defined]
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in keywords}
    return run


class _Group:
    """The options of a model on the command line."""

    def __init__(
        self, model: Any, nested: NestedOptions | None = None, chosen: tuple[str, ...] | None = None
    ) -> None:
        nested = nested or NestedOptions()
        self._model = model
        self._options: list[tuple[str, str, Any, Option]] = []
        self._groups: dict[str, _Group] = {}
        self._order: list[_Group | inspect.Parameter] = []
        defaults = {item.name: item.default for item in fields(model)}
        for name, kind, declaration in declarations(model):
            if name in nested.omitted or (chosen is not None and name not in chosen):
                continue
            if isinstance(declaration, NestedOptions):
                self._groups[name] = _Group(kind, declaration)
                self._order.append(self._groups[name])
                continue
            option_name = nested.names.get(name, OPTION_NAMES.get(name, name))
            option = declaration
            if name in nested.help:
                option = replace(option, help=nested.help[name], shows_default=True)
            self._options.append((name, option_name, kind, option))
            self._order.append(_parameter(option_name, kind, option, defaults[name]))

    def parameters(self) -> list[inspect.Parameter]:
        """One parameter for each option, in order."""
        return [
            parameter
            for part in self._order
            for parameter in (part.parameters() if isinstance(part, _Group) else [part])
        ]

    def make(self, values: dict[str, Any]) -> Any:
        """The model of the values of its options, which are removed from the values of the command."""
        given = {name: group.make(values) for name, group in self._groups.items()}
        for name, option_name, kind, option in self._options:
            value = values.pop(option_name)
            if kind == tuple[int, int]:
                value = parse_size(value, "--" + option_name.replace("_", "-"))
            elif get_origin(kind) is tuple:
                value = tuple(value or ())
            given[name] = None if option.none is not None and value == option.none else value
        return self._model(**given)


def _parameter(name: str, kind: Any, option: Option, default: Any) -> inspect.Parameter:
    """The parameter of a command for an option, as Typer reads it."""
    names = [f"--{name.replace('_', '-')}"] if kind is bool and default is False else []
    if kind == tuple[int, int]:
        kind, default = str, f"{default[1]}x{default[0]}"
    elif kind == str | Path | None:
        kind = Path | None
    elif get_origin(kind) is tuple:
        kind, default = list[get_args(kind)[0]] | None, None  # type: ignore[misc]
    info = typer.Option(
        *names,
        metavar=option.metavar,
        help=option.help,
        show_default=option.shows_default,
        min=option.minimum if option.shows_range else None,
        max=option.maximum if option.shows_range else None,
    )
    return inspect.Parameter(
        name,
        inspect.Parameter.KEYWORD_ONLY,
        default=inspect.Parameter.empty if default is MISSING else default,
        annotation=Annotated[kind, info],
    )


def parse_numbers(text: str, option: str, count: int | None = None) -> tuple[float, ...]:
    """Numbers of an option, with commas between them; of any number if `count` is None."""
    try:
        values = tuple(map(float, text.split(",")))
    except ValueError:
        values = ()
    if not values or count not in (None, len(values)):
        wanted = "numbers" if count is None else f"{count} numbers"
        raise ArgumentError(option, f"must be {wanted} separated by commas, not {text!r}")
    return values


def parse_size(text: str, option: str = "--size") -> tuple[int, int]:
    """Height and width of a text "WxH"."""
    width, _, height = text.lower().partition("x")
    if not (width.isascii() and width.isdecimal() and height.isascii() and height.isdecimal()):
        raise InputError(option, f"must be width and height in pixels, such as 256x192, not {text}")
    return int(height), int(width)
