"""A growth stage between two others: every law, probability, number and pigment mixed."""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from typing import Any, Final, TypeVar

import numpy as np

from pepperscene.cultivar.choice import Choice
from pepperscene.cultivar.cultivar import Cultivar
from pepperscene.cultivar.distribution import Distribution
from pepperscene.cultivar.origin import Origin
from pepperscene.cultivar.pigments import PigmentPath, Pigments
from pepperscene.document import Document, dotted
from pepperscene.errors import InputError

Key = tuple[str | int, ...]
Model = TypeVar("Model", bound=Document)

_SAID: Final = (*Origin.model_fields, "name")
"""Words that may differ between two stages."""
_SHARES: Final = 4096
"""At the middles of so many equal shares a blend's spread is summed up."""


def interpolated(first: Cultivar, last: Cultivar, share: float) -> Cultivar:
    """The growth stage that lies a share of the way from one to another.

    Quantile functions, probabilities, plain numbers, pigments and dates are mixed linearly, whole numbers
    rounded.

    Args:
        first: the stage at share 0.
        last: the stage at share 1; with the same kinds, forms and slots.
        share: from 0 to 1.

    Raises:
        InputError: kinds, forms, slots or other words differ.
        ValueError: `share` lies outside [0, 1], or a chance or a ripeness does not fit together in between.
    """
    if not 0.0 <= share <= 1.0:
        raise ValueError(f"share must lie in [0, 1], not {share}")
    if share in (0.0, 1.0):
        return last if share else first
    mix = _Mix(f"{first.name} and {last.name}", share)
    fields = {
        name: mix.of(getattr(first, name), getattr(last, name), (name,)) for name in Cultivar.model_fields
    }
    if first.name != last.name:
        fields["name"] = f"{first.name} to {last.name}, {share:.2f}"
    return Cultivar(**fields)


@dataclass(frozen=True)
class _Mix:
    """Mixing two values of one kind, whatever they are; a fault names both cultivars and the key."""

    where: str
    share: float

    def of(self, first: Any, last: Any, key: Key) -> Any:
        """What lies the share of the way from the first to the last."""
        if key[-1] == "date" and (first is None or last is None):
            return None
        if key[-1] in _SAID and isinstance(first, str):
            return first if first == last else "; ".join(said for said in (first, last) if said)
        if type(first) is not type(last):
            raise self.fault(key, "must be there in both or in neither")
        if isinstance(first, Distribution):
            return first if first == last else self.law(first, last)
        if isinstance(first, PigmentPath):
            return self.pigments(first, last, key)
        if isinstance(first, Choice):
            return self.choice(first, last, key)
        if isinstance(first, Document):
            return self.model(first, last, key)
        if isinstance(first, dict):
            if set(first) != set(last):
                raise self.fault(
                    key, f"must name the same in both: {', '.join(sorted(set(first) ^ set(last)))}"
                )
            return {name: self.of(value, last[name], (*key, name)) for name, value in first.items()}
        if isinstance(first, tuple):
            if len(first) != len(last):
                raise self.fault(key, "must be as many in both")
            return tuple(self.of(a, b, (*key, i)) for i, (a, b) in enumerate(zip(first, last, strict=True)))
        return self.plain(first, last, key)

    def plain(self, first: Any, last: Any, key: Key) -> Any:
        """A number, a date, or a word that is the same in both."""
        if isinstance(first, datetime.date):
            return datetime.date.fromordinal(self.whole(first.toordinal(), last.toordinal()))
        if isinstance(first, float):
            return (1.0 - self.share) * first + self.share * last
        if isinstance(first, int) and not isinstance(first, bool):
            return self.whole(first, last)
        if first != last:
            raise self.fault(key, "must be the same in both")
        return first

    def whole(self, first: int, last: int) -> int:
        """The whole number next to the mix."""
        return round((1.0 - self.share) * first + self.share * last)

    def model(self, first: Model, last: Model, key: Key) -> Model:
        """All fields of a table."""
        if key[-2:-1] == ("bears",) and first.name != last.name:  # type: ignore[attr-defined]
            raise self.fault((*key, "name"), "must be the same in both")
        fields = type(first).model_fields
        return type(first)(**{n: self.of(getattr(first, n), getattr(last, n), (*key, n)) for n in fields})

    def law(self, first: Distribution, last: Distribution) -> Distribution:
        """The law whose quantiles are the mix of both laws' quantiles."""

        def mixed(name: str) -> float:
            return (1.0 - self.share) * float(getattr(first, name)) + self.share * float(getattr(last, name))

        said = {
            name: self.of(getattr(first, name), getattr(last, name), (name,)) for name in Origin.model_fields
        }
        law, sd = "blend", mixed("sd")
        if first.sd == last.sd == 0.0 and not (first.follows_height or last.follows_height):
            return Distribution(
                law="value", mean=mixed("mean"), sd=0.0, low=mixed("mean"), high=mixed("mean"), **said
            )
        if "curve" not in (first.law, last.law) and not (first.between or last.between):
            middles = (np.arange(_SHARES) + 0.5) / _SHARES
            both = (1.0 - self.share) * first.quantiles(middles) + self.share * last.quantiles(middles)
            sd = float(both.std())
        return Distribution(
            law="blend", mean=mixed("mean"), sd=sd, low=mixed("low"), high=mixed("high"),
            between=(self.share, first, last), **said,
        )  # fmt: skip

    def choice(self, first: Choice, last: Choice, key: Key) -> Choice:
        """Every outcome of either, with the mix of its probabilities."""
        names = dict.fromkeys((*first.probabilities, *last.probabilities))
        chances = {
            name: self.plain(first.probabilities.get(name, 0.0), last.probabilities.get(name, 0.0), key)
            for name in names
        }
        said = {
            name: self.of(getattr(first, name), getattr(last, name), (name,)) for name in Origin.model_fields
        }
        return type(first)(probabilities=chances, **said)

    def pigments(self, first: PigmentPath, last: PigmentPath, key: Key) -> PigmentPath:
        """The mix of the contents at every state at which either path has a knot."""
        states = sorted({state for path in (first, last) for state, _ in path.knots})
        contents = [path.at(states) for path in (first, last)]
        mixed = {
            n: (1.0 - self.share) * contents[0][n] + self.share * contents[1][n]
            for n in Pigments.model_fields
        }
        knots = [Pigments(**{n: float(v[i]) for n, v in mixed.items()}) for i in range(len(states))]
        rest = set(PigmentPath.model_fields) - {"start", "path", "end"}
        return PigmentPath(
            start=knots[0],
            path=tuple(zip(states[1:-1], knots[1:-1], strict=True)),
            end=knots[-1],
            **{n: self.of(getattr(first, n), getattr(last, n), (*key, n)) for n in sorted(rest)},
        )

    def fault(self, key: Key, allowed: str) -> InputError:
        """Something that differs and cannot be mixed."""
        return InputError(self.where, dotted(key), None, allowed)
