"""The outputs of a render, and the frame that holds them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import CLASS_COLOURS, OrganClass
from pepperscene.errors import ArgumentError
from pepperscene.user_files import FileKind


@dataclass(frozen=True)
class Output:
    """One kind of image, or of JSON object, that a frame can hold.

    Attributes:
        name: its name, also that of its folder in a data set.
        shape: of the array: h rows and w columns; c channels, 3 of a colour sensor, 1 of a monochrome one, or
            its bands;
            H rows and W columns of photosites. Empty for a JSON object.
        dtype: of the array; "dict" for a JSON object.
        description: one line for users.
        traced: whether it needs light transport; otherwise rays through the pixels suffice.
        shows_surfaces: whether it needs the spectra of the surfaces, as all traced outputs do.
    """

    name: str
    shape: str
    dtype: str
    description: str
    traced: bool = False
    shows_surfaces: bool = False

    @property
    def is_image(self) -> bool:
        """Whether it is an array; otherwise it is a JSON object."""
        return self.dtype != "dict"

    @property
    def suffix(self) -> str:
        """Suffix of its file in a data set."""
        return ".json" if not self.is_image else ".exr" if self.dtype.startswith("float") else ".png"

    @property
    def file_kind(self) -> FileKind:
        """Kind of its file, which limits the length."""
        kinds: dict[str, FileKind] = {".json": "json", ".exr": "values", ".png": "image"}
        return kinds[self.suffix]

    @property
    def channels(self) -> tuple[int, ...]:
        """Lengths of the third axis, without those of sensors with bands; empty if there is no such axis."""
        third = re.search(r", (\d+|c)\)$", self.shape)
        if third is None:
            return ()
        return (1, 3) if third[1] == "c" else (int(third[1]),)

    @property
    def has_channels(self) -> bool:
        """Whether its third axis has the channels of the sensor."""
        return self.shape.endswith(", c)")

    def fits(self, image: Any) -> bool:
        """Whether an array has this output's type, axes and channels, or an object is one for JSON."""
        if not self.is_image:
            return isinstance(image, Mapping)
        if not isinstance(image, np.ndarray) or image.dtype != np.dtype(self.dtype):
            return False
        if self.has_channels:
            return image.ndim == 3 and image.shape[2] > 0
        return image.ndim == 3 and image.shape[2] in self.channels if self.channels else image.ndim == 2


_COVERAGE_SHAPE: Final = f"(h, w, {len(OrganClass)})"
_ALL: Final = (
    Output("colour", "(h, w, 3)", "uint8", "developed photograph, sRGB", traced=True),
    Output("raw", "(H, W)", "uint16", "digital number of each photosite", traced=True),
    Output(
        "electrons",
        "(h, w, c)",
        "float32",
        "expected photo-electrons per photosite of each colour, before noise",
        traced=True,
    ),
    Output("class", "(h, w)", "uint8", "class id, 0 to 7, or 255 where ignored; with a colour palette"),
    Output("class_colour", "(h, w, 3)", "uint8", "class colour of the published data set"),
    Output("instance", "(h, w)", "uint16", "organ instance; 0 is the background"),
    Output(
        "distance", "(h, w)", "float32", "metres along the ray from the projection centre; background inf"
    ),
    Output("distance_code", "(h, w)", "uint8", "8-bit distance code of the published data set"),
    Output("depth_z", "(h, w)", "float32", "metres along the optical axis; background inf"),
    Output("normal", "(h, w, 3)", "float32", "unit surface normal in world coordinates; background 0"),
    Output("coverage", _COVERAGE_SHAPE, "float16", "fraction of the pixel area per class, without defocus"),
    Output("position", "(h, w, 3)", "float32", "world coordinates in metres; background inf"),
    Output("uv", "(h, w, 2)", "float32", "surface coordinates of the organ in [0, 1]; background -1"),
    Output(
        "flow", "(h, w, 3)", "float32", "pixel displacement to the path's next frame, and visibility in it"
    ),
    Output("stereo", "(h, w, 3)", "float32", "pixel displacement to the stereo camera, and visibility in it"),
    Output("colour_stereo", "(h, w, 3)", "uint8", "developed photograph of the stereo camera", traced=True),
    Output(
        "depth_sensor",
        "(h, w)",
        "float32",
        "metres along the optical axis as the depth camera measures them; holes nan",
        traced=True,
    ),
    Output(
        "depth_confidence", "(h, w)", "float32", "agreement of the depth camera's images, 0 to 1", traced=True
    ),
    Output("imager_left", "(H, W)", "uint8", "image of the depth camera's left imager", traced=True),
    Output("imager_right", "(H, W)", "uint8", "image of the depth camera's right imager", traced=True),
    Output("harvest", "", "dict", "masks, pose, ripeness, cut point and approach of each fruit in view"),
    Output(
        "amodal", "", "dict", "masks of all visible organs with their hidden parts, and visible fractions"
    ),
    Output(
        "albedo",
        "(h, w, c)",
        "float16",
        "diffuse reflectance as the camera develops it, linear sRGB; background 0",
        shows_surfaces=True,
    ),
    Output(
        "chlorophyll",
        "(h, w)",
        "float32",
        "chlorophyll a and b, ug per cm2 of leaf or skin; nan where none is modelled",
        shows_surfaces=True,
    ),
    Output(
        "carotenoids",
        "(h, w)",
        "float32",
        "carotenoids, ug per cm2 of leaf or skin; nan where none are modelled",
        shows_surfaces=True,
    ),
    Output(
        "water",
        "(h, w)",
        "float32",
        "water of blades and petals, g per cm2 or cm of equivalent thickness; nan elsewhere",
        shows_surfaces=True,
    ),
    Output(
        "ripeness", "(h, w)", "float32", "0 unripe to 1 ripe, of fruit; nan elsewhere", shows_surfaces=True
    ),
    Output(
        "leaf_age",
        "(h, w)",
        "float32",
        "ageing of leaf blades, 0 healthy to 1 dried up; nan elsewhere",
        shows_surfaces=True,
    ),
    Output(
        "bands", "(h, w, c)", "float32", "electrons of each band, as the sensor measures them", traced=True
    ),
    Output(
        "radiance",
        "(h, w, c)",
        "float32",
        "mean spectral radiance in each band, W m-2 sr-1 nm-1, without noise",
        traced=True,
    ),
    Output(
        "reflectance",
        "(h, w, c)",
        "float32",
        "measured electrons of each band relative to those of a white reference",
        traced=True,
    ),
)
OUTPUTS: Final[Mapping[str, Output]] = {output.name: output for output in _ALL}
"""All outputs by name, in canonical order."""

