"""Organ kinds of a cultivar: the parameters of each form, and what grows on it.

Codes such as P-1 or L-4 are those of Barth et al. 2018, Table 1. Inclinations are angles above the
horizontal, in the vertical plane of the organ. Parameters that a file leaves out have a neutral default.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Final, Literal, Self, get_args

from pydantic import BeforeValidator, ConfigDict, Field, model_validator

from pepperscene.classes import OrganClass
from pepperscene.cultivar.distribution import Distribution
from pepperscene.cultivar.notation import Angle, Factor, Fraction, Lobes, Number, Ratio, Size, Width
from pepperscene.cultivar.slot import Slot
from pepperscene.document import Document

OrganForm = Literal["internode", "node", "stalk", "blade", "peduncle", "calyx", "fruit", "cut", "flower"]
FORMS: Final[tuple[OrganForm, ...]] = get_args(OrganForm)


@dataclass(frozen=True)
class OrganKind:
    """Shape, label and surface of an organ kind.

    Attributes:
        form: selects the mesh generator.
        organ_class: label of all its pixels.
        surface: name of its surface.
        scan: file of a scanned mesh to use instead of a generated one, or None.
    """

    form: OrganForm
    organ_class: OrganClass
    surface: str
    scan: Path | None = None


USUAL: Final[Mapping[OrganForm, OrganKind]] = MappingProxyType(
    {
        "internode": OrganKind("internode", OrganClass.STEM, "stem"),
        "node": OrganKind("node", OrganClass.STEM, "stem"),
        "stalk": OrganKind("stalk", OrganClass.SHOOT, "petiole"),
        "blade": OrganKind("blade", OrganClass.LEAF, "leaf"),
        "peduncle": OrganKind("peduncle", OrganClass.PEDUNCLE, "peduncle"),
        "calyx": OrganKind("calyx", OrganClass.PEDUNCLE, "calyx"),
        "fruit": OrganKind("fruit", OrganClass.PEPPER, "fruit"),
        "cut": OrganKind("cut", OrganClass.CUT, "cut"),
        # The published classes have none for flowers.
        "flower": OrganKind("flower", OrganClass.BACKGROUND, "petal"),
    }
)
"""Defaults for kinds of each form."""

LARGEST_FRUIT_M: Final = 0.6
"""Chosen: no crop grown on strings bears larger fruit, and this catches metres instead of millimetres."""

ClassName = Literal["background", "leaf", "pepper", "peduncle", "stem", "shoot", "cut"]


def _default(value: float) -> Distribution:
    return Distribution(law="value", mean=value, sd=0.0, low=value, high=value, chosen="neutral default")


class OrganModel(Document):
    """Parameters of all organ kinds.

    Attributes:
        form: selects the mesh generator.
        organ_class: `class` in the file; None for the form's default.
        surface: name of the surface; None for the form's default.
        depth: how many organs of this kind can follow one another; None for no limit.
        bears: its slots.
        source, chosen: origin of the plain numbers.
    """

    model_config = ConfigDict(populate_by_name=True)

    form: OrganForm
    organ_class: ClassName | None = Field(default=None, alias="class")
    surface: Annotated[str, Field(min_length=1)] | None = None
    depth: Annotated[int, Field(ge=1, le=8)] | None = None
    bears: tuple[Slot, ...] = ()
    source: str = ""
    chosen: str = ""

    @property
    def kind(self) -> OrganKind:
        """Form, class, surface and scan, with the form's defaults."""
        default = USUAL[self.form]
        organ_class = (
            default.organ_class if self.organ_class is None else OrganClass[self.organ_class.upper()]
        )
        return OrganKind(self.form, organ_class, self.surface or default.surface, getattr(self, "scan", None))

    @property
    def distributions(self) -> dict[str, Distribution]:
        """Every random parameter by its name, in the order of the class."""
        values = ((name, getattr(self, name)) for name in type(self).model_fields)
        return {name: value for name, value in values if isinstance(value, Distribution)}


