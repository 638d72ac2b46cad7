"""The form of what a comparison finds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from pepperscene.colour.comparison.measure import SetMeasures
from pepperscene.colour.statistics.bootstrap import LEVEL, REPLICATES, Estimate

if TYPE_CHECKING:
    from pepperscene.colour.comparison.tables import TextTable


FORMAT: Final = "pepperscene compare 1"


@dataclass(frozen=True)
class KindSide:
    """One kind of organ in one of the sets.

    Attributes:
        pictures: in whose middle it is seen.
        pixels: of it there.
        hue_mean_deg: mean direction of its hues.
        hue_spread_deg: their circular standard deviation.
        grey_share: of its pixels, that have no hue.
        lab: CIELAB (D65) of the mean of its pixels' linear colours.
        lab_spread: standard deviation of its pixels' L*, a*, b*.
        share: of all pixels of the whole pictures, in [0, 1].
    """

    pictures: int
    pixels: int
    hue_mean_deg: Estimate
    hue_spread_deg: Estimate
    grey_share: Estimate
    lab: tuple[Estimate, Estimate, Estimate]
    lab_spread: tuple[Estimate, Estimate, Estimate]
    share: Estimate


@dataclass(frozen=True)
class KindComparison:
    """One kind of organ in both sets.

    Attributes:
        kind: a class in lower case, and maybe a stage after a dot.
        hue_correlation: Pearson's, of the two hue spectra over their 180 bins (Fig. 12).
        hue_emd_deg: earth mover's distance of the two spectra on the circle, degrees.
        delta_e_2000: between the two mean colours.
        place_correlation: Pearson's, of the two mean masks (Fig. 11).
        place_ssim: their structural similarity, each over its greatest value as in the figure.
        one: the kind in the first set.
        other: in the second.
    """

    kind: str
    hue_correlation: Estimate
    hue_emd_deg: Estimate
    delta_e_2000: Estimate
    place_correlation: Estimate
    place_ssim: Estimate
    one: KindSide
    other: KindSide


@dataclass(frozen=True)
class LightComparison:
    """The light of both sets (Fig. 13).

    Attributes:
        correlation: Pearson's, of the two mean intensity images.
        ssim: their structural similarity, at the levels that they have.
        falloff_correlation: of their means in rings around the middle.
        one: mean grey value of the first set's pictures, 0 to 255.
        other: of the second's.
        one_spread: standard deviation of that between pictures; None without photographs.
        other_spread: likewise.
    """

    correlation: Estimate
    ssim: Estimate
    falloff_correlation: Estimate
    one: Estimate
    other: Estimate
    one_spread: float | None
    other_spread: float | None


@dataclass(frozen=True, eq=False)
class Comparison:
    """What `compare` finds.

    Attributes:
        one: sums over the first set, as the figure shows them.
        other: over the second.
        names: what the two are called; never the same.
        kinds: by name: classes, and their stages where both sides tell them.
        hue_correlation: mean of the classes' hue correlations over all plant parts that both sets show.
        share_correlation: of the class shares, over the classes that both sets know (Fig. 10).
        light: of the pictures.
    """

    one: SetMeasures = field(repr=False)
    other: SetMeasures = field(repr=False)
    names: tuple[str, str]
    kinds: Mapping[str, KindComparison]
    hue_correlation: Estimate
    share_correlation: Estimate
    light: LightComparison

    def json(self) -> dict[str, Any]:
        """Everything as JSON holds it: a number is null where it is not known, and `why` tells the reason."""
        from pepperscene.colour.comparison.tables import to_json

        sides = zip(self.names, (self.one, self.other), strict=True)
        first, second = ({"name": name, "measured": side.units, "of": side.of} for name, side in sides)
        return {
            "format": FORMAT,
            "one": first,
            "other": second,
            "interval": {"level": LEVEL, "replicates": REPLICATES},
            "hue_correlation": to_json(self.hue_correlation),
            "share_correlation": to_json(self.share_correlation),
            "kinds": {
                name: {key: value for key, value in to_json(found).items() if key != "kind"}
                for name, found in self.kinds.items()
            },
            "light": to_json(self.light),
        }

    def tables(self) -> tuple[TextTable, ...]:
        """Everything as tables for people."""
        from pepperscene.colour.comparison.tables import comparison_tables

        return comparison_tables(self)

    def table(self) -> str:
        """The tables as lines of text."""
        from pepperscene.colour.comparison.tables import format_tables

        return format_tables(self.tables())

    def figure(self) -> str:
        """Figs. 10 to 13 of the paper with both sets in one picture, as SVG."""
        from pepperscene.colour.comparison.figure import figure

        return figure(self)
