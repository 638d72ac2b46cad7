"""The section on variation: the distributions in the recipe, and the values that were drawn."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.recipe.variation.recorded import distinct_draws, goodness_of_fit
from pepperscene.recipe.variation.varied import Varied, VariedChoice, VariedInTurn, VariedNumber
from pepperscene.review.report.charts import step_chart
from pepperscene.review.report.data import DrawnRecords, SetSummary

VARIATION_HEADS: Final = ("Value", "per", "distribution", "draws", "minimum", "median", "maximum", "p")
_BINS: Final = 24  # chosen: as of the other charts
_MIN_BINS: Final = 4  # chosen: fewer show no shape
_MAX_BARS: Final = 20  # chosen: outcomes in a panel
_MARGIN: Final = 0.01  # chosen: half the width of a constant's bin, over the constant
_UNKNOWN: Final = "–"


def variation_tables(sets: Sequence[SetSummary]) -> list[dict[str, Any]]:
    """The table and the charts of each data set that has varied values or twins."""
    return [
        _set_tables(item, item.records.drawn)
        for item in sets
        if item.records is not None and item.records.drawn is not None
    ]


def _set_tables(item: SetSummary, drawn: DrawnRecords) -> dict[str, Any]:
    rows: list[tuple[str, list[str]]] = []
    panels: list[dict[str, Any]] = []
    for number, varied in enumerate(drawn.variation):
        draws = distinct_draws(varied, drawn.plan, drawn.indices, drawn.numbers[varied.name])
        rows.append((varied.name, _cells(varied, draws)))
        if len(draws) and isinstance(varied, VariedNumber):
            chart = _histogram(f"varied-{item.key}{number}", varied, draws)
            panels.append({"name": varied.name, "chart": chart})
        elif len(draws):
            panels.append({"name": varied.name, "chart": None, **_bars(varied, draws)})
    for name, values in drawn.twins.items():
        rows.append((name, ["twin", ", ".join(map(str, values)), *[_UNKNOWN] * 5]))
    return {"set": item, "rows": rows, "panels": panels}


def _cells(varied: Varied, draws: NDArray[np.float64]) -> list[str]:
    limits = [_UNKNOWN] * 3
    if isinstance(varied, VariedNumber) and len(draws):
        limits = [_text(varied, value) for value in (draws.min(), np.median(draws), draws.max())]
    p = goodness_of_fit(varied, draws)
    return [
        varied.per, varied.describe(), f"{len(draws):,}", *limits, _UNKNOWN if p is None else f"{p:.2g}",
    ]  # fmt: skip


def _text(varied: VariedNumber, value: float) -> str:
    return str(datetime.date.fromordinal(round(value))) if varied.kind == "date" else f"{value:.4g}"


def _histogram(chart_id: str, varied: VariedNumber, draws: NDArray[np.float64]) -> str:
    """Percentage of the draws in each bin, and that of the distribution."""
    scale, unit = (np.log10, "logarithm to base 10") if varied.logarithmic else (np.asarray, "value")
    offset = 0.0
    if varied.kind == "date":
        offset = np.floor(draws.min())
        unit = f"days after {_text(varied, offset)}"
    edges = _bin_edges(varied, draws)
    drawn = 100.0 * np.histogram(draws, edges)[0] / len(draws)
    shares = np.diff(varied.cumulative(edges))
    expected = 100.0 * shares / max(float(shares.sum()), 1e-9)
    series = [("a", "drawn", drawn), ("b", "expected", expected)]
    return step_chart(
        chart_id, f"Drawn values of {varied.name}", scale(edges - offset), series, unit, "% of draws"
    )


def _bin_edges(varied: VariedNumber, draws: NDArray[np.float64]) -> NDArray[np.float64]:
    """`(n + 1,)` edges of bins for all draws and the whole distribution."""
    ends = varied.distribution.quantiles([0.0, 1.0])
    if varied.logarithmic:
        # Numbers that have no logarithm are not drawn, but a damaged record can hold them.
        ends, draws = np.exp(ends), draws[draws > 0]
    low = float(np.min(draws, initial=ends[0]))
    high = float(np.max(draws, initial=ends[1]))
    if varied.kind != "number":
        low, high = np.floor(low) - 0.5, np.ceil(high) + 0.5
    if low == high:
        margin = _MARGIN * abs(low) or _MARGIN
        return np.array([low - margin, low + margin])
    # Few draws need wide bins; bins of integers are whole numbers wide.
    count = int(np.clip(np.sqrt(len(draws)), _MIN_BINS, _BINS))
    if varied.logarithmic:
        return np.geomspace(low, high, count + 1)
    edges = np.linspace(low, high, count + 1)
    return edges if varied.kind == "number" else np.unique(np.round(edges - low)) + low


def _bars(varied: Varied, draws: NDArray[np.float64]) -> dict[str, Any]:
    """Outcomes with the drawn and the expected fraction of each."""
    if isinstance(varied, VariedChoice):
        outcomes, expected = varied.outcomes, np.array(varied.probabilities)
    else:
        assert isinstance(varied, VariedInTurn)
        outcomes, expected = varied.values, np.full(len(varied.values), 1.0 / len(varied.values))
    drawn = np.bincount(draws.astype(np.int64), minlength=len(outcomes)) / len(draws)
    pairs = zip(drawn.tolist(), expected.tolist(), strict=True)
    return {
        "bars": list(zip(map(str, outcomes), pairs, strict=True))[:_MAX_BARS],
        "scale": float(max(drawn.max(), expected.max())),
        "more": max(len(outcomes) - _MAX_BARS, 0),
    }
