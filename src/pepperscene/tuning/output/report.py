"""A fit as text tables, and as the JSON record `tuning.json`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from pepperscene.colour.comparison.tables import UNKNOWN, TextTable
from pepperscene.tuning.output.provenance import RunInfo, fitted_entries, format_value, format_with_sd

if TYPE_CHECKING:
    from pepperscene.tuning.fit.least_squares import FitResult, KindFit
    from pepperscene.tuning.parameters.parameter import Parameter
    from pepperscene.tuning.whole_scene import Agreement, Verification

FORMAT: Final = "pepperscene tuning 1"
_BOUNDS: Final = {"mean", "sd", "low", "high", "source", "chosen"}


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
    record = {
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
    return {key: _json_value(value) for key, value in record.items()}


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


def _json_value(value: Any) -> Any:
    """The value with Python's own types, and None for numbers that JSON cannot represent."""
    if isinstance(value, np.ndarray | np.generic):
        return _json_value(value.tolist())
    if isinstance(value, Mapping):
        return {str(key): _json_value(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_json_value(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
