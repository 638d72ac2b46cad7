"""Reading text and JSON, and TOML files into validated models; every error becomes one `InputError`."""

from __future__ import annotations

import codecs
import json
import os
import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final, TypeVar, cast

from pydantic import BaseModel, ConfigDict, ValidationError

from pepperscene.errors import InputError
from pepperscene.shipped import ShippedFolder, find_file
from pepperscene.units import type_adapter
from pepperscene.user_files import FileKind, read_file

_INTEGERS: Final = range(-(2**63), 2**63)
"""TOML 1.0: 64-bit signed integers, and an error for those that would lose digits."""

_INTEGER_RANGE: Final = f"must be an integer of 64 bits, {_INTEGERS[0]} to {_INTEGERS[-1]}"
_MAX_DEPTH: Final = 32  # chosen: levels of nested tables and lists; no model has more than six
_OTHER_ENCODINGS: Final = (
    (codecs.BOM_UTF32_LE, "UTF-32"),  # before UTF-16: its mark begins with that of UTF-16
    (codecs.BOM_UTF32_BE, "UTF-32"),
    (codecs.BOM_UTF16_LE, "UTF-16"),
    (codecs.BOM_UTF16_BE, "UTF-16"),
)
"""Byte-order marks of encodings that are not read."""
_LONG_KEY: Final = re.compile(r"""(?:\.[ \t]*(?:[\w-]+|"[^"\n]*"|'[^'\n]*')[ \t]*){32}""")
"""The end of a dotted key of more parts than `_MAX_DEPTH`."""
_MAX_KEYS: Final = 50_000  # chosen: keys, tables and lists of a TOML file; reading takes some kB for each
_MAX_VALUES: Final[Mapping[FileKind, int]] = {
    "json": 2_000_000,  # 65,535 instances, the most of a frame, have half as many
    "poses": 4_000_000,  # 100,000 poses, the most that are read, have 2.6 million
    "annotations": 100_000_000,  # COCO's own largest file has as many coordinates of polygons
}
"""Values of a JSON file. Chosen: Python takes about 100 bytes for each."""
_LONG_NUMBER: Final = re.compile(r"\d[\d_]{999,}")
_PYTHON_TO_TOML: Final = (
    (re.compile(r"a valid tuple|a valid list"), "a list"),
    (re.compile(r"a( valid)? dictionary( or .*)?"), "a table"),
    (re.compile(r"Input is not a valid path.*"), "must be a path, in quotes"),
)
"""The validator's names of Python types, in terms of TOML."""


class Document(BaseModel):
    """Base class of all models that are read from files: frozen, and an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True)


Model = TypeVar("Model")


def read_toml(path: Path) -> dict[str, Any]:
    """Read the tables of a TOML file.

    Raises:
        InputError: the file is missing, unreadable, too long, not UTF-8, not TOML (with the parser's line and
            column) or nested too deeply, or contains an integer beyond 64 bits.
    """
    text = read_text(path)
    _check_cost(text, path)
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(path, f"is not valid TOML: {error}") from None
    except RecursionError:
        raise InputError(path, "is not valid TOML: nested too deeply") from None
    except ValueError as error:
        # Python does not parse integers of thousands of digits.
        raise _long_integer_error(path, text) or InputError(path, f"is not valid TOML: {error}") from None
    _check_values(tables, path)
    return tables


def read_text(path: Path, kind: FileKind = "text") -> str:
    """Read a text file in UTF-8, with or without a byte-order mark; every line ends with a line feed.

    Lines may end with a line feed, a carriage return (old Mac programs) or both (Windows programs).

    Raises:
        InputError: the file is missing, unreadable, longer than a text of its kind, or not text in UTF-8.
    """
    return decode_text(read_file(path, kind), path)


def decode_text(content: bytes, where: str | Path) -> str:
    """The text of a file that `where` names in errors; as of `read_text`."""
    encodings = [encoding for mark, encoding in _OTHER_ENCODINGS if content.startswith(mark)]
    if not encodings and len(content) > 1 and b"\0" in content[:2]:
        # Every second byte of plain text in UTF-16 is zero, and some programs write no mark.
        encodings = ["UTF-16"]
    if encodings:
        raise InputError(where, f"must be a text file in UTF-8, not {encodings[0]}; save it as UTF-8")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = len((content[: error.start] + b"x").splitlines())
        problem = f"must be a text file in UTF-8, but line {line} is not; save it as UTF-8"
        raise InputError(where, problem) from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def parse_json(content: bytes, kind: FileKind = "json") -> Any:
    """The value in the JSON text of a file.

    Raises:
        ValueError: it is not JSON, is nested too deeply, or has more values than a file of its kind may have.
    """
    most = _MAX_VALUES[kind]
    # Each value but the first follows one of these characters.
    if len(content) > most and sum(map(content.count, (b"[", b"{", b",", b":"))) > most:
        raise ValueError(f"it has more than {most:,} values")
    try:
        return json.loads(content)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def _check_cost(text: str, path: Path) -> None:
    """Refuse what costs far more than its length: many keys and tables, and keys of many parts."""
    if sum(map(text.count, "=[{")) > _MAX_KEYS:
        if "[" * (_MAX_DEPTH + 1) in text:
            raise InputError(path, f"is nested too deeply: more than {_MAX_DEPTH} levels")
        raise InputError(path, f"has more than {_MAX_KEYS:,} keys, tables and lists")
    # The parser's time for a dotted key grows with the square of its parts.
    if text.count(".") > _MAX_DEPTH and _LONG_KEY.search(text):
        raise InputError(path, f"is nested too deeply: more than {_MAX_DEPTH} levels")


def _check_values(tables: dict[str, Any], path: Path) -> None:
    """Check that no integer is beyond 64 bits and that the nesting is not too deep for a validator."""
    for key, value in _walk(tables):
        if len(key) > _MAX_DEPTH:
            raise InputError(path, f"is nested too deeply: more than {_MAX_DEPTH} levels")
        if type(value) is int and value not in _INTEGERS:
            raise InputError(path, _INTEGER_RANGE, key=toml_key(key), value=value)


def _walk(tables: dict[str, Any]) -> Iterator[tuple[tuple[str | int, ...], Any]]:
    """Every value with its key, in the order of the file; iterative, because dotted keys can nest deeply."""
    stack: list[tuple[tuple[str | int, ...], Any]] = [((), tables)]
    while stack:
        key, value = stack.pop()
        yield key, value
        if isinstance(value, dict | list):
            items = value.items() if isinstance(value, dict) else enumerate(value)
            stack.extend(((*key, name), child) for name, child in reversed(list(items)))


def _long_integer_error(path: Path, text: str) -> InputError | None:
    """The error that names the key of an integer too long for Python, if there is one."""
    # Replace it by a shorter integer beyond 64 bits, whose key can be found.
    short = _LONG_NUMBER.sub(str(2 * _INTEGERS.stop), text)
    try:
        _check_values(tomllib.loads(short), path)
    except InputError as error:
        return InputError(path, error.problem, key=error.key)
    except (ValueError, RecursionError):
        pass
    return None


def toml_key(key: tuple[str | int, ...]) -> str:
    """A key in TOML's notation: parts joined by dots, with quotes where they are needed."""
    parts = (str(part) for part in key)
    return ".".join(part if _is_plain(part) else json.dumps(part) for part in parts)