class Internode(OrganModel):
    """Section of the main stem. Attributes: length (I-1), from node to node; groove: its depth."""

    form: Literal["internode"]
    length: Size
    groove: Width = _default(0.0)
    state: Fraction = _default(0.6)
    state_spread: Fraction = _default(0.12)


class Node(OrganModel):
    """Swelling between two sections. Attributes: width (I-2) and length."""

    form: Literal["node"]
    width: Size
    length: Size
    state: Fraction = _default(0.6)


class Stalk(OrganModel):
    """Petiole, side shoot, rachis of a leaf, or pedicel.

    Attributes:
        diameter: at its base.
        tip: ratio of the diameter at its end to that at its base.
        inclination: at its base.
        bend: change of the inclination from base to end; negative is downwards.
        sway: bend out of its vertical plane, counter-clockwise.
        towards: fraction of the way to the inclination of the blade at its tip that the stalk itself bends.
        channel: 1 for a channel along its upper side.
    """

    form: Literal["stalk"]
    length: Size
    diameter: Size
    tip: Factor = _default(1.0)
    inclination: Angle
    bend: Angle = _default(0.0)
    sway: Angle = _default(0.0)
    state: Fraction = _default(0.6)
    state_spread: Fraction = _default(0.12)
    towards: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    channel: Annotated[int, Field(ge=0, le=1)] = 0


class Peduncle(OrganModel):
    """Stalk of a fruit. Attributes: length (P-1) and its bend from `inclination` to `end_inclination`."""

    form: Literal["peduncle"]
    length: Size
    diameter: Size
    tip: Factor = _default(1.0)
    inclination: Angle
    end_inclination: Angle
    state: Fraction = _default(0.6)


class Blade(OrganModel):
    """Blade of a leaf or a leaflet.

    Attributes:
        length: of the midrib.
        width: of the flat blade.
        inclination: of the midrib at its middle.
        droop: downward bend of the midrib from base to tip.
        sway: its sideways bend, counter-clockwise.
        roll: about the midrib.
        fold: angle by which each half is lifted.
        curl: cross-curvature of each half, margins up if positive.
        twist: of the tip relative to the base.
        margin_wave: amplitude of the waves along a margin.
        margin_waves: number of waves.
        blister: height of the bulges between the veins.
        vein: depth of the sunken secondary veins.
        asymmetry: excess width of one half over the mean half, relative.
        widest: position of the greatest width, 0 base to 1 tip.
        base: exponent of the outline at the base; small is broad.
        lobes: number of teeth or lobes along each margin; 0 is entire.
        lobe_depth: their depth, as a fraction of half the width.
        state: 0 pale to 1 dark green.
        state_spread: mottling within a blade.
        size_correlation: of length and width, by a Gaussian copula.
    """

    form: Literal["blade"]
    length: Size
    width: Size
    inclination: Angle
    droop: Angle = _default(0.0)
    sway: Angle = _default(0.0)
    roll: Angle = _default(0.0)
    fold: Angle = _default(0.0)
    curl: Angle = _default(0.0)
    twist: Angle = _default(0.0)
    margin_wave: Width = _default(0.0)
    margin_waves: Factor = _default(4.0)
    blister: Width = _default(0.0)
    vein: Width = _default(0.0)
    asymmetry: Ratio = _default(0.0)
    widest: Fraction = _default(0.35)
    base: Factor = _default(0.8)
    lobes: Ratio = _default(0.0)
    lobe_depth: Fraction = _default(0.0)
    state: Fraction = _default(0.7)
    state_spread: Fraction = _default(0.1)
    size_correlation: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0


