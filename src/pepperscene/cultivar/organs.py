"""The organ kinds of a cultivar: the parameters of each form, and what grows on it.

Codes such as P-1 or L-4 are those of Barth et al. 2018, Table 1. Inclinations are above the horizontal,
positive upwards, in the vertical plane that the organ grows in. What a file leaves out is neutral.
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
from pepperscene.cultivar.notation import Angle, Factor, Lobes, Number, Ratio, Share, Size, Width
from pepperscene.cultivar.slot import Slot
from pepperscene.document import Document

OrganForm = Literal["internode", "node", "stalk", "blade", "peduncle", "calyx", "fruit", "cut", "flower"]
FORMS: Final[tuple[OrganForm, ...]] = get_args(OrganForm)


@dataclass(frozen=True)
class OrganKind:
    """An organ kind: its body, what it is labelled as, and what its surface is.

    Attributes:
        form: the body that geometry gives it.
        organ_class: of all its pixels.
        surface: the surface that light meets.
        scan: file of a scanned mesh that takes the place of the body, or None.
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
"""What a kind of each form is where its file does not say otherwise."""


LARGEST_FRUIT_M: Final = 0.6
"""Chosen: no crop on a string bears larger ones, and a metre instead of a millimetre is soon written."""

ClassName = Literal["background", "leaf", "pepper", "peduncle", "stem", "shoot", "cut"]


def _always(value: float) -> Distribution:
    """A parameter that a file may leave out."""
    why = "neutral where the file says nothing else"
    return Distribution(law="value", mean=value, sd=0.0, low=value, high=value, chosen=why)


class OrganModel(Document):
    """What all organ kinds have.

    Attributes:
        form: the body that geometry gives it.
        organ_class: `class` in the file; the form's usual one if None.
        surface: the surface that light meets; the form's usual one if None.
        depth: how many of this kind can follow one another; None without end.
        bears: its slots.
        source: of the plain numbers.
        chosen: why the plain numbers are what they are.
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
        """Form, class and surface, with what the form usually has where the file is silent."""
        usual = USUAL[self.form]
        named = usual.organ_class if self.organ_class is None else OrganClass[self.organ_class.upper()]
        return OrganKind(self.form, named, self.surface or usual.surface, self._scan)

    @property
    def distributions(self) -> dict[str, Distribution]:
        """Every random parameter by its name, in the order of the form's list."""
        every = ((name, getattr(self, name)) for name in type(self).model_fields)
        return {name: value for name, value in every if isinstance(value, Distribution)}

    @property
    def _scan(self) -> Path | None:
        return None


class Internode(OrganModel):
    """A section of the main stem. Attributes: length (I-1), from node to node; groove: its depth."""

    form: Literal["internode"]
    length: Size
    groove: Width = _always(0.0)
    state: Share = _always(0.6)
    state_spread: Share = _always(0.12)


class Node(OrganModel):
    """The swelling between two sections. Attributes: width (I-2) and length."""

    form: Literal["node"]
    width: Size
    length: Size
    state: Share = _always(0.6)


class Stalk(OrganModel):
    """A petiole, a side shoot, a leaf's rachis, a pedicel.

    Attributes:
        diameter: at its base.
        tip: diameter at its end, as a ratio to that.
        inclination: at its base.
        bend: of the inclination from base to end; negative is downwards.
        sway: bend out of its vertical plane, counter-clockwise.
        towards: share of the way to the inclination of the blade at its tip that the stalk itself bends.
        channel: 1 for a channel along its upper side.
    """

    form: Literal["stalk"]
    length: Size
    diameter: Size
    tip: Factor = _always(1.0)
    inclination: Angle
    bend: Angle = _always(0.0)
    sway: Angle = _always(0.0)
    state: Share = _always(0.6)
    state_spread: Share = _always(0.12)
    towards: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    channel: Annotated[int, Field(ge=0, le=1)] = 0


class Peduncle(OrganModel):
    """The stalk of a fruit. Attributes: length (P-1) and its bend from `inclination` to `end_inclination`."""

    form: Literal["peduncle"]
    length: Size
    diameter: Size
    tip: Factor = _always(1.0)
    inclination: Angle
    end_inclination: Angle
    state: Share = _always(0.6)


class Blade(OrganModel):
    """A leaf's or a leaflet's blade.

    Attributes:
        length: of the midrib.
        width: of the flat blade.
        inclination: of the midrib, half-way along.
        droop: downward bend of the midrib from base to tip.
        sway: its sideways bend, counter-clockwise.
        roll: about the midrib.
        fold: by which each half is lifted.
        curl: cross-curvature of each half, margins up when positive.
        twist: of the tip against the base.
        margin_wave: amplitude of the waves along a margin.
        margin_waves: how many there are.
        blister: height of the bulges between the veins.
        vein: depth of the sunken secondary veins.
        asymmetry: by how much one half is wider than the mean half.
        widest: place of the greatest width, 0 base to 1 tip.
        base: power of the outline at the base; small is broad.
        lobes: teeth or lobes along each margin; 0 is entire.
        lobe_depth: their depth, as a share of half the width.
        state: 0 pale to 1 dark green.
        state_spread: mottling within a blade.
        size_correlation: of length and width, by a Gaussian copula.
    """

    form: Literal["blade"]
    length: Size
    width: Size
    inclination: Angle
    droop: Angle = _always(0.0)
    sway: Angle = _always(0.0)
    roll: Angle = _always(0.0)
    fold: Angle = _always(0.0)
    curl: Angle = _always(0.0)
    twist: Angle = _always(0.0)
    margin_wave: Width = _always(0.0)
    margin_waves: Factor = _always(4.0)
    blister: Width = _always(0.0)
    vein: Width = _always(0.0)
    asymmetry: Ratio = _always(0.0)
    widest: Share = _always(0.35)
    base: Factor = _always(0.8)
    lobes: Ratio = _always(0.0)
    lobe_depth: Share = _always(0.0)
    state: Share = _always(0.7)
    state_spread: Share = _always(0.1)
    size_correlation: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0


