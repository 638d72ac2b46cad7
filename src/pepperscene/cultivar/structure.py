"""What may grow on what: the faults of a cultivar that no table shows alone."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Annotated, Any, Final, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError, ValidationError

from pepperscene.cultivar.distribution import Origin
from pepperscene.cultivar.notation import NOTHING, Angle, Factor, OncePerPlant, Size
from pepperscene.cultivar.organs import OrganModel
from pepperscene.cultivar.slot import Slot
from pepperscene.document import Document


class Stem(Document):
    """P-1 (stem diameter) and P-2 (lean across the row), and the kinds that the stem is made of.

    Attributes:
        parts: internodes, each with the node above it.
        young_nodes: of them, those at the top that still grow.
        young_size: size of the topmost one, of a grown one's.
        diameter: of the stem, mean from foot to top.
        top_diameter: ratio of the diameter at the top to that at the foot.
        lean: positive towards the aisle.
        zigzag: angle of a section to the plant's own line.
        internode: the kind of its sections.
        node: the kind of its nodes.
        source: of the plain numbers.
        chosen: why the plain numbers are what they are.
    """

    parts: Annotated[int, Field(ge=1, le=200)]
    young_nodes: Annotated[int, Field(ge=0, le=200)] = 0
    young_size: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0
    diameter: Annotated[Size, OncePerPlant]
    top_diameter: Annotated[Factor, OncePerPlant]
    lean: Annotated[Angle, OncePerPlant]
    zigzag: Angle
    internode: str
    node: str
    source: str = ""
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


class PigmentPath(Origin):
    """The pigments of a surface from state 0 to state 1, linear between the knots.

    Attributes:
        start: pigments at state 0.
        end: pigments at state 1.
        path: (state, pigments) in between, ascending.
        flesh_reflectance: of a diffuse body below the pigment layer; None for a leaf with air behind it.
        ior: refractive index of the cuticle.
        roughness: GGX alpha of the cuticle's front and back.
    """

    start: Pigments
    end: Pigments
    path: tuple[tuple[Annotated[float, Field(gt=0.0, lt=1.0)], Pigments], ...] = ()
    flesh_reflectance: Annotated[float, Field(ge=0.0, lt=1.0)] | None = None
    ior: Annotated[float, Field(ge=1.0, le=2.5)]
    roughness: tuple[Annotated[float, Field(gt=0.0, le=1.0)], Annotated[float, Field(gt=0.0, le=1.0)]]

    @model_validator(mode="after")
    def _ascends(self) -> Self:
        states = [state for state, _ in self.path]
        if any(after <= before for before, after in pairwise(states)):
            raise ValueError("the states along path must ascend")
        return self

    @property
    def knots(self) -> tuple[tuple[float, Pigments], ...]:
        """(state, pigments) from 0 to 1, ends included."""
        return ((0.0, self.start), *self.path, (1.0, self.end))

    def at(self, states: ArrayLike) -> dict[str, NDArray[np.float64]]:
        """Each pigment's content at states in [0, 1], by the field names of `Pigments`."""
        asked = np.asarray(states, dtype=float)
        known = np.array([state for state, _ in self.knots])
        names = Pigments.model_fields
        return {n: np.interp(asked, known, [getattr(p, n) for _, p in self.knots]) for n in names}


CALYX: Final = "calyx"
"""The kind that every fruit's own calyx has."""

_BEARING: Final = ("node", "stalk", "peduncle")
_BORNE: Final = ("stalk", "blade", "peduncle", "fruit", "cut", "flower")
_ONLY_ON_NODES: Final = ("lift", "azimuth", "step", "after", "every", "first", "flush", "descent")
_NEVER_ON_NODES: Final = ("at", "aside", "pairs")

Key = tuple[str | int, ...]
Fault = tuple[Key, object, str]


def check_structure(stem: Stem, organs: Mapping[str, OrganModel], surfaces: Mapping[str, Any]) -> None:
    """Raise the first fault that lies between the tables.

    Raises:
        ValidationError: with the key of the table that must be changed.
    """
    for fault in _faults(stem, organs, surfaces):
        raise fault_at(*fault)