BAND_OUTPUTS: Final = frozenset({"bands", "radiance", "reflectance"})
"""Outputs that need a sensor with bands."""

STEREO_OUTPUTS: Final = frozenset({"stereo", "colour_stereo"})
"""Outputs that need a stereo camera."""

DEPTH_CAMERA_OUTPUTS: Final = frozenset({"depth_sensor", "depth_confidence", "imager_left", "imager_right"})
"""Outputs that need a depth camera."""

TRAIT_OUTPUTS: Final = frozenset({"chlorophyll", "carotenoids", "water", "ripeness", "leaf_age"})
"""Outputs of what the tissue behind a pixel's centre holds."""


COLOUR_OUTPUTS: Final = frozenset({"colour", "raw", "colour_stereo", "albedo"})
"""Outputs of sensors with colours, or monochrome ones: a sensor with bands has none of them."""


def needs_surfaces(names: Iterable[str]) -> bool:
    """Whether one of these outputs needs the spectra of a scene's surfaces."""
    return any(OUTPUTS[name].traced or OUTPUTS[name].shows_surfaces for name in names)


def check_band_outputs(names: Iterable[str], sensor: str, *, has_bands: bool) -> None:
    """Raise `ArgumentError` if an output needs a sensor with bands, or one without."""
    wrong = (COLOUR_OUTPUTS if has_bands else BAND_OUTPUTS).intersection(names)
    if wrong and has_bands:
        others = ", ".join(repr(name) for name in ("electrons", *sorted(BAND_OUTPUTS)))
        problem = f"{min(wrong)!r} needs a colour or monochrome sensor; {sensor} has bands: use {others}"
        raise ArgumentError("outputs", problem)
    if wrong:
        raise ArgumentError("outputs", f"{min(wrong)!r} needs a sensor with bands, which {sensor} has not")


DEFAULT_OUTPUTS: Final = ("colour", "class", "instance", "distance", "distance_code")


def check_outputs(names: Iterable[str]) -> tuple[str, ...]:
    """The output names in canonical order, without duplicates.

    Raises:
        ArgumentError: a name is unknown, or no name is given.
    """
    requested = list(names)
    for name in requested:
        if name not in OUTPUTS:
            raise ArgumentError("outputs", f"unknown output {name!r}; allowed are {', '.join(OUTPUTS)}")
    if not requested:
        raise ArgumentError("outputs", f"must name at least one output of {', '.join(OUTPUTS)}")
    return tuple(name for name in OUTPUTS if name in requested)


TARGET_TOLERANCE: Final = 1.25
"""Chosen: ratio of an error to its target up to which the target counts as met. The error is an estimate."""


def is_target_met(error_to_noise: float, target: float) -> bool:
    """Whether the estimated error of a frame's light, over the sensor noise, is not far above its target."""
    return error_to_noise <= TARGET_TOLERANCE * target


@dataclass(frozen=True, eq=False)
class Frame:
    """One rendered view.

    Attributes:
        images: array by output name, as described in `OUTPUTS`; a JSON-ready object for "harvest" and
            "amodal".
        metadata: JSON-ready description: camera pose, intrinsics, distortion, exposure, variant, versions,
            and the instances in view.
    """

    images: Mapping[str, Any]
    metadata: Mapping[str, Any] = field(default_factory=dict)

    def __getitem__(self, output: str) -> Any:
        return self.images[output]

    def __repr__(self) -> str:
        sizes = (f"{i.shape[1]}x{i.shape[0]}" for i in self.images.values() if isinstance(i, np.ndarray))
        return f"Frame({', '.join([*self.images, *list(sizes)[:1]])})"

    def _repr_html_(self) -> str:
        """The images that can be seen as they are, small, for notebooks."""
        from pepperscene.notebook_view import object_html, picture_html

        shown = {name: image for name, image in self.images.items() if _is_viewable(image)}
        if "class" in shown:
            palette = np.zeros((256, 3), np.uint8)
            palette[: len(CLASS_COLOURS)] = CLASS_COLOURS
            shown["class"] = palette[shown["class"]]
        return object_html(repr(self), (picture_html(image, name) for name, image in shown.items()))

    @property
    def colour(self) -> NDArray[np.uint8]:
        """`(h, w, 3)` uint8, the developed photograph."""
        photograph: NDArray[np.uint8] = self.images["colour"]
        return photograph


def _is_viewable(image: Any) -> bool:
    """Whether an image has 8 bits, and one or three channels."""
    is_array = isinstance(image, np.ndarray) and image.dtype == np.uint8
    return is_array and (image.ndim == 2 or image.shape[2:] == (3,))
