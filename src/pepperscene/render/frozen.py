"""Surfaces whose directions are drawn from one state of them while another is evaluated.

A direction that is drawn from what is to be differentiated moves with it, over edges and behind obstacles,
and a picture of it jumps. So directions and their densities are those of the surfaces as they are, fixed, and
only the values of the BSDF follow the parameters. Value (of the parameters) over density stays without bias
and is as smooth as the BSDF itself, so that its derivative is exact without any care for visibility
("detached sampling", Zeltner et al. 2021, ACM TOG 40(4)). The noise grows with the distance between the two
states; where they are one, it is the renderer's own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pepperscene.render.optics import Optics, Point
from pepperscene.render.variant import kernel

_LEAST_COSINE = 1e-5  # as of `pepperscene.render.optics`, which lets nothing pass there


@dataclass(frozen=True, eq=False)
class FrozenOptics:
    """In the place of `Optics`.

    Attributes:
        values: the surfaces that are evaluated.
        drawn: those that directions are drawn from; None where none are.
    """

    values: Optics
    drawn: Optics | None = None

    def at(self, si: Any, surface: Any, state: Any, active: Any) -> FrozenPoint:
        """The optical state at surface interactions, as of `Optics.at`."""
        point = self.values.at(si, surface, state, active)
        drawn = None if self.drawn is None else self.drawn.at(si, surface, state, active)
        return FrozenPoint(**vars(point), drawn=drawn, there=active)


@dataclass(frozen=True, eq=False)
class FrozenPoint(Point):
    """The optical state at a hit.

    Attributes:
        drawn: the state that directions are drawn from.
        there: where there is a hit at all.
    """

    drawn: Point | None = None
    there: Any = True

    def sample(self, sample1: Any, sample2: Any) -> Any:
        """A direction and its density of the one state, with the weight that it has in the other."""
        _, dr = kernel()
        assert self.drawn is not None
        wo, density, _, lobe = self.drawn.sample(sample1, sample2)
        good = density > 0.0
        value, _ = self.eval_pdf(wo)
        return wo, density, dr.select(good, value / dr.select(good, density, 1.0), 0.0), lobe

    def _eval_pdf(self, wo: Any, active: Any) -> Any:
        """As of any point, but in lanes without a value along the normal.

        There directions can be anything, and slopes that are not finite stay so even times nothing.
        """
        mi, dr = kernel()
        good = self.there & active & (self.wi.z > _LEAST_COSINE) & (dr.abs(wo.z) > _LEAST_COSINE)
        upwards = mi.Vector3f(0.0, 0.0, 1.0)
        safe = Point(**{**_point(self), "wi": dr.select(good, self.wi, upwards)})
        return safe._eval_pdf(dr.select(good, wo, upwards), good)


def _point(point: FrozenPoint) -> dict[str, Any]:
    return {name: value for name, value in vars(point).items() if name not in ("drawn", "there")}
