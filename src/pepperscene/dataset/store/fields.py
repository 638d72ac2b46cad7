"""Reading the files of a data set with a check of all that readers, exports and reports use.

A data set may come from anywhere. Each function here returns the content of a file only if all that this
package uses of it has the right types; further keys are ignored. Whoever uses the content need not check it.
Parsing and checking a frame's JSON take 1.6 and 1.8 ms for 860 instances; its outputs alone take .4 ms.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import AfterValidator, BaseModel, Field, ValidationError, model_validator

from pepperscene.camera.metadata import (
    LARGEST,
    LARGEST_SIDE,
    CameraMetadata,
    Four,
    Item,
    Pose,
    Real,
    RecordedFields,
    Text,
    Three,
)
from pepperscene.classes import IGNORE_CLASS, OrganClass
from pepperscene.dataset.store.dataset import MARK, Dataset
from pepperscene.dataset.store.images import read_image
from pepperscene.dataset.store.manifest import FRUIT_COLUMNS
from pepperscene.dataset.store.recorded_values import recorded_values
from pepperscene.document import validate
from pepperscene.errors import InputError
from pepperscene.outputs import OUTPUTS
from pepperscene.recipe.camera_tables import CameraTable, RigCamera
from pepperscene.recipe.plan import MAX_FRAMES, Plan
from pepperscene.recipe.variation.recorded import read_variation
from pepperscene.scene import Daylight, DoubleRow, Greenhouse
from pepperscene.truth.encodings import is_class_id
from pepperscene.user_files import read_file

_INSTANCES: Final = 65_535  # instance images have 16 bits
Line = Annotated[str, Field(max_length=400, pattern=r"^[^\x00-\x1f]+$")]
"""As the names in a recipe."""
Count = Annotated[int, Field(ge=0, le=int(LARGEST))]
Number = Annotated[int, Field(ge=-(2**31), lt=2**31)]
Seed = Annotated[int, Field(ge=-(2**63), lt=2**63)]
Place = Annotated[int, Field(ge=0, lt=MAX_FRAMES)]
InstanceNumber = Annotated[int, Field(ge=1, le=_INSTANCES)]
Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Two = Annotated[list[Item], Field(min_length=2, max_length=2)]


def _check_instance_key(key: str) -> str:
    # Not `int` alone, which reads "+7", "007" and digits of other scripts.
    if not (key.isascii() and key.isdigit() and key[0] != "0" and len(key) <= 5 and int(key) <= _INSTANCES):
        raise ValueError(f"must be a number, 1 to {_INSTANCES}")
    return key


InstanceKey = Annotated[str, AfterValidator(_check_instance_key)]


class _Fields(BaseModel):
    """The keys of a JSON object that readers use, of exactly these types."""

    model_config = RecordedFields.model_config


def _check_variation(variation: dict[str, Any]) -> dict[str, Any]:
    read_variation({"variation": variation})
    return variation


class _Recipe(_Fields):
    name: Line
    seed: Annotated[int, Field(ge=0, lt=2**63)]
    cultivar: Line
    plan: Plan
    row: DoubleRow
    camera: CameraTable
    daylight: Daylight | None = None
    greenhouse: Greenhouse | None = None
    variation: Annotated[dict[Line, dict[Text, Any]], AfterValidator(_check_variation)] = {}
    twins: dict[Line, list[Any]] = {}
    rig: list[RigCamera] = []


class DatasetFields(_Fields):
    """`dataset.json`."""

    quality: Line
    version: Line
    recipe_sha256: Digest
    recipe: _Recipe
    measured_spectra: list[Text] = []


def _check_class(value: int) -> int:
    if not 0 <= value < len(OrganClass) and value != IGNORE_CLASS:
        raise ValueError(f"must be 0 to {len(OrganClass) - 1}, or {IGNORE_CLASS}")
    return value


class _Instance(_Fields):
    organ_class: Annotated[int, AfterValidator(_check_class), Field(alias="class")]
    kind: Text
    plant: Number
    phytomer: Number
    parent: Number
    pixels: Count
    box: Four[Number] | None = None
    far: bool = False


class _Sampling(_Fields):
    samples_per_pixel: Real | None = None
    error_codes: Real | None = None
    noise_codes: Real | None = None


class _Contacts(_Fields):
    fruit_touching: Count
    blades_touching: Count


class _OutputEntry(_Fields):
    bytes: Count
    sha256: Digest


class FrameFiles(_Fields):
    """What reading the images of a frame uses of `frames/000000.json`."""

    index: Place
    outputs: dict[Text, _OutputEntry]


class _ViewTarget(_Fields):
    instance: InstanceNumber
    plant: Number
    kind: Text


class FrameFields(_Fields):
    """`frames/000000.json`."""

    index: Place
    set: Place
    rotation: Place
    step: Place
    seed: Seed | None = None
    recipe_seed: Seed | None = None
    camera: CameraMetadata
    instances: dict[InstanceKey, _Instance]
    class_pixels: dict[Text, Count] = {}
    sampling: _Sampling = _Sampling()
    contacts: _Contacts | None = None
    moment: Place | None = None
    twin: Place | None = None
    rig_camera: Line | None = None
    drawn: dict[Line, bool | Real | Text | list[Any]] = {}
    target: _ViewTarget | None = None
    outputs: dict[Text, _OutputEntry]


class _Mask(_Fields):
    """COCO's uncompressed run lengths, of all pixels of the image."""

    size: Two[Annotated[int, Field(ge=1, le=LARGEST_SIDE)]]
    counts: list[Annotated[int, Field(ge=0, le=LARGEST_SIDE**2)]]

    @model_validator(mode="after")
    def _check_sum(self) -> _Mask:
        height, width = self.size
        if sum(self.counts) != height * width:
            raise ValueError(f"must have counts that sum to {height} x {width}")
        return self


