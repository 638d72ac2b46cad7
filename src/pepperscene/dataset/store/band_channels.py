"""The bands of a sensor in image files: names of channels, and lists of wavelengths in headers."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from pepperscene.camera.optics.white_reference import UNLIT_BANDS
from pepperscene.camera.sensor.bands import Band

_CHANNEL: Final = re.compile(r"B(\d+)(\.\d+nm)?")


def band_channels(count: int, bands: Sequence[Band] = ()) -> tuple[str, ...]:
    """Names of `count` channels: `B01.475nm`, with the centre to a nanometre; `B01` without bands.

    Raises:
        ValueError: there is another number of bands.
    """
    if bands and len(bands) != count:
        raise ValueError(f"{count} channels cannot be those of {len(bands)} bands")
    digits = max(2, len(str(count)))
    centres = [f".{band.centre_nm:.0f}nm" for band in bands] or [""] * count
    return tuple(f"B{number:0{digits}d}{centre}" for number, centre in enumerate(centres, start=1))


def sorted_bands(channels: Iterable[str]) -> tuple[str, ...]:
    """The channels in the order of their bands; empty if they are not those of bands."""
    matches = {name: _CHANNEL.fullmatch(name) for name in channels}
    numbers = {name: int(match[1]) for name, match in matches.items() if match is not None}
    return tuple(sorted(numbers, key=numbers.__getitem__)) if len(numbers) == len(matches) else ()


def band_attributes(bands: Sequence[Band]) -> dict[str, str]:
    """Attributes of an EXR header: centres and full widths at half maximum, and names if there are some."""
    attributes = {
        "wavelength_nm": ", ".join(f"{band.centre_nm:g}" for band in bands),
        "fwhm_nm": ", ".join(f"{band.width_nm:g}" for band in bands),
    }
    if any(band.name for band in bands):
        attributes["band_names"] = ", ".join(band.name for band in bands)
    return attributes


def recorded_bands(metadata: Mapping[str, Any]) -> tuple[Band, ...]:
    """The bands in the JSON of a frame, whose types are valid; empty for a sensor without bands."""
    return tuple(
        Band(entry["name"], entry["centre_nm"], entry["width_nm"])
        for entry in metadata.get("camera", {}).get("bands", ())
    )


def unlit_bands(metadata: Mapping[str, Any]) -> tuple[int, ...]:
    """Bands, from 0, whose reflectance is nan somewhere in a frame, by its JSON, which may be damaged."""
    reference = metadata.get("white_reference")
    listed = reference.get(UNLIT_BANDS, ()) if isinstance(reference, Mapping) else ()
    known = listed if isinstance(listed, list | tuple) else ()
    return tuple(band for band in known if isinstance(band, int) and not isinstance(band, bool))
