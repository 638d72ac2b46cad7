"""A plan and its cost as lines of text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Final

from pepperscene.building.memory import format_size
from pepperscene.review.preview.preview import CostEstimate
from pepperscene.review.preview.summary import CameraSummary, PlanSummary
from pepperscene.units import format_duration

_INDENT: Final = 10  # columns before the text of a section
_UNITS: Final = {"_mm_s": " mm/s", "_mm": " mm", "_deg": "°", "_hz": " Hz"}
_RANGES: Final = {
    "arc": {"azimuth_deg", "height_mm"},
    "random": {"distance_mm", "elevation_deg", "azimuth_deg", "roll_deg", "offset"},
}
"""Keys of pairs that are the ends of a range, by kind of views; other lists are values, each used."""
_MOST_VALUES: Final = 12  # chosen: values of a list that are printed, which fit into a line


def plan_lines(summary: PlanSummary, cost: CostEstimate | None) -> list[str]:
    """The lines that describe a plan, and its cost if that was estimated."""
    sections = [
        ("frames", [_frames_text(summary)]),
        ("views", [_views_text(summary)]),
        ("camera" if len(summary.cameras) == 1 else "cameras", list(map(_camera_text, summary.cameras))),
        ("varies", list(_variation_lines(summary)) or ["nothing"]),
    ]
    if summary.twins:
        sections.append(
            ("twins", [f"{key}: {_values_text(values)}" for key, values in summary.twins.items()])
        )
    sections.append(("estimate", _cost_lines(cost)))
    lines = [f"{summary.name}, seed {summary.seed}"]
    for head, texts in sections:
        lines += [f"{head if not number else '':<{_INDENT}}{text}" for number, text in enumerate(texts)]
    return lines


def _frames_text(summary: PlanSummary) -> str:
    frames = summary.frames
    factors = {"sets": frames.sets, "rotations": frames.rotations, "views": frames.views}
    factors |= {name: n for name, n in {"twins": frames.twins, "cameras": frames.cameras}.items() if n > 1}
    product = " x ".join(
        f"{number:,} {name if number != 1 else name[:-1]}" for name, number in factors.items()
    )
    if frames.selected == frames.total:
        selection = "all are selected"
    else:
        more = ", ..." if frames.selected > len(frames.first) else ""
        selection = f"{frames.selected:,} selected: {', '.join(map(str, frames.first))}{more}"
    scenes = f"{frames.scenes:,} scene{'' if frames.scenes == 1 else 's'}"
    return f"{frames.total:,} = {product}; {selection}, of {scenes}"


def _views_text(summary: PlanSummary) -> str:
    table = dict(summary.views)
    kind = table.pop("kind")
    varied = {item.key.split(".")[1] for item in summary.varied if item.key.startswith("views.")}
    parts = []
    for key, value in table.items():
        unit = next((end for end in _UNITS if key.endswith(end)), "")
        name = key.removesuffix(unit).replace("_", " ")
        name = f"{len(value)} points from" if key == "points_mm" else name
        text = _view_value(value, key in _RANGES.get(kind, ())) + _UNITS.get(unit, "")
        parts.append(f"{name} varies" if key in varied else f"{name} {text}")
    return f"{kind}: {', '.join(parts)}"


def _view_value(value: Any, is_range: bool) -> str:
    if is_range:
        low, high = value
        return f"{low:g} to {high:g}" if low != high else f"{low:g}"
    if isinstance(value, list) and value and isinstance(value[0], list):
        # Points of a path, or the limits of three axes.
        if len(value[0]) == 2:
            return " x ".join(f"{low:g} to {high:g}" for low, high in value)
        ends = [f"({', '.join(f'{number:g}' for number in point)})" for point in (value[0], value[-1])]
        return f"{ends[0]} to {ends[1]}"
    return _values_text(value if isinstance(value, list) else [value])


def _values_text(values: Sequence[Any]) -> str:
    shown = [_plain(value) for value in values[:_MOST_VALUES]]
    more = f", ... ({len(values)} values)" if len(values) > _MOST_VALUES else ""
    return ", ".join(shown) + more


def _plain(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _camera_text(camera: CameraSummary) -> str:
    if camera.auto_exposure is None:
        exposure = f"exposure {camera.exposure_us:g} µs"
    else:
        control = camera.auto_exposure
        shortest, longest = control["exposure_us"]
        aim = f"to a mean grey of {control['target_grey']:g}, "
        exposure = (
            f"automatic exposure {'' if control['metering'] == 'highlights' else aim}"
            f"{shortest:g} to {longest:g} µs, gain up to {control['most_gain']:g}, "
            f"metering {control['metering']}{', locked' if control['lock'] else ''}"
        )
    varied = "; typical values of those that vary" if camera.varied else ""
    return (
        f"{camera.name}: {camera.sensor}, {camera.width} x {camera.height} pixels, "
        f"{camera.hfov_deg:.1f}° wide, {exposure}{varied}"
    )


def _variation_lines(summary: PlanSummary) -> Iterator[str]:
    key_width = max((len(item.key) for item in summary.varied), default=0)
    per_width = max((len(item.per) for item in summary.varied), default=0)
    for item in summary.varied:
        shared = "" if item.draw is None else f"; shared draw {item.draw!r}"
        reverse = ", reversed" if item.reversed else ""
        yield f"{item.key:<{key_width}}  per {item.per:<{per_width}}  {item.values}{shared}{reverse}"


def _cost_lines(cost: CostEstimate | None) -> list[str]:
    if cost is None:
        return ["none without a probe frame"]
    processes = "1 process" if cost.processes == 1 else f"{cost.processes} workers"
    each = "" if cost.processes == 1 else f", {format_size(cost.memory_bytes)} each"
    return [
        f"from frame {cost.index} ({cost.quality}; {', '.join(cost.outputs)}), on this machine",
        f"time    {format_duration(cost.total_s)} with {processes}: {cost.scenes:,} x "
        f"{format_duration(cost.setup_s)} to set up a scene, {cost.frames:,} x "
        f"{format_duration(cost.frame_s)} a frame",
        f"memory  {format_size(cost.processes * cost.memory_bytes)}{each}",
        f"disk    {format_bytes(cost.disk_bytes)}, {format_bytes(cost.frame_bytes)} a frame",
    ]


def format_bytes(size: float) -> str:
    """Bytes with two or three digits."""
    for unit in ("B", "kB", "MB", "GB"):
        if size < 999.5:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:.3g} TB"
