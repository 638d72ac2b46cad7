"""Writing the report: one HTML file that contains its style, script and images, and a contact sheet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any, Final

from pepperscene.atomic import atomic_write
from pepperscene.dataset.readers import RenderedSet, open_images
from pepperscene.dataset.readers.image_set import FIELDS, ImageSet, LabelledImage
from pepperscene.dataset.store.crop import crop_name, cultivar_names
from pepperscene.dataset.store.dataset import open_dataset
from pepperscene.dataset.store.fields import has_ignored_pixels, read_info
from pepperscene.dataset.store.frame_json import DIGITS
from pepperscene.errors import InputError, OutputError
from pepperscene.recipe.plan import Plan
from pepperscene.review.report import sections
from pepperscene.review.report.build_section import build_html
from pepperscene.review.report.colours import VIRIDIS
from pepperscene.review.report.contact_sheet import MAX_ROWS, SheetRow, contact_sheet, sheet_row
from pepperscene.review.report.data import (
    OnProgress,
    SetSummary,
    distance_range,
    evenly_spaced,
    frame_records,
    image_statistics,
)
from pepperscene.review.report.facts import facts_html
from pepperscene.review.report.image_view import (
    TABLE_COLUMNS,
    Relative,
    card_html,
    image_view,
    max_image_length,
    table_row,
)
from pepperscene.review.report.markup import Html, as_html, csp_hash, element, fragment, joined
from pepperscene.review.report.moments import Moments, displayed_positions
from pepperscene.review.report.scene_view import NO_SCENE, SceneView, scene_view
from pepperscene.review.report.switches import switches_html
from pepperscene.review.report.variation import variation_html, variation_link

PAGE, SHEET = "index.html", "contact_sheet.png"

_OVERLAY_NOTE: Final = (
    " The switches below draw labels over the photographs; each has a key. Of the keypoints of fruit, a "
    "square is the cut point, a triangle the end at the stalk, and a disc the blossom end; hidden ones are "
    "hollow."
)

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
    view = (
        scene_view(dataset, [first_set.items[position] for position in positions[0]]) if scene else NO_SCENE
    )
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
    return ReportFiles(
        page, sheet, len(first.cards), first.statistics.image_count, first.frames, view.missing
    )


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
    cards, table_rows, sheet_rows, has_labels = [], [], [], False
    moments = Moments.of_images(images)
    names = images.names()
    displayed = {names[position] for position in positions}
    for position in positions:
        view = image_view(_visible_image(images, position), *distances_m, max_length)
        relatives = [] if moments is None else moments.relatives(position)
        named = [(f"{index:0{DIGITS}d}", difference) for index, difference in relatives]
        links = [Relative(name, difference, name in displayed) for name, difference in named]
        cards.append(card_html(view, key, links))
        table_rows.append(table_row(view, key))
        has_labels = has_labels or view.labels is not None
        if key == "a" and position in sheet_positions:
            sheet_rows.append(sheet_row(view))
    records = frame_records(images.dataset) if isinstance(images, RenderedSet) else None
    statistics = image_statistics(images, sample, on_progress)
    summary = SetSummary(
        key, images.name, len(images), statistics, records, tuple(cards), tuple(table_rows), has_labels
    )
    return summary, sheet_rows


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
    scene: SceneView,
) -> str:
    """The page as HTML; `distances_m` are those of the brightest and the darkest colour."""
    recipe, cultivars = info["recipe"], cultivar_names(info)
    total = Plan.model_validate(recipe["plan"]).count
    summary: list[str] = [f"{sets[0].frames:,} of {total:,} planned frames exist."]
    summary += [
        fragment("Compared with ", sections.set_label(item), f", {sections.plural(item.frames, 'image')}.")
        for item in sets[1:]
    ]
    measured_sets = []
    for item in sets:
        count = item.statistics.image_count
        number = f"all {count:,}" if count == item.frames else f"{count:,} evenly spaced of {item.frames:,}"
        measured_sets.append(fragment(f"{number} images of ", sections.set_label(item)))
    ramp = fragment()
    if distances_m is not None:
        near, far = (element("span", f"{distance:.2f} m") for distance in distances_m)
        ramp = element("p", near, element("i", class_="back"), far, class_="ramp")
    variation = variation_html(sets)
    has_labels, ignored = any(item.has_labels for item in sets), has_ignored_pixels(info)
    # The policy allows exactly this style and these scripts.
    style = Template(_read_resource("page.css")).substitute(ramp=", ".join(VIRIDIS))
    files = ["overlays.js", "page.js", *(["scene.js"] if scene.library else [])]
    script = Html("\n".join(map(_read_resource, files)))
    scripts = [scene.library, script] if scene.library else [script]
    contents: dict[str, str] = {
        "style": Html(style),
        "style_hash": csp_hash(style),
        "scripts": joined(element("script", text) for text in scripts),
        "script_hashes": joined(map(csp_hash, scripts), " "),
        "name": str(recipe["name"]),
        "crop": crop_name(info),
        "cultivar": f"cultivar{'s' if len(cultivars) > 1 else ''} {', '.join(cultivars)}",
        "summary": joined(summary, " "),
        "facts": facts_html(info),
        "overlay_note": _OVERLAY_NOTE if has_labels else "",
        "classes": (switches_html if has_labels else sections.legend_html)(ignored=ignored),
        "scene": scene.section,
        "scene_link": element("a", "Scene", href="#scene") if scene.section else "",
        "distances": ramp,
        "frames": joined(_frames_html(item, single=len(sets) == 1) for item in sets),
        "fractions": sections.class_fractions_html(sets),
        "measured": fragment("Measured in ", joined(measured_sets, " and "), "."),
        "maps": sections.class_maps_html(sets),
        "hues": sections.hue_spectra_html(sets),
        "intensity": sections.intensity_html(sets),
        "variation": variation,
        "variation_link": variation_link(variation),
        "build": build_html(sets),
    }
    page = Template(_read_resource("page.html"))
    return page.substitute({name: as_html(content) for name, content in contents.items()})


def _read_resource(name: str) -> str:
    return resources.files("pepperscene.review.report").joinpath(name).read_text(encoding="utf-8")


def _frames_html(item: SetSummary, single: bool) -> Html:
    """The displayed images of a set as cards, and as a table."""
    count = f"{len(item.cards):,} of {item.frames:,}" if len(item.cards) < item.frames else f"{item.frames:,}"
    title = fragment() if single else element("h3", sections.set_label(item))
    table = sections.html_table("frames", TABLE_COLUMNS, item.table_rows)
    label = f"Images of {item.name}"
    return fragment(
        title,
        element("p", f"{count} shown."),
        element("div", *item.cards, class_="cards"),
        element(
            "details",
            element("summary", "As a table" if single else f"As a table: {item.name}"),
            element("div", table, class_="scroll", tabindex=0, role="region", aria_label=label),
        ),
    )
