"""Content of the page's sections: Figs. 10 to 13 of Barth et al. 2018, recipe, build, drawn values."""

from __future__ import annotations

import datetime
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.dataset.store.recorded_values import is_varied
from pepperscene.recipe.camera_tables import AUTO
from pepperscene.recipe.variation.recorded import distinct_draws, goodness_of_fit
from pepperscene.recipe.variation.varied import Varied, VariedChoice, VariedInTurn, VariedNumber
from pepperscene.review.report.charts import Curve, line_chart, step_chart, value_chart
from pepperscene.review.report.colours import png_data_uri, viridis_colours
from pepperscene.review.report.data import DrawnRecords, FrameRecords, SetSummary
from pepperscene.review.report.image_view import Picture
from pepperscene.review.report.page import format_percent, plural
from pepperscene.truth import HUE_BINS, centre_falloff, hue_spectrum_correlation, mean_hue
from pepperscene.units import format_duration

_HUES: Final = np.arange(HUE_BINS) * (360.0 / HUE_BINS)
_HUE_AXIS: Final = ("hue, degrees", (0, 60, 120, 180, 240, 300, 360))
_FALLOFF_AXIS: Final = ("from the centre (0) to the corners (1)", (0, 0.25, 0.5, 0.75, 1))
_RINGS: Final = 40  # chosen: each 12 pixels wide in an image of 800 x 600
_MAP_PX: Final = 400  # chosen: twice the displayed width of a map

_BUILD_CHARTS: Final = (
    ("render_s", "Render time of a frame", "seconds", 1.0),
    ("write_s", "Write time of a frame", "seconds", 1.0),
    ("error_codes", "Estimated error of the traced light", "8-bit codes, root mean square", 1.0),
    ("samples_per_pixel", "Samples per pixel", "mean over the frame", 1.0),
    ("bytes", "File size of a frame", "MB", 1e-6),
)
"""Column of the manifest, title, unit, and factor to that unit."""


def recipe_facts(info: Mapping[str, Any]) -> dict[str, str]:
    """Quality, seed, plan and others by their terms, from the content of a `dataset.json`."""
    recipe = info["recipe"]
    plan, row, exposure = recipe["plan"], recipe["row"], recipe["camera"]["exposure_us"]
    factors = [f"{plan['sets']} sets", f"{plan['rotations']} rotations", f"{plan['frames']} steps"]
    factors += [f"{plan[name]} {name}" for name in ("twins", "cameras") if plan.get(name, 1) > 1]
    plants, spacing = f"{row['plants_front']} + {row['plants_back']} plants", "varied spacing"
    if is_varied(info, "row.plants_front", "row.plants_back"):
        plants = "varied number of plants"
    if not is_varied(info, "row.spacing_mm"):
        spacing = f"{row['spacing_mm']:g} mm apart"
    exposure = "automatic" if exposure == AUTO else f"{exposure:g} µs"
    daylight = f"{(recipe.get('daylight') or {'illuminance_lx': 0})['illuminance_lx']:,.0f} lx"
    return {
        "Quality": info["quality"],
        "Seed": recipe["seed"],
        "Plan": " × ".join(factors),
        "Rows": f"{plants}, {spacing}",
        "Exposure": "varied" if is_varied(info, "camera.exposure_us") else exposure,
        "Daylight": "varied" if is_varied(info, "daylight.illuminance_lx") else daylight,
        "Version": info["version"],
        "Recipe SHA-256": info["recipe_sha256"][:12] + "…",
    }


def class_fractions(sets: Sequence[SetSummary]) -> dict[str, Any] | None:
    """Fraction of each class in all pixels of each set (Fig. 10); None without labels."""
    fractions = {item.key: item.class_fractions() for item in sets}
    measured = [values for values, _ in fractions.values() if np.isfinite(values).all()]
    if not measured:
        return None
    rows = []
    for organ in OrganClass:
        drawn = [(item.key, float(fractions[item.key][0][organ])) for item in sets]
        # Zero is unknown if the set has unlabelled pixels.
        known = [
            float("nan") if fraction == 0.0 and item.statistics.unlabelled_pixels else fraction
            for item, (_, fraction) in zip(sets, drawn, strict=True)
        ]
        rows.append((organ, known, drawn))
    has_unlabelled = any(item.statistics.unlabelled_pixels for item in sets)
    return {
        "rows": rows,
        "scale": max(float(values.max()) for values in measured),
        "unlabelled": [item.unlabelled_fraction() for item in sets] if has_unlabelled else [],
        "counts": " and ".join(f"{plural(fractions[item.key][1], 'image')} of {item.name}" for item in sets),
    }


def class_maps(
    sets: Sequence[SetSummary],
) -> dict[OrganClass, list[tuple[SetSummary, Picture | None, float]]]:
    """Mean mask of each class in each set, relative to its maximum, and the maximum (Fig. 11)."""
    masks = [item.statistics.mean_masks() for item in sets]
    return {
        organ: [(item, *_class_map(item, organ, mean)) for item, mean in zip(sets, masks, strict=True)]
        for organ in OrganClass
    }


def _class_map(
    item: SetSummary, organ: OrganClass, masks: NDArray[np.float64] | None
) -> tuple[Picture | None, float]:
    if masks is None or not masks[organ].any():
        return None, 0.0
    maximum = float(masks[organ].max())
    image = viridis_colours(masks[organ] / maximum)
    alt = f"Locations of {organ.name.lower()} in {item.name}"
    return Picture("map", png_data_uri(image, _MAP_PX), alt, image.shape[1], image.shape[0]), maximum


