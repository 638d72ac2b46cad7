"""What a render gives: images by output name, and the facts that belong to them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.errors import InputError


@dataclass(frozen=True)
class Output:
    """One kind of image that a frame can hold.

    Attributes:
        name: as on the command line, and the name of its folder in a data set.
        shape: of the array: h rows and w columns; c channels, 3 of a colour sensor and 1 of a monochrome one;
            H rows and W columns of photosites.
        dtype: of the array.
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
    def channels(self) -> tuple[int, ...]:
        """How many values a pixel may have along a third axis; empty where there is no such axis."""
        return {"3)": (3,), "c)": (1, 3)}.get(self.shape[-2:], ())

    def fits(self, image: NDArray[Any]) -> bool:
        """Whether an array has this output's type, axes and channels."""
        axes = image.ndim == 3 and image.shape[2] in self.channels if self.channels else image.ndim == 2
        return axes and image.dtype == np.dtype(self.dtype)


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
    )
}
DEFAULT_OUTPUTS: Final = ("colour", "class", "instance", "distance", "distance_code")


def check_outputs(names: Iterable[str], where: str = "--outputs") -> tuple[str, ...]:
    """The output names in canonical order, without repeats.

    Raises:
        InputError: a name is unknown, or there is none at all.
    """
    wanted = list(names)
    for name in wanted:
        if name not in OUTPUTS:
            raise InputError(where, "", None, f"unknown output {name!r}; allowed are {', '.join(OUTPUTS)}")
    if not wanted:
        raise InputError(where, "", None, f"at least one output is needed of {', '.join(OUTPUTS)}")
    return tuple(name for name in OUTPUTS if name in wanted)


@dataclass(frozen=True, eq=False)
class Frame:
    """One rendered view.

    Attributes:
        images: array by output name, as `OUTPUTS` tells.
        facts: JSON-ready description: camera pose, intrinsics, distortion, exposure, variant, versions,
            and the instances in view.
    """

    images: Mapping[str, NDArray[Any]]
    facts: Mapping[str, Any] = field(default_factory=dict)

    def __getitem__(self, output: str) -> NDArray[Any]:
        return self.images[output]

    @property
    def colour(self) -> NDArray[np.uint8]:
        """`(h, w, 3)` uint8, the developed photograph."""
        return self.images["colour"]
