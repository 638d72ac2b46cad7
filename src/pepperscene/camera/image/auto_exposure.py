"""Automatic exposure: the exposure time, and then the gain, that give an image the wanted mean grey.

Daylight adds to an image for as long as it is exposed, the flash only during its pulse, and with a rolling
shutter only to the rows that are exposed then. So two small images of the light, one of each, predict the
grey of the developed image for every exposure and gain: with the lens' stray light, the pedestal, and the
noise of the sensor, without which dark images would be predicted too dark.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from pepperscene.camera.camera import Camera
from pepperscene.camera.image.metered_image import SUBJECT_METERINGS, Metering, MeterReading, image_meter
from pepperscene.errors import InputError

ExposureLimit = Literal[
    "shortest exposure", "longest exposure and gain", "saturation", "no light", "highlights"
]

_TOLERANCE: Final = 1e-3
"""Relative error of the grey at which the search stops. Chosen: a tenth of a code at the usual grey."""
_MOST_STEPS: Final = 60  # chosen: halves any range of exposures to the resolution of double precision
_MORE_LIGHT: Final = 2.0  # chosen: an image that so much more light leaves as it is shows what is saturated
_MOST_SATURATED: Final = 0.003
"""Predicted share of the metered pixels that may be saturated. Chosen: in views of four recipes, at most 1 %
of the image's are then. Before a bright sky they are up to six times as many, as demosaicing mixes it into
the edges of leaves; by flash half as many."""


@dataclass(frozen=True)
class ExposureControl:
    """What automatic exposure aims at, and the settings that it may use.

    The exposure time is chosen first; the gain is raised only if the longest exposure is too dark. The lowest
    gain is the camera's own.

    Attributes:
        target_grey: mean of the 8-bit codes of the developed image, over pixels and colours, in (0, 255];
            of a sensor with bands, which develops no image, 255 times the mean signal as a fraction of full
            scale, over pixels and bands. The default is chosen: near the middle of the codes, with a margin
            for highlights.
        shortest_s, longest_s: range of exposure times. The defaults are chosen: electronic shutters are
            rarely faster than 10 us, and in 10 ms a camera at walking pace moves by a centimetre.
        most_gain: highest gain of the sensor's amplifier, at least 1. The default is chosen: 12 dB.
        metering: "average" gives all pixels the same weight, "centre" gives more to the middle, "subject" all
            weight to pixels that show the subject, if there are some. With "subject", no more than 0.3 % of
            these are saturated, even if they are darker than the target then. "highlights" has no target: as
            many of these, or of all pixels if none shows the subject, are saturated as that allows.

    Raises:
        InputError: a value is out of range or unknown.
    """

    target_grey: float = 110.0
    shortest_s: float = 10e-6
    longest_s: float = 10e-3
    most_gain: float = 4.0
    metering: Metering = "average"

    def __post_init__(self) -> None:
        # Written so that nan fails too.
        if not 0 < self.target_grey <= 255:
            raise _invalid("target_grey", self.target_grey, "must be above 0 and at most 255")
        if not 0 < self.shortest_s < math.inf:
            raise _invalid("shortest_s", self.shortest_s, "must be positive and finite")
        if not self.shortest_s <= self.longest_s < math.inf:
            allowed = f"must be finite and at least shortest_s, {self.shortest_s:g}"
            raise _invalid("longest_s", self.longest_s, allowed)
        if not 1 <= self.most_gain < math.inf:
            raise _invalid("most_gain", self.most_gain, "must be finite and at least 1")
        if self.metering not in get_args(Metering):
            raise _invalid("metering", self.metering, f"must be one of {', '.join(get_args(Metering))}")


def _invalid(key: str, value: object, allowed: str) -> InputError:
    return InputError("exposure_control", allowed, key=key, value=value)


@dataclass(frozen=True)
class ChosenExposure:
    """Settings chosen by automatic exposure.

    Attributes:
        exposure_s: exposure time.
        gain: of the sensor's amplifier.
        grey: predicted mean of the image's codes, weighted as the metering says.
        limited_by: why the grey is not the target; None if it is. "saturation": more light would not make the
            image brighter; then the exposure is the shortest that gives this grey. "shortest exposure": also
            the shortest with which a rolling shutter exposes all rows to the flash, if that is too bright.
            "highlights": more light would saturate too much of the subject.
        metering: what was used for "subject" and "highlights": "average" where no pixel shows the subject.
        saturated: with these, the predicted share of the metered pixels that are saturated.
    """

    exposure_s: float
    gain: float
    grey: float
    limited_by: ExposureLimit | None = None
    metering: Metering | None = None
    saturated: float | None = None

    def to_json(self) -> dict[str, Any]:
        """JSON-ready values, without those that do not apply."""
        values = dataclasses.asdict(self)
        return {key: values[key] for key in values if key == "limited_by" or values[key] is not None}


def choose_exposure(
    camera: Camera,
    daylight: ArrayLike,
    flash: ArrayLike,
    control: ExposureControl,
    subject: ArrayLike | None = None,
) -> ChosenExposure:
    """Choose the exposure time and gain with which the developed image has the wanted mean grey.

    Deterministic: found by bisection, to 0.1 % of the grey.

    Args:
        camera: its optics, sensor, flash and developing; its exposure has no effect.
        daylight: `(h, w, c)` constant light of a reduced image over the camera's whole field of view, in the
            unit of the signal of `expected_electrons`.
        flash: `(h, w, c)` the same of the flash while it is on; zeros without a flash.
        control: the wanted grey and the allowed settings.
        subject: `(h, w)` share of each pixel that shows the subject, for a metering that needs it; None for
            no subject.

    Raises:
        InputError: the camera's own gain is above the highest allowed, or its sensor cannot distinguish
            colours under the reference light.
        ValueError: the images' shapes do not fit, light is not finite, the flash has light and the camera has
            no flash, or the white balance needs a missing flash.
    """
    lowest, metering = camera.sensor.gain, control.metering
    if lowest > control.most_gain:
        raise _invalid("most_gain", control.most_gain, f"must be at least the camera's own gain, {lowest:g}")
    shown = None if subject is None else np.asarray(subject, float)
    read = image_meter(camera, np.asarray(daylight, float), np.asarray(flash, float), metering, shown)
    if not (np.any(daylight) or np.any(flash)):
        grey = read(control.longest_s, control.most_gain, 1.0).grey
        chosen = ChosenExposure(control.longest_s, control.most_gain, grey, "no light")
    elif metering == "highlights":
        chosen = _spare_highlights(read, lowest, control)
    else:
        chosen = _reach_grey(read, lowest, control)
    if metering not in SUBJECT_METERINGS:
        return chosen

    # A subject with highlights is darker than the target rather than saturated.
    has_subject = shown is not None and bool(shown.any())
    saturated = read(chosen.exposure_s, chosen.gain, 1.0).saturated
    if metering == "subject" and has_subject and saturated > _MOST_SATURATED:
        spared = _spare_highlights(read, lowest, control)
        chosen = dataclasses.replace(spared, limited_by=spared.limited_by or "highlights")
        saturated = read(chosen.exposure_s, chosen.gain, 1.0).saturated
    used: Metering = metering if has_subject or metering == "highlights" else "average"
    return dataclasses.replace(chosen, metering=used, saturated=saturated)


def _reach_grey(read: MeterReading, lowest: float, control: ExposureControl) -> ChosenExposure:
    """The settings with the wanted grey, from the lowest gain upwards; there is light."""
    longest, most = control.longest_s, control.most_gain

    # A target that no setting reaches.
    brightest = read(longest, most, 1.0).grey
    target = control.target_grey
    limit: ExposureLimit | None = None
    if brightest < target * (1.0 - _TOLERANCE):
        # What light adds to the grey of black, which is not 0.
        added = brightest - read(longest, most, 0.0).grey
        if read(longest, most, _MORE_LIGHT).grey - brightest >= _TOLERANCE * added:
            return ChosenExposure(longest, most, brightest, "longest exposure and gain")
        target, limit = brightest * (1.0 - _TOLERANCE), "saturation"

    # The exposure time first, then the gain.
    exposure_s, gain = longest, lowest
    if read(longest, lowest, 1.0).grey < target * (1.0 - _TOLERANCE):
        gain, grey = _search(lambda gain: read(longest, gain, 1.0).grey, lowest, most, target)
    else:
        exposure_s, grey = _search(
            lambda exposure_s: read(exposure_s, lowest, 1.0).grey, control.shortest_s, longest, target
        )
    if grey > control.target_grey * (1.0 + _TOLERANCE):
        limit = "shortest exposure"
    return ChosenExposure(exposure_s, gain, grey, limit)


def _spare_highlights(read: MeterReading, lowest: float, control: ExposureControl) -> ChosenExposure:
    """The brightest settings that saturate no more than may be, from the lowest gain upwards."""

    def is_allowed(exposure_s: float, gain: float) -> bool:
        return read(exposure_s, gain, 1.0).saturated <= _MOST_SATURATED

    shortest, longest = control.shortest_s, control.longest_s
    exposure_s, gain = longest, lowest
    limit: ExposureLimit | None = None
    if is_allowed(longest, control.most_gain):
        gain, limit = control.most_gain, "longest exposure and gain"
    elif is_allowed(longest, lowest):
        gain = _largest(lambda gain: is_allowed(longest, gain), lowest, control.most_gain)
    elif is_allowed(shortest, lowest):
        exposure_s = _largest(lambda exposure_s: is_allowed(exposure_s, lowest), shortest, longest)
    else:
        exposure_s, limit = shortest, "shortest exposure"
    return ChosenExposure(exposure_s, gain, read(exposure_s, gain, 1.0).grey, limit)


def _largest(is_allowed: Callable[[float], bool], low: float, high: float) -> float:
    """The largest allowed value, of which `low` is one and `high` is not, to 0.1 %."""
    while high > low * (1.0 + _TOLERANCE):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if is_allowed(middle) else (low, middle)
    return low


def with_exposure(camera: Camera, chosen: ChosenExposure) -> Camera:
    """The same camera with the chosen exposure time and gain."""
    sensor = camera.sensor
    if chosen.gain != sensor.gain:
        sensor = sensor.with_settings(gain=chosen.gain)
    return dataclasses.replace(camera, sensor=sensor, exposure_s=chosen.exposure_s)


def _search(grey_of: Callable[[float], float], low: float, high: float, target: float) -> tuple[float, float]:
    """The value in [low, high] whose grey is the target, and its grey; `low` if even that is too bright."""
    grey = grey_of(low)
    if grey >= target:
        return low, grey
    for _ in range(_MOST_STEPS):
        middle = math.sqrt(low * high)
        grey = grey_of(middle)
        if abs(grey - target) <= _TOLERANCE * target:
            return middle, grey
        low, high = (middle, high) if grey < target else (low, middle)
    # The grey jumps over the target: that of a rolling shutter does where all rows begin to see the flash.
    return high, grey_of(high)
