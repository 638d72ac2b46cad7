"""The outputs of a render, each declared once.

`pepperscene.render.photographs`, `.aov.label_images` and `.aov.light_images` register how they are rendered,
and `pepperscene.review.check` how they are checked beyond their limits.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import KW_ONLY, dataclass
from typing import Any, Final, Literal

import numpy as np

from pepperscene.classes import IGNORE_CLASS, OrganClass
from pepperscene.errors import ArgumentError
from pepperscene.user_files import FileKind

Need = Literal["light", "surfaces", "colours", "bands", "stereo", "depth_camera", "tissue", "meters"]
"""What an output can need: traced light, the spectra of the surfaces, a sensor with colours (or a monochrome
one) or with bands, the stereo partner, a depth camera, contents of tissue, or meters on surfaces."""


@dataclass(frozen=True)
class Output:
    """One kind of image, or of JSON object, that a frame can hold.

    Attributes:
        name: its name, also that of its folder in a data set.
        shape: of the array: h rows and w columns; c channels, 3 of a colour sensor, 1 of a monochrome one, or
            its bands; H rows and W columns of photosites. Empty for a JSON object.
        dtype: of the array; "dict" for a JSON object.
        unit: of its values, or their range; also in the header of an EXR file.
        meaning: further remarks, Markdown of the page of outputs.
        needs: what it is rendered from; otherwise rays through the pixels suffice.
        channel_names: names along the third axis in an EXR file, unless they are those of the sensor.
        in_runs: whether its rows consist of runs of equal values, which compress well.
        padding: value of pixels outside the image.
        limits: smallest and largest value of an output whose other pixels, such as the sky, have `padding`.
        field: of `LabelledImage` that it is read into; empty for none.
    """

    name: str
    shape: str
    dtype: str
    unit: str
    meaning: str = ""
    _: KW_ONLY
    needs: frozenset[Need] = frozenset()
    channel_names: tuple[str, ...] = ()
    in_runs: bool = False
    padding: float = 0.0
    limits: tuple[float, float] | None = None
    field: str = ""

    @property
    def is_image(self) -> bool:
        """Whether it is an array; otherwise it is a JSON object."""
        return self.dtype != "dict"

    @property
    def traced(self) -> bool:
        """Whether it needs light transport."""
        return "light" in self.needs

    @property
    def suffix(self) -> str:
        """Suffix of its file in a data set."""
        if self.name == "photo":
            return ".jpg"
        return ".json" if not self.is_image else ".exr" if self.dtype.startswith("float") else ".png"

    @property
    def file_kind(self) -> FileKind:
        """Kind of its file, which limits the length."""
        kinds: dict[str, FileKind] = {".json": "json", ".exr": "values", ".png": "image", ".jpg": "image"}
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


_LARGEST: Final = float(np.finfo(np.float32).max)


def _trait(name: str, unit: str, meaning: str, field: str, most: float = _LARGEST, **options: Any) -> Output:
    """An output of what the tissue behind a pixel's centre holds."""
    options |= {"padding": np.nan, "limits": (0.0, most), "needs": frozenset({"surfaces", "tissue"})}
    return Output(name, "(h, w)", "float32", unit, meaning, field=field, **options)


def _light(name: str, meaning: str) -> Output:
    """An output of the light at the surface behind a pixel's centre."""
    options: dict[str, Any] = {
        "padding": np.nan,
        "limits": (0.0, _LARGEST),
        "needs": frozenset({"surfaces", "meters"}),
    }
    return Output(name, "(h, w)", "float32", "W m-2", meaning, **options)