class _Point(_Fields):
    camera_m: Three[Real]
    world_m: Three[Real] | None = None
    px: Two[Real] | None
    visible: bool


class _Box3d(_Fields):
    centre: Three[Real]
    size: Three[Real]


class _Peduncle(_Fields):
    instance: InstanceNumber
    cut: _Point


class _Approach(_Fields):
    camera: Three[Real]
    world: Three[Real] | None = None


class _WholeOrgan(_Fields):
    """An organ with its hidden parts."""

    instance: InstanceNumber
    kind: Text
    visible_fraction: Real
    visible_pixels: Count
    amodal_pixels: Count
    truncated: bool
    occluders: list[Any]
    amodal: _Mask
    box: Four[Number] | None
    amodal_box: Four[Number] | None


class _Fruit(_WholeOrgan):
    plant: Number
    phytomer: Number
    ripeness: Real | None = None
    length_m: Real | None = None
    diameter_m: Real | None = None
    pose: Pose
    stalk_end: _Point | None = None
    blossom_end: _Point | None = None
    box_3d: _Box3d | None = None
    peduncle: _Peduncle | None
    approach: _Approach | None

    @model_validator(mode="before")
    @classmethod
    def _refuse_columns(cls, content: Any) -> Any:
        # Tables copy the keys that are columns, and compute these columns from other keys.
        computed = FRUIT_COLUMNS.keys() - cls.model_fields.keys()
        found = sorted(computed & content.keys()) if isinstance(content, dict) else ()
        if found:
            raise ValueError(f"must not have the key {found[0]}, which is computed")
        return content


class HarvestFields(_Fields):
    """`harvest/000000.json`."""

    fruit: list[_Fruit]


class _AmodalOrgan(_WholeOrgan):
    organ_class: Annotated[int, AfterValidator(_check_class), Field(alias="class")]


class AmodalFields(_Fields):
    """`amodal/000000.json`."""

    organs: list[_AmodalOrgan]


_OBJECTS: Final[Mapping[str, type[BaseModel]]] = {"harvest": HarvestFields, "amodal": AmodalFields}
"""Models of the outputs that are JSON objects."""


def frame_indices(dataset: Dataset) -> tuple[int, ...]:
    """The existing frames, ascending; raises `InputError` if there are none."""
    indices = dataset.indices()
    if not indices:
        raise InputError(dataset.folder, "holds no frames yet; build some first")
    return indices


def read_info(dataset: Dataset) -> Mapping[str, Any]:
    """The content of `dataset.json`, of valid types; raises `InputError` otherwise."""
    validate(DatasetFields, dataset.info, dataset.folder / MARK)
    return dataset.info


def has_ignored_pixels(info: Mapping[str, Any]) -> bool:
    """Whether the recipe in a `dataset.json`, of any content, lets images of a frame hold `IGNORE_CLASS`."""
    return "ignore" in recorded_values(info, "greenhouse.far_rows_as")


def read_frame(dataset: Dataset, index: int) -> dict[str, Any]:
    """The content of a frame's JSON, of valid types; raises `InputError` if it is missing or damaged."""
    path = dataset.frame_path(index)
    content = dataset.metadata(index)
    validate(FrameFields, content, path)
    _check_index(content["index"], index, path)
    return content


def read_outputs(dataset: Dataset, index: int) -> Collection[str]:
    """The names of a frame's outputs, much faster than `read_frame`.

    Instances and other metadata are not checked.

    Raises:
        InputError: the frame's JSON is missing, is not valid JSON, belongs to another frame, or lists no
            outputs.
    """
    path = dataset.frame_path(index)
    text = read_file(path, "json", within=dataset.folder)
    with suppress(ValidationError):
        files = FrameFiles.model_validate_json(text)
        if files.index == index:
            return files.outputs.keys()
    # Python's parser reads all that `read_frame` reads, and its errors name the key.
    content = dataset.metadata(index)
    validate(FrameFiles, content, path)
    _check_index(content["index"], index, path)
    return content["outputs"].keys()


def _check_index(found: int, expected: int, path: Path) -> None:
    if found != expected:
        raise InputError(path, f"must be {expected}, as in the name", key="index", value=found)


def read_output(dataset: Dataset, index: int, output: str) -> Any:
    """An output of a frame, as `Frame` holds it; of valid types if it is JSON.

    Raises:
        InputError: the file is missing, damaged, of another kind, or holds a class or distance that is none.
    """
    path = dataset.path(index, output)
    image, expected = read_image(path, within=dataset.folder), OUTPUTS[output]
    if not expected.fits(image):
        raise InputError(
            path, f"must hold {expected.shape} {expected.dtype}, not {image.shape} {image.dtype}"
        )
    if output in _OBJECTS:
        validate(_OBJECTS[output], image, path)
    elif output == "class" and image.max(initial=0) >= len(OrganClass):
        is_unknown, allowed = image >= len(OrganClass), f"from 0 to {len(OrganClass) - 1}"
        if has_ignored_pixels(dataset.info):
            is_unknown, allowed = ~is_class_id(image), f"{allowed}, or {IGNORE_CLASS}"
        if is_unknown.any():
            raise InputError(path, f"must hold class ids {allowed}, not {int(image[is_unknown].max())}")
    elif output == "distance" and not (image >= 0).all():
        # Written so that nan fails too.
        raise InputError(path, "must hold distances from 0 metres, inf for none")
    return image
