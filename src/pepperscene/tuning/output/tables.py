"""What a fit found, as tables for people."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from pepperscene.colour.comparison.tables import UNKNOWN, TextTable
from pepperscene.tuning.output.provenance import entries, plain, with_spread

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pepperscene.tuning.fit.result import FitResult
    from pepperscene.tuning.parameters.parameter import Parameter
    from pepperscene.tuning.whole_scene import Likeness
    from pepperscene.tuning.workflow import Verification


def fit_tables(fit: FitResult, verification: Verification | None = None) -> tuple[TextTable, ...]:
    """Parameters, colours before and after, the whole scene where it was looked at, and what it all means."""
    return tuple(_tables(fit, verification))


def known_table(parameters: tuple[Parameter, ...]) -> TextTable:
    """What can be fitted of a recipe."""
    rows = [
        (
            name,
            plain(before, law.sd),
            f"{law.mean:.3g} ± {law.sd:.2g}",
            f"{law.low:.3g} to {law.high:.3g}",
            one.unit,
            one.meaning if place == 0 else "",
        )
        for one in parameters
        for place, (name, before, law) in enumerate(
            zip(_labels(one), np.atleast_1d(one.default).tolist(), one.prior, strict=True)
        )
    ]
    heads = ("parameter", "now", "expected", "bounds", "unit", "meaning")
    return TextTable("What can be fitted", heads, tuple(rows))


def _tables(fit: FitResult, verification: Verification | None) -> Iterator[TextTable]:
    rows = [
        (
            name, plain(before, sd), with_spread(value, sd), f"{law.low:.4g} to {law.high:.4g}", one.unit,
            _share(gained),
        )
        for one in fit.parameters
        for (name, value, sd, before), law, gained in zip(
            entries(fit, one), one.prior, np.atleast_1d(fit.gained[one.name]).tolist(), strict=True
        )
    ]  # fmt: skip
    heads = ("parameter", "before", "after", "bounds", "unit", "told by the patches")
    yield TextTable("What was fitted", heads, tuple(rows))
    if fit.kinds:
        rows_of_kinds = tuple(
            (name, f"{one.delta_e_before:.2f}", f"{one.delta_e_after:.2f}") for name, one in fit.kinds.items()
        )
        yield TextTable(
            "CIEDE2000 of mean colours, single organs", ("kind", "before", "after"), rows_of_kinds
        )
    if fit.spectra:
        rows_of_spectra = tuple(
            (name, f"{one.rmse_before:.4f}", f"{one.rmse_after:.4f}") for name, one in fit.spectra.items()
        )
        yield TextTable(
            "Root mean square error of reflectance", ("spectrum", "before", "after"), rows_of_spectra
        )
    if verification is not None:
        frames = f"{verification.frames} frame{'' if verification.frames == 1 else 's'} of the whole scene"
        yield _likenesses(f"{frames} and the patches", verification.before, verification.after)
        if verification.held_after:
            title = f"{frames} and pictures that were held out"
            yield _likenesses(title, verification.held_before, verification.held_after)


def _likenesses(title: str, before: Mapping[str, Likeness], after: Mapping[str, Likeness]) -> TextTable:
    heads = ("kind", "dE2000 before", "after", "hue correlation before", "after")
    rows = [
        (
            kind,
            _number(before[kind].delta_e), _number(one.delta_e),
            _number(before[kind].correlation), _number(one.correlation),
        )
        for kind, one in after.items()
    ]  # fmt: skip
    return TextTable(title, heads, tuple(rows))


def _labels(parameter: Parameter) -> list[str]:
    return [f"{parameter.name} ({label})" if label else parameter.name for label in parameter.labels]


def _number(value: float | None) -> str:
    return UNKNOWN if value is None or not np.isfinite(value) else f"{value:.2f}"


def _share(value: float) -> str:
    return UNKNOWN if not np.isfinite(value) else f"{100 * np.clip(value, 0.0, 1.0):.0f} %"