_PHOTO: Final[frozenset[Need]] = frozenset({"light", "colours"})
_BANDS: Final[frozenset[Need]] = frozenset({"light", "bands"})
_IMAGER: Final[frozenset[Need]] = frozenset({"light", "depth_camera"})
_CLASSES: Final = tuple(organ_class.name.lower() for organ_class in OrganClass)
_ALL: Final = (
    Output("colour", "(h, w, 3)", "uint8", "sRGB", "the developed photograph", needs=_PHOTO, field="colour"),
    Output("photo", "(h, w, 3)", "uint8", "sRGB", "the same as [JPEG](#jpeg)", needs=_PHOTO, field="colour"),
    Output(
        "raw",
        "(H, W)",
        "uint16",
        "digital numbers",
        "output of the sensor's converter for every photosite, see below",
        needs=_PHOTO,
    ),
    Output(
        "electrons",
        "(h, w, c)",
        "float32",
        "photo-electrons per photosite",
        "expected ones of each colour or band, before noise and saturation",
        needs=frozenset({"light"}),
        channel_names=("R", "G", "B"),
    ),
    Output(
        "class",
        "(h, w)",
        "uint8",
        "0 to 7, and 255",
        "class ids, and 255 for pixels to ignore; the palette is for viewing only",
        padding=IGNORE_CLASS,
        field="classes",
    ),
    Output(
        "class_colour",
        "(h, w, 3)",
        "uint8",
        "sRGB",
        "class colours of the published data set",
        field="classes",
    ),
    Output(
        "instance",
        "(h, w)",
        "uint16",
        "0 to 65,535",
        "number of the organ or object; 0 is the sky. Objects that are not organs (gutter, floor) have a "
        "number too, and the class background",
        field="instances",
    ),
    Output(
        "distance",
        "(h, w)",
        "float32",
        "metres along the ray from the projection centre",
        "infinite in the sky",
        padding=np.inf,
        field="distance_m",
    ),
    Output(
        "distance_code",
        "(h, w)",
        "uint8",
        "0 to 255",
        "distance in the code of the published data set, see below",
        field="distance_m",
    ),
    Output(
        "depth_z",
        "(h, w)",
        "float32",
        "metres along the optical axis",
        "infinite in the sky",
        padding=np.inf,
        field="depth_z_m",
    ),
    Output(
        "normal",
        "(h, w, 3)",
        "float32",
        "unit vector in world coordinates",
        "of the visible surface; 0 in the sky",
        channel_names=("X", "Y", "Z"),
    ),
    Output(
        "coverage",
        f"(h, w, {len(OrganClass)})",
        "float16",
        "share of the pixel's area",
        "that each class covers, in 64ths, without defocus; they sum to 1, less the fraction of ignored "
        "plants",
        channel_names=_CLASSES,
        in_runs=True,
    ),
    Output(
        "position",
        "(h, w, 3)",
        "float32",
        "metres in world coordinates",
        "of the visible point; infinite in the sky",
        channel_names=("X", "Y", "Z"),
    ),
    Output(
        "uv",
        "(h, w, 2)",
        "float32",
        "surface coordinates from 0 to 1",
        "of the visible point; −1 in the sky",
        channel_names=("U", "V"),
    ),
    Output(
        "flow",
        "(h, w, 3)",
        "float32",
        "pixels right and down to the next frame; 1 where visible there",
        "displacement from the pixel's centre to the same point in the next step's frame",
        channel_names=("flow.x", "flow.y", "visible"),
    ),
    Output(
        "stereo",
        "(h, w, 3)",
        "float32",
        "pixels right and down in the partner's picture; 1 where visible there",
        "the same for the stereo partner's image",
        needs=frozenset({"stereo"}),
        channel_names=("stereo.x", "stereo.y", "visible"),
    ),
    Output(
        "colour_stereo",
        "(h, w, 3)",
        "uint8",
        "sRGB",
        "photograph of the stereo partner",
        needs=_PHOTO | {"stereo"},
    ),
    Output(
        "depth_sensor",
        "(h, w)",
        "float32",
        "metres along the optical axis, as measured; nan in holes",
        "by the [depth camera](recipe.md#depth_camera), in the pixels of the photograph",
        needs=_IMAGER,
        padding=np.nan,
        field="depth_sensor_m",
    ),
    Output(
        "depth_confidence",
        "(h, w)",
        "float32",
        "1 where both images agree, 0 in holes",
        "correlation of the depth camera's images around the point",
        needs=_IMAGER,
    ),
    Output(
        "imager_left",
        "(H, W)",
        "uint8",
        "grey values",
        "image of the depth camera's left imager, at its own size",
        needs=_IMAGER,
    ),
    Output("imager_right", "(H, W)", "uint8", "grey values", "the same of the right imager", needs=_IMAGER),
    Output("harvest", "", "dict", "", "data on each fruit for harvest robots, see [Harvest](harvest.md)"),
    Output(
        "amodal",
        "",
        "dict",
        "",
        "masks of all visible organs with their hidden parts, see [below](#amodal-masks)",
    ),
    Output(
        "albedo",
        "(h, w, c)",
        "float16",
        "diffuse reflectance, linear sRGB, 1 for white",
        "of the surfaces, as the camera develops it; 0 in the sky, see [below](#albedo)",
        needs=frozenset({"surfaces", "colours"}),
        channel_names=("R", "G", "B"),
    ),
    _trait(
        "chlorophyll",
        "micrograms per square centimetre",
        "chlorophyll *a* and *b* of the tissue, per area of leaf or skin; nan where none is modelled, "
        "see [below](#traits-of-tissue)",
        "chlorophyll_ug_cm2",
    ),
    _trait(
        "carotenoids",
        "micrograms per square centimetre",
        "carotenoids of the tissue, likewise",
        "carotenoids_ug_cm2",
    ),
    _trait(
        "water",
        "grams per square centimetre, or centimetres of water",
        "water of leaf blades and petals (equivalent thickness); nan elsewhere",
        "water_cm",
    ),
    _trait("ripeness", "0 unripe to 1 ripe", "ripeness of fruit; nan elsewhere", "ripeness", 1.0),
    _trait(
        "leaf_age",
        "0 healthy to 1 dried up",
        "ageing of leaf blades; nan elsewhere",
        "leaf_age",
        1.0,
        in_runs=True,
    ),
    _light("irradiance", "PAR that arrives at both sides of the surface, unfiltered; nan in the sky"),
    _light("absorbed", "PAR that the surface absorbs, likewise, see [below](#absorbed-light)"),
    Output(
        "bands",
        "(h, w, c)",
        "float32",
        "photo-electrons per photosite, as measured",
        "of each band: with noise, full well and converter, without the black level; sensors with bands "
        "only, see [below](#bands)",
        needs=_BANDS,
        field="bands",
    ),
    Output(
        "radiance",
        "(h, w, c)",
        "float32",
        "W m-2 sr-1 nm-1",
        "mean spectral radiance in each band, in front of lens and filter, without noise",
        needs=_BANDS,
        field="radiance",
    ),
    Output(
        "reflectance",
        "(h, w, c)",
        "float32",
        "1, relative to the white reference",
        "measured electrons of each band relative to those of a white reference",
        needs=_BANDS,
        field="reflectance",
    ),
)
OUTPUTS: Final[Mapping[str, Output]] = {output.name: output for output in _ALL}
"""All outputs by name, in canonical order."""


def outputs_with(need: Need) -> frozenset[str]:
    """Names of the outputs that need this."""
    return frozenset(name for name, output in OUTPUTS.items() if need in output.needs)


BAND_OUTPUTS: Final = outputs_with("bands")
COLOUR_OUTPUTS: Final = outputs_with("colours")
"""Outputs of sensors with colours, or monochrome ones: a sensor with bands has none of them."""
STEREO_OUTPUTS: Final = outputs_with("stereo")
DEPTH_CAMERA_OUTPUTS: Final = outputs_with("depth_camera")
METER_OUTPUTS: Final = outputs_with("meters")
TRAIT_OUTPUTS: Final = outputs_with("tissue")
"""Outputs of what the tissue behind a pixel's centre holds."""


def needs_surfaces(names: Iterable[str]) -> bool:
    """Whether one of these outputs needs the spectra of a scene's surfaces, as traced light does."""
    return any(OUTPUTS[name].needs & {"light", "surfaces"} for name in names)


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
