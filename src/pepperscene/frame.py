"""What a render gives: images by output name, and the facts that belong to them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.errors import ArgumentError


@dataclass(frozen=True)
class Output:
    """One kind of image, or of knowledge about one, that a frame can hold.

    Attributes:
        name: as on the command line, and the name of its folder in a data set.
        shape: of the array: h rows and w columns; c channels, 3 of a colour sensor and 1 of a monochrome one;
            H rows and W columns of photosites. Empty where it is no array.
        dtype: of the array; "dict" for a JSON object.
        suffix: of its file in a data set.
        meaning: one line for help texts.
        traced: True when it comes out of light transport, False when rays through pixel centres suffice.
    """

    name: str
    shape: str
    dtype: str
    suffix: str
    meaning: str
    traced: bool = False

    @property
    def is_image(self) -> bool:
        """Whether it is an array; else a JSON object."""
        return self.dtype != "dict"

    @property
    def channels(self) -> tuple[int, ...]:
        """How many values a pixel may have along a third axis; empty where there is no such axis."""
        third = re.search(r", (\d+|c)\)$", self.shape)
        if third is None:
            return ()
        return (1, 3) if third[1] == "c" else (int(third[1]),)

    def fits(self, image: Any) -> bool:
        """Whether an array has this output's type, axes and channels, or an object is one for JSON."""
        if not self.is_image:
            return isinstance(image, Mapping)
        if not isinstance(image, np.ndarray) or image.dtype != np.dtype(self.dtype):
            return False
        return image.ndim == 3 and image.shape[2] in self.channels if self.channels else image.ndim == 2


OUTPUTS: Final[Mapping[str, Output]] = {
    output.name: output
    for output in (
        Output("colour", "(h, w, 3)", "uint8", ".png", "the developed photograph, sRGB", traced=True),
        Output(
            "raw",
            "(H, W)",
            "uint16",
            ".png",
            "digital numbers of the photosites, as the converter gives them",
            traced=True,
        ),
        Output(
            "electrons",
            "(h, w, c)",
            "float32",
            ".exr",
            "expected photo-electrons per photosite of each colour, before noise",
            traced=True,
        ),
        Output("class", "(h, w)", "uint8", ".png", "class ids 0 to 7, with a colour palette"),
        Output("class_colour", "(h, w, 3)", "uint8", ".png", "class colours of the published data set"),
        Output("instance", "(h, w)", "uint16", ".png", "organ instance, 0 is background"),
        Output(
            "distance",
            "(h, w)",
            "float32",
            ".exr",
            "metres along the ray from the projection centre, inf in the background",
        ),
        Output("distance_code", "(h, w)", "uint8", ".png", "the published data set's 8-bit distance code"),
        Output(
            "depth_z", "(h, w)", "float32", ".exr", "metres along the optical axis, inf in the background"
        ),
        Output(
            "normal",
            "(h, w, 3)",
            "float32",
            ".exr",
            "unit surface normal in world coordinates, 0 in the background",
        ),
        Output(
            "coverage",
            f"(h, w, {len(OrganClass)})",
            "float16",
            ".exr",
            "share of the pixel's area that each class covers, everything sharp",
        ),
        Output(
            "position",
            "(h, w, 3)",
            "float32",
            ".exr",
            "world coordinates in metres, inf in the background",
        ),
        Output(
            "uv",
            "(h, w, 2)",
            "float32",
            ".exr",
            "surface coordinates of the organ in [0, 1], -1 in the background",
        ),
        Output(
            "flow",
            "(h, w, 3)",
            "float32",
            ".exr",
            "pixels to where it lies in the path's next frame, and whether it is visible there",
        ),
        Output(
            "stereo",
            "(h, w, 3)",
            "float32",
            ".exr",
            "pixels to where it lies for the camera at the baseline, and whether it is visible there",
        ),
        Output(
            "colour_stereo",
            "(h, w, 3)",
            "uint8",
            ".png",
            "the developed photograph of the camera at the baseline, sRGB",
            traced=True,
        ),
        Output("harvest", "", "dict", ".json", "what a robot needs to know of each fruit in view"),
    )
}
PARTNERED: Final = frozenset({"stereo", "colour_stereo"})
"""Outputs that need a second camera beside the first."""

DEFAULT_OUTPUTS: Final = ("colour", "class", "instance", "distance", "distance_code")


def check_outputs(names: Iterable[str]) -> tuple[str, ...]:
    """The output names in canonical order, without repeats.

    Raises:
        ArgumentError: a name is unknown, or there is none at all.
    """
    wanted = list(names)
    for name in wanted:
        if name not in OUTPUTS:
            raise ArgumentError("outputs", f"unknown output {name!r}; allowed are {', '.join(OUTPUTS)}")
    if not wanted:
        raise ArgumentError("outputs", f"at least one output is needed of {', '.join(OUTPUTS)}")
    return tuple(name for name in OUTPUTS if name in wanted)


@dataclass(frozen=True, eq=False)
class Frame:
    """One rendered view.

    Attributes:
        images: array by output name, as `OUTPUTS` tells; of "harvest" a JSON-ready object.
        facts: JSON-ready description: camera pose, intrinsics, distortion, exposure, variant, versions,
            and the instances in view.
    """

    images: Mapping[str, Any]
    metadata: Mapping[str, Any] = field(default_factory=dict)

    def __getitem__(self, output: str) -> Any:
        return self.images[output]

    @property
    def colour(self) -> NDArray[np.uint8]:
        """`(h, w, 3)` uint8, the developed photograph."""
        photograph: NDArray[np.uint8] = self.images["colour"]
        return photograph
