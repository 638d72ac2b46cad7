"""A data set to look at: a contact sheet and a web page that needs no network."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from pepperscene.dataset.readers import RenderedSet, open_images
from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.dataset.report.contact_sheet import MOST_ROWS, SheetRow, contact_sheet, row, view
from pepperscene.dataset.report.data import (
    Side,
    Told,
    distance_range,
    evenly_spaced,
    frame_records,
    image_statistics,
)
from pepperscene.dataset.report.page import page
from pepperscene.dataset.report.sections import card, line
from pepperscene.dataset.store.atomic import atomic_write
from pepperscene.dataset.store.dataset import open_dataset
from pepperscene.errors import InputError, OutputError

PAGE, SHEET = "index.html", "contact_sheet.png"

SHOWN: Final = 12
"""Chosen: three or four rows of cards on a wide screen."""
SAMPLE: Final = 1000
"""Chosen: a mean over 1,000 frames is known to 3 % of the spread between them; 15 s of processor time."""


@dataclass(frozen=True)
class ReportFiles:
    """Where a report lies, and of how many frames it shows how many.

    Attributes:
        page: the web page.
        sheet: the contact sheet.
        shown: frames of which there are pictures in the page.
        measured: frames whose images were measured.
        frames: frames of the data set.
    """

    page: Path
    sheet: Path
    shown: int
    measured: int
    frames: int


def write_report(
    folder: str | Path,
    limit: int = SHOWN,
    beside: str | Path | ImageSet | None = None,
    *,
    sample: int = SAMPLE,
    on_progress: Told | None = None,
) -> ReportFiles:
    """Write `contact_sheet.png` and `index.html` into a data set's folder, from the frames that are there.

    The page holds its pictures itself: it can be moved, mailed and opened without a network. It shows frames,
    and the measures by which Barth et al. 2018 compare image sets (Figs. 10 to 13), of the data set and of a
    second one.

    Args:
        folder: of the data set.
        limit: most frames shown of each set; they are spread over those that are there.
        beside: the second set: an image set, or the folder of one: another data set, the published one, or
            any folder of images with masks (see `open_images`).
        sample: most frames of each set whose images are measured, spread likewise.
        on_progress: called after each picture measured with how many are, out of how many.

    Raises:
        InputError: there is no data set, or no frame in it, or a file is damaged.
        OutputError: the files cannot be written.
    """
    dataset = open_dataset(folder)
    if not dataset.indices():
        raise InputError(folder, "holds no frames yet; build some first")
    sets: list[ImageSet] = [RenderedSet.of(dataset)]
    if beside is not None:
        sets.append(beside if isinstance(beside, ImageSet) else open_images(beside))
    # One range of distances for all pictures of both sets, so that they can be compared.
    places = [evenly_spaced(len(images), limit) for images in sets]
    ranges = [distance_range(images, some) for images, some in zip(sets, places, strict=True)]
    known = [found for found in ranges if found is not None]
    near = min((one[0] for one in known), default=0.0)
    far = max((one[1] for one in known), default=1.0)

    sides, rows = [], []
    for key, images, some in zip("ab", sets, places, strict=False):
        side, sheet_rows = _side(key, images, some, sample, near, far, on_progress)
        sides.append(side)
        rows.append(sheet_rows)
    target = ReportFiles(
        dataset.folder / PAGE,
        dataset.folder / SHEET,
        len(sides[0].cards),
        sides[0].statistics.pictures,
        sides[0].frames,
    )
    text = page(dataset.info, sides, *((near, far) if known else (None, None)))
    try:
        with atomic_write(target.sheet) as temporary:
            contact_sheet(rows[0], near, far).save(temporary, format="PNG")
        with atomic_write(target.page) as temporary:
            temporary.write_text(text, encoding="utf-8")
    except OSError as fault:
        raise OutputError(f"{folder}: the report cannot be written ({fault.strerror or fault})") from None
    return target


def _side(
    key: str, images: ImageSet, places: list[int], sample: int, near: float, far: float, told: Told | None
) -> tuple[Side, list[SheetRow]]:
    """A set's measures and pictures; the pictures go through memory one by one."""
    on_sheet = {places[place] for place in evenly_spaced(len(places), MOST_ROWS)}
    cards, lines, rows = [], [], []
    for place in places:
        shown = view(images[place], near, far)
        cards.append(card(shown, key))
        lines.append(line(shown, key))
        if key == "a" and place in on_sheet:
            rows.append(row(shown))
    known = frame_records(images.dataset) if isinstance(images, RenderedSet) else None
    statistics = image_statistics(images, sample, told)
    return Side(key, images.name, len(images), statistics, known, tuple(cards), tuple(lines)), rows