def _is_plain(part: str) -> bool:
    return bool(part) and part.isprintable() and not set(part) & set(" .\"'")


def validate(model: type[Model], data: Mapping[str, Any], where: str | Path) -> Model:
    """Validate `data` as a `model`, a pydantic model or a data class.

    Raises:
        InputError: for the first error, with its dotted key and value.
    """
    try:
        kind: Any = model
        return cast("Model", type_adapter(kind).validate_python(data))
    except ValidationError as error:
        raise _as_input_error(error, data, where) from None


def _as_input_error(error: ValidationError, data: Any, where: str | Path) -> InputError:
    first = error.errors(include_url=False, include_context=True)[0]
    key = toml_key(_keys_of_file(first["loc"], data))
    if first["type"] == "union_tag_not_found":
        return InputError(where, "is required but missing", key=f"{key}.kind")
    if first["type"] == "union_tag_invalid":
        context = first["ctx"]
        return InputError(
            where, f"must be one of {context['expected_tags']}", key=f"{key}.kind", value=context["tag"]
        )
    if first["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        return InputError(where, "is not a known key", key=key)
    if first["type"] == "missing":
        return InputError(where, "is required but missing", key=key)
    if first["type"] == "too_long":
        context = first["ctx"]
        problem = f"has {context['actual_length']} entries; at most {context['max_length']} are allowed"
        return InputError(where, problem, key=key)
    message = first["msg"].removeprefix("Value error, ").removeprefix("Assertion failed, ")
    message = message.replace("Input should be", "must be").replace("\n", " ")
    for python_type, toml_type in _PYTHON_TO_TOML:
        message = python_type.sub(toml_type, message)
    value = first["input"] if not isinstance(first["input"], (dict, BaseModel)) else None
    return InputError(where, message, key=key, value=value)


def _keys_of_file(location: tuple[str | int, ...], data: Any) -> tuple[str | int, ...]:
    """The location of an error without the validator's own parts: the kind of a table of several kinds."""
    keys: list[str | int] = []
    entered: Any = None  # the last table whose kind was skipped
    for part in location:
        if isinstance(data, Mapping):
            if data.get("kind") == part and entered is not data:
                entered = data
                continue
            data = data.get(part)
        elif isinstance(data, list | tuple) and isinstance(part, int) and part < len(data):
            data = data[part]
        else:
            data = None
        keys.append(part)
    return tuple(keys)


_MAX_FILES: Final = 20  # chosen: more files than a reader can follow


def extends_chain(
    path: Path, folder: ShippedFolder, *, follow_links: bool = True
) -> list[tuple[Path, dict[str, Any]]]:
    """Read a TOML file, the file that its key `extends` names, and so on.

    `extends` is a path relative to the file, or the bare name of a shipped file.

    Args:
        path: the first file.
        folder: of the shipped files.
        follow_links: whether ".." behind a symbolic link leaves the folder that the link points to; False
            removes the name before it, as written.

    Returns:
        Each file with its tables, without `extends`; the first file comes first.

    Raises:
        InputError: a file cannot be read or found, or `extends` is not text, forms a cycle or is longer than
            20 files.
    """
    files: list[tuple[Path, dict[str, Any]]] = []
    while True:
        tables = read_toml(path)
        name = tables.pop("extends", None)
        files.append((path, tables))
        if name is None:
            return files
        if not isinstance(name, str):
            raise InputError(path, "must be a name or a path", key="extends", value=name)
        is_bare = not name.endswith(".toml") and Path(name).parent == Path(".")
        target = path.parent / name
        try:
            if not follow_links:
                target = Path(os.path.normpath(target.absolute()))
            parent = find_file(folder, name if is_bare else target)
        except InputError as error:
            raise InputError(path, error.problem, key="extends", value=name) from None
        if len(files) == _MAX_FILES or parent.resolve() in {file.resolve() for file, _ in files}:
            problem = f"forms a cycle, or is longer than {_MAX_FILES} files"
            raise InputError(path, problem, key="extends", value=name)
        path = parent
