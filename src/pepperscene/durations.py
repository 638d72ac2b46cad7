"""Durations and rates in words."""

from __future__ import annotations

from itertools import pairwise


def format_duration(seconds: float) -> str:
    """Days, hours, minutes and seconds, at most two units."""
    if seconds < 10:
        return f"{seconds:.2g} s"
    total = round(seconds)
    units = ((86_400, "d"), (3600, "h"), (60, "min"), (1, "s"))
    for (large, name), (small, next_name) in pairwise(units):
        if total >= large:
            rest = total % large // small
            return f"{total // large} {name} {rest} {next_name}"
    return f"{total} s"


def format_rate(frames_per_s: float) -> str:
    """Frames per second, or seconds per frame."""
    return f"{frames_per_s:.1f} frames/s" if frames_per_s >= 1 else f"{1 / frames_per_s:.1f} s a frame"
