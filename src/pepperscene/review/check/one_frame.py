"""Checks of a single frame; each of its files is read once."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset.store.dataset import FRAMES, Dataset, file_name
from pepperscene.dataset.store.fields import has_ignored_pixels
from pepperscene.dataset.store.frame_json import CHECKSUM, is_as_written
from pepperscene.dataset.store.images import read_image
from pepperscene.dataset.store.manifest import MANIFEST, frame_row, fruit_rows, table_columns
from pepperscene.errors import InputError, short_repr
from pepperscene.outputs import OUTPUTS
from pepperscene.recipe.plan import Plan, frame_seed
from pepperscene.review.check.edges import CHANCE, EdgeMatch, match_edges
from pepperscene.review.check.findings import Finding, camera_integer, camera_pose, json_object
from pepperscene.review.check.images import check_photo, check_values
from pepperscene.review.check.labels import check_labels, check_whole_organs
from pepperscene.review.check.tables import frame_row_digest, fruit_rows_digest, short_digest
from pepperscene.review.check.variation import check_drawn
from pepperscene.truth import class_pixel_counts, saturated_fraction
from pepperscene.truth.encodings import is_class_id
from pepperscene.user_files import MissingFileError, open_file

_PHOTOS: Final = ("colour", "colour_stereo")


@dataclass(frozen=True)
class FrameTraits:
    """Values that are compared with other frames, the manifest and the recipe.

    Digests have 64 bits (see `short_digest`), and are 0 if there is nothing to compare.
    """

    index: int
    scene: int | None = None  # set and rotation as one number
    photo: int = 0  # digest of its first traced image that is not constant
    content: int = 0  # digest of all its files, unless all images are constant
    view: int = 0  # digest of pose and seed
    row: int = 0  # digest of its row in the manifest
    fruit: int = 0  # digest of its rows in the table of fruit
    fractions: tuple[float, ...] | None = None  # of the pixels for each class
    mean: float | None = None  # grey value of the photograph
    saturated: float = 0.0  # fraction of the photograph's pixels with a channel at 255
    automatic: Mapping[str, Any] | None = None  # settings that automatic exposure chose
    sampling: Mapping[str, Any] = field(default_factory=dict)  # samples of the light, their error and target
    drawn: Mapping[str, Any] = field(default_factory=dict)  # drawn values by dotted key


@dataclass(frozen=True)
class FrameExamination:
    """Result of the checks of one frame."""

    findings: tuple[Finding, ...]
    traits: FrameTraits
    has_harvest: bool = False  # whether its JSON names the output harvest


def examine_frame(dataset: Dataset, index: int) -> FrameExamination:
    """Check one frame of a data set by itself."""
    json_file = f"{FRAMES}/{dataset.frame_path(index).name}"
    try:
        metadata = dataset.metadata(index)
    except InputError as error:
        finding = Finding("damaged", index, json_file, error.problem)
        return FrameExamination((finding,), FrameTraits(index))
    findings = [
        Finding(kind, index, json_file, problem)
        for kind, problem in _check_metadata(dataset, metadata, index)
    ]

    # Files: do they exist, and are they what was written?
    digests: dict[str, str] = {}
    images: dict[str, Any] = {}
    for output, entry in json_object(metadata, "outputs").items():
        file = file_name(index, output) if output in OUTPUTS else json_file
        for kind, problem in _read_file(dataset, index, output, entry, digests, images):
            findings.append(Finding(kind, index, file, problem))
    findings += _unnamed_files(dataset, index, metadata)
    for output, problem in _wrong_shapes(images, metadata):
        findings.append(Finding("shape", index, file_name(index, output), problem))
        del images[output]

    # Content of all images that could be read.
    for kind, output, problem in _check_content(images, metadata, has_ignored_pixels(dataset.info)):
        findings.append(Finding(kind, index, file_name(index, output), problem))
    has_harvest = "harvest" in json_object(metadata, "outputs")
    traits = _traits(index, metadata, digests, images, dataset.info)
    return FrameExamination(tuple(findings), traits, has_harvest)


def _traits(
    index: int,
    metadata: Mapping[str, Any],
    digests: Mapping[str, str],
    images: Mapping[str, Any],
    info: Mapping[str, Any],
) -> FrameTraits:
    # Frames of constant images (all sky, no light) may be equal.
    arrays = {name: image for name, image in images.items() if OUTPUTS[name].is_image}
    varied = [name for name, array in arrays.items() if not (array == array.flat[0]).all()]
    traced = next((name for name in varied if OUTPUTS[name].traced), None)
    photo = images.get("colour")
    pose, seed = camera_pose(metadata), metadata.get("seed")
    twin = metadata.get("twin") if isinstance(metadata.get("twin"), int) else None
    set_index, rotation, scene = metadata.get("set"), metadata.get("rotation"), None
    if isinstance(set_index, int) and isinstance(rotation, int):
        # The recipe allows at most 1000 rotations.
        scene = set_index * 1000 + rotation
    return FrameTraits(
        index,
        scene=scene,
        photo=short_digest(np.ascontiguousarray(images[traced]).data) if traced else 0,
        # Twins that differ only in light have equal labels.
        content=short_digest(json.dumps([digests, twin], sort_keys=True).encode()) if varied else 0,
        view=0 if pose is None or seed is None else short_digest(json.dumps([pose.tolist(), seed]).encode()),
        row=_row_digest(metadata, info),
        fruit=_fruit_digest(index, metadata, images),
        fractions=_class_fractions(images.get("class")),
        mean=None if photo is None else float(photo.mean()),
        saturated=0.0 if photo is None else saturated_fraction(photo),
        automatic=json_object(metadata, "auto_exposure") or None,
        sampling=json_object(metadata, "sampling"),
        drawn=json_object(metadata, "drawn"),
    )


def _class_fractions(classes: NDArray[np.uint8] | None) -> tuple[float, ...] | None:
    if classes is None or not is_class_id(classes).all():
        return None
    return tuple(count / classes.size for count in class_pixel_counts(classes).values())


def _row_digest(metadata: Mapping[str, Any], info: Mapping[str, Any]) -> int:
    return frame_row_digest(frame_row(metadata), table_columns(MANIFEST, info))


def _fruit_digest(index: int, metadata: Mapping[str, Any], images: Mapping[str, Any]) -> int:
    """Digest of the rows of the frame in the table of fruit; 0 if the output harvest cannot be read."""
    if "harvest" not in json_object(metadata, "outputs"):
        return fruit_rows_digest(())
    try:
        return fruit_rows_digest(fruit_rows(index, images["harvest"]))
    except (LookupError, TypeError, AttributeError):
        # Its faults are findings of other checks.
        return 0


def _check_metadata(dataset: Dataset, metadata: dict[str, Any], index: int) -> Iterator[tuple[str, str]]:
    """Yield kind and description of the problems of a frame's JSON by itself."""
    if CHECKSUM not in metadata:
        yield "damaged", "has no checksum"
    elif not is_as_written(metadata):
        yield "damaged", "is not what was written: its checksum differs"
    if not isinstance(metadata.get("outputs"), dict) or not metadata["outputs"]:
        yield "damaged", "names no outputs"
    recipe = json_object(dataset.info, "recipe")
    expected: dict[str, Any] = {"index": index}
    try:
        spec = Plan.model_validate(recipe["plan"]).frame(index)
        expected |= {"set": spec.set, "rotation": spec.rotation, "step": spec.step}
        expected |= {"recipe_seed": recipe["seed"], "seed": frame_seed(recipe["seed"], index)}
        for problem in check_drawn(recipe, spec, metadata):
            yield "contradiction", problem
    except KeyError:
        # A damaged dataset.json is one finding, not one for every frame.
        pass
    except (ValueError, TypeError):
        yield "contradiction", "is outside the plan of dataset.json"
    for key, value in expected.items():
        if metadata.get(key) != value:
            yield (
                "contradiction",
                f"has {key} = {short_repr(metadata.get(key))}; by the plan it must be {value}",
            )


