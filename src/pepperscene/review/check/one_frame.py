"""Checks of a single frame; each of its files is read once."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from pepperscene.dataset.store.dataset import FRAMES, Dataset, file_name
from pepperscene.dataset.store.fields import AmodalFields, FrameFields, HarvestFields, has_ignored_pixels
from pepperscene.dataset.store.frame_json import is_as_written
from pepperscene.dataset.store.images import read_image
from pepperscene.dataset.store.journal import TIMINGS
from pepperscene.dataset.store.manifest import (
    FRUIT_COLUMNS,
    MANIFEST,
    Row,
    frame_row,
    fruit_rows,
    stored_row,
    table_columns,
)
from pepperscene.document import validate
from pepperscene.errors import InputError, short_repr
from pepperscene.outputs import OUTPUTS
from pepperscene.recipe.camera_tables import FIRST_CAMERA
from pepperscene.recipe.plan import FrameSpec, Plan, frame_seed
from pepperscene.recipe.variation.recorded import read_variation, recorded_draws, recorded_twins, same_value
from pepperscene.review.check.edges import CHANCE, EdgeMatch, match_edges
from pepperscene.review.check.findings import Finding, camera_integer, json_object
from pepperscene.review.check.images import check_photo, check_values
from pepperscene.review.check.labels import check_labels, check_whole_organs
from pepperscene.truth import class_pixel_counts, saturated_fraction
from pepperscene.truth.encodings import is_class_id
from pepperscene.user_files import MissingFileError, open_file

_MAIN_PHOTOS: Final = ("colour", "photo")
"""Photographs of the main camera, the one without loss first."""
_PHOTOS: Final = (*_MAIN_PHOTOS, "colour_stereo")
_OBJECTS: Final[Mapping[str, tuple[type[BaseModel], str]]] = {
    "harvest": (HarvestFields, "pepperscene harvest 1"),
    "amodal": (AmodalFields, "pepperscene amodal 1"),
}
"""Models and formats of the outputs that are JSON objects."""

Problem = tuple[str, str, str]
"""Kind, output ("" for the frame's JSON) and description."""


@dataclass(frozen=True)
class FrameTraits:
    """Values that are compared with other frames, the manifest and the recipe.

    Digests have 64 bits (see `short_digest`), and are 0 if there is nothing to compare.
    """

    index: int
    scene: int = -1  # set and rotation as one number
    photo: int = 0  # digest of its first traced image that is not constant
    content: int = 0  # digest of all its files, unless all images are constant
    view: int = 0  # digest of pose and seed
    row: int = 0  # digest of its row in the manifest
    fruit: int = 0  # digest of its rows in the table of fruit
    has_harvest: bool = False
    fractions: tuple[float, ...] | None = None  # of the pixels for each class
    mean: float | None = None  # grey value of the photograph
    saturated: float = 0.0  # fraction of the photograph's pixels with a channel at 255
    automatic: Mapping[str, Any] = field(default_factory=dict)  # settings that automatic exposure chose
    sampling: Mapping[str, Any] = field(default_factory=dict)  # samples of the light, their error and target
    drawn: Mapping[str, Any] = field(default_factory=dict)  # drawn values by dotted key


class FrameChecker:
    """Checks frames of a data set, each by itself.

    Args:
        dataset: whose `info` has valid types, or is empty if it is damaged.
    """

    def __init__(self, dataset: Dataset) -> None:
        self._dataset = dataset
        self._has_ignored = has_ignored_pixels(dataset.info)
        self._columns = table_columns(MANIFEST, dataset.info)
        self._recipe: dict[str, Any] = dataset.info.get("recipe", {})
        self._plan = Plan.model_validate(self._recipe["plan"]) if self._recipe else None
        self._variation = read_variation(self._recipe)

    def check(self, index: int) -> tuple[list[Finding], FrameTraits]:
        """The findings of one frame, and what other checks use of it."""
        json_file = f"{FRAMES}/{self._dataset.frame_path(index).name}"
        try:
            metadata = self._read(index)
        except InputError as error:
            return [Finding("damaged", index, json_file, error.detail)], FrameTraits(index)
        digests, images, problems = dict[str, str](), dict[str, Any](), list[Problem]()
        problems += (("contradiction", "", problem) for problem in self._compare_with_plan(metadata, index))
        for output, entry in metadata["outputs"].items():
            problems += _read_output(self._dataset, index, output, entry, digests, images)
        for output in OUTPUTS.keys() - metadata["outputs"].keys():
            if self._dataset.path(index, output).exists():
                problem = "is not named in the frame's JSON; a build with this output makes it again"
                problems.append(("extra", output, problem))
        for output, problem in [*_wrong_shapes(images, metadata)]:
            problems.append(("shape", output, problem))
            del images[output]
        problems += _check_content(images, metadata, self._has_ignored)
        findings = [
            Finding(kind, index, file_name(index, output) if output in OUTPUTS else json_file, problem)
            for kind, output, problem in problems
        ]
        return findings, self._traits(index, metadata, digests, images)

    def _read(self, index: int) -> dict[str, Any]:
        """The frame's JSON, of valid types; raises `InputError` if it is damaged."""
        metadata = self._dataset.metadata(index)
        if not is_as_written(metadata):
            raise InputError("", "is not what was written: its checksum differs")
        validate(FrameFields, metadata, "")
        if not metadata["outputs"]:
            raise InputError("", "names no outputs")
        return metadata

    def _compare_with_plan(self, metadata: Mapping[str, Any], index: int) -> Iterator[str]:
        """Yield the contradictions between a frame's JSON and the recipe of `dataset.json`."""
        expected: dict[str, Any] = {"index": index}
        if self._plan is not None:
            if index >= self._plan.count:
                yield "is outside the plan of dataset.json"
                return
            spec, seed = self._plan.frame(index), self._recipe["seed"]
            expected |= {"set": spec.set, "rotation": spec.rotation, "step": spec.step}
            expected |= {"recipe_seed": seed, "seed": frame_seed(seed, index)}
            # Twins or a rig that are recorded with other lengths than those of the plan raise one of these.
            with suppress(ValueError, LookupError, TypeError):
                expected |= self._place(spec)
                yield from self._compare_drawn(spec, metadata.get("drawn", {}))
        for key, value in expected.items():
            if metadata.get(key) != value:
                yield f"has {key} = {short_repr(metadata.get(key))}; by the plan it must be {value!r}"

    def _place(self, spec: FrameSpec) -> dict[str, Any]:
        """Moment and twin of a frame, and its camera on a rig, as far as the recipe has them."""
        place: dict[str, Any] = {}
        if recorded_twins(self._recipe):
            place |= {"moment": spec.moment, "twin": spec.twin}
        if rig := self._recipe.get("rig"):
            camera = rig[spec.camera - 1]["name"] if spec.camera else FIRST_CAMERA
            place |= {"moment": spec.moment, "rig_camera": camera}
        return place

    def _compare_drawn(self, spec: FrameSpec, drawn: Mapping[str, Any]) -> Iterator[str]:
        """Yield the drawn values that differ from those that index and seed determine."""
        expected = recorded_draws(self._recipe, self._variation, spec)
        for name, value in expected.items():
            if name not in drawn:
                yield f"has no drawn value {name}; by its index and seed it must be {value!r}"
            elif not same_value(value, drawn[name]):
                found = f"has the drawn value {name} = {short_repr(drawn[name])}"
                yield f"{found}; by its index and seed it must be {value!r}"
        for name in sorted(drawn.keys() - expected.keys()):
            yield f"has the drawn value {name}, which the recipe does not vary"

    def _traits(
        self, index: int, metadata: Mapping[str, Any], digests: Mapping[str, str], images: Mapping[str, Any]
    ) -> FrameTraits:
        # Frames of constant images (all sky, no light) may be equal.
        arrays = {name: image for name, image in images.items() if OUTPUTS[name].is_image}
        varied = [name for name, array in arrays.items() if not (array == array.flat[0]).all()]
        traced = next((name for name in varied if OUTPUTS[name].traced), None)
        photo, seed = _main_photo(images), metadata.get("seed")
        has_harvest = "harvest" in metadata["outputs"]
        fruit = 0 if has_harvest else fruit_digest(())
        if "harvest" in images:
            fruit = fruit_digest(fruit_rows(index, images["harvest"]))
        return FrameTraits(
            index,
            # The recipe allows at most 1000 rotations.
            scene=metadata["set"] * 1000 + metadata["rotation"],
            photo=short_digest(np.ascontiguousarray(images[traced]).data) if traced else 0,
            # Twins that differ only in light have equal labels.
            content=_json_digest([digests, metadata.get("twin")]) if varied else 0,
            view=0 if seed is None else _json_digest([metadata["camera"]["pose"], seed]),
            row=row_digest(frame_row(metadata), self._columns),
            fruit=fruit,
            has_harvest=has_harvest,
            fractions=_class_fractions(images.get("class")),
            mean=None if photo is None else float(photo.mean()),
            saturated=0.0 if photo is None else saturated_fraction(photo),
            automatic=json_object(metadata, "auto_exposure"),
            sampling=metadata.get("sampling", {}),
            drawn=metadata.get("drawn", {}),
        )


def short_digest(content: bytes | memoryview) -> int:
    """A digest of 64 bits; in a million, two different contents have the same one with a chance of 3e-8."""
    return int.from_bytes(hashlib.blake2b(content, digest_size=8).digest())


def row_digest(row: Row, columns: Mapping[str, str]) -> int:
    """Digest of a row as a manifest of these columns stores it, without timings, which no frame holds."""
    return _json_digest(_as_stored({**row, **dict.fromkeys(TIMINGS)}, columns))


def fruit_digest(rows: Iterable[Row]) -> int:
    """Digest of the rows of one frame as the table of fruit stores them."""
    return _json_digest([_as_stored(row, FRUIT_COLUMNS) for row in rows])


def _as_stored(row: Row, columns: Mapping[str, str]) -> Row:
    """A row as it is read from a table: JSON may hold 1 where the column holds 1.0."""
    stored = stored_row(row, columns)
    for name, value in stored.items():
        if columns[name] == "doubles":
            stored[name] = [float(number) for number in value]
        elif columns[name] == "double":
            stored[name] = float(value)
    return stored


def _json_digest(content: Any) -> int:
    return short_digest(json.dumps(content, sort_keys=True).encode())


def _class_fractions(classes: NDArray[np.uint8] | None) -> tuple[float, ...] | None:
    if classes is None or not is_class_id(classes).all():
        return None
    return tuple(count / classes.size for count in class_pixel_counts(classes).values())


def _read_output(
    dataset: Dataset,
    index: int,
    output: str,
    entry: Mapping[str, Any],
    digests: dict[str, str],
    images: dict[str, Any],
) -> Iterator[Problem]:
    """Read one file into `digests` and `images`, and yield its problems."""
    if output not in OUTPUTS:
        yield "contradiction", "", f"names the unknown output {short_repr(output)}"
        return
    path = dataset.path(index, output)
    try:
        with open_file(path, OUTPUTS[output].file_kind, within=dataset.folder) as file:
            size = os.fstat(file.fileno()).st_size
            # A file of another length is not what was written, and may be very long.
            digests[output] = ""
            if entry["bytes"] == size:
                digests[output] = hashlib.file_digest(file, "sha256").hexdigest()
        if entry.get("file") != file_name(index, output):
            yield "contradiction", output, f"is named {short_repr(entry.get('file'))} in the frame's JSON"
        if entry["bytes"] != size:
            yield "checksum", output, f"has {size} bytes, the frame's JSON says {entry['bytes']}"
        elif entry["sha256"] != digests[output]:
            yield "checksum", output, "is not what was written: its checksum differs"
        else:
            # Only now: the content of a damaged file says nothing about the rendered image.
            images[output] = read_image(path, within=dataset.folder)
            if output in _OBJECTS:
                model, format_name = _OBJECTS[output]
                if images[output].get("format") != format_name:
                    raise InputError("", f"must have the format {format_name!r}")
                validate(model, images[output], "")
    except MissingFileError:
        yield "missing", output, "does not exist"
    except OSError as error:
        yield "unreadable", output, f"cannot be read ({error.strerror})"
    except InputError as error:
        is_invalid = images.pop(output, None) is not None
        yield "damaged" if is_invalid else "unreadable", output, error.detail if is_invalid else error.problem


def _wrong_shapes(images: Mapping[str, Any], metadata: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield images of the wrong type, or of another size than the camera's, and what is wrong."""
    for output, image in images.items():
        expected = OUTPUTS[output]
        if not expected.fits(image):
            actual = f"{image.shape} {image.dtype}" if hasattr(image, "dtype") else type(image).__name__
            yield output, f"is {actual}, must be {expected.shape} {expected.dtype}"
        elif expected.is_image:
            rows, columns = _expected_size(output, metadata)
            if image.shape[:2] != (rows, columns):
                found = f"has {image.shape[1]}x{image.shape[0]} pixels"
                yield output, f"{found}, the camera has {columns}x{rows}"


def _expected_size(output: str, metadata: Mapping[str, Any]) -> tuple[int, int]:
    """Rows and columns that an output of a frame must have."""
    if output in ("imager_left", "imager_right"):
        metadata = {"camera": json_object(metadata, "depth_camera")}
    height, width = camera_integer(metadata, "height"), camera_integer(metadata, "width")
    if output != "raw":
        return height, width
    # Photosites, by binning if the JSON does not have them.
    shape, binning = metadata["camera"].get("site_shape"), camera_integer(metadata, "binning", 1)
    is_known = isinstance(shape, list) and len(shape) == 2
    return (shape[0], shape[1]) if is_known else (height * binning, width * binning)


def _check_content(
    images: Mapping[str, Any], metadata: Mapping[str, Any], ignored: bool
) -> Iterator[Problem]:
    """Yield the problems of all images; see `check_labels` for `ignored`."""
    photo, has_edges = _main_photo(images), True
    for output in _PHOTOS:
        if output in images:
            for kind, problem in check_photo(images[output]):
                has_edges = has_edges and output not in _MAIN_PHOTOS
                yield kind, output, problem
    yield from check_labels(images, metadata, ignored=ignored)
    yield from check_values(images, metadata, ignored=ignored)
    yield from check_whole_organs(images)
    labels = next((name for name in ("instance", "class") if name in images), None)
    if photo is not None and has_edges and labels is not None:
        result = match_edges(photo, images[labels])
        if result is not None and not result.fits:
            yield "edges", labels, _describe_shift(result)


def _main_photo(images: Mapping[str, Any]) -> NDArray[np.uint8] | None:
    return next((images[output] for output in _MAIN_PHOTOS if output in images), None)


def _describe_shift(result: EdgeMatch) -> str:
    if result.height < CHANCE:
        return "fits the photograph at no shift: mirrored, or of another frame"
    position = f"in its {result.quarter} quarter is" if result.quarter else "is"
    return (
        f"{position} {result.right_px:+d} px to the right of and {result.down_px:+d} px below "
        f"the photograph's edges ({result.height:.0f} standard deviations above other shifts)"
    )
