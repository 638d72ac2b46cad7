"""The stem, the pigments of surfaces, and checks across the tables of a cultivar."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BeforeValidator, Field, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError, ValidationError

from pepperscene.cultivar.distribution import FloatArray, Origin
from pepperscene.cultivar.notation import NOTHING, Angle, Factor, OncePerPlant, Size
from pepperscene.cultivar.organs import OrganModel
from pepperscene.cultivar.slot import Slot
from pepperscene.document import Document


class Stem(Document):
    """Main stem: P-1 (diameter), P-2 (lean across the row), and the kinds that it consists of."""

    parts: Annotated[int, Field(ge=1, le=200)]  # number of internodes, each with the node above it
    young_nodes: Annotated[int, Field(ge=0, le=200)] = 0  # number of parts at the top that are still growing
    # Relative size of the topmost one. The least is chosen: such an internode is as long as a cell.
    young_size: Annotated[float, Field(ge=0.001, le=1.0)] = 1.0
    diameter: Annotated[Size, OncePerPlant]  # mean from foot to top
    top_diameter: Annotated[Factor, OncePerPlant]  # ratio of the diameter at the top to that at the foot
    lean: Annotated[Angle, OncePerPlant]  # positive towards the aisle
    zigzag: Angle  # angle of an internode to the plant's axis
    internode: str  # kind of its internodes
    node: str  # kind of its nodes
    source: str = ""  # origin of the plain numbers, as is `chosen`
    chosen: str = ""


class Pigments(Document):
    """Contents of one PROSPECT layer (Feret et al. 2017); `capsanthin` is the red of ripe Capsicum."""

    structure_n: Annotated[float, Field(ge=1.0, le=4.0)]
    chlorophyll_ug_cm2: Annotated[float, Field(ge=0.0)]
    carotenoid_ug_cm2: Annotated[float, Field(ge=0.0)]
    capsanthin_ug_cm2: Annotated[float, Field(ge=0.0)] = 0.0
    anthocyanin_ug_cm2: Annotated[float, Field(ge=0.0)] = 0.0
    brown: Annotated[float, Field(ge=0.0)] = 0.0
    water_cm: Annotated[float, Field(ge=0.0)]
    dry_matter_g_cm2: Annotated[float, Field(ge=0.0)]


Alpha = Annotated[float, Field(gt=0.0, le=1.0)]
"""Roughness of a GGX lobe."""


class PigmentPath(Origin):
    """Pigments of a surface from state 0 to state 1, linear between the knots.

    Attributes:
        start, end: pigments at states 0 and 1.
        path: (state, pigments) in between, ascending.
        flesh_reflectance: of a diffuse body below the pigment layer; None for a leaf with air behind it.
        ageing: (fraction, pigments) on the way from state 0 to dry tissue, ascending; at fraction 1 the
            tissue is dry. Without them a surface does not age.
        ior: refractive index of the cuticle.
        roughness: GGX alpha of the cuticle's front and back.
        wide_roughness: alpha of a second, wider lobe of the gloss, front and back; None for one lobe.
        wide_share: fraction of the cuticle's area with the wider lobe.
    """

    start: Pigments
    end: Pigments
    path: tuple[tuple[Annotated[float, Field(gt=0.0, lt=1.0)], Pigments], ...] = ()
    flesh_reflectance: Annotated[float, Field(ge=0.0, lt=1.0)] | None = None
    ior: Annotated[float, Field(ge=1.0, le=2.5)]
    roughness: tuple[Alpha, Alpha]
    wide_roughness: tuple[Alpha, Alpha] | None = None
    wide_share: Annotated[float, Field(ge=0.0, le=1.0)] = 0.5
    ageing: tuple[tuple[Annotated[float, Field(gt=0.0, le=1.0)], Pigments], ...] = ()

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        for name in ("path", "ageing"):
            if any(after[0] <= before[0] for before, after in pairwise(getattr(self, name))):
                raise ValueError(f"the states of {name} must ascend")
        if self.ageing and self.ageing[-1][0] < 1.0:
            raise ValueError("the last state of ageing must be 1")
        return self

    @property
    def knots(self) -> tuple[tuple[float, Pigments], ...]:
        """(state, pigments), ascending; states below 0 are minus the fraction of the way to dry tissue."""
        aged = ((-fraction, pigments) for fraction, pigments in reversed(self.ageing))
        return (*aged, (0.0, self.start), *self.path, (1.0, self.end))

    @staticmethod
    def fields_of(knots: Sequence[tuple[float, Pigments]]) -> dict[str, Any]:
        """Fields `start`, `path`, `end` and `ageing` for these `knots`, which include states 0 and 1."""
        healthy = [knot for knot in knots if knot[0] >= 0.0]
        ageing = tuple((-state, pigments) for state, pigments in reversed(knots) if state < 0.0)
        start, *between, end = healthy
        return {"start": start[1], "path": tuple(between), "end": end[1], "ageing": ageing}

    def at(self, states: ArrayLike) -> dict[str, FloatArray]:
        """Interpolate each content at states in [0, 1], or [-1, 1] with `ageing`.

        Keys are the field names of `Pigments`.
        """
        x = np.asarray(states, dtype=float)
        known = np.array([state for state, _ in self.knots])
        names = Pigments.model_fields
        return {n: np.interp(x, known, [getattr(p, n) for _, p in self.knots]) for n in names}


STATE_PER_SD: Final = 1.0 / 6.0
"""States 0 to 1 of a measured surface are 3 standard deviations below and above the mean of its organs."""

Columns = Annotated[
    tuple[str, ...],
    Field(min_length=1, max_length=1000),
    BeforeValidator(lambda raw: (raw,) if isinstance(raw, str) else raw),
]
"""Names of columns: one, or those of several samples."""


class MeasuredCurve(Document):
    """A measured curve of a surface, instead of the colour of its pigments, and how organs vary about it.

    Attributes:
        file: CSV file; see `pepperscene.spectra.measured.read_measured`, also for both units.
        reflectance: columns of the front. Several are samples: organs vary along their first principal
            component, with the samples' standard deviation.
        reflectance_below: columns of the back of a blade or petal; None for those of the front.
        transmittance: columns of a blade or petal; None for "transmittance".
        spread: standard deviation of a factor on the whole curve between organs, for a single sample.
        gloss: whether the curve includes the light that a glossy cuticle reflects, which then has the index
            and the roughness of the pigments' table; otherwise the surface is matt.
    """

    file: Path
    reflectance: Columns = ("reflectance",)
    reflectance_below: Columns | None = None
    transmittance: Columns | None = None
    unit: Literal["fraction", "percent"] | None = None
    wavelength_unit: Literal["nm", "um"] | None = None
    spread: Annotated[float, Field(ge=0.0, le=0.3)] = 0.0
    gloss: bool = True
    source: str = ""
    chosen: str = ""

    @model_validator(mode="after")
    def _check_samples(self) -> Self:
        count = len(self.reflectance)
        for name in ("reflectance_below", "transmittance"):
            if len(getattr(self, name) or self.reflectance) != count:
                raise ValueError(f"{name} must have as many columns as reflectance, {count}")
        if count > 1 and self.spread:
            raise ValueError("spread must be left out: it is that of the samples")
        return self


CALYX: Final = "calyx"
"""Kind of every fruit's own calyx."""