class Fruit(OrganModel):
    """A fruit and the calyx that it hangs from.

    Attributes:
        diameter: F-2, of a grown fruit.
        slenderness: length divided by diameter.
        inclination: of the axis from stalk end to blossom end, about -90 degrees.
        aside: azimuth of the axis against that of its peduncle.
        lobe_depth: of the furrows; 1 is typical of a blocky pepper.
        shoulder: how far the shoulders rise above the stalk.
        taper: diameter near the blossom end by the greatest.
        point: 0 blocky to 1 drawn out to a point.
        bend: of the axis.
        calyx_radius: of the fruit's diameter, to the longest teeth.
        calyx_tooth: depth of the calyx' teeth, of its radius.
        calyx_state: pigment state of the calyx.
        ripe_fraction: share of the grown fruit that is ripe; that of a young top is green.
        ripe_descent: how much that share rises towards the foot, where fruit is older, and falls to the top,
            over half the plant's height.
        breaker_fraction: share of fruit that is turning, taken from both sides alike.
        unripe, breaker, ripe: ripeness of such fruit, 0 green to 1 ripe.
        ripeness_spread: how unevenly a fruit colours.
        lobes: two to five.
        scan: a mesh file that takes the place of the body.
        calyx: whether there is one.
    """

    form: Literal["fruit"]
    diameter: Size
    slenderness: Factor
    inclination: Angle
    aside: Angle = _always(0.0)
    lobe_depth: Ratio = _always(0.0)
    shoulder: Ratio = _always(0.0)
    taper: Factor = _always(1.0)
    point: Share = _always(0.0)
    bend: Angle = _always(0.0)
    calyx_radius: Factor = _always(0.27)
    calyx_tooth: Share = _always(0.28)
    calyx_state: Share = _always(0.5)
    ripe_fraction: Share = _always(0.0)
    ripe_descent: Share = _always(0.0)
    breaker_fraction: Share = _always(0.0)
    unripe: Share = _always(0.0)
    breaker: Share = _always(0.5)
    ripe: Share = _always(1.0)
    ripeness_spread: Share = _always(0.0)
    lobes: Lobes = Number(probabilities={"four": 1.0}, chosen="the usual number of a blocky pepper")
    scan: Path | None = None
    calyx: bool = True

    @property
    def _scan(self) -> Path | None:
        return self.scan

    @model_validator(mode="after")
    def _shares_fit(self) -> Self:
        ripe, descent = self.ripe_fraction, self.ripe_descent
        if ripe.high + descent.high > 1.0 + 1e-9 or ripe.low - descent.high < -1e-9:
            raise ValueError(
                "ripe_descent must leave the share of ripe fruit within [0, 1] at both ends of the plant"
            )
        if self.diameter.high > LARGEST_FRUIT_M:
            raise ValueError(
                f"diameter reaches {1e3 * self.diameter.high:g} mm, and fruit must be at most "
                f"{1e3 * LARGEST_FRUIT_M:g} mm wide"
            )
        return self


class Cut(OrganModel):
    """The scar of a harvested fruit's stalk. Attributes: length of the stump, and its inclination."""

    form: Literal["cut"]
    diameter: Size
    length: Size
    inclination: Angle = _always(0.0)


class Flower(OrganModel):
    """A flower. Attributes: diameter when flat; open: 0 bud to 1 flat; state: along the petals' pigments."""

    form: Literal["flower"]
    diameter: Size
    open: Share = _always(0.8)
    inclination: Angle
    state: Share = _always(0.8)
    petals: Annotated[int, Field(ge=3, le=12)] = 6


MODELS: Final[Mapping[str, type[OrganModel]]] = {
    get_args(model.model_fields["form"].annotation)[0]: model
    for model in (Internode, Node, Stalk, Blade, Peduncle, Fruit, Cut, Flower)
}
"""The parameters of each form; a calyx comes with its fruit."""


def _by_form(raw: Any) -> Any:
    """An organ kind's table, read by the form that it names."""
    if isinstance(raw, OrganModel):
        return raw
    if not isinstance(raw, Mapping):
        raise ValueError("must be a table with a form and that form's parameters")
    form = raw.get("form")
    if not isinstance(form, str) or form not in MODELS:
        # A kind without a form is most often the misspelt name of one that is inherited.
        missing = "" if "form" in raw else " (it is missing, and no kind of this name is inherited)"
        allowed = ", ".join(name for name in FORMS if name in MODELS)
        raise ValueError(f"form must be one of {allowed}{missing}")
    return MODELS[form].model_validate(raw)


AnyOrgan = Annotated[OrganModel, BeforeValidator(_by_form)]
