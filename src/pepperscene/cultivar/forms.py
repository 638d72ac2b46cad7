"""The bodies that organs can have, and what an organ kind of a cultivar file stands for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final, Literal, get_args

from pepperscene.classes import OrganClass

Form = Literal["internode", "node", "stalk", "blade", "peduncle", "calyx", "fruit", "cut", "flower"]
FORMS: Final[tuple[Form, ...]] = get_args(Form)


@dataclass(frozen=True)
class Kind:
    """An organ kind: its body, what it is labelled as, and what its surface is.

    Attributes:
        form: the body that geometry gives it.
        organ_class: of all its pixels.
        surface: the surface that light meets.
        scan: file of a scanned mesh that takes the place of the body, or None.
    """

    form: Form
    organ_class: OrganClass
    surface: str
    scan: Path | None = None


USUAL: Final[Mapping[Form, Kind]] = MappingProxyType(
    {
        "internode": Kind("internode", OrganClass.STEM, "stem"),
        "node": Kind("node", OrganClass.STEM, "stem"),
        "stalk": Kind("stalk", OrganClass.SHOOT, "petiole"),
        "blade": Kind("blade", OrganClass.LEAF, "leaf"),
        "peduncle": Kind("peduncle", OrganClass.PEDUNCLE, "peduncle"),
        "calyx": Kind("calyx", OrganClass.PEDUNCLE, "calyx"),
        "fruit": Kind("fruit", OrganClass.PEPPER, "fruit"),
        "cut": Kind("cut", OrganClass.CUT, "cut"),
        # The published classes have none for flowers.
        "flower": Kind("flower", OrganClass.BACKGROUND, "petal"),
    }
)
"""What a kind of each form is where its file does not say otherwise."""
