"""A comparison as text tables."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from pepperscene.colour.comparison.appearance import WHOLE, AppearanceMeasures
from pepperscene.colour.comparison.bootstrap import Estimate
from pepperscene.colour.comparison.measure import SetMeasures
from pepperscene.colour.comparison.result import Comparison, KindMeasures

UNKNOWN: Final = "-"
_MASKS: Final = (
    "To compare them, put a mask beside each image, such as img1.png and mask1.png, and a classes.toml that "
    "names its values; a rendered set needs the output class"
)


@dataclass(frozen=True)
class TextTable:
    """A table of text cells."""

    title: str  # one line
    heads: tuple[str, ...]  # column headings
    rows: tuple[tuple[str, ...], ...]  # one cell for each heading
    notes: tuple[str, ...] = ()  # lines below the table


def comparison_tables(comparison: Comparison) -> tuple[TextTable, ...]:
    """The comparison in tables, of what was measured in both sets.

    The first one lists the sets, the central square and the scale at which they are compared, and says what
    is missing. Hues, CIELAB, class fractions and places, light, saturation and texture follow, as far as both
    sets have data; with patches on one side, hues and CIELAB only.
    """
    tables = [_set_table(comparison)]
    if comparison.coloured_kinds:
        tables += [_hue_table(comparison), _lab_table(comparison)]
    if comparison.labelled_classes:
        tables.append(_class_table(comparison))
    if comparison.light.first.value is not None and comparison.light.second.value is not None:
        tables += [_light_table(comparison), _saturation_table(comparison)]
        tables += _texture_tables(comparison)
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


def _set_table(comparison: Comparison) -> TextTable:
    """What is compared: images, the central square, and the scale of textures."""
    rows = [
        (letter, side.name, f"{side.units:,} of {side.available:,}", *describe_scale(side))
        for letter, side in zip("AB", comparison.sides, strict=True)
    ]
    headers = ("set", "name", "measured", "size, pixels", "hues and CIELAB", "saturation and texture")
    notes = tuple(f"{sentence}." for sentence in missing_parts(*comparison.sides))
    return TextTable("Sets", headers, tuple(rows), notes)


def _hue_table(comparison: Comparison) -> TextTable:
    rows = [
        (
            kind.kind,
            format_estimate(kind.hue_correlation),
            format_estimate(kind.hue_emd_deg, 1),
            *(_format_hue(side.hue_mean_deg, side.hue_spread_deg) for side in (kind.first, kind.second)),
            f"{kind.first.pictures:,}",
            f"{kind.second.pictures:,}",
        )
        for kind in comparison.coloured_kinds
    ]
    headers = ("kind", "correlation", "EMD, deg", "A, mean ± sd", "B, mean ± sd", "images A", "images B")
    mean = comparison.hue_correlation
    notes = [] if mean.value is None else [f"mean correlation over plant parts: {format_estimate(mean)}"]
    if _both_labelled(comparison):
        notes += _reasons((kind.kind, kind.hue_correlation.why) for kind in comparison.kinds.values())
    return TextTable("Hues (Fig. 12)", headers, tuple(rows), tuple(notes))


def _both_labelled(comparison: Comparison) -> bool:
    """Whether both sets have classes; otherwise the first table says so."""
    sides = comparison.sides
    return all(side.statistics.labelled_count or not side.has_images for side in sides)


def _format_hue(mean: Estimate, spread: Estimate) -> str:
    known = mean.value is not None and spread.value is not None
    return f"{mean.value:.0f} ± {spread.value:.0f}" if known else UNKNOWN


def _lab_table(comparison: Comparison) -> TextTable:
    rows = [
        (kind.kind, format_estimate(kind.delta_e_2000, 1), _format_lab(kind.first), _format_lab(kind.second))
        for kind in comparison.coloured_kinds
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
    rows = [
        (
            kind.kind,
            *(format_estimate(side.share, 2, 100.0) for side in (kind.first, kind.second)),
            format_estimate(kind.place_correlation),
            format_estimate(kind.place_ssim),
        )
        for kind in comparison.labelled_classes
    ]
    correlation = comparison.share_correlation
    value = format_estimate(correlation, 3) if correlation.value is not None else correlation.why
    return TextTable(
        "Class fractions in % of whole images (Fig. 10), and mean masks (Fig. 11)",
        ("kind", "A, %", "B, %", "mask correlation", "mask SSIM"),
        tuple(rows),
        (
            f"correlation of the class fractions: {value}",
            *_reasons((kind.kind, kind.place_correlation.why) for kind in comparison.classes),
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
    return TextTable("Light of whole images (Fig. 13)", ("measure", "value"), rows)


def _saturation_table(comparison: Comparison) -> TextTable:
    rows = [
        (
            kind,
            letter,
            *(format_estimate(percentile) for percentile in side.saturation),
            _format_hue(side.hue_median_deg, side.hue_spread_deg),
            *(format_estimate(share, 1, 100.0) for share in (side.blue_dark_share, side.clipped_share)),
        )
        for kind, letter, side in _appearance_sides(comparison)
    ]
    return TextTable(
        "Saturation S = C*/(L*+16), and hue weighted by chroma",
        ("kind", "set", "S 10 %", "S 50 %", "S 90 %", "hue, deg", "blue < .002, %", "clipped, %"),
        tuple(rows),
    )


def _texture_tables(comparison: Comparison) -> list[TextTable]:
    """Texture of whole images and of the classes that show it in both sets, if there are any."""
    textured = {
        kind: pair
        for kind, pair in comparison.appearance.items()
        if all(any(one.value is not None for one in _textures(side)) for side in (pair.first, pair.second))
    }
    rows, reasons = [], []
    for kind, letter, side in _appearance_sides(comparison):
        if kind in textured:
            organ, patch, gradients, coherence, gloss = _textures(side)
            rows.append(
                (
                    kind,
                    letter,
                    *(format_estimate(lightness, 1) for lightness in (organ, patch)),
                    *(format_estimate(ratio) for ratio in (gradients, coherence)),
                    format_estimate(gloss, 1, 100.0),
                )
            )
            reasons += [(f"{kind} {letter}", estimate.why) for estimate in _textures(side)]
        else:
            reasons += [(kind, estimate.why) for estimate in _textures(side)]
    if not rows:
        return []
    slopes = [
        f"{letter} {format_estimate(side.spectrum_slope)} (sd {format_estimate(side.spectrum_slope_spread)})"
        for kind, letter, side in _appearance_sides(comparison)
        if kind == WHOLE and side.spectrum_slope.value is not None
    ]
    notes = [f"slope of the power spectrum, and sd between images: {', '.join(slopes)}"] if slopes else []
    table = TextTable(
        "Texture: lightness in organs and in patches, gradients, gloss",
        ("kind", "set", "organ sd L*", "patch sd L*", "gradients", "coherence", "gloss, %"),
        tuple(rows),
        (*notes, *_reasons(reasons)),
    )
    return [table]


def _appearance_sides(comparison: Comparison) -> Iterator[tuple[str, str, AppearanceMeasures]]:
    """Kind, letter of the set and appearance, for the kinds that both sets show."""
    for kind, pair in comparison.appearance.items():
        if pair.first.pictures and pair.second.pictures:
            yield kind, "A", pair.first
            yield kind, "B", pair.second


def _textures(side: AppearanceMeasures) -> tuple[Estimate, ...]:
    """The measures of texture, gloss last."""
    lightness = (side.organ_lightness_sd, side.patch_lightness_sd)
    return (*lightness, side.gradient_ratio, side.coherence, side.gloss_share)


def _reasons(missing: Iterable[tuple[str, str]]) -> list[str]:
    """One line with the reasons for missing values, each after what it applies to; nothing without any."""
    names_of: dict[str, list[str]] = {}
    for name, reason in missing:
        if reason:
            names_of.setdefault(reason, []).append(name)
    lines = [f"{', '.join(dict.fromkeys(names))} ({reason})" for reason, names in names_of.items()]
    return [f"not measured: {'; '.join(lines)}"] if lines else []


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
    elif narrow := [
        side for side in sides if all(side.scale.width(width) is None for _, width in side.centres)
    ]:
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
