"""Provenance of tuned values: the run that tuned them, sentences, and TOML text with comments."""

from __future__ import annotations

import datetime
import hashlib
import math
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import tomlkit
from tomlkit.container import Container
from tomlkit.items import Item, Table

from pepperscene.tuning.parameters.tuned import round_for_file
from pepperscene.version import __version__

if TYPE_CHECKING:
    from pepperscene.colour import PatchSet
    from pepperscene.tuning.fit.least_squares import FitResult
    from pepperscene.tuning.parameters.parameter import Parameter

_WIDTH: Final = 116  # chosen: of comment lines


@dataclass(frozen=True)
class RunInfo:
    """When a recipe was tuned, to which patches, and with which options."""

    when: datetime.date
    patches: str  # name of the set
    sha256: str  # of all its pixels and spectra
    members: Mapping[str, str]  # digest of each patch and spectrum, by name
    options: Mapping[str, Any] = field(default_factory=dict)  # such as seed and starts, for JSON
    version: str = __version__

    @classmethod
    def of(cls, patches: PatchSet, when: datetime.date, options: Mapping[str, Any] | None = None) -> RunInfo:
        """Return the information on a run that tunes something to these patches."""
        members = dict(_digests(patches))
        joined = "".join(f"{name}\0{digest}\n" for name, digest in sorted(members.items()))
        sha256 = hashlib.sha256(joined.encode()).hexdigest()
        return cls(when, patches.name, sha256, members, dict(options or {}))

    def summary(self) -> str:
        """Program, date and patches, as the beginning of a sentence."""
        return (
            f"Tuned by pepperscene {self.version} on {self.when.isoformat()} to the patches "
            f"{self.patches!r} (sha256 of their pixels {self.sha256})"
        )


def _digests(patches: PatchSet) -> Iterator[tuple[str, str]]:
    """SHA-256 of the numbers of each patch and spectrum, independent of the platform."""
    for patch in patches.patches:
        yield patch.name, _sha256(np.asarray(patch.linear, "<f8"), np.asarray(patch.codes, "u1"))
    for measurement in patches.spectra:
        wavelength_nm, values = measurement.spectrum.wavelength_nm, measurement.spectrum.values
        yield measurement.name, _sha256(np.asarray(wavelength_nm, "<f8"), np.asarray(values, "<f8"))


def _sha256(*arrays: Any) -> str:
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def fitted_entries(fit: FitResult, parameter: Parameter) -> Iterator[tuple[str, float, float, float]]:
    """Label, value, standard deviation and original value of each entry of a fitted parameter."""
    columns = (fit.values[parameter.name], fit.sd[parameter.name], parameter.default)
    numbers = (np.atleast_1d(column).tolist() for column in columns)
    yield from zip(parameter.entry_labels, *numbers, strict=True)


def describe_values(fit: FitResult, parameter: Parameter) -> str:
    """Values of a parameter with their standard deviations and original values."""
    unit = f" {parameter.unit}" if parameter.unit and parameter.unit != "1" else ""
    values = [
        f"{label} {format_with_sd(value, sd)}{unit} (was {format_value(before, sd)})".strip()
        for label, (_, value, sd, before) in zip(
            parameter.labels, fitted_entries(fit, parameter), strict=True
        )
    ]
    return f"{parameter.name} {', '.join(values)}"


def describe_colours(fit: FitResult) -> str:
    """Differences between model and patches before and after the fit."""
    kinds = [
        f"{name} {kind.delta_e_before:.2f} before, {kind.delta_e_after:.2f} after"
        for name, kind in fit.kinds.items()
    ]
    spectra = [
        f"{name} RMSE {spectrum.rmse_before:.4f} before, {spectrum.rmse_after:.4f} after"
        for name, spectrum in fit.spectra.items()
    ]
    sentences = [f"CIEDE2000 of mean colours: {'; '.join(kinds)}"] if kinds else []
    return ". ".join([*sentences, *([f"Reflectance: {'; '.join(spectra)}"] if spectra else [])])


def format_with_sd(value: float, sd: float) -> str:
    """A value and its standard deviation, with two significant digits of the latter."""
    return f"{format_value(value, sd)} ± {format_value(sd, sd)}"


def format_value(value: float, sd: float) -> str:
    """A value to the second digit of its standard deviation, or with four digits if there is none."""
    if not (math.isfinite(sd) and sd > 0.0) or not math.isfinite(value):
        return f"{value:.4g}"
    digits = 1 - math.floor(math.log10(sd))
    # A value far below its sd keeps one digit.
    if value:
        digits = max(digits, -math.floor(math.log10(abs(value))))
    return f"{round(value, digits):.{max(min(digits, 12), 0)}f}"


def toml_text(
    tables: Mapping[str, Any], head: str = "", comments: Mapping[str, str] | None = None, depth: int = 1
) -> str:
    """Return a TOML file with a comment at the top and comments after values.

    Args:
        tables: Content; numbers are written with 12 significant digits.
        head: Paragraphs of the comment at the top.
        comments: Comment after a value, by dotted key.
        depth: Levels of tables with headings, which come after other keys; deeper ones are inline.
    """
    document = tomlkit.document()
    for paragraph in head.splitlines():
        indent = paragraph[: len(paragraph) - len(paragraph.lstrip())]
        for line in textwrap.wrap(
            paragraph.strip(),
            _WIDTH,
            initial_indent=indent,
            subsequent_indent=2 * indent,
            break_long_words=False,
        ):
            document.add(tomlkit.comment(line))
    if head:
        document.add(tomlkit.nl())
    _fill_table(document, tables, "", comments or {}, depth)
    return tomlkit.dumps(document)


def _fill_table(
    table: Container | Table, content: Mapping[str, Any], prefix: str, comments: Mapping[str, str], depth: int
) -> None:
    headed = {key: value for key, value in content.items() if isinstance(value, Mapping) and depth > 0}
    for key, value in content.items():
        if key not in headed:
            item = _toml_item(value)
            if comment := comments.get(f"{prefix}{key}"):
                item.comment(" ".join(comment.split()))
                item.trivia.comment_ws = "  "
            table.append(key, item)
    for key, value in headed.items():
        # A table that only holds tables needs no heading.
        only_tables = bool(value) and depth > 1 and all(isinstance(item, Mapping) for item in value.values())
        inner = tomlkit.table(is_super_table=only_tables)
        _fill_table(inner, value, f"{prefix}{key}.", comments, depth - 1)
        table.append(key, inner)


def _toml_item(value: Any) -> Item:
    """A value as a TOML item: tables inline, arrays of arrays with one row a line."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, float):
        rounded = round_for_file(value)
        value = int(rounded) if rounded.is_integer() and abs(rounded) < 1e15 else rounded
    if isinstance(value, Mapping):
        table = tomlkit.inline_table()
        for key, item in value.items():
            table.append(key, _toml_item(item))
        return table
    if isinstance(value, list | tuple):
        array = tomlkit.array()
        array.extend(_toml_item(item) for item in value)
        return array.multiline(bool(value) and isinstance(value[0], list | tuple))
    return tomlkit.item(value)
