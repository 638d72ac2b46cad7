"""A comparison as text tables and as JSON."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, Final

from pepperscene.colour.comparison.bootstrap import LEVEL, REPLICATES, Estimate
from pepperscene.colour.comparison.result import Comparison, KindComparison, KindMeasures

FORMAT: Final = "pepperscene compare 1"
UNKNOWN: Final = "-"

_KEYS: Final = {
    "first": "one",
    "second": "other",
    "first_spread": "one_spread",
    "second_spread": "other_spread",
}
"""Keys of the JSON format that differ from the names of the attributes."""


# --- JSON ---------------------------------------------------------------------------------------------------


def comparison_json(comparison: Comparison) -> dict[str, Any]:
    """The comparison as JSON data; an unknown number is null, and `why` gives the reason."""
    first, second = (
        {"name": side.name, "measured": side.units, "of": side.available}
        for side in (comparison.first, comparison.second)
    )
    return {
        "format": FORMAT,
        "one": first,
        "other": second,
        "interval": {"level": LEVEL, "replicates": REPLICATES},
        "hue_correlation": _to_json(comparison.hue_correlation),
        "share_correlation": _to_json(comparison.share_correlation),
        "kinds": {
            name: {key: value for key, value in _to_json(kind).items() if key != "kind"}
            for name, kind in comparison.kinds.items()
        },
        "light": _to_json(comparison.light),
        "appearance": {kind: _to_json(pair) for kind, pair in comparison.appearance.items()},
    }


def _to_json(value: Any) -> Any:
    """Estimates and the data classes that hold them as JSON data."""
    if isinstance(value, Estimate):
        numbers = {"value": value.value, "low": value.low, "high": value.high}
        return {**numbers, "why": value.why} if value.value is None else numbers
    if is_dataclass(value) and not isinstance(value, type):
        names = [field.name for field in fields(value)]
        return {_KEYS.get(name, name): _to_json(getattr(value, name)) for name in names}
    return [_to_json(item) for item in value] if isinstance(value, tuple) else value


# --- tables -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TextTable:
    """A table of text cells."""

    title: str  # one line
    heads: tuple[str, ...]  # column headings
    rows: tuple[tuple[str, ...], ...]  # one cell for each heading
    notes: tuple[str, ...] = ()  # lines below the table


def comparison_tables(comparison: Comparison) -> tuple[TextTable, ...]:
    """The comparison in tables: hues, CIELAB, class fractions and places, light, saturation and texture.

    With patches on one side, there are tables of hues and CIELAB only.
    """
    tables = [_hue_table(comparison), _lab_table(comparison)]
    if comparison.first.has_images and comparison.second.has_images:
        tables += [_class_table(comparison), _light_table(comparison)]
        tables += [_saturation_table(comparison), _texture_table(comparison)]
    return tuple(tables)


def format_tables(tables: Sequence[TextTable]) -> str:
    """Tables as lines of text, with columns aligned by spaces."""
    lines: list[str] = []
    for table in tables:
        lines += [*([""] if lines else []), table.title]
        widths = [max(map(len, column)) for column in zip(table.heads, *table.rows, strict=True)]
        for row in (table.heads, *table.rows):
            cells = [cell.ljust(width) for cell, width in zip(row, widths, strict=True)]
            lines.append("  ".join(cells).rstrip())
        lines += table.notes
    return "\n".join(lines)


def format_estimate(estimate: Estimate, digits: int = 2, factor: float = 1.0) -> str:
    """A number with its interval in brackets."""
    if estimate.value is None:
        return UNKNOWN
    # Adding zero turns a rounded minus zero into zero.
    value, *ends = (
        None if number is None else f"{round(factor * number, digits) + 0.0:.{digits}f}"
        for number in (estimate.value, estimate.low, estimate.high)
    )
    return str(value) if None in ends else f"{value} [{ends[0]}, {ends[1]}]"


def _hue_table(comparison: Comparison) -> TextTable:
    a, b = (
        f"{side.name}, {side.units:,} of {side.available:,} images measured"
        for side in (comparison.first, comparison.second)
    )
    kinds = comparison.kinds.values()
    rows = [
        (
            kind.kind,
            format_estimate(kind.hue_correlation),
            format_estimate(kind.hue_emd_deg, 1),
            _format_hue(kind.first),
            _format_hue(kind.second),
            f"{kind.first.pictures:,}",
            f"{kind.second.pictures:,}",
        )
        for kind in kinds
    ]
    headers = ("kind", "correlation", "EMD, deg", "A, mean ± sd", "B, mean ± sd", "images A", "images B")
    mean = f"mean correlation over plant parts: {format_estimate(comparison.hue_correlation)}"
    notes = (mean, *_reasons(kinds, "hue_correlation", "hue_emd_deg"))
    return TextTable(f"Hues (Fig. 12). A: {a}; B: {b}", headers, tuple(rows), notes)


def _format_hue(side: KindMeasures) -> str:
    mean, spread = side.hue_mean_deg.value, side.hue_spread_deg.value
    return UNKNOWN if mean is None or spread is None else f"{mean:.0f} ± {spread:.0f}"


def _lab_table(comparison: Comparison) -> TextTable:
    rows = [
        (kind.kind, format_estimate(kind.delta_e_2000, 1), _format_lab(kind.first), _format_lab(kind.second))
        for kind in comparison.kinds.values()
    ]
    headers = ("kind", "CIEDE2000", "A, L* a* b*", "B, L* a* b*")
    return TextTable("CIELAB (D65): mean colour ± standard deviation over pixels", headers, tuple(rows))


def _format_lab(side: KindMeasures) -> str:
    cells = [
        f"{round(mean.value) + 0} ± {spread.value:.0f}"
        for mean, spread in zip(side.lab, side.lab_spread, strict=True)
        if mean.value is not None and spread.value is not None
    ]
    return ", ".join(cells) or UNKNOWN


def _class_table(comparison: Comparison) -> TextTable:
    kinds = [kind for kind in comparison.kinds.values() if "." not in kind.kind]
    rows = [
        (
            kind.kind,
            *(format_estimate(side.share, 2, 100.0) for side in (kind.first, kind.second)),
            format_estimate(kind.place_correlation),
            format_estimate(kind.place_ssim),
        )
        for kind in kinds
    ]
    correlation = comparison.share_correlation
    reason = f" ({correlation.why})" if correlation.value is None else ""
    return TextTable(
        "Class fractions in % of all pixels (Fig. 10), and mean masks (Fig. 11)",
        ("kind", "A, %", "B, %", "mask correlation", "mask SSIM"),
        tuple(rows),
        (
            f"correlation of the class fractions: {format_estimate(correlation, 3)}{reason}",
            *_reasons(kinds, "place_correlation"),
        ),
    )


def _light_table(comparison: Comparison) -> TextTable:
    light = comparison.light
    a, b = (UNKNOWN if sd is None else f"{sd:.1f}" for sd in (light.first_spread, light.second_spread))
    rows = (
        ("mean grey value, A", format_estimate(light.first, 1)),
        ("mean grey value, B", format_estimate(light.second, 1)),
        ("sd between images, A and B", f"{a} and {b}"),
        ("correlation of the mean images", format_estimate(light.correlation)),
        ("SSIM of the mean images", format_estimate(light.ssim)),
        ("correlation of the radial falloff", format_estimate(light.falloff_correlation)),
    )
    return TextTable("Light (Fig. 13)", ("measure", "value"), rows)


def _saturation_table(comparison: Comparison) -> TextTable:
    rows = []
    for kind, pair in comparison.appearance.items():
        for letter, side in (("A", pair.first), ("B", pair.second)):
            hue, spread = side.hue_median_deg.value, side.hue_spread_deg.value
            rows.append(
                (
                    kind,
                    letter,
                    *(format_estimate(percentile) for percentile in side.saturation),
                    UNKNOWN if hue is None or spread is None else f"{hue:.0f} ± {spread:.0f}",
                    format_estimate(side.blue_dark_share, 1, 100.0),
                    format_estimate(side.clipped_share, 1, 100.0),
                )
            )
    return TextTable(
        "Saturation S = C*/(L*+16), and hue weighted by chroma",
        ("kind", "set", "S 10 %", "S 50 %", "S 90 %", "hue, deg", "blue < .002, %", "clipped, %"),
        tuple(rows),
    )


def _texture_table(comparison: Comparison) -> TextTable:
    rows = [
        (
            kind,
            letter,
            format_estimate(side.organ_lightness_sd, 1),
            format_estimate(side.patch_lightness_sd, 1),
            format_estimate(side.gradient_ratio),
            format_estimate(side.coherence),
            format_estimate(side.gloss_share, 1, 100.0),
            format_estimate(side.spectrum_slope),
        )
        for kind, pair in comparison.appearance.items()
        for letter, side in (("A", pair.first), ("B", pair.second))
    ]
    spreads = [
        format_estimate(side.spectrum_slope_spread)
        for pair in list(comparison.appearance.values())[:1]
        for side in (pair.first, pair.second)
    ]
    return TextTable(
        "Texture: lightness in organs and in patches, gradients, gloss, power spectrum",
        ("kind", "set", "organ sd L*", "patch sd L*", "gradients", "coherence", "gloss, %", "slope"),
        tuple(rows),
        (f"sd of the slope between images, A and B: {' and '.join(spreads)}",) if spreads else (),
    )


def _reasons(kinds: Iterable[KindComparison], *names: str) -> list[str]:
    """Reasons for missing values, each with the kinds that it applies to."""
    kinds_of: dict[str, list[str]] = {}
    for kind in kinds:
        for name in names:
            if reason := getattr(kind, name).why:
                kinds_of.setdefault(reason, []).append(kind.kind)
    return [f"{', '.join(dict.fromkeys(names))}: {reason}" for reason, names in kinds_of.items()]
