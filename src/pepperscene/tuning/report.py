"""A fit as text tables, as the JSON record `tuning.json`, and the provenance of its values."""

from __future__ import annotations

import datetime
import hashlib
import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Final

import numpy as np
import tomlkit
from numpy.typing import NDArray
from tomlkit.container import Container
from tomlkit.items import Item, Table

from pepperscene.atomic import plain_values
from pepperscene.colour import PatchSet
from pepperscene.colour.comparison.tables import UNKNOWN, TextTable
from pepperscene.tuning.bounds import Parameter
from pepperscene.tuning.least_squares import FitResult, KindFit
from pepperscene.tuning.tuned import round_for_file
from pepperscene.tuning.whole_scene import Agreement, Verification
from pepperscene.version import __version__

_WIDTH: Final = 116  # chosen: of comment lines
FORMAT: Final = "pepperscene tuning 1"
_BOUNDS: Final = {"mean", "sd", "low", "high", "source", "chosen"}


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
        spectrum = measurement.spectrum
        yield measurement.name, _sha256(*np.asarray([spectrum.wavelength_nm, spectrum.values], "<f8"))


def _sha256(*arrays: NDArray[Any]) -> str:
    return hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()


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
    parts = {"CIEDE2000 of mean colours": kinds, "Reflectance": spectra}
    return ". ".join(f"{name}: {'; '.join(texts)}" for name, texts in parts.items() if texts)


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


def known_table(parameters: Sequence[Parameter]) -> TextTable:
    """Table of parameters that can be fitted."""
    rows = [
        (
            label,
            format_value(before, prior.sd),
            f"{prior.mean:.3g} ± {prior.sd:.2g}",
            f"{prior.low:.3g} to {prior.high:.3g}",
            parameter.unit,
            parameter.meaning if i == 0 else "",
        )
        for parameter in parameters
        for i, (label, before, prior) in enumerate(
            zip(parameter.entry_labels, parameter.default.tolist(), parameter.prior, strict=True)
        )
    ]
    headers = ("parameter", "current", "prior", "bounds", "unit", "meaning")
    return TextTable("Parameters that can be fitted", headers, tuple(rows))


def fit_tables(fit: FitResult, verification: Verification | None = None) -> tuple[TextTable, ...]:
    """Tables of parameters, of colours and spectra before and after, and of the whole scene if rendered."""
    rows = [
        (
            label, format_value(before, sd), format_with_sd(value, sd),
            f"{prior.low:.4g} to {prior.high:.4g}", parameter.unit, _format_percent(reduction),
        )
        for parameter in fit.parameters
        for (label, value, sd, before), prior, reduction in zip(
            fitted_entries(fit, parameter), parameter.prior,
            np.atleast_1d(fit.variance_reduction[parameter.name]), strict=True,
        )
    ]  # fmt: skip
    headers = ("parameter", "before", "after", "bounds", "unit", "variance reduction")
    tables = [TextTable("Fitted parameters", headers, tuple(rows))]
    delta_e = {
        name: (kind_fit.delta_e_before, kind_fit.delta_e_after) for name, kind_fit in fit.kinds.items()
    }
    rmse = {name: (spectrum.rmse_before, spectrum.rmse_after) for name, spectrum in fit.spectra.items()}
    for title, head, digits, pairs in (
        ("CIEDE2000 of mean colours, single organs", "kind", 2, delta_e),
        ("Root mean square error of reflectance", "spectrum", 4, rmse),
    ):
        if pairs:
            cells = tuple(
                (name, *(f"{number:.{digits}f}" for number in pair)) for name, pair in pairs.items()
            )
            tables.append(TextTable(title, (head, "before", "after"), cells))
    if verification is not None:
        frames = f"{verification.frames} frame{'' if verification.frames == 1 else 's'} of the whole scene"
        sides = [("the patches", verification.before, verification.after)]
        if verification.held_after:
            sides.append(("held-out pictures", verification.held_before, verification.held_after))
        tables += [_agreement_table(f"{frames} and {name}", *both) for name, *both in sides]
    return tuple(tables)


def _agreement_table(
    title: str, before: Mapping[str, Agreement], after: Mapping[str, Agreement]
) -> TextTable:
    headers = ("kind", "dE2000 before", "after", "hue correlation before", "after")
    rows = [
        (
            kind,
            _format_number(before[kind].delta_e), _format_number(agreement.delta_e),
            _format_number(before[kind].correlation), _format_number(agreement.correlation),
        )
        for kind, agreement in after.items()
    ]  # fmt: skip
    return TextTable(title, headers, tuple(rows))


def _format_number(value: float | None) -> str:
    return UNKNOWN if value is None or not np.isfinite(value) else f"{value:.2f}"


def _format_percent(value: float) -> str:
    return UNKNOWN if not np.isfinite(value) else f"{100 * np.clip(value, 0.0, 1.0):.0f} %"


def fit_record(fit: FitResult, run: RunInfo, verification: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """The whole result, serialisable as JSON; numbers that are not finite become null."""
    parts = fit.tuned_parts
    record: dict[str, Any] = {
        "format": FORMAT,
        "version": run.version,
        "date": run.when.isoformat(),
        "options": run.options,
        "patches": {"name": run.patches, "sha256": run.sha256, "members": run.members},
        "parameters": [_parameter_record(fit, parameter) for parameter in fit.parameters],
        "entries": [label for parameter in fit.parameters for label in parameter.entry_labels],
        "correlation": fit.correlation,
        "undetermined": fit.undetermined,
        "kinds": {name: _kind_record(kind_fit) for name, kind_fit in fit.kinds.items()},
        "spectra": {name: asdict(spectrum) for name, spectrum in fit.spectra.items()},
        "starts": [asdict(start) for start in fit.starts],
        "chi_squared": fit.chi_squared,
        "data": fit.data_count,
        "leftover": fit.omitted,
        "verdict": fit.diagnostics,
        "verification": verification,
        "tuned": {
            "pigments": {name: path.model_dump(mode="json") for name, path in sorted(parts.pigments.items())},
            "flash_power": parts.flash_power,
            "flash_nodes_nm": parts.flash_nodes_nm,
            "flash_spectrum": parts.flash_factors,
            "exposure": parts.exposure,
            "gains": parts.gains,
            "matrix": parts.matrix,
        },
    }
    return {key: plain_values(value) for key, value in record.items()}


def _parameter_record(fit: FitResult, parameter: Parameter) -> dict[str, Any]:
    name = parameter.name
    return {
        "name": name,
        "unit": parameter.unit,
        "group": parameter.group,
        "labels": parameter.labels,
        "before": parameter.default,
        "value": fit.values[name],
        "sd": fit.sd[name],
        "gained": fit.variance_reduction[name],
        "bounds": [prior.model_dump(include=_BOUNDS) for prior in parameter.prior],
    }


def _kind_record(kind_fit: KindFit) -> dict[str, Any]:
    colours = {"target": kind_fit.target, "before": kind_fit.before, "after": kind_fit.after}
    moments = {name: {"mean_lab": mean, "sd_lab": sd} for name, (mean, sd) in colours.items()}
    return {**moments, "delta_e_before": kind_fit.delta_e_before, "delta_e_after": kind_fit.delta_e_after}
