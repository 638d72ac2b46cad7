"""How organs of one surface are spread along their path through pigment space: the laws of their states."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.cultivar import CALYX, USUAL, Fruit

if TYPE_CHECKING:
    from pepperscene.cultivar import Cultivar, Distribution

Array = NDArray[np.float64]
Part = tuple[float, float, float]
"""Weight, mean and standard deviation of one law in a mixture."""

_SHARES: Final = 256
_PLACES: Final = 64
"""At the middles of so many equal shares, and of so many parts of the stem, a law's spread is summed up."""


@dataclass(frozen=True)
class StateLaw:
    """Where the organs of one surface lie on its path.

    Attributes:
        mean: of the state over organs; kinds that plants grow count alike, however many a plant has.
        sd: of the same.
        ripe: mean ripeness of ripe fruit, kinds alike; None where no fruit has this surface, or none ripens.
    """

    mean: float
    sd: float
    ripe: float | None = None


def state_law(cultivar: Cultivar, surface: str) -> StateLaw | None:
    """The law of one surface's states; None where no kind that grows has it, or none has such a law.

    Fruit has its stages instead: unripe, turning and ripe, in the shares that the cultivar states. The
    mottling within an organ is not counted.
    """
    kinds = [_parts(cultivar, kind, surface) for kind in cultivar.grown]
    mixture = [(weight / len(found), mean, sd) for found in kinds for weight, mean, sd in found if found]
    if not mixture:
        return None
    weights, means, sds = np.array(mixture).T
    weights /= weights.sum()
    mean = float(weights @ means)
    sd = float(np.sqrt(weights @ (sds**2 + (means - mean) ** 2)))
    fruits = _fruits(cultivar, surface)
    ripe = float(np.mean([organ.ripe.mean for organ in fruits])) if fruits else 0.0
    return StateLaw(mean, sd, ripe if ripe > 0.0 else None)


def surfaces_of(cultivar: Cultivar) -> tuple[str, ...]:
    """Those that pigments make and plants show, in the order of the cultivar's file."""
    shown = {cultivar.kinds[kind].surface for kind in cultivar.grown}
    return tuple(name for name in cultivar.pigments if name in shown)


def _fruits(cultivar: Cultivar, surface: str) -> list[Fruit]:
    organs = [cultivar.organs[kind] for kind in cultivar.grown if kind != CALYX]
    return [organ for organ in organs if isinstance(organ, Fruit) and organ.kind.surface == surface]


def _parts(cultivar: Cultivar, kind: str, surface: str) -> list[Part]:
    """One kind's share of the mixture."""
    if kind == CALYX:
        # The calyx is its fruit's, whose table states how green it is.
        bearers = [cultivar.organs[name] for name in cultivar.grown if name != CALYX]
        laws = [organ.calyx_state for organ in bearers if isinstance(organ, Fruit) and organ.calyx]
        return [_moments(law, 1.0 / len(laws)) for law in laws if USUAL["calyx"].surface == surface]
    organ = cultivar.organs[kind]
    if organ.kind.surface != surface:
        return []
    if isinstance(organ, Fruit):
        turning = organ.breaker_fraction.mean
        ripe = max(organ.ripe_fraction.mean - 0.5 * turning, 0.0)
        unripe = max(1.0 - ripe - turning, 0.0)
        stages = ((organ.unripe, unripe), (organ.breaker, turning), (organ.ripe, ripe))
        return [_moments(law, share) for law, share in stages]
    law = getattr(organ, "state", None)
    return [] if law is None else [_moments(law, 1.0)]


def _moments(law: Distribution, weight: float) -> Part:
    """Mean and standard deviation over all places along the stem."""
    return weight, law.mean, _spread_along(law) if law.follows_height else law.sd


@lru_cache(maxsize=256)
def _spread_along(law: Distribution) -> float:
    """Standard deviation over shares and places together; a fit asks for it again and again."""
    shares = (np.arange(_SHARES) + 0.5) / _SHARES
    places = (np.arange(_PLACES) + 0.5) / _PLACES
    return float(law.quantiles(shares[:, None], places).std())
