"""Organ kinds of a cultivar: the parameters of each form, its slots, and the scans of fruit.

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
from pepperscene.cultivar.notation import (
    Amount,
    Angle,
    Factor,
    Fraction,
    Lobes,
    Number,
    Ratio,
    Size,
    Width,
    check_sum,
)
from pepperscene.cultivar.slot import Slot
from pepperscene.document import Document

ScanAxis = Literal["x", "y", "z", "-x", "-y", "-z"]
ScanUnit = Literal["m", "cm", "mm", "in"]

SCAN_SUFFIXES: Final = (".glb", ".obj", ".ply", ".stl")

UNIT_M: Final[Mapping[ScanUnit, float]] = MappingProxyType({"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254})
"""Metres of each unit that a file can be in."""


@dataclass(frozen=True)
class FruitScans:
    """The scans of a fruit kind.

    Attributes:
        files: mesh files; each fruit uses one of them.
        weights: relative frequency of each file, above 0; empty for equal ones.
        up: axis of the files that points to the stalk end; None for that of the format, y for GLB, else z.
        unit: of the files; None if it is not known.
        colour: whether the fruit have the colours of the files instead of those of their pigments.
        diameter_m: mean diameter of the kind, which the size of a file of known unit is compared with.
    """

    files: tuple[Path, ...]
    weights: tuple[float, ...] = ()
    up: ScanAxis | None = None
    unit: ScanUnit | None = None
    colour: bool = False
    diameter_m: float = 0.08


def _as_list(raw: Any) -> Any:
    """One path as a list of one."""
    if isinstance(raw, str | Path):
        return (raw,)
    if isinstance(raw, list | tuple) and all(isinstance(item, str | Path) for item in raw):
        return raw
    raise ValueError("must be a path, or a list of paths")


ScanFiles = Annotated[tuple[Path, ...], BeforeValidator(_as_list)]
ScanWeights = tuple[Annotated[float, Field(gt=0.0, le=1e6)], ...]


OrganForm = Literal["internode", "node", "stalk", "blade", "peduncle", "calyx", "fruit", "cut", "flower"]
FORMS: Final[tuple[OrganForm, ...]] = get_args(OrganForm)


@dataclass(frozen=True)
class OrganKind:
    """Shape, label, surface and scans of an organ kind."""

    form: OrganForm  # selects the mesh generator
    organ_class: OrganClass  # label of all its pixels
    surface: str  # name of its surface
    scans: FruitScans | None = None  # meshes to use instead of a generated one, or None


DEFAULT_KINDS: Final[Mapping[OrganForm, OrganKind]] = MappingProxyType(
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


def _constant(value: float) -> Distribution:
    return Distribution(family="value", mean=value, sd=0.0, low=value, high=value, chosen="neutral default")


class OrganModel(Document):
    """Parameters of all organ kinds."""

    model_config = ConfigDict(populate_by_name=True)

    form: OrganForm  # selects the mesh generator
    organ_class: ClassName | None = Field(default=None, alias="class")  # None for the form's default
    # Name of the surface; None for the form's default.
    surface: Annotated[str, Field(min_length=1)] | None = None
    # How many organs of this kind can follow one another; None for no limit.
    depth: Annotated[int, Field(ge=1, le=8)] | None = None
    bears: tuple[Slot, ...] = ()  # its slots
    source: str = ""  # origin of the plain numbers, as is `chosen`
    chosen: str = ""

    @property
    def kind(self) -> OrganKind:
        """Form, class, surface and scans, with the form's defaults."""
        default = DEFAULT_KINDS[self.form]
        label = default.organ_class if self.organ_class is None else OrganClass[self.organ_class.upper()]
        scans: FruitScans | None = getattr(self, "scans", None)
        return OrganKind(self.form, label, self.surface or default.surface, scans)

    @property
    def distributions(self) -> dict[str, Distribution]:
        """Every random parameter by its name, in the order of the class."""
        values = ((name, getattr(self, name)) for name in type(self).model_fields)
        return {name: value for name, value in values if isinstance(value, Distribution)}


class Internode(OrganModel):
    """Section of the main stem. Attributes: length (I-1), from node to node; groove: its depth."""

    form: Literal["internode"]
    length: Size
    groove: Width = _constant(0.0)
    state: Fraction = _constant(0.6)
    state_spread: Fraction = _constant(0.12)


class Node(OrganModel):
    """Swelling between two sections. Attributes: width (I-2) and length."""

    form: Literal["node"]
    width: Size
    length: Size
    state: Fraction = _constant(0.6)