def _read_file(
    dataset: Dataset, index: int, output: str, entry: Any, digests: dict[str, str], images: dict[str, Any]
) -> Iterator[tuple[str, str]]:
    """Read one file into `digests` and `images`, and yield kind and description of its problems."""
    if output not in OUTPUTS:
        yield "contradiction", f"names the unknown output {short_repr(output)}"
        return
    path, expected = dataset.folder / file_name(index, output), entry if isinstance(entry, dict) else {}
    try:
        with open_file(path, OUTPUTS[output].file_kind, within=dataset.folder) as file:
            size = os.fstat(file.fileno()).st_size
            # A file of another length is not what was written, and may be very long.
            if expected.get("bytes") == size:
                digests[output] = hashlib.file_digest(file, "sha256").hexdigest()
    except MissingFileError:
        yield "missing", "does not exist"
        return
    except InputError as error:
        yield "unreadable", error.problem
        return
    except OSError as error:
        yield "unreadable", f"cannot be read ({error.strerror})"
        return
    if expected.get("file") != file_name(index, output):
        yield "contradiction", f"is named {short_repr(expected.get('file'))} in the frame's JSON"
    if expected.get("bytes") != size:
        yield "checksum", f"has {size} bytes, the frame's JSON says {short_repr(expected.get('bytes'))}"
        return
    if expected.get("sha256") != digests[output]:
        yield "checksum", "is not what was written: its checksum differs"
        return
    # Only now: the content of a damaged file says nothing about the rendered image.
    try:
        images[output] = read_image(path, within=dataset.folder)
    except InputError as error:
        yield "unreadable", error.problem


