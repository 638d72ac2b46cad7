"""Predictions of a model, written as class images."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

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
from pepperscene.learning.evaluation.evaluate import Segmenter, predict_classes
from pepperscene.learning.evaluation.outlines import IMAGES_NAME, OUTLINES, RESULTS_NAME, ObjectWriter
from pepperscene.learning.models.trained_model import TrainedModel
from pepperscene.learning.options import DECIDED_SCORE

CLASSES_NAME: Final = "classes.json"
FORMAT: Final = "pepperscene prediction 1"
FOLDERS: Final = ("class", "class_colour", OUTLINES)

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
