"""Sizes of images, and the central square and scale at which they are compared, as text."""

from __future__ import annotations

from pepperscene.colour.comparison.measure import SetMeasures


def describe_scale(side: SetMeasures) -> tuple[str, str, str]:
    """Sizes of a set's images, their central square, and the scale of their textures."""
    if not side.has_images:
        return ("patches", "of the patches", "not compared")
    if not side.centres:
        return ("no images", "not compared", "not compared")
    sizes = sorted(side.centres, key=lambda size: (size[0] * size[1], size))
    return (
        _span([f"{width} x {height}" for height, width in sizes]),
        _describe_centre(side),
        _describe_texture(side),
    )


def _describe_centre(side: SetMeasures) -> str:
    """Side of the central square in pixels, and how much of the images or of the plants it shows."""
    sides = sorted(side.centres.values())
    pixels = _span([f"{length} x {length}" for length in (sides[0], sides[-1])])
    scale = side.scale
    if scale.centre_px is None or scale.pixel_mm is None or scale.factor is None:
        return f"centre, {pixels} ({_area_percent(side)} of the image)"
    length_mm = scale.centre_px * scale.pixel_mm * scale.factor
    return f"centre, {pixels} ({length_mm:.0f} x {length_mm:.0f} mm, {_area_percent(side)} of the image)"


def _area_percent(side: SetMeasures) -> str:
    """Fraction of the images in the central square."""
    fractions = sorted(
        100.0 * centre**2 / (height * width) for (height, width), centre in side.centres.items()
    )
    return f"{_span([f'{fraction:.0f}' for fraction in (fractions[0], fractions[-1])])} %"


def _describe_texture(side: SetMeasures) -> str:
    """Scale at which saturation and texture of whole images are measured."""
    scale = side.scale
    if scale.factor is not None:
        reduced = "as it is" if scale.factor == 1.0 else f"reduced to {100.0 * scale.factor:.0f} %"
        return f"whole image, {reduced}, {scale.pixel_mm:g} mm per pixel"
    if all(scale.width(width) is None for _, width in side.centres):
        return "whole image, as it is"
    return f"whole image, {scale.width_px} wide"


def _span(texts: list[str]) -> str:
    """The first and the last of some texts, once if they are the same."""
    return texts[0] if texts[0] == texts[-1] else f"{texts[0]} to {texts[-1]}"
