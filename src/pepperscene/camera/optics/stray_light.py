"""Stray light of a lens: its parameters and their table in lens files."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Final

from pydantic import Field, model_validator

from pepperscene.document import Document

_MOST_STRAY, _MOST_IN_ALL = 0.9, 0.95  # chosen: a lens that loses more of its light shows no image
_SCATTER_WIDTH_UM: Final = (0.01, 1000.0)  # chosen: a hundredth of the smallest pixel to a hundred large ones
_SCATTER_EXPONENT: Final = (1.05, 10.0)
"""At 1 the integral over the plane is infinite; chosen just above it. Smooth optics have 1.2 to 1.6."""
_MAGNIFICATION: Final = (-10.0, 10.0)  # chosen: beyond it, a ghost spreads over a hundred times the image
_LEAST_RADIUS_MM: Final = 1e-3  # chosen: a pixel


@dataclass(frozen=True)
class Ghost:
    """A weak, blurred image by two reflections inside the lens, scaled about the optical axis.

    Attributes:
        magnification: of the ghost relative to the image; below 0 it is mirrored through the axis.
        radius_m: radius on the sensor of the disc into which a point is spread: the aperture out of focus.
        fraction: of the light that goes into the ghost.
    """

    magnification: float
    radius_m: float
    fraction: float


_TYPICAL_GHOSTS: Final = (Ghost(-1.0, 4e-4, 2.5e-4), Ghost(-0.4, 2e-4, 2.5e-5), Ghost(0.6, 6e-4, 2.5e-5))
"""Chosen, with reflections as in the model of Hullin et al. 2011 (ACM Trans. Graph. 30:108): a coated surface
reflects 0.5 %, and the sensor with the filter in front of it 5 %. The strongest ghost is reflected by the
sensor and a surface of the lens, others by two surfaces. Positions and sizes depend on the design, which is
not known; those of Lee & Eisemann 2013 (Comput. Graph. Forum 32:1) lie on both sides of the axis."""


@dataclass(frozen=True)
class StrayLight:
    """Light that a lens does not image as a point: diffraction, scatter, veiling glare and ghosts.

    A point is imaged as the diffraction pattern of the aperture, which depends on the f-number alone. A
    fraction of its light is scattered by surfaces and dust into the point spread function

        (exponent - 1) / (pi width^2) (1 + (r / width)^2)^-exponent

    of the distance r on the sensor (Bitlis, Jansson & Allebach 2007, Proc. SPIE 6498:64980V, on the axis).
    Further fractions spread evenly over the image (veiling glare) or form ghosts.

    Attributes:
        scatter: fraction of the light that is scattered. The default is that of a measured compact camera
            (Olympus SP-510 UZ; Wei, Cao, Bouman & Allebach 2009, Proc. SPIE 7246:72460B, second hand), as are
            width and exponent; two thirds of it stay within 12 micrometres.
        scatter_width_m: half of its light stays within about three widths.
        scatter_exponent: half the power by which the scattered light decreases.
        veil: fraction of the light that reflections between surfaces spread evenly. The default is chosen for
            seven coated glasses: 91 pairs of surfaces that each reflect 0.5 %. Together with the scatter, it
            gives a veiling glare index (ISO 9358) of 1 to 2 %.
        ghosts: the ghosts.

    Raises:
        ValueError: a number is out of range, or no light is left for the image.
    """

    scatter: float = 0.39
    scatter_width_m: float = 1.76e-6
    scatter_exponent: float = 1.31
    veil: float = 0.0023
    ghosts: tuple[Ghost, ...] = _TYPICAL_GHOSTS

    def __post_init__(self) -> None:
        fractions = [self.scatter, self.veil, *(ghost.fraction for ghost in self.ghosts)]
        # Written so that nan fails too.
        if not (min(fractions) >= 0.0 and sum(fractions) <= _MOST_IN_ALL):
            raise ValueError(
                f"fractions of stray light must be at least 0, together at most {_MOST_IN_ALL:g}"
            )
        if not (0.0 < self.scatter_width_m < math.inf and 1.0 < self.scatter_exponent < math.inf):
            raise ValueError("scatter must have a positive width and an exponent above 1")
        for ghost in self.ghosts:
            is_finite = math.isfinite(ghost.magnification) and math.isfinite(ghost.radius_m)
            if not (is_finite and ghost.magnification != 0.0 and ghost.radius_m > 0.0):
                raise ValueError("a ghost must have a magnification other than 0, and a positive radius")


Fraction = Annotated[float, Field(ge=0, le=_MOST_STRAY)]
Magnification = Annotated[float, Field(ge=_MAGNIFICATION[0], le=_MAGNIFICATION[1])]
Radius = Annotated[float, Field(ge=_LEAST_RADIUS_MM, le=1000)]  # larger than any sensor


class StrayLightTable(Document):
    """The table `[stray_light]` of a lens file; what is left out has the default of `StrayLight`.

    The three lists have an entry for each ghost.
    """

    scatter: Fraction = StrayLight.scatter
    scatter_width_um: Annotated[float, Field(ge=_SCATTER_WIDTH_UM[0], le=_SCATTER_WIDTH_UM[1])] = (
        StrayLight.scatter_width_m * 1e6
    )
    scatter_exponent: Annotated[float, Field(ge=_SCATTER_EXPONENT[0], le=_SCATTER_EXPONENT[1])] = (
        StrayLight.scatter_exponent
    )
    veil: Fraction = StrayLight.veil
    ghost_magnification: tuple[Magnification, ...] = tuple(g.magnification for g in _TYPICAL_GHOSTS)
    ghost_radius_mm: tuple[Radius, ...] = tuple(g.radius_m * 1e3 for g in _TYPICAL_GHOSTS)
    ghost_fraction: tuple[Fraction, ...] = tuple(g.fraction for g in _TYPICAL_GHOSTS)

    @model_validator(mode="after")
    def _check_stray_light(self) -> StrayLightTable:
        lengths = {len(self.ghost_magnification), len(self.ghost_radius_mm), len(self.ghost_fraction)}
        if len(lengths) > 1:
            raise ValueError(
                "ghost_magnification, ghost_radius_mm and ghost_fraction must have one value for each ghost"
            )
        self.stray_light()
        return self

    def stray_light(self) -> StrayLight:
        """The table in metres."""
        ghosts = zip(self.ghost_magnification, self.ghost_radius_mm, self.ghost_fraction, strict=True)
        return StrayLight(
            self.scatter,
            self.scatter_width_um * 1e-6,
            self.scatter_exponent,
            self.veil,
            tuple(Ghost(scale, radius * 1e-3, fraction) for scale, radius, fraction in ghosts),
        )