class Stalk(OrganModel):
    """Petiole, side shoot, rachis of a leaf, or pedicel."""

    form: Literal["stalk"]
    length: Size
    diameter: Size  # at its base
    tip: Factor = _constant(1.0)  # ratio of the diameter at its end to that at its base
    inclination: Angle  # at its base
    bend: Angle = _constant(0.0)  # change of the inclination from base to end; negative is downwards
    sway: Angle = _constant(0.0)  # bend out of its vertical plane, counter-clockwise
    state: Fraction = _constant(0.6)
    state_spread: Fraction = _constant(0.12)
    # Fraction of the way to the inclination of the blade at its tip that the stalk itself bends.
    towards: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    channel: Annotated[int, Field(ge=0, le=1)] = 0  # 1 for a channel along its upper side


class Peduncle(OrganModel):
    """Stalk of a fruit. Attributes: length (P-1) and its bend from `inclination` to `end_inclination`."""

    form: Literal["peduncle"]
    length: Size
    diameter: Size
    tip: Factor = _constant(1.0)
    inclination: Angle
    end_inclination: Angle
    state: Fraction = _constant(0.6)


class ResidueShares(Document):
    """Mean shares of what covers leaves, of sum 1. Chosen defaults: dust, with a few drops on most leaves."""

    dust: Annotated[float, Field(ge=0.0, le=1.0)] = 0.86  # an even film
    spray: Annotated[float, Field(ge=0.0, le=1.0)] = 0.13  # dried drops with rims
    mildew: Annotated[float, Field(ge=0.0, le=1.0)] = 0.01  # soft patches

    @model_validator(mode="after")
    def _check_sum(self) -> Self:
        check_sum(self.values, "dust, spray and mildew")
        return self

    @property
    def values(self) -> tuple[float, float, float]:
        """Dust, spray and mildew."""
        return self.dust, self.spray, self.mildew


class Blade(OrganModel):
    """Blade of a leaf or a leaflet."""

    form: Literal["blade"]
    length: Size  # of the midrib
    width: Size  # of the flat blade
    inclination: Angle  # of the midrib at its middle
    droop: Angle = _constant(0.0)  # downward bend of the midrib from base to tip
    sway: Angle = _constant(0.0)  # its sideways bend, counter-clockwise
    roll: Angle = _constant(0.0)  # about the midrib
    fold: Angle = _constant(0.0)  # angle by which each half is lifted
    curl: Angle = _constant(0.0)  # cross-curvature of each half, margins up if positive
    rolled: Angle = _constant(0.0)  # by which the outer part of each half is rolled up, negative is down
    twist: Angle = _constant(0.0)  # of the tip relative to the base
    margin_wave: Width = _constant(0.0)  # amplitude of the waves along a margin
    margin_waves: Factor = _constant(4.0)  # number of waves
    blister: Width = _constant(0.0)  # height of the bulges between the veins
    vein: Width = _constant(0.0)  # depth of the sunken secondary veins
    asymmetry: Ratio = _constant(0.0)  # excess width of one half over the mean half, relative
    widest: Fraction = _constant(0.35)  # position of the greatest width, 0 base to 1 tip
    base: Factor = _constant(0.8)  # exponent of the outline at the base; small is broad
    lobes: Ratio = _constant(0.0)  # number of teeth or lobes along each margin; 0 is entire
    lobe_depth: Fraction = _constant(0.0)  # their depth, as a fraction of half the width
    palmate: bool = False  # whether the lowest veins radiate from the base, with a lobe at the end of each
    sinus: Fraction = _constant(0.0)  # how far the lower lobes extend behind the base, over the length
    teeth: Amount = _constant(0.0)  # number of teeth along each margin, in addition to the lobes
    tooth_depth: Width = _constant(0.0)  # their depth
    bites: Amount = _constant(0.0)  # number of round bites out of the margins, rounded down
    bite_width: Width = _constant(0.01)  # their mean diameter
    tears: Amount = _constant(0.0)  # number of tears along lateral veins, rounded down
    tear_depth: Fraction = _constant(0.5)  # their mean length, over the way from the margin to the midrib
    state: Fraction = _constant(0.7)  # 0 pale to 1 dark green
    state_spread: Fraction = _constant(0.1)  # mottling within a blade
    residue: Fraction = _constant(0.0)  # mean cover of the upper side with dust, dried spray or mildew
    # Of the residue, equal at all wavelengths.
    residue_reflectance: Annotated[float, Field(ge=0.0, le=1.0)] = 0.45
    residue_behind: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0  # cover of the lower side over that above
    residue_shares: ResidueShares = ResidueShares()  # what it consists of
    # Height of the finest bulges and veins over that of sweet pepper; belongs to the surface, as the residue.
    relief: Annotated[float, Field(ge=0.0, le=3.0)] = 1.0
    ageing: Fraction = _constant(0.0)  # 0 healthy, through yellow or dry rims and spots, to 1 dried up
    size_correlation: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0  # of length and width (Gaussian copula)
    # Of residue, ageing, bites, tears, droop and hanging (minus the inclination) with the age of a leaf,
    # likewise.
    age_correlation: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0

    @model_validator(mode="after")
    def _check_palmate(self) -> Self:
        for name in ("sinus", "teeth", "tooth_depth"):
            if not self.palmate and getattr(self, name).high > 0.0:
                raise ValueError(f"{name} needs palmate = true")
        return self


