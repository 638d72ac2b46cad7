"""What was measured as Markdown, ready for `benchmarks/README.md`."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from pepperscene.bench.equal_error import Ratio, front, ratio
from pepperscene.bench.measuring import Measured
from pepperscene.bench.peers import CYCLES
from pepperscene.bench.settings import NAMED, OUR_FAMILIES, PLAIN

OF_NOTE: tuple[float, ...] = (1.0,)
"""Errors in codes that every scene is compared at, beside those of the named qualities."""


def error_table(measured: Sequence[Measured]) -> str:
    """Error and time of each setting of one scene."""
    lines = [
        "| way | setting | RMSE, codes | relative MSE | FLIP | median | least | most | runs |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for one in measured:
        wrong = one.errors
        flip = f"{wrong.flip:.4f}" if math.isfinite(wrong.flip) else ""
        spans = " | ".join(duration(s) for s in (one.median_s, min(one.seconds), max(one.seconds)))
        lines.append(
            f"| {one.family} | {one.name} | {wrong.rmse_codes:.2f} | {wrong.relative_mse:.2g} | {flip} "
            f"| {spans} | {one.runs} |"
        )
    return "\n".join(lines)


def ratios(measured: Sequence[Measured]) -> list[dict[str, Any]]:
    """How long others take for the errors that ours reaches, on one scene; see `equal_error`."""
    ours = _points(measured, lambda family: family in OUR_FAMILIES)
    named = {one.errors.rmse_codes: one for one in measured if one.family == NAMED}
    others = {
        "plain path": _points(measured, lambda family: family == PLAIN),
        "Cycles, raw": _points(measured, lambda family: family == f"{CYCLES}, raw"),
        "Cycles, denoised": _points(measured, lambda family: family == f"{CYCLES}, denoised"),
        "Cycles, its best": _points(measured, lambda family: family.startswith(CYCLES)),
    }
    found = []
    for level in sorted({*OF_NOTE, *named}, reverse=True):
        # At its own error a named quality is compared as it is, not the best of all settings.
        own = [(named[level].median_s, level)] if level in named else ours
        for name, points in others.items():
            compared = ratio(level, own, points) if points else None
            if compared is not None:
                found.append(_told(compared, named[level].name if level in named else "best", name))
    return found


def ratio_table(found: Iterable[Mapping[str, Any]]) -> str:
    """The ratios as a table."""
    lines = [
        "| at an error of | ours | takes | against | takes | times as long |",
        "|---:|---|---:|---|---:|---:|",
    ]
    lines += [
        f"| {one['error_codes']:.2f} codes | {one['ours']} | {duration(one['ours_s'])} | {one['other']} "
        f"| {duration(one['other_s'])} | {one['times']:.1f}{' *' if one['beyond'] else ''} |"
        for one in found
    ]
    return "\n".join(lines)


def time_table(rows: Iterable[tuple[str, Sequence[float]]], first: str = "what") -> str:
    """Median, least and most of several times each."""
    import statistics

    lines = [f"| {first} | median | least | most | runs |", "|---|---:|---:|---:|---:|"]
    for name, seconds in rows:
        spans = " | ".join(duration(s) for s in (statistics.median(seconds), min(seconds), max(seconds)))
        lines.append(f"| {name} | {spans} | {len(seconds)} |")
    return "\n".join(lines)


def duration(seconds: float) -> str:
    """A time as one reads it in a table: milliseconds below ten seconds."""
    return f"{1e3 * seconds:,.0f} ms" if seconds < 9.9995 else f"{seconds:,.1f} s"


def _points(measured: Sequence[Measured], wanted: Any) -> list[tuple[float, float]]:
    found = [(one.median_s, one.errors.rmse_codes) for one in measured if wanted(one.family)]
    return front(point for point in found if point[1] > 0.0)


def _told(compared: Ratio, ours: str, other: str) -> dict[str, Any]:
    return {
        "error_codes": compared.error,
        "ours": ours,
        "ours_s": compared.ours_s,
        "other": other,
        "other_s": compared.other_s,
        "times": compared.times,
        "beyond": compared.beyond,
    }
