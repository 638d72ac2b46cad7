"""Data classes of the result of a comparison, and the result as JSON data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any, Final

from pepperscene.colour.comparison.appearance import WHOLE, AppearanceMeasures
from pepperscene.colour.comparison.bootstrap import LEVEL, REPLICATES, Estimate
from pepperscene.colour.comparison.measure import SetMeasures

FORMAT: Final = "pepperscene compare 1"
_KEYS: Final = {
    "first": "one",
    "second": "other",
    "first_spread": "one_spread",
    "second_spread": "other_spread",
}
"""Keys of the JSON format that differ from attributes: it calls the two sets "one" and "other"."""


@dataclass(frozen=True)
class KindMeasures:
    """Measures of one kind of organ in one set."""

    pictures: int  # number of images that show the kind in their centre
    pixels: int  # number of its pixels there
    hue_mean_deg: Estimate  # mean direction of its hues
    hue_spread_deg: Estimate  # their circular standard deviation
    grey_share: Estimate  # fraction of its pixels that are grey and have no hue
    lab: tuple[Estimate, Estimate, Estimate]  # CIELAB (D65) of the mean linear colour of its pixels
    lab_spread: tuple[Estimate, Estimate, Estimate]  # standard deviation of its pixels' L*, a*, b*
    share: Estimate  # fraction of all pixels of the whole images


@dataclass(frozen=True)
class KindComparison:
    """One kind of organ in both sets.

    Attributes:
        kind: a class in lower case, optionally with a stage after a dot; or "image".
        hue_correlation: Pearson correlation of the two hue spectra over their 180 bins (Fig. 12).
        hue_emd_deg: circular earth mover's distance of the two hue spectra, degrees.
        delta_e_2000: between the two mean colours.
        place_correlation: Pearson correlation of the two mean masks (Fig. 11).
        place_ssim: their structural similarity, each over its maximum as in the figure.
        first: the kind in the first set.
        second: the kind in the second set.
    """

    kind: str
    hue_correlation: Estimate
    hue_emd_deg: Estimate
    delta_e_2000: Estimate
    place_correlation: Estimate
    place_ssim: Estimate
    first: KindMeasures
    second: KindMeasures


@dataclass(frozen=True)
class LightComparison:
    """Brightness of the images of both sets (Fig. 13)."""

    correlation: Estimate  # Pearson correlation of the two mean intensity images
    ssim: Estimate  # their structural similarity, without normalising their levels
    falloff_correlation: Estimate  # correlation of their means in rings around the centre
    first: Estimate  # mean grey value of the first set's images, 0 to 255
    second: Estimate  # of the second set's
    first_spread: float | None  # its standard deviation between images; None without photographs
    second_spread: float | None  # likewise


@dataclass(frozen=True)
class AppearanceComparison:
    """Appearance of one kind of organ, or of whole images, in both sets."""

    first: AppearanceMeasures
    second: AppearanceMeasures


@dataclass(frozen=True, eq=False)
class Comparison:
    """Result of `compare`.

    Attributes:
        first: sums over the first set, as the figure needs them; the names of the two always differ.
        second: over the second set.
        kinds: by name: the whole centre of the images ("image") if both sets have photographs, classes, and
            their stages if both sets have them.
        hue_correlation: mean of the classes' hue correlations over the plant parts that both sets show.
        share_correlation: of the class fractions, over the classes that both sets know (Fig. 10).
        light: brightness of the images.
        appearance: saturation, texture, gloss and clipping: of whole images ("image") and of each class.
    """

    first: SetMeasures = field(repr=False)
    second: SetMeasures = field(repr=False)
    kinds: Mapping[str, KindComparison]
    hue_correlation: Estimate
    share_correlation: Estimate
    light: LightComparison
    appearance: Mapping[str, AppearanceComparison]

    @property
    def sides(self) -> tuple[SetMeasures, SetMeasures]:
        """The first and the second set."""
        return self.first, self.second

    @property
    def classes(self) -> list[KindComparison]:
        """The kinds that are classes: not the whole centre, and no stages."""
        return [kind for kind in self.kinds.values() if kind.kind != WHOLE and "." not in kind.kind]

    @property
    def coloured_kinds(self) -> list[KindComparison]:
        """Kinds whose colours were measured in both sets."""
        return [kind for kind in self.kinds.values() if kind.first.pixels and kind.second.pixels]

    @property
    def labelled_classes(self) -> list[KindComparison]:
        """Classes whose fraction is known in both sets."""
        return [
            kind
            for kind in self.classes
            if kind.first.share.value is not None and kind.second.share.value is not None
        ]


def comparison_json(comparison: Comparison) -> dict[str, Any]:
    """The comparison as JSON data; an unknown number is null, and `why` gives the reason."""
    return {
        "format": FORMAT,
        "one": _set_json(comparison.first),
        "other": _set_json(comparison.second),
        "interval": {"level": LEVEL, "replicates": REPLICATES},
        "hue_correlation": _to_json(comparison.hue_correlation),
        "share_correlation": _to_json(comparison.share_correlation),
        "kinds": {
            name: {key: value for key, value in _to_json(kind).items() if key != "kind"}
            for name, kind in comparison.kinds.items()
        },
        "light": _to_json(comparison.light),
        "appearance": {kind: _to_json(pair) for kind, pair in comparison.appearance.items()},
    }


def _set_json(side: SetMeasures) -> dict[str, Any]:
    """What was measured of a set, and where: sizes in pixels."""
    sizes = [
        {"width": width, "height": height, "centre": centre, "texture_width": side.scale.width(width)}
        for (height, width), centre in sorted(side.centres.items())
    ]
    return {"name": side.name, "measured": side.units, "of": side.available, "sizes": sizes}


def _to_json(value: Any) -> Any:
    """Estimates and the data classes that hold them as JSON data."""
    if isinstance(value, Estimate):
        numbers = {"value": value.value, "low": value.low, "high": value.high}
        return {**numbers, "why": value.why} if value.value is None else numbers
    if is_dataclass(value) and not isinstance(value, type):
        names = [field.name for field in fields(value)]
        return {_KEYS.get(name, name): _to_json(getattr(value, name)) for name in names}
    return [_to_json(item) for item in value] if isinstance(value, tuple) else value