class Fruit(OrganModel):
    """Fruit and the calyx that it hangs from.

    Attributes:
        diameter: F-2, of a grown fruit.
        slenderness: length divided by diameter.
        inclination: of the axis from stalk end to blossom end, about -90 degrees.
        aside: azimuth of the axis relative to that of its peduncle.
        lobe_depth: of the furrows; 1 is typical of a blocky pepper.
        shoulder: height of the shoulders above the stalk end.
        taper: ratio of the diameter near the blossom end to the greatest.
        point: 0 blocky to 1 pointed.
        bend: of the axis.
        calyx_radius: to the longest teeth, as a ratio to the fruit's diameter.
        calyx_tooth: depth of the calyx' teeth, as a fraction of its radius.
        calyx_state: pigment state of the calyx.
        ripe_fraction: fraction of the grown fruit that is ripe; fruit of a young top is green.
        ripe_descent: rise of that fraction towards the foot, where fruit is older, and fall towards the top,
            over half the plant's height.
        breaker_fraction: fraction of fruit at the breaker stage, taken equally from the ripe and the unripe.
        unripe, breaker, ripe: ripeness of fruit at that stage, 0 green to 1 ripe.
        ripeness_spread: variation of ripeness within a fruit.
        lobes: two to five.
        scan: a mesh file to use instead of a generated mesh.
        calyx: whether it has one.
    """

    form: Literal["fruit"]
    diameter: Size
    slenderness: Factor
    inclination: Angle
    aside: Angle = _default(0.0)
    lobe_depth: Ratio = _default(0.0)
    shoulder: Ratio = _default(0.0)
    taper: Factor = _default(1.0)
    point: Fraction = _default(0.0)
    bend: Angle = _default(0.0)
    calyx_radius: Factor = _default(0.27)
    calyx_tooth: Fraction = _default(0.28)
    calyx_state: Fraction = _default(0.5)
    ripe_fraction: Fraction = _default(0.0)
    ripe_descent: Fraction = _default(0.0)
    breaker_fraction: Fraction = _default(0.0)
    unripe: Fraction = _default(0.0)
    breaker: Fraction = _default(0.5)
    ripe: Fraction = _default(1.0)
    ripeness_spread: Fraction = _default(0.0)
    lobes: Lobes = Number(probabilities={"four": 1.0}, chosen="the usual number of a blocky pepper")
    scan: Path | None = None
    calyx: bool = True

    @model_validator(mode="after")
    def _check_limits(self) -> Self:
        ripe, descent = self.ripe_fraction, self.ripe_descent
        if ripe.high + descent.high > 1.0 + 1e-9 or ripe.low - descent.high < -1e-9:
            raise ValueError(
                "ripe_descent must keep the fraction of ripe fruit within [0, 1] at both ends of the plant"
            )
        if self.diameter.high > LARGEST_FRUIT_M:
            raise ValueError(
                f"diameter reaches {1e3 * self.diameter.high:g} mm, and fruit must be at most "
                f"{1e3 * LARGEST_FRUIT_M:g} mm wide"
            )
        return self


class Cut(OrganModel):
    """Scar of a harvested fruit's stalk. Attributes: length of the stump, and its inclination."""

    form: Literal["cut"]
    diameter: Size
    length: Size
    inclination: Angle = _default(0.0)


class Flower(OrganModel):
    """Flower. Attributes: diameter when flat; open: 0 bud to 1 flat; state: along the petals' pigments."""

    form: Literal["flower"]
    diameter: Size
    open: Fraction = _default(0.8)
    inclination: Angle
    state: Fraction = _default(0.8)
    petals: Annotated[int, Field(ge=3, le=12)] = 6


MODELS: Final[Mapping[str, type[OrganModel]]] = {
    get_args(model.model_fields["form"].annotation)[0]: model
    for model in (Internode, Node, Stalk, Blade, Peduncle, Fruit, Cut, Flower)
}
"""Parameters of each form except the calyx, which is part of its fruit."""


def _parse_organ(raw: Any) -> Any:
    """Validate an organ kind's table with the model of its form."""
    if isinstance(raw, OrganModel):
        return raw
    if not isinstance(raw, Mapping):
        raise ValueError("must be a table with a form and that form's parameters")
    form = raw.get("form")
    if not isinstance(form, str) or form not in MODELS:
        # A kind without a form is most often a misspelt name of an inherited one.
        hint = "" if "form" in raw else " (it is missing, and no kind of this name is inherited)"
        raise ValueError(f"form must be one of {', '.join(MODELS)}{hint}")
    return MODELS[form].model_validate(raw)


AnyOrgan = Annotated[OrganModel, BeforeValidator(_parse_organ)]
