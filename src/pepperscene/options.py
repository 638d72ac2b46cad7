"""Option models: dataclasses whose fields declare what users may choose, once for Python and command line.

batch: Annotated[int | None, Option("Images in a step.", "N", minimum=1, maximum=4096)] = None
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, get_args, get_type_hints

from pepperscene.errors import ArgumentError


@dataclass(frozen=True)
class Option:
    """The declaration of an option, beside the type of its field.

    Attributes:
        help: what it is for.
        metavar: how the command line writes its value.
        minimum, maximum: bounds of a number, or of both numbers of pixels of a size.
        above: a number that the value must exceed.
        choices: allowed texts.
        none: number by which the command line says None, where leaving the option out says something else.
        shows_default: whether the help of the command line shows the default.
        shows_range: whether it shows the bounds of a number, which the command line then checks itself.
    """

    help: str
    metavar: str | None = None
    minimum: float | None = None
    maximum: float | None = None
    above: float | None = None
    choices: tuple[str, ...] = ()
    none: int | None = None
    shows_default: bool = True
    shows_range: bool = False

    def check(self, name: str, value: Any) -> None:
        """Raise `ArgumentError` unless a value is allowed; None is."""
        values = value if isinstance(value, tuple) else (value,)
        if value is not None and not all(map(self._allows, values)):
            size = "two numbers of pixels, " if isinstance(value, tuple) else ""
            raise ArgumentError(name, f"must be {size}{self._allowed()}, not {value!r}")

    def _allows(self, value: Any) -> bool:
        if self.choices:
            return value in self.choices
        if self.above is not None and not (math.isfinite(value) and value > self.above):
            return False
        # Comparisons with nan are false.
        is_high = self.minimum is None or value >= self.minimum
        return is_high and (self.maximum is None or value <= self.maximum)

    def _allowed(self) -> str:
        if self.choices:
            return (" or " if len(self.choices) == 2 else ", ").join(self.choices)
        if self.above is not None:
            return f"above {self.above:g}"
        return f"{self.minimum} or more" if self.maximum is None else f"{self.minimum} to {self.maximum}"


@dataclass(frozen=True)
class NestedOptions:
    """The declaration of a field that is an option model itself.

    Attributes:
        omitted: names of its fields that are no options here.
        names: of its options, where they differ from the fields'.
        help: texts that differ from those of its fields; with these, the default is shown.
    """

    omitted: tuple[str, ...] = ()
    names: Mapping[str, str] = field(default_factory=dict)
    help: Mapping[str, str] = field(default_factory=dict)


def declarations(model: type) -> Iterator[tuple[str, Any, Option | NestedOptions]]:
    """Name, type and declaration of the fields of an option model that have one."""
    hints = get_type_hints(model, include_extras=True)
    for item in fields(model):
        kind, *extras = get_args(hints[item.name]) or (None,)
        for extra in extras:
            if isinstance(extra, Option | NestedOptions):
                yield item.name, kind, extra


def check_options(options: Any) -> None:
    """Raise `ArgumentError` for the first value of an option model that is not allowed."""
    for name, _, declaration in declarations(type(options)):
        if isinstance(declaration, Option):
            declaration.check(name, getattr(options, name))
