"""What the surfaces' colour comes from: paths through pigment space, from young or green to old or ripe."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from pepperscene.cultivar.origin import Origin
from pepperscene.document import Document


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