def _unnamed_files(dataset: Dataset, index: int, metadata: Mapping[str, Any]) -> Iterator[Finding]:
    """Yield the images of a frame that its JSON does not name."""
    for output in OUTPUTS.keys() - json_object(metadata, "outputs").keys():
        if dataset.path(index, output).exists():
            problem = "is not named in the frame's JSON; a build with this output makes it again"
            yield Finding("extra", index, file_name(index, output), problem)


def _wrong_shapes(images: Mapping[str, Any], metadata: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Output and description of images of the wrong type, or of another size than the camera's."""
    height, width = camera_integer(metadata, "height"), camera_integer(metadata, "width")
    problems = []
    for output, image in images.items():
        expected = OUTPUTS[output]
        if not expected.fits(image):
            actual = f"{image.shape} {image.dtype}" if hasattr(image, "dtype") else type(image).__name__
            problems.append((output, f"is {actual}, must be {expected.shape} {expected.dtype}"))
        elif expected.is_image:
            rows, columns = _expected_size(output, metadata, (height, width))
            if image.shape[:2] != (rows, columns):
                problem = f"has {image.shape[1]}x{image.shape[0]} pixels, the camera has {columns}x{rows}"
                problems.append((output, problem))
    return problems


def _expected_size(output: str, metadata: Mapping[str, Any], size: tuple[int, int]) -> tuple[int, int]:
    """Rows and columns that an output must have in a frame of this size."""
    if output == "raw":
        return _site_shape(metadata, *size)
    if output in ("imager_left", "imager_right"):
        imager = {"camera": json_object(metadata, "depth_camera")}
        return camera_integer(imager, "height"), camera_integer(imager, "width")
    return size


def _site_shape(metadata: Mapping[str, Any], height: int, width: int) -> tuple[int, int]:
    """Rows and columns of the camera's photosites, by binning if the JSON does not have them."""
    shape = json_object(metadata, "camera").get("site_shape")
    if isinstance(shape, list) and len(shape) == 2 and all(isinstance(length, int) for length in shape):
        return shape[0], shape[1]
    binning = camera_integer(metadata, "binning", 1)
    return height * binning, width * binning


def _check_content(
    images: Mapping[str, Any], metadata: Mapping[str, Any], ignored: bool
) -> Iterator[tuple[str, str, str]]:
    """Yield kind, output and description of the problems of all images; see `check_labels` for `ignored`."""
    has_edges = "colour" in images
    for output in _PHOTOS:
        if output in images:
            for kind, problem in check_photo(images[output]):
                has_edges = has_edges and output != "colour"
                yield kind, output, problem
    yield from check_labels(images, metadata, ignored=ignored)
    yield from check_values(images, metadata, ignored=ignored)
    yield from check_whole_organs(images)
    labels = next((name for name in ("instance", "class") if name in images), None)
    if has_edges and labels is not None:
        result = match_edges(images["colour"], images[labels])
        if result is not None and not result.fits:
            yield "edges", labels, _describe_shift(result)


def _describe_shift(result: EdgeMatch) -> str:
    if result.height < CHANCE:
        return "fits the photograph at no shift: mirrored, or of another frame"
    position = f"in its {result.quarter} quarter is" if result.quarter else "is"
    return (
        f"{position} {result.right_px:+d} px to the right of and {result.down_px:+d} px below "
        f"the photograph's edges ({result.height:.0f} standard deviations above other shifts)"
    )
