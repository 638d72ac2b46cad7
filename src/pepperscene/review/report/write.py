"""Writing the report: one HTML file that contains its style, script and images, and a contact sheet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from pepperscene.atomic import atomic_write
from pepperscene.camera.sensor.indices import INDICES
from pepperscene.classes import CLASS_COLOURS, IGNORE_COLOUR, OrganClass
from pepperscene.dataset.readers import RenderedSet, open_images
from pepperscene.dataset.readers.image_set import FIELDS, ImageSet, LabelledImage
from pepperscene.dataset.store.dataset import open_dataset
from pepperscene.dataset.store.fields import has_ignored_pixels, read_info
from pepperscene.dataset.store.frame_json import DIGITS
from pepperscene.dataset.store.recorded_values import crop_name, cultivar_names
from pepperscene.errors import InputError, OutputError
from pepperscene.recipe.plan import Plan
from pepperscene.review.report import sections
from pepperscene.review.report.colours import distance_colours
from pepperscene.review.report.data import (
    Moments,
    OnProgress,
    SetSummary,
    displayed_positions,
    distance_range,
    evenly_spaced,
    frame_records,
    image_statistics,
)
from pepperscene.review.report.image_view import (
    TABLE_COLUMNS,
    TITLES,
    ImageView,
    Relative,
    card_id,
    image_view,
    make_card,
    max_image_length,
)
from pepperscene.review.report.page import page_script, page_style, render
from pepperscene.review.report.scene_view import SceneView, scene_view
from pepperscene.review.report.sections import VARIATION_HEADS, variation_tables

if TYPE_CHECKING:
    from PIL import Image, ImageDraw

PAGE, SHEET = "index.html", "contact_sheet.png"

_SWITCHES: Final = (
    ("class-masks", "Class masks", "c"),
    ("instance-masks", "Instance masks", "i"),
    ("boxes", "Boxes", "b"),
    ("keypoints", "Keypoints", "k"),
)
"""Id, label and key of each switch that draws labels over photographs."""

DEFAULT_LIMIT: Final = 12
"""Chosen: three or four rows of cards on a wide screen."""
DEFAULT_SAMPLE: Final = 1000
"""Chosen: the standard error of a mean over 1,000 frames is 3 % of their deviation; 15 s of CPU time."""


@dataclass(frozen=True)
class ReportFiles:
    """Files of a report, and numbers of frames.

    Attributes:
        page: the web page.
        sheet: the contact sheet.
        shown: frames that the page shows.
        measured: frames whose images were measured.
        frames: of the data set.
        missing_scene: why the page has no 3D view although one was asked for; empty otherwise.
    """

    page: Path
    sheet: Path
    shown: int
    measured: int
    frames: int
    missing_scene: str = ""


def write_report(
    folder: str | Path,
    limit: int = DEFAULT_LIMIT,
    beside: str | Path | ImageSet | None = None,
    *,
    sample: int = DEFAULT_SAMPLE,
    scene: bool = False,
    on_progress: OnProgress | None = None,
) -> ReportFiles:
    """Write `contact_sheet.png` and `index.html` into a data set's folder, from the frames that exist.

    The page contains its images: it can be moved, mailed and opened without a network. It shows frames, and
    the statistics by which Barth et al. 2018 compare image sets (Figs. 10 to 13), of one or two data sets.

    Args:
        folder: of the data set.
        limit: maximum number of frames shown of each set, evenly spaced.
        beside: a second set to compare with: an image set, or the folder of one: another data set, the
            published one, or any folder of images with masks (see `open_images`).
        sample: maximum number of frames measured of each set, evenly spaced.
        scene: whether the page has a 3D view of the first shown frame's scene with its cameras. The plants
            are grown for it, which takes seconds. If that is not possible, the page says why.
        on_progress: called after each measured image with their number and that of all images to measure.

    Raises:
        InputError: there is no data set, it holds no frames, or a file is damaged.
        OutputError: the files cannot be written.
    """
    dataset = open_dataset(folder)
    info = read_info(dataset)
    first_set = RenderedSet.from_dataset(dataset)
    image_sets: list[ImageSet] = [first_set]
    if beside is not None:
        image_sets.append(beside if isinstance(beside, ImageSet) else open_images(beside))

    # One range of distances for all images, so that their colours can be compared.
    positions = [displayed_positions(images, limit) for images in image_sets]
    ranges = [distance_range(*pair) for pair in zip(image_sets, positions, strict=True)]
    known = [pair for pair in ranges if pair is not None]
    near = min((pair[0] for pair in known), default=0.0)
    far = max((pair[1] for pair in known), default=1.0)

    sets, sheet_rows = [], []
    max_length = max_image_length(sum(map(len, positions)))
    for key, images, displayed in zip("ab", image_sets, positions, strict=False):
        summary, rows = _summarize(key, images, displayed, sample, (near, far), max_length, on_progress)
        sets.append(summary)
        sheet_rows.append(rows)
    view = scene_view(dataset, [first_set.items[position] for position in positions[0]]) if scene else None
    text = _page_html(info, sets, (near, far) if known else None, view)
    page, sheet = dataset.folder / PAGE, dataset.folder / SHEET
    try:
        with atomic_write(sheet) as temporary:
            contact_sheet(sheet_rows[0], near, far).save(temporary, format="PNG")
        with atomic_write(page) as temporary:
            # Names of folders that are not UTF-8 are shown as escape sequences.
            temporary.write_text(text, encoding="utf-8", errors="backslashreplace")
    except OSError as error:
        raise OutputError(f"{folder}: the report cannot be written ({error.strerror or error})") from None
    first = sets[0]
    missing = "" if view is None else view.missing
    return ReportFiles(page, sheet, len(first.cards), first.statistics.image_count, first.frames, missing)


def _summarize(
    key: str,
    images: ImageSet,
    positions: list[int],
    sample: int,
    distances_m: tuple[float, float],
    max_length: int,
    on_progress: OnProgress | None,
) -> tuple[SetSummary, list[SheetRow]]:
    """Summary of a set, and rows of the contact sheet; one image is in memory at a time."""
    sheet_positions = {positions[number] for number in evenly_spaced(len(positions), MAX_ROWS)}
    cards, sheet_rows = [], []
    moments = Moments.of_images(images)
    names = images.names()
    displayed = {names[position] for position in positions}
    for position in positions:
        view = image_view(_visible_image(images, position), *distances_m, max_length)
        relatives = [] if moments is None else moments.relatives(position)
        named = [(f"{index:0{DIGITS}d}", difference) for index, difference in relatives]
        links = [
            Relative(name, difference, card_id(name, key) if name in displayed else None)
            for name, difference in named
        ]
        cards.append(make_card(view, key, links))
        if key == "a" and position in sheet_positions:
            sheet_rows.append(sheet_row(view))
    records = frame_records(images.dataset) if isinstance(images, RenderedSet) else None
    statistics = image_statistics(images, sample, on_progress)
    return SetSummary(key, images.name, len(images), statistics, records, tuple(cards)), sheet_rows


def _visible_image(images: ImageSet, position: int) -> LabelledImage:
    """An image of a set; raises `InputError` if it has nothing that a report shows."""
    image = images[position]
    if all(getattr(image, field) is None for field in FIELDS if field != "metadata"):
        problem = f"{image.name} has no photograph, classes, instances or distances to show"
        raise InputError(images.name, problem)
    return image


def _page_html(
    info: Mapping[str, Any],
    sets: Sequence[SetSummary],
    distances_m: tuple[float, float] | None,
    scene: SceneView | None,
) -> str:
    """The page as HTML; `distances_m` are those of the brightest and the darkest colour."""
    recipe, cultivars = info["recipe"], cultivar_names(info)
    has_scene = scene is not None and scene.library
    script = page_script(["overlays.js", "page.js", *(["scene.js"] if has_scene else [])])
    return render(
        "page.html",
        # The page's security policy allows exactly this style and these scripts.
        style=page_style(),
        scripts=[scene.library, script] if scene is not None and has_scene else [script],
        name=str(recipe["name"]),
        crop=crop_name(info),
        cultivar=f"cultivar{'s' if len(cultivars) > 1 else ''} {', '.join(cultivars)}",
        planned=Plan.model_validate(recipe["plan"]).count,
        facts=sections.recipe_facts(info),
        spectra=info.get("measured_spectra", ()),
        sets=sets,
        has_labels=any(card.labels is not None for item in sets for card in item.cards),
        switches=_SWITCHES,
        ignored=has_ignored_pixels(info),
        ignore_colour=IGNORE_COLOUR,
        distances_m=distances_m,
        card_heads=TABLE_COLUMNS,
        scene=scene,
        fractions=sections.class_fractions(sets),
        measured=[(item, _measured_images(item)) for item in sets],
        maps=sections.class_maps(sets),
        hues=sections.hue_spectra(sets),
        intensity=sections.intensity(sets),
        variation=variation_tables(sets),
        variation_heads=VARIATION_HEADS,
        build=sections.build_figures(sets),
    )


def _measured_images(item: SetSummary) -> str:
    count = item.statistics.image_count
    return f"all {count:,}" if count == item.frames else f"{count:,} evenly spaced of {item.frames:,}"


MAX_ROWS: Final = 24
"""Chosen: image viewers do not open much taller sheets."""

# Layout of the contact sheet in pixels; chosen so that four panels fill a wide screen.
_PANEL_WIDTH: Final = 440
_GAP: Final = 10
_MARGIN: Final = 28
_CAPTION_HEIGHT: Final = 34
_HEADER_HEIGHT: Final = 44
_FOOTER_HEIGHT: Final = 70
_PAPER: Final = (22, 24, 29)
_INK: Final = (236, 238, 242)
_FAINT: Final = (150, 156, 168)


@dataclass(frozen=True, eq=False)
class SheetRow:
    """Panels of an image in the size of the contact sheet, and the caption below them."""

    panels: dict[str, Image.Image]
    caption: str


def sheet_row(view: ImageView) -> SheetRow:
    """The row of an image in the contact sheet."""
    from PIL import Image

    panels = {}
    for key, panel in view.panels.items():
        # Labels must not be blended: a mixed colour would be another class.
        resampling = Image.Resampling.LANCZOS if key in ("colour", *INDICES) else Image.Resampling.NEAREST
        size = (_PANEL_WIDTH, round(_PANEL_WIDTH * panel.shape[0] / panel.shape[1]))
        panels[key] = Image.fromarray(np.ascontiguousarray(panel)).resize(size, resampling)
    return SheetRow(panels, " · ".join(part for part in (view.title, view.location) if part))


def contact_sheet(rows: Sequence[SheetRow], near_m: float, far_m: float) -> Image.Image:
    """All rows below each other, with legends for class and distance in the footer."""
    from PIL import Image, ImageDraw

    columns = [key for key in TITLES if any(key in row.panels for row in rows)]
    heights = [max((panel.height for panel in row.panels.values()), default=0) for row in rows]
    width = 2 * _MARGIN + max(2, len(columns)) * (_PANEL_WIDTH + _GAP) - _GAP
    height = _HEADER_HEIGHT + sum(heights) + len(rows) * _CAPTION_HEIGHT + _FOOTER_HEIGHT
    sheet = Image.new("RGB", (width, height), _PAPER)
    draw = ImageDraw.Draw(sheet)
    lefts = {key: _MARGIN + number * (_PANEL_WIDTH + _GAP) for number, key in enumerate(columns)}
    for key, left in lefts.items():
        draw.text((left, _HEADER_HEIGHT - 30), TITLES[key], fill=_INK, font=_font(19))
    top = _HEADER_HEIGHT
    for row, row_height in zip(rows, heights, strict=True):
        for key, panel in row.panels.items():
            sheet.paste(panel, (lefts[key], top))
        draw.text((_MARGIN, top + row_height + 6), row.caption, fill=_FAINT, font=_font(15))
        top += row_height + _CAPTION_HEIGHT
    _draw_legends(sheet, draw, columns, near_m, far_m)
    return sheet


def _draw_legends(
    sheet: Image.Image, draw: ImageDraw.ImageDraw, columns: Sequence[str], near_m: float, far_m: float
) -> None:
    from PIL import Image

    top, left, font = sheet.height - _FOOTER_HEIGHT + 14, float(_MARGIN), _font(16)
    if "class" in columns:
        for organ_class, colour in zip(OrganClass, CLASS_COLOURS, strict=True):
            draw.rounded_rectangle((left, top + 4, left + 18, top + 22), 4, fill=colour, outline=_FAINT)
            name = organ_class.name.lower()
            draw.text((left + 25, top + 2), name, fill=_INK, font=font)
            left += 25 + draw.textlength(name, font=font) + 22
    if "distance" in columns:
        ramp = np.linspace(near_m, far_m, 200)[None].repeat(18, axis=0)
        right = sheet.width - _MARGIN - 200 - 60
        sheet.paste(Image.fromarray(distance_colours(ramp, near_m, far_m)), (right, top + 4))
        draw.text((right - 8, top + 2), f"{near_m:.2f} m", fill=_INK, font=font, anchor="ra")
        draw.text((right + 208, top + 2), f"{far_m:.2f} m", fill=_INK, font=font)


def _font(size: int) -> Any:
    """Pillow's default font, so that the sheet is the same on every machine."""
    from PIL import ImageFont

    return ImageFont.load_default(size)
