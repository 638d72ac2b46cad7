"""One declaration per parameter: frozen data classes in SI units, read from tables of files in their units.

A key of a file names its unit, an attribute is in metres, radians or seconds: `width_m` is read from
`width_mm`, `lean_rad` from `lean_deg`, `exposure_s` from `exposure_us`. Python code makes the same objects
from SI values. Bounds and error messages are in the unit of the file. Durations are written in words.
"""

from __future__ import annotations

import dataclasses
import math
import re
import typing
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Annotated, Any, ClassVar, Final

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    TypeAdapter,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
)
from pydantic_core import CoreSchema, core_schema

_SUFFIXES: Final = {"_m_s": "_mm_s", "_m": "_mm", "_rad": "_deg", "_s": "_us"}
"""Ends of names of attributes, and those of the keys in files."""
_SUFFIX: Final = re.compile(r"(?<!_per)(?<!_umol)(_m_s|_m|_rad|_s)$")


def file_key(attribute: str) -> str:
    """The key in a file for an attribute in SI units."""
    return _SUFFIX.sub(lambda match: _SUFFIXES[match[1]], attribute)


TABLE_CONFIG: Final = ConfigDict(
    extra="forbid", allow_inf_nan=False, alias_generator=file_key, serialize_by_alias=True
)


class Table:
    """Base of the frozen data classes that hold a table of a file."""

    __pydantic_config__: ClassVar[ConfigDict] = TABLE_CONFIG


@dataclass(frozen=True)
class Unit:
    """The last annotation of a number that a file holds in another unit than its attribute.

    Attributes:
        to_si: converts a number of a file.
        per_si: numbers of the file in one SI unit, to about 1e-15.
    """

    to_si: Callable[[float], float]
    per_si: float

    def in_file(self, value: Any) -> Any:
        """The number of a file that gives exactly this value; with at most 15 digits if there is one."""
        if not isinstance(value, float):
            return value
        number = value * self.per_si
        # Rounding can give several numbers the same value, and none to values that are from no file.
        neighbours = (math.nextafter(number, -math.inf), math.nextafter(number, math.inf))
        candidates = (float(f"{number:.15g}"), number, *neighbours)
        return next((x for x in candidates if self.to_si(x) == value), number)

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        to_file = core_schema.plain_serializer_function_ser_schema(self.in_file)
        return core_schema.no_info_after_validator_function(
            self.to_si, handler(source), serialization=to_file
        )


MILLIMETRES: Final = Unit(lambda mm: mm / 1e3, 1e3)
DEGREES: Final = Unit(math.radians, 180.0 / math.pi)
MICROSECONDS: Final = Unit(lambda us: us / 1e6, 1e6)


def within(low: float, high: float) -> Any:
    """Bounds of a number that must not be given as text or as a switch."""
    return Field(strict=True, ge=low, le=high)


@dataclass(frozen=True)
class ZeroOrAtLeast:
    """An annotation of a number: 0 omits a part; a positive number that is no real part's is an error."""

    least: float

    def _check(self, value: float) -> float:
        if 0 < value < self.least:
            raise ValueError(f"must be 0 for none, or at least {self.least:g}")
        return value

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_after_validator_function(self._check, handler(source))


def single_message(allowed: str) -> WrapValidator:
    """One sentence for a value of several forms, instead of an error for each form."""

    def check(value: Any, handler: ValidatorFunctionWrapHandler) -> Any:
        try:
            return handler(value)
        except ValidationError:
            raise ValueError(allowed) from None

    return WrapValidator(check)


def _check_undecodable(value: Any, check: ValidatorFunctionWrapHandler) -> Any:
    """Check a name; the validator's own check of text refuses paths whose bytes are not UTF-8 (PEP 383)."""
    if not isinstance(value, str):
        return check(value)
    check(re.sub("[\udc80-\udcff]", "_", value))
    return value


Name = Annotated[
    str,
    Field(strict=True, min_length=1, max_length=400, pattern=r"^[^\x00-\x1f]+$"),
    WrapValidator(_check_undecodable),
]
"""A shipped name or a path."""

NONE: Final = "none"
"""Instead of a name: no flash, no filter, no cover, no white balance."""

Switch = Annotated[bool, Field(strict=True)]
Fraction = Annotated[float, within(0, 1)]
Angle = Annotated[float, within(-180, 180), DEGREES]


def is_table(annotation: Any) -> bool:
    """Whether a type is a model or a data class of a table."""
    return isinstance(annotation, type) and issubclass(annotation, (BaseModel, Table))


@cache
def table_fields(model: Any) -> dict[str, Any]:
    """The types of a model or a data class by their keys in files."""
    hints = typing.get_type_hints(model, include_extras=True)
    if issubclass(model, BaseModel):
        return {info.alias or name: hints[name] for name, info in model.model_fields.items()}
    return {file_key(field.name): hints[field.name] for field in dataclasses.fields(model)}


def default_value(model: Any, key: str) -> Any:
    """The default of a key, in SI units; None if it has none."""
    if issubclass(model, BaseModel):
        defaults = {name: info.default for name, info in model.model_fields.items() if not info.is_required()}
    else:
        fields = (field for field in dataclasses.fields(model) if field.default is not dataclasses.MISSING)
        defaults = {field.name: field.default for field in fields}
    return next((default for name, default in defaults.items() if file_key(name) == key), None)


@cache
def type_adapter(model: Any) -> TypeAdapter[Any]:
    """Pydantic's adapter of a model or a data class, made once."""
    return TypeAdapter(model)


def file_values(table: Any, **options: Any) -> dict[str, Any]:
    """The values of a table as in a file; `options` are those of pydantic's `dump_python`."""
    kind: Any = type(table)
    values: dict[str, Any] = type_adapter(kind).dump_python(table, **options)
    return values


def format_duration(seconds: float) -> str:
    """Days, hours, minutes and seconds, at most two units."""
    if seconds < 10:
        return f"{seconds:.2g} s"
    total = round(seconds)
    units = ((86_400, "d"), (3600, "h"), (60, "min"), (1, "s"))
    for (large, name), (small, next_name) in pairwise(units):
        if total >= large:
            rest = total % large // small
            return f"{total // large} {name} {rest} {next_name}"
    return f"{total} s"


def format_rate(frames_per_s: float) -> str:
    """Frames per second, or seconds per frame."""
    return f"{frames_per_s:.1f} frames/s" if frames_per_s >= 1 else f"{1 / frames_per_s:.1f} s a frame"
