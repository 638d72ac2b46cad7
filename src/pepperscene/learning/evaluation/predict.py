"""Predictions of a model, written as class images, or objects as outlines and in the format of COCO."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from pepperscene.atomic import (
    SYSTEM_FILES,
    canonical_json,
    check_can_create,
    make_folder,
    write_error,
    write_file,
)
from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.dataset.readers.open import open_images
from pepperscene.dataset.readers.pictures import is_turned, read_photo, with_upright_exif
from pepperscene.dataset.store.images import png_bytes
from pepperscene.errors import ArgumentError, InputError, OutputError
from pepperscene.learning.class_table import ClassTable
from pepperscene.learning.evaluation.average_precision import object_record
from pepperscene.learning.evaluation.evaluate import Segmenter, predict_classes
from pepperscene.learning.models.trained_model import TrainedModel
from pepperscene.learning.options import DECIDED_SCORE
from pepperscene.version import __version__

CLASSES_NAME: Final = "classes.json"
RESULTS_NAME: Final = "detections.json"
IMAGES_NAME: Final = "images.json"
FORMAT: Final = "pepperscene prediction 1"
OUTLINES: Final = "outlines"
FOLDERS: Final = ("class", "class_colour", OUTLINES)

_SIDE_OF_LINE: Final = 400  # chosen: pixels of an image's longer side for one of a line's width
_LINES_OF_TEXT: Final = 5  # chosen: height of a text in widths of lines, with _LEAST_TEXT pixels or more
_LEAST_TEXT: Final = 9

Outline = tuple[NDArray[np.bool_], tuple[int, ...], str]
"""Mask `(h, w)`, 8-bit RGB, and the text beside it."""

Source = ImageSet | str | Path
"""A set of images, a folder of one, or a picture."""

_Reader = Callable[[], tuple[NDArray[np.uint8], bool]]


@dataclass(frozen=True)
class Predictions:
    """What `predict` wrote.

    Attributes:
        folder: of the files.
        names: of the images, in order: `class/NAME.png` and `class_colour/NAME.png` belong to each, or of a
            detector `outlines/NAME.png`.
    """

    folder: Path
    names: tuple[str, ...]


def predict(
    model: Segmenter,
    images: Source | Sequence[Source],
    out: str | Path,
    *,
    classes: ClassTable | None = None,
    half: str | None = None,
    least_score: float = DECIDED_SCORE,
    on_progress: Callable[[int, int], None] | None = None,
) -> Predictions:
    """Predict the classes of images, and write them as `class/NAME.png` and `class_colour/NAME.png`.

    The values of a class image are ids of `OrganClass` if the classes are those eight, else indices of the
    classes. `classes.json` lists the values with their names and colours; it is written last. Each file is
    complete or absent.

    A detector's objects are outlined in `outlines/NAME.png`, and are COCO's results in `detections.json`;
    `images.json` lists their images and categories.

    Args:
        model: a trained model.
        images: one or more of: a set of images, a folder that `open_images` reads, a picture file.
        out: a new or an empty folder, or one of earlier predictions, which are replaced where names match.
        classes: to predict, to which the model's are merged; None for the model's.
        half: of the published data set, as for `open_images`.
        least_score: of the objects that are outlined.
        on_progress: called after each image with the number of images done and of all.

    Raises:
        InputError: an image cannot be read, has no colours, or has the name of another one.
        OutputError: the folder holds other files or cannot be written to.
    """
    folder = Path(out)
    _check_folder(folder)
    sources = (images,) if isinstance(images, (ImageSet, str, Path)) else tuple(images)
    table = model.classes if classes is None else classes
    merging = None if classes is None else classes.merging(model.classes)
    readers = _collect_readers(sources, half)
    objects = None
    if isinstance(model, TrainedModel) and model.task == "detect":
        objects = ObjectWriter(model, table, least_score)

    # Values and colours of the classes.
    values = class_values(table)
    palette = np.zeros((int(values.max()) + 1, 3), np.uint8)
    palette[values] = table.colours
    colours = [(int(red), int(green), int(blue)) for red, green, blue in palette]

    # Write two files for each image.
    try:
        for done, (name, read) in enumerate(readers.items(), start=1):
            colour, turned = read()
            if objects is not None:
                contents = objects.add(name, colour)
            else:
                predicted = values[predict_classes(model, colour, merging)]
                contents = {
                    "class": png_bytes(predicted, colours),
                    "class_colour": png_bytes(palette[predicted]),
                }
            for kind, content in contents.items():
                # Beside a turned photograph, the mask says that it is of the displayed one.
                _write(folder / kind / f"{name}.png", with_upright_exif(content) if turned else content)
            if on_progress is not None:
                on_progress(done, len(readers))
        classes_file = {CLASSES_NAME: canonical_json(_classes_json(table, values))}
        for file, content in (classes_file if objects is None else objects.files()).items():
            _write(folder / file, content)
    except OSError as error:
        raise write_error(error, folder) from None
    return Predictions(folder, tuple(readers))


def class_values(table: ClassTable) -> NDArray[np.uint8]:
    """Value of each class in class images `(k,)`: its id if the classes are the eight, else its index."""
    if set(table.members) == set(ClassTable.organs().members):
        return np.array([min(ids) for ids in table.members], np.uint8)
    return np.arange(len(table), dtype=np.uint8)


def _classes_json(table: ClassTable, values: NDArray[np.uint8]) -> dict[str, object]:
    colours = table.colours.tolist()
    rows = zip(values.tolist(), table.names, colours, table.members, strict=True)
    classes = [
        {"index": value, "name": name, "colour": colour, "members": sorted(members)}
        for value, name, colour, members in sorted(rows, key=lambda row: row[0])
    ]
    return {"format": FORMAT, "classes": classes}


def _check_folder(folder: Path) -> None:
    """Raise `OutputError` if the folder cannot be written to, or holds anything but earlier predictions."""
    check_can_create(folder)
    allowed = {*FOLDERS, CLASSES_NAME, RESULTS_NAME, IMAGES_NAME, *SYSTEM_FILES}
    others = (
        sorted(path.name for path in folder.iterdir() if path.name not in allowed) if folder.is_dir() else []
    )
    if others:
        raise OutputError(f"{folder}: holds {others[0]!r}; choose an empty or a new folder")


def _collect_readers(sources: Sequence[Source], half: str | None) -> dict[str, _Reader]:
    """A function that reads each image, by the image's name; nothing is read yet."""
    readers: dict[str, _Reader] = {}
    for source in sources:
        for name, read in _readers_of(source, half):
            if name in readers:
                place = source.name if isinstance(source, ImageSet) else source
                raise InputError(place, f"holds a second image with the name {name}; predict it separately")
            readers[name] = read
    if not readers:
        raise ArgumentError("images", "must hold at least one image")
    return readers