def hue_spectra(sets: Sequence[SetSummary]) -> list[tuple[OrganClass, Any, list[Any], float | None]]:
    """Distribution of the hues of each class's pixels, in the centre of the images (Fig. 12).

    By class: a chart, a table of mean hues, and the correlation of two sets.
    """
    spectra = {item.key: item.statistics.hue_spectra() for item in sets}
    panels: list[tuple[OrganClass, Any, list[Any], float | None]] = []
    for organ in OrganClass:
        known = [item for item in sets if np.isfinite(spectra[item.key][organ]).all()]
        if not known:
            continue
        curves = [Curve(item.key, item.name, _HUES, spectra[item.key][organ]) for item in known]
        title = f"Hues of the class {organ.name.lower()}"
        chart = line_chart(f"hue{organ:d}", title, curves, _HUE_AXIS, "% of its pixels", hue_strip=True)
        table = []
        for item, curve in zip(known, curves, strict=True):
            hue, statistics = mean_hue(curve.y), item.statistics
            grey = format_percent(statistics.grey_fractions()[organ], 1)
            cells = ["–" if np.isnan(hue) else f"{hue:.0f}°", grey, f"{statistics.hue_image_counts[organ]:,}"]
            table.append((item, cells))
        correlation = hue_spectrum_correlation(curves[0].y, curves[1].y) if len(curves) == 2 else np.nan
        panels.append((organ, chart, table, float(correlation) if np.isfinite(correlation) else None))
    return panels


def intensity(sets: Sequence[SetSummary]) -> dict[str, Any] | None:
    """Mean intensity image of each set, its falloff to the corners, and a table (Fig. 13)."""
    known = [(item, mean) for item in sets if (mean := item.statistics.mean_intensity()) is not None]
    if not known:
        return None
    # One factor for all images, so that they can be compared, and without clipping.
    factor = 255.0 / max(1.0, max(float(np.percentile(mean, 99.5)) for _, mean in known))
    factor = max(1.0, np.floor(10.0 * factor) / 10.0)
    images, table = [], []
    for item, mean in known:
        values = np.array(item.statistics.intensities)
        images.append((item, _mean_image(item, mean, factor), float(np.mean(values))))
        statistics = (values.mean(), values.std(), values.min(), values.max())
        saturated = format_percent(float(np.mean(item.statistics.saturated_fractions)))
        table.append((item, [f"{values.size:,}", *(f"{value:.1f}" for value in statistics), saturated]))
    title = "Mean intensity by distance from the centre"
    chart = line_chart(
        "falloff", title, [_falloff(item, mean) for item, mean in known], _FALLOFF_AXIS, "grey value"
    )
    return {"images": images, "factor": factor, "chart": chart, "table": table}


def _mean_image(item: SetSummary, mean: NDArray[np.float64], factor: float) -> Picture:
    grey = np.rint(np.minimum(factor * mean, 255.0)).astype(np.uint8)
    uri = png_data_uri(np.repeat(grey[..., None], 3, axis=-1))
    return Picture("mean", uri, f"Mean intensity of {item.name}", grey.shape[1], grey.shape[0])


def _falloff(item: SetSummary, mean: NDArray[np.float64]) -> Curve:
    """Mean intensity of rings around the centre, as far as they contain pixels."""
    radii = np.linspace(0.0, 1.0, _RINGS + 1)
    rings = centre_falloff(mean, radii)
    known = np.isfinite(rings)
    return Curve(item.key, item.name, ((radii[1:] + radii[:-1]) / 2.0)[known], rings[known])


def build_figures(sets: Sequence[SetSummary]) -> dict[str, Any]:
    """Totals of each set, and distributions of timings, errors and sizes of all frames."""
    known = [(item, item.records) for item in sets if item.records is not None]
    panels = [_build_panel(known, *chart) for chart in _BUILD_CHARTS]
    return {
        "totals": [(item, _totals(records)) for item, records in known],
        "panels": [panel for panel in panels if panel],
    }


def _build_panel(
    sets: Sequence[tuple[SetSummary, FrameRecords]], column: str, title: str, unit: str, factor: float
) -> dict[str, Any] | None:
    values = [
        (item, records.indices[known], factor * records.numbers[column][known])
        for item, records in sets
        if (known := records.known(column)).any()
    ]
    if not values:
        return None
    series = [(item.key, item.name, numbers) for item, _, numbers in values]
    lines = []
    for item, indices, numbers in values:
        low, middle, high = np.percentile(numbers, (5, 50, 95))
        highest = int(np.argmax(numbers))
        spread = f", 90 % from {low:.3g} to {high:.3g}, maximum {numbers[highest]:.3g} in frame"
        lines.append((item, f"{middle:.3g}", f"{spread} {indices[highest]:06d}"))
    return {"title": title, "chart": value_chart(f"build-{column}", title, series, unit), "lines": lines}


def _totals(records: FrameRecords) -> str:
    size = float(np.nansum(records.numbers["bytes"]))
    parts = [f"{plural(len(records.indices), 'frame')}, {_format_size(size)} of files"]
    if records.known("render_s").any():
        seconds = float(np.nansum(records.numbers["render_s"]))
        by = f" by {plural(len(records.workers), 'worker')}" if records.workers else ""
        parts.append(f"{format_duration(seconds)} of rendering{by}")
    if records.known("error_codes").any() and records.known("noise_codes").any():
        ratio = np.nanmedian(records.numbers["error_codes"] / records.numbers["noise_codes"])
        parts.append(f"the light's error is {100 * ratio:.0f} % of the sensor's noise (median)")
    return "; ".join(parts)


def _format_size(count: float) -> str:
    unit, size = next((pair for pair in (("GB", 1e9), ("MB", 1e6)) if count >= pair[1]), ("kB", 1e3))
    return f"{count / size:.3g} {unit}"


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
