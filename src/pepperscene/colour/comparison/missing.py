"""What a comparison could not measure, in one sentence for each cause, with how to measure it."""

from __future__ import annotations

from typing import Final

from pepperscene.colour.comparison.measure import SetMeasures

_MASKS: Final = (
    "To compare them, put a mask beside each image, such as img1.png and mask1.png, and a classes.toml that "
    "names its values; a rendered set needs the output class"
)


def missing_parts(first: SetMeasures, second: SetMeasures) -> list[str]:
    """Sentences on what is left out of the tables and figures of two sets; empty if nothing is."""
    sides = (first, second)
    if patches := [side.name for side in sides if not side.has_images]:
        return [f"Only colours are compared, because {_holds(patches)} patches instead of images"]
    sentences = []
    if unlabelled := [side.name for side in sides if not side.statistics.labelled_count]:
        sentences.append(
            "Classes (their colours, fractions and places) are not compared, because "
            f"{_holds(unlabelled)} no masks"
        )
        sentences.append(_MASKS)
    if dark := [side.name for side in sides if not side.statistics.photograph_count]:
        sentences.append(
            "Colours, light, saturation and texture are not compared, because "
            f"{_holds(dark)} no photographs. A rendered set needs the output colour"
        )
    elif narrow := [side for side in sides if not _has_textures(side)]:
        names = " and ".join(side.name for side in narrow)
        width = min(max(width for _, width in side.centres) for side in narrow)
        sentences.append(
            f"Texture is not compared, because no image of {names} is {narrow[0].scale.width_px} pixels "
            f"wide. Choose a width of at most {width} (--width, width_px)"
        )
    return sentences


def _holds(names: list[str]) -> str:
    """Subject and verb: "a has", "a and b have"."""
    return f"{' and '.join(names)} {'has' if len(names) == 1 else 'have'}"


def _has_textures(side: SetMeasures) -> bool:
    return any(side.scale.width(width) is not None for _, width in side.centres)
