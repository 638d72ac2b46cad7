"""A comparison as text: tables for people, and the same numbers as JSON."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import TYPE_CHECKING, Any, Final

from pepperscene.colour.statistics.bootstrap import Estimate

if TYPE_CHECKING:
    from pepperscene.colour.comparison.result import Comparison, KindComparison, KindSide


UNKNOWN: Final = "-"


@dataclass(frozen=True)
class TextTable:
    """Rows of cells under headings.

    Attributes:
        title: what is told, in a line.
        heads: of the columns.
        rows: as many cells each.
        notes: lines below it.
    """

    title: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()


def comparison_tables(found: Comparison) -> tuple[TextTable, ...]:
    """The comparison in four tables: hues, CIELAB, shares and places, light."""
    parts = [_hues(found), _lab(found)]
    if found.one.pictured and found.other.pictured:
        parts += [_places(found), _light(found)]
    return tuple(parts)


def format_tables(parts: Sequence[TextTable]) -> str:
    """Tables as lines of text, columns by spaces."""
    lines: list[str] = []
    for part in parts:
        lines += [*([""] if lines else []), part.title]
        widths = [max(map(len, column)) for column in zip(part.heads, *part.rows, strict=True)]
        for row in (part.heads, *part.rows):
            cells = [cell.ljust(width) for cell, width in zip(row, widths, strict=True)]
            lines.append("  ".join(cells).rstrip())
        lines += part.notes
    return "\n".join(lines)


def to_json(value: Any) -> Any:
    """Measures and what is made of them as JSON holds it; `why` only where there is no value."""
    if isinstance(value, Estimate):
        told = {"value": value.value, "low": value.low, "high": value.high}
        return {**told, "why": value.why} if value.value is None else told
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: to_json(getattr(value, field.name)) for field in fields(value)}
    return [to_json(one) for one in value] if isinstance(value, tuple) else value


def cell(measure: Estimate, digits: int = 2, factor: float = 1.0) -> str:
    """A number with its interval in brackets."""
    if measure.value is None:
        return UNKNOWN
    # Adding zero makes of a rounded minus zero a zero.
    value, *ends = (
        None if one is None else f"{round(factor * one, digits) + 0.0:.{digits}f}"
        for one in (measure.value, measure.low, measure.high)
    )
    return str(value) if None in ends else f"{value} [{ends[0]}, {ends[1]}]"


def _hues(found: Comparison) -> TextTable:
    rows = [
        (
            kind.kind, cell(kind.hue_correlation), cell(kind.hue_emd_deg, 1),
            _hue(kind.one), _hue(kind.other), f"{kind.one.pictures:,}", f"{kind.other.pictures:,}",
        )
        for kind in found.kinds.values()
    ]  # fmt: skip
    one, other = (f"{name}: {side.units:,} of {side.of:,}" for name, side in
                  zip(found.names, (found.one, found.other), strict=True))  # fmt: skip
    mean = cell(found.hue_correlation)
    return TextTable(
        f"A is {one}, B is {other} measured. Hues (Fig. 12)",
        ("kind", "correlation", "EMD, deg", "mean ± sd of A", "mean ± sd of B", "seen in A", "in B"),
        tuple(rows),
        (
            f"mean correlation of the plant parts: {mean}",
            *_reasons(found.kinds.values(), "hue_correlation", "hue_emd_deg"),
        ),
    )


def _hue(side: KindSide) -> str:
    mean, spread = side.hue_mean_deg.value, side.hue_spread_deg.value
    return UNKNOWN if mean is None or spread is None else f"{mean:.0f} ± {spread:.0f}"


def _lab(found: Comparison) -> TextTable:
    rows = [
        (kind.kind, cell(kind.delta_e_2000, 1), *(_colour(side) for side in (kind.one, kind.other)))
        for kind in found.kinds.values()
    ]
    heads = ("kind", "dE2000", "L* a* b* of A", "L* a* b* of B")
    return TextTable("CIELAB (D65) of the mean colour ± sd of the pixels", heads, tuple(rows))


def _colour(side: KindSide) -> str:
    cells = [
        f"{round(mean.value) + 0} ± {spread.value:.0f}"
        for mean, spread in zip(side.lab, side.lab_spread, strict=True)
        if mean.value is not None and spread.value is not None
    ]
    return ", ".join(cells) or UNKNOWN


def _places(found: Comparison) -> TextTable:
    rows = [
        (
            kind.kind, *(cell(side.share, 2, 100.0) for side in (kind.one, kind.other)),
            cell(kind.place_correlation), cell(kind.place_ssim),
        )
        for kind in found.kinds.values() if "." not in kind.kind
    ]  # fmt: skip
    alike = found.share_correlation
    because = f" ({alike.why})" if alike.value is None else ""
    return TextTable(
        "Shares of all pixels (Fig. 10) and places (Fig. 11)",
        ("kind", "% of A", "% of B", "correlation of places", "SSIM of places"),
        tuple(rows),
        (
            f"correlation of the shares: {cell(alike, 3)}{because}",
            *_reasons([kind for kind in found.kinds.values() if "." not in kind.kind], "place_correlation"),
        ),
    )


def _light(found: Comparison) -> TextTable:
    light = found.light
    rows = [
        ("mean grey value of A", cell(light.one, 1)),
        ("mean grey value of B", cell(light.other, 1)),
        ("sd between pictures, A and B", " and ".join(
            UNKNOWN if one is None else f"{one:.1f}" for one in (light.one_spread, light.other_spread))),
        ("correlation of mean pictures", cell(light.correlation)),
        ("SSIM of mean pictures", cell(light.ssim)),
        ("correlation of the falls from the middle", cell(light.falloff_correlation)),
    ]  # fmt: skip
    return TextTable("Light (Fig. 13)", ("measure", "value"), tuple(rows))


def _reasons(kinds: Iterable[KindComparison], *names: str) -> list[str]:
    """Why cells hold a dash, each reason once."""
    why: dict[str, list[str]] = {}
    for kind in kinds:
        for name in names:
            if reason := getattr(kind, name).why:
                why.setdefault(reason, []).append(kind.kind)
    return [f"{', '.join(dict.fromkeys(some))}: {reason}" for reason, some in why.items()]
