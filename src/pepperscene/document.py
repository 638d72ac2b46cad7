"""Reading a TOML file into a validated model; every fault becomes one `InputError`."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from pepperscene.errors import InputError


class Document(BaseModel):
    """Base of everything that is read from a file: frozen, and an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True)


Model = TypeVar("Model", bound=BaseModel)


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file.

    Raises:
        InputError: missing, unreadable, not UTF-8, or not TOML (with the parser's line and column).
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as fault:
        raise InputError(path, "", None, f"cannot be read ({fault.strerror})") from None
    except UnicodeDecodeError:
        raise InputError(path, "", None, "must be a text file in UTF-8") from None
    except tomllib.TOMLDecodeError as fault:
        raise InputError(path, "", None, f"is not valid TOML: {fault}") from None
    except RecursionError:
        raise InputError(path, "", None, "is not valid TOML: nested too deeply") from None


def validated(model: type[Model], data: Mapping[str, Any], where: str | Path) -> Model:
    """`data` as a `model`.

    Raises:
        InputError: for the first fault found, with its dotted key and value.
    """
    try:
        return model.model_validate(data)
    except ValidationError as fault:
        raise _as_input_error(fault, where) from None


def _as_input_error(fault: ValidationError, where: str | Path) -> InputError:
    first = fault.errors(include_url=False, include_context=True)[0]
    key = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        return InputError(where, key, None, "is not a known key")
    if first["type"] == "missing":
        return InputError(where, key, None, "is required but missing")
    message = first["msg"].removeprefix("Value error, ").removeprefix("Assertion failed, ")
    message = message.replace("Input should be", "must be").replace("\n", " ")
    value = first["input"] if not isinstance(first["input"], (dict, BaseModel)) else None
    return InputError(where, key, value, message)
