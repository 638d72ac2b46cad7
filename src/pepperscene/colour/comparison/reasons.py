"""Reasons for values that a comparison cannot give, as clauses."""

from __future__ import annotations

from pepperscene.classes import OrganClass
from pepperscene.colour.comparison.measure import SetMeasures


def unlabelled_reason(side: SetMeasures) -> str:
    """Reason why a set has no classes."""
    return f"no labels in {side.name}" if side.has_images else f"{side.name} has patches, not images"


def absence_reason(side: SetMeasures) -> str:
    """Reason why a class has no pixel: it was not labelled, or it does not occur."""
    return f"not labelled in {side.name}" if side.statistics.unlabelled_pixels else f"not seen in {side.name}"


def missing_reason(kind: str, side: SetMeasures) -> str:
    """Reason why the colours of a kind are unknown."""
    if not side.has_images:
        return f"no patch of it in {side.name}"
    if not side.statistics.photograph_count:
        return f"no photographs in {side.name}"
    if not side.statistics.labelled_count:
        return f"no labels in {side.name}"
    if "." not in kind and side.statistics.class_pixels[OrganClass[kind.upper()]]:
        return f"not in the centre of the images of {side.name}"
    return absence_reason(side)
