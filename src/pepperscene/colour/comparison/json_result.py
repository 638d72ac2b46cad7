"""A comparison as JSON data."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import Any, Final

from pepperscene.colour.comparison.bootstrap import LEVEL, REPLICATES, Estimate
from pepperscene.colour.comparison.measure import SetMeasures
from pepperscene.colour.comparison.result import Comparison

FORMAT: Final = "pepperscene compare 1"

_KEYS: Final = {
    "first": "one",
    "second": "other",
    "first_spread": "one_spread",
    "second_spread": "other_spread",
}
"""Keys of the JSON format that differ from the names of the attributes."""


def comparison_json(comparison: Comparison) -> dict[str, Any]:
    """The comparison as JSON data; an unknown number is null, and `why` gives the reason."""
    return {
        "format": FORMAT,
        "one": _set_json(comparison.first),
        "other": _set_json(comparison.second),
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


def _set_json(side: SetMeasures) -> dict[str, Any]:
    """What was measured of a set, and where: sizes in pixels."""
    sizes = [
        {"width": width, "height": height, "centre": centre, "texture_width": side.scale.width(width)}
        for (height, width), centre in sorted(side.centres.items())
    ]
    return {"name": side.name, "measured": side.units, "of": side.available, "sizes": sizes}


def _to_json(value: Any) -> Any:
    """Estimates and the data classes that hold them as JSON data."""
    if isinstance(value, Estimate):
        numbers = {"value": value.value, "low": value.low, "high": value.high}
        return {**numbers, "why": value.why} if value.value is None else numbers
    if is_dataclass(value) and not isinstance(value, type):
        names = [field.name for field in fields(value)]
        return {_KEYS.get(name, name): _to_json(getattr(value, name)) for name in names}
    return [_to_json(item) for item in value] if isinstance(value, tuple) else value