def _readers_of(source: Source, half: str | None) -> Iterator[tuple[str, _Reader]]:
    if not isinstance(source, ImageSet):
        path = Path(source)
        if not path.is_dir() and path.suffix != ".json":
            if not path.exists():
                raise InputError(path, "must be a folder of images or a picture")
            yield path.stem, lambda: (read_photo(path), is_turned(path))
            return
        source = open_images(path, half=half)
    images = source.select("colour", "metadata")
    for position, name in enumerate(images.names()):
        yield name, lambda position=position: _read_colour(images, position)  # type: ignore[misc]


def _read_colour(images: ImageSet, position: int) -> tuple[NDArray[np.uint8], bool]:
    """Colours of an image, and whether they are those of a photograph that was turned for display."""
    image = images[position]
    if image.colour is None:
        raise InputError(images.name, f"{image.name} has no colours, from which a model predicts")
    photo = image.metadata.get("image")
    return image.colour, isinstance(photo, str) and is_turned(Path(photo))


def _write(path: Path, content: bytes) -> None:
    make_folder(path.parent, [])
    write_file(path, content)


def draw_outlines(colour: NDArray[np.uint8], outlines: Iterable[Outline]) -> NDArray[np.uint8]:
    """An sRGB image `(h, w, 3)` with outlines of objects around their masks."""
    from scipy import ndimage

    drawn, width = colour.copy(), max(1, round(max(colour.shape) / _SIDE_OF_LINE))
    texts = []
    for mask, shade, text in outlines:
        rows, columns = np.nonzero(mask.any(axis=1))[0], np.nonzero(mask.any(axis=0))[0]
        if not len(rows):
            continue
        top, left = max(0, rows[0] - width), max(0, columns[0] - width)
        box = slice(top, rows[-1] + width + 1), slice(left, columns[-1] + width + 1)
        inside = mask[box]
        drawn[box][ndimage.binary_dilation(inside, iterations=width) & ~inside] = shade
        texts.append(((int(left), int(top)), shade, text))
    # Texts are above the outlines, so that they hide no object.
    picture, height = Image.fromarray(drawn), max(_LEAST_TEXT, _LINES_OF_TEXT * width)
    draw, font = ImageDraw.Draw(picture), ImageFont.load_default(height)
    for (left, top), shade, text in texts:
        place = (left, max(0, top - height - 2))
        draw.text(place, text, shade, font, stroke_width=1, stroke_fill=(0, 0, 0))
    return np.asarray(picture)


@final
class ObjectWriter:
    """The files of the objects that a detector finds in images, which are added one after another.

    `detections.json` is a list of COCO's results, with all objects from a score of .05 on. The numbers of
    images and categories are those of `images.json`, which has the form of COCO's annotations, without any.

    Args:
        model: a trained detector.
        table: classes to which the model's are merged.
        least_score: of the objects whose outlines are drawn.
    """

    def __init__(self, model: TrainedModel, table: ClassTable, least_score: float) -> None:
        model.check_task("detect")
        self._model, self._table, self._least_score = model, table, least_score
        self._merged = table.merging(model.classes)
        self._results: list[dict[str, Any]] = []
        self._images: list[dict[str, Any]] = []

    def add(self, name: str, colour: NDArray[np.uint8]) -> dict[str, bytes]:
        """Find the objects of an image; returns its picture with outlines by the folder of such pictures."""
        number, (height, width) = len(self._images) + 1, colour.shape[:2]
        self._images.append({"id": number, "file_name": name, "height": height, "width": width})
        found, outlines = self._model.detections(colour), []
        for position, model_label in enumerate(found.labels):
            for label in np.flatnonzero(self._merged[:, model_label]).tolist():
                mask, score = found.mask(position), float(found.scores[position])
                entry = object_record(number, label + 1, found.boxes[position], mask, score=score)
                self._results.append({key: entry[key] for key in entry if key != "area"})
                if score >= self._least_score:
                    shade = tuple(self._table.colours[label].tolist())
                    outlines.append((mask, shade, f"{self._table.names[label]} {score:.2f}"))
        return {OUTLINES: png_bytes(draw_outlines(colour, outlines))}

    def files(self) -> dict[str, bytes]:
        """The files of all images."""
        categories = [{"id": index, "name": name} for index, name in enumerate(self._table.names, start=1)]
        info = {"description": f"pepperscene {__version__}, detections of {self._model.model}"}
        images = {"info": info, "images": self._images, "categories": categories}
        return {RESULTS_NAME: canonical_json(self._results), IMAGES_NAME: canonical_json(images)}