class Fruit(OrganModel):
    """Fruit and the calyx that it hangs from; two to five lobes."""

    form: Literal["fruit"]
    diameter: Size  # F-2, of a grown fruit
    slenderness: Factor  # length divided by diameter
    inclination: Angle  # of the axis from stalk end to blossom end, about -90 degrees
    aside: Angle = _constant(0.0)  # azimuth of the axis relative to that of its peduncle
    lobe_depth: Ratio = _constant(0.0)  # of the furrows; 1 is typical of a blocky pepper
    shoulder: Ratio = _constant(0.0)  # height of the shoulders above the stalk end
    taper: Factor = _constant(1.0)  # ratio of the diameter near the blossom end to the greatest
    point: Fraction = _constant(0.0)  # 0 blocky to 1 pointed
    bend: Angle = _constant(0.0)  # of the axis
    neck: Fraction = _constant(1.0)  # ratio of the diameter beside the stalk to the greatest
    neck_length: Fraction = _constant(0.25)  # of the part that narrows towards the stalk, over the length
    calyx_radius: Factor = _constant(0.27)  # to the longest teeth, as a ratio to the fruit's diameter
    calyx_tooth: Fraction = _constant(0.28)  # depth of the calyx' teeth, as a fraction of its radius
    calyx_state: Fraction = _constant(0.5)  # pigment state of the calyx
    ripe_fraction: Fraction = _constant(0.0)  # of the mature fruit; fruit of a young top is green
    # Rise of ripe_fraction towards the foot, where fruit is older, and fall towards the top, over half the
    # plant's height.
    ripe_descent: Fraction = _constant(0.0)
    # Fraction of fruit at the breaker stage, taken equally from the ripe and the unripe.
    breaker_fraction: Fraction = _constant(0.0)
    # Ripeness at each stage, 0 green to 1 ripe.
    unripe: Fraction = _constant(0.0)
    breaker: Fraction = _constant(0.5)
    ripe: Fraction = _constant(1.0)
    ripeness_spread: Fraction = _constant(0.0)  # variation of ripeness within a fruit
    residue: Fraction = _constant(0.0)  # mean cover of the skin with russet, scars and dried spray
    # Ribs along the skin and warts belong to the surface.
    ribs: Annotated[int, Field(ge=0, le=24)] = 0
    rib_height_mm: Annotated[float, Field(ge=0.0, le=3.0)] = 0.0  # of a crest over the furrows beside it
    warts_per_cm2: Annotated[float, Field(ge=0.0, le=10.0)] = 0.0
    wart_height_mm: Annotated[float, Field(ge=0.0, le=3.0)] = 0.5  # mean
    wart_width_mm: Annotated[float, Field(ge=1.0, le=20.0)] = 3.0  # mean diameter
    lobes: Lobes = Number(probabilities={"four": 1.0}, chosen="the usual number of a blocky pepper")
    scan: ScanFiles = ()  # mesh files to use instead of a generated mesh; each fruit uses one
    scan_weights: ScanWeights = ()  # relative frequency of each of them; equal if empty
    scan_up: ScanAxis | None = None  # axis of the files that points to the stalk end; None: of the format
    scan_unit: ScanUnit | None = None  # of the files, whose size is then checked
    scan_colour: bool = False  # whether fruit have the colours of the files, not those of pigments
    calyx: bool = True  # whether it has one

    @property
    def scans(self) -> FruitScans | None:
        """The scans to use, or None."""
        if not self.scan:
            return None
        up, unit, colour = self.scan_up, self.scan_unit, self.scan_colour
        return FruitScans(self.scan, self.scan_weights, up, unit, colour, self.diameter.mean)

    @model_validator(mode="after")
    def _check_limits(self) -> Self:
        if self.scan_weights and len(self.scan_weights) != len(self.scan):
            weights, files = len(self.scan_weights), len(self.scan)
            raise ValueError(f"scan_weights must have one weight for each scan: {files}, not {weights}")
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
    inclination: Angle = _constant(0.0)


class Flower(OrganModel):
    """Flower. Attributes: diameter when flat; open: 0 bud to 1 flat; state: along the petals' pigments."""

    form: Literal["flower"]
    diameter: Size
    open: Fraction = _constant(0.8)
    inclination: Angle
    state: Fraction = _constant(0.8)
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