def fault_at(key: Key, value: object, allowed: str) -> ValidationError:
    """A fault as pydantic reports its own, so that it is told with its key."""
    detail: InitErrorDetails = {
        # Braces are how pydantic marks what it fills in.
        "type": PydanticCustomError("structure", "{allowed}", {"allowed": allowed}),
        "loc": key,
        "input": value,
    }
    return ValidationError.from_exception_data("cultivar", [detail])


def _faults(stem: Stem, organs: Mapping[str, OrganModel], surfaces: Mapping[str, Any]) -> Iterator[Fault]:
    yield from _names(organs)
    for key in ("internode", "node"):
        name = getattr(stem, key)
        if name not in organs:
            yield ("stem", key), name, f"must be one of the organs: {', '.join(organs)}"
        elif organs[name].form != key:
            yield ("stem", key), name, f"must be of the form {key}, and {name} is a {organs[name].form}"
    for name, organ in organs.items():
        yield from _surface(name, organ, surfaces)
        if organ.bears and organ.form not in _BEARING:
            yield ("organs", name, "bears"), None, f"must be left out, since a {organ.form} bears nothing"
        for index, slot in enumerate(organ.bears):
            before = [other.name for other in organ.bears[:index]]
            for within, value, allowed in _slot(organ, slot, before, organs):
                yield ("organs", name, "bears", index, *within), value, allowed
    yield from _endless(organs)


def _names(organs: Mapping[str, OrganModel]) -> Iterator[Fault]:
    for name in organs:
        if not name.isidentifier():
            yield ("organs", name), None, "a kind's name must have letters, digits and _ only"
        if name in (NOTHING, CALYX):
            why = "nothing" if name == NOTHING else "each fruit's own calyx"
            yield ("organs", name), None, f"must have another name: {name} stands for {why}"


def _surface(name: str, organ: OrganModel, surfaces: Mapping[str, Any]) -> Iterator[Fault]:
    needed = [organ.kind.surface] + ([CALYX] if getattr(organ, "calyx", False) else [])
    for surface in needed:
        if surface not in surfaces and surface != "cut":
            key = ("organs", name, "surface")
            yield key, surface, f"must be cut or one of the pigments: {', '.join(surfaces)}"


def _slot(
    organ: OrganModel, slot: Slot, before: list[str], organs: Mapping[str, OrganModel]
) -> Iterator[Fault]:
    """Faults of a slot, by their keys within it; `before` names the slots that stand before it."""
    for kind in slot.kinds:
        if kind not in organs:
            yield ("what",), None, f"{kind} must be none or one of the organs: {', '.join(organs)}"
        elif organs[kind].form not in _BORNE:
            yield ("what",), None, f"{kind} is of the form {organs[kind].form}, which only the stem has"
    if slot.name in before:
        yield ("name",), slot.name, "must be unique among the slots of an organ"
    on_node = organ.form == "node"
    for name in _NEVER_ON_NODES if on_node else _ONLY_ON_NODES:
        if getattr(slot, name) != type(slot).model_fields[name].default:
            yield (
                (name,),
                None,
                f"must be left out, a key that {'no node has' if on_node else 'only nodes have'}",
            )
    if on_node and slot.azimuth is None:
        yield ("azimuth",), None, "is required but missing"
    if slot.after is not None and (slot.after not in before or slot.step is None):
        yield ("after",), slot.after, "must name a slot before this one, and needs a step"
    if slot.pairs and slot.aside is None:
        yield ("pairs",), True, "needs aside, the angle to either side"


def _endless(organs: Mapping[str, OrganModel]) -> Iterator[Fault]:
    """Kinds that follow themselves without end: not even through others, unless one of them has a depth."""
    free = {name: organ for name, organ in organs.items() if organ.depth is None}
    below = {
        name: {kind for slot in organ.bears for kind in slot.kinds if kind in free}
        for name, organ in free.items()
    }
    for name in free:
        seen, waiting = set(), list(below[name])
        while waiting:
            kind = waiting.pop()
            if kind not in seen:
                seen.add(kind)
                waiting.extend(below[kind])
        if name in seen:
            yield ("organs", name, "depth"), None, "is required where a kind can follow itself"
