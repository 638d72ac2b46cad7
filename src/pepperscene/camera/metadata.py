"""The keys of a camera in a frame's JSON that are read again, and the lens and sensor that they describe.

`Camera.to_metadata` writes them with all others, and `Camera.from_metadata` reads them.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Annotated, Any, Final, TypeVar

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from pepperscene.camera.optics.distortion import MODELS, LensModel, make_distortion
from pepperscene.camera.optics.lens import Lens
from pepperscene.camera.sensor.sensor import Sensor
from pepperscene.spectra import Spectrum

LARGEST: Final = 1e12
"""Chosen: no number of a data set comes near, and sums and squares of such numbers stay finite."""
LARGEST_SIDE: Final = 65_535
"""Chosen: pixels; masks of such images have fewer than 2^32, as pycocotools needs."""
_PITCH_M: Final = 2.0**-17
"""Pitch of the pixels. Chosen: with any power of two, focal lengths in pixels stay exact."""

Item = TypeVar("Item")


def _refuse_surrogates(text: str) -> str:
    """JSON can hold halves of UTF-16 pairs, which no text file can."""
    if not text.isascii() and any("\ud800" <= letter <= "\udfff" for letter in text):
        raise ValueError("must be text without unpaired surrogates")
    return text


Text = Annotated[str, AfterValidator(_refuse_surrogates)]
Real = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
Three = Annotated[list[Item], Field(min_length=3, max_length=3)]
Four = Annotated[list[Item], Field(min_length=4, max_length=4)]
Pose = Four[Four[Real]]
"""`(4, 4)`, row by row."""


class RecordedFields(BaseModel):
    """The keys of a JSON object that readers use, of exactly these types; further keys are ignored."""

    model_config = ConfigDict(strict=True, frozen=True, extra="ignore", allow_inf_nan=False)


class _Distortion(RecordedFields):
    k1: Real
    k2: Real
    k3: Real
    p1: Real = 0.0
    p2: Real = 0.0
    k4: Real = 0.0
    k5: Real = 0.0
    k6: Real = 0.0
    model: Text = "plumb_bob"


class _Motion(RecordedFields):
    velocity_m_s: Three[Real]
    angular_velocity_rad_s: Three[Real]
    labels_per_row: bool = True


class _Band(RecordedFields):
    name: Text
    centre_nm: Real
    width_nm: Real


class CameraMetadata(RecordedFields):
    """The camera in `frames/000000.json`."""

    pose: Pose
    fx: Real
    fy: Real
    cx: Real
    cy: Real
    distortion: _Distortion
    width: Annotated[int, Field(ge=1, le=LARGEST_SIDE)] | None = None
    height: Annotated[int, Field(ge=1, le=LARGEST_SIDE)] | None = None
    line_time_s: Annotated[float, Field(ge=0, le=LARGEST)] = 0.0
    line_scan: bool = False
    bands: list[_Band] = []
    motion: _Motion | None = None


def recorded_optics(metadata: Mapping[str, Any]) -> tuple[Lens, Sensor]:
    """Lens and sensor with the geometry of `CameraMetadata`; values of light and electrons are placeholders.

    The same objects for equal values, since rays are cached by them. Raises as `Camera.from_metadata`.
    """
    distortion = metadata["distortion"]
    model = distortion.get("model", "plumb_bob")
    return _optics(
        model,
        tuple(float(distortion.get(name, 0.0)) for name in MODELS[model]),
        tuple(float(metadata[name]) for name in ("fx", "fy", "cx", "cy")),
        (int(metadata["width"]), int(metadata["height"])),
        float(metadata.get("line_time_s") or 0.0),
        bool(metadata.get("line_scan", False)),
    )


@lru_cache(maxsize=8)
def _optics(
    model: LensModel,
    coefficients: tuple[float, ...],
    intrinsics: tuple[float, ...],
    size: tuple[int, int],
    line_time_s: float,
    line_scan: bool,
) -> tuple[Lens, Sensor]:
    (fx, fy, cx, cy), (width, height) = intrinsics, size
    sensor = Sensor(
        name="the recorded camera",
        columns=width,
        rows=height,
        pitch_m=_PITCH_M,
        quantum_efficiency=Spectrum(np.array([400.0, 700.0]), np.ones((1, 2))),
        full_well_e=1.0,
        read_noise_e=0.0,
        bits=8,
        black_level_dn=0.0,
        binning=1,
        pattern="mono",
        line_time_s=line_time_s,
        line_scan=line_scan,
    )
    lens = Lens(
        name="the recorded camera",
        focal_length_m=fx * _PITCH_M,
        f_number=1.0,
        distortion=make_distortion(model, coefficients),
        principal_offset_m=((cx - width / 2) * _PITCH_M, (cy - height / 2) * _PITCH_M),
        fy_over_fx=fy / fx,
    )
    return lens, sensor