_BEARING_FORMS: Final = ("node", "stalk", "peduncle")
_BORNE_FORMS: Final = ("stalk", "blade", "peduncle", "fruit", "cut", "flower")
_ONLY_ON_NODES: Final = ("lift", "azimuth", "step", "after", "every", "first", "flush", "descent")
_NEVER_ON_NODES: Final = ("at", "aside", "pairs")

Key = tuple[str | int, ...]
Organs = Mapping[str, OrganModel]


def check_structure(
    stem: Stem, organs: Organs, surfaces: Mapping[str, Any], curves: Mapping[str, MeasuredCurve]
) -> None:
    """Check conditions across tables.

    Raises:
        ValidationError: for the first error, with the key to change.
    """
    for name in organs:
        if not name.isidentifier():
            raise _error(("organs", name), None, "the name of a kind must have letters, digits and _ only")
        if name in (NOTHING, CALYX):
            meaning = "nothing" if name == NOTHING else "each fruit's own calyx"
            raise _error(("organs", name), None, f"must have another name: {name} means {meaning}")
    for key in ("internode", "node"):
        name = getattr(stem, key)
        if name not in organs:
            raise _error(("stem", key), name, f"must be one of the organs: {', '.join(organs)}")
        if organs[name].form != key:
            raise _error(("stem", key), name, f"must be of the form {key}, but is a {organs[name].form}")
    for name, organ in organs.items():
        for surface in (organ.kind.surface, *((CALYX,) if getattr(organ, "calyx", False) else ())):
            if surface not in surfaces and surface != "cut":
                allowed = f"must be cut or one of the pigments: {', '.join(surfaces)}"
                raise _error(("organs", name, "surface"), surface, allowed)
        if organ.bears and organ.form not in _BEARING_FORMS:
            raise _error(("organs", name, "bears"), None, f"must be left out: a {organ.form} bears nothing")
        for index, slot in enumerate(organ.bears):
            earlier = [other.name for other in organ.bears[:index]]
            _check_slot(("organs", name, "bears", index), slot, organ.form == "node", earlier, organs)
    _check_recursion(organs)
    sheets = {organ.kind.surface for organ in organs.values() if organ.form in ("blade", "flower")}
    for name, curve in curves.items():
        if name not in surfaces:
            raise _error(("spectra", name), None, f"must be one of the pigments: {', '.join(surfaces)}")
        for key in ("transmittance", "reflectance_below") if name not in sheets else ():
            if getattr(curve, key) is not None:
                raise _error(("spectra", name, key), None, "must be left out: only blades and petals have it")


def _error(key: Key, value: object, allowed: str) -> ValidationError:
    """Error in the form of pydantic's own, so that it is reported with its key."""
    detail: InitErrorDetails = {
        # A custom template, since pydantic would fill in braces of the message.
        "type": PydanticCustomError("structure", "{allowed}", {"allowed": allowed}),
        "loc": key,
        "input": value,
    }
    return ValidationError.from_exception_data("cultivar", [detail])


def _check_slot(key: Key, slot: Slot, on_node: bool, earlier: list[str], organs: Organs) -> None:
    """Check a slot; `earlier` has the names of the slots before it."""
    for kind in slot.kinds:
        if kind not in organs:
            allowed = f"{kind} must be none or one of the organs: {', '.join(organs)}"
            raise _error((*key, "what"), None, allowed)
        if organs[kind].form not in _BORNE_FORMS:
            allowed = f"{kind} is of the form {organs[kind].form}, which only the stem has"
            raise _error((*key, "what"), None, allowed)
    if slot.name in earlier:
        raise _error((*key, "name"), slot.name, "must be unique among the slots of an organ")
    for name in _NEVER_ON_NODES if on_node else _ONLY_ON_NODES:
        if getattr(slot, name) != type(slot).model_fields[name].default:
            owner = "no node has" if on_node else "only nodes have"
            raise _error((*key, name), None, f"must be left out, a key that {owner}")
    if on_node and slot.azimuth is None:
        raise _error((*key, "azimuth"), None, "is required but missing")
    if slot.after is not None and (slot.after not in earlier or slot.step is None):
        raise _error((*key, "after"), slot.after, "must name a slot before this one, and needs a step")
    if slot.pairs and slot.aside is None:
        raise _error((*key, "pairs"), True, "needs aside, the angle to either side")


def _check_recursion(organs: Organs) -> None:
    """Check that a kind which can follow itself, even through others, is limited by a depth."""
    unlimited = {name: organ for name, organ in organs.items() if organ.depth is None}
    below = {
        name: {kind for slot in organ.bears for kind in slot.kinds if kind in unlimited}
        for name, organ in unlimited.items()
    }
    try:
        TopologicalSorter(below).prepare()
    except CycleError as error:
        key = "organs", next(name for name in unlimited if name in error.args[1]), "depth"
        raise _error(key, None, "is required for a kind that can follow itself") from None
