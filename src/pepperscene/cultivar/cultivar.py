"""All parameters of a cultivar's plants, and reading them from a TOML file."""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self, TypeVar

import numpy as np
from pydantic import model_validator

from pepperscene.cultivar.distribution import Distribution, Origin
from pepperscene.cultivar.inheritance import inherited, lineage, stated_in
from pepperscene.cultivar.notation import Choice
from pepperscene.cultivar.organs import USUAL, AnyOrgan, OrganKind
from pepperscene.cultivar.slot import Slot
from pepperscene.cultivar.structure import CALYX, PigmentPath, Pigments, Stem, check_structure
from pepperscene.document import Document, toml_key, validate
from pepperscene.errors import InputError


class Cultivar(Document):
    """All that is known about a cultivar's plants.

    Attributes:
        name: of the cultivar.
        species: its botanical name.
        source: where the numbers come from.
        date: of the growth stage that they describe.
        stem: the main stem.
        organs: kind -> its parameters and what grows on it.
        pigments: surface -> its path through pigment space.
    """

    name: str
    species: str
    source: str
    date: datetime.date | None = None
    stem: Stem
    organs: dict[str, AnyOrgan]
    pigments: dict[str, PigmentPath]

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        check_structure(self.stem, self.organs, self.pigments)
        return self

    @property
    def kinds(self) -> dict[str, OrganKind]:
        """Every kind of organ that a plant can have, the fruit's calyx included."""
        kinds = {name: organ.kind for name, organ in self.organs.items()}
        if any(getattr(organ, "calyx", False) for organ in self.organs.values()):
            kinds[CALYX] = USUAL["calyx"]
        return kinds

    @property
    def grown(self) -> tuple[str, ...]:
        """The kinds that the plants do have, being of a probability above 0; in the file's order."""
        found, waiting = set(), [self.stem.internode, self.stem.node]
        while waiting:
            kind = waiting.pop()
            if kind not in found:
                found.add(kind)
                slots = self.organs[kind].bears
                waiting.extend(k for slot in slots for k in slot.kinds if slot.what.probabilities[k] > 0)
        if any(getattr(self.organs[kind], "calyx", False) for kind in found):
            found.add(CALYX)
        return tuple(kind for kind in self.kinds if kind in found)


def load_cultivar(name_or_path: str | Path) -> Cultivar:
    """A shipped cultivar by its name, or one from a TOML file, with what it inherits from others.

    Raises:
        InputError: not found, not TOML, or a parameter is missing, unknown or not allowed.
    """
    files = lineage(name_or_path)
    tables = inherited(files)
    try:
        return validate(Cultivar, tables, files[0][0])
    except InputError as fault:
        where = stated_in(files, tables, fault.key)
        raise InputError(where, fault.problem, key=fault.key, value=fault.value) from None


Key = tuple[str | int, ...]
Model = TypeVar("Model", bound=Document)

_SAID: Final = (*Origin.model_fields, "name")
"""Words that may differ between two stages."""
_SHARES: Final = 4096
"""At the middles of so many equal shares a blend's spread is summed up."""


def interpolate_cultivars(first: Cultivar, last: Cultivar, share: float) -> Cultivar:
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
            return self.choice(first, last)
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
            return self.number(first, last)
        if isinstance(first, int) and not isinstance(first, bool):
            return self.whole(first, last)
        if first != last:
            raise self.fault(key, "must be the same in both")
        return first

    def whole(self, first: int, last: int) -> int:
        """The whole number next to the mix."""
        return round(self.number(first, last))

    def number(self, first: Any, last: Any) -> Any:
        """The mix of numbers or of arrays; exactly the number that both have."""
        return first + self.share * (last - first)

    def origin(self, first: Origin, last: Origin) -> dict[str, str]:
        """Where both come from."""
        return {n: self.of(getattr(first, n), getattr(last, n), (n,)) for n in Origin.model_fields}

    def model(self, first: Model, last: Model, key: Key) -> Model:
        """All fields of a table."""
        if isinstance(first, Slot) and isinstance(last, Slot) and first.name != last.name:
            raise self.fault((*key, "name"), "must be the same in both")
        fields = type(first).model_fields
        return type(first)(**{n: self.of(getattr(first, n), getattr(last, n), (*key, n)) for n in fields})

    def law(self, first: Distribution, last: Distribution) -> Distribution:
        """The law whose quantiles are the mix of both laws' quantiles."""
        mean, sd, low, high = (
            self.number(getattr(first, name), getattr(last, name)) for name in ("mean", "sd", "low", "high")
        )
        said = self.origin(first, last)
        fields = {"mean": mean, "low": low, "high": high, **said}
        if first.law == last.law == "value":
            return Distribution.model_validate({"law": "value", "sd": sd, **fields})
        if not (first.needs_place or last.needs_place):
            middles = (np.arange(_SHARES) + 0.5) / _SHARES
            sd = float(self.number(first.quantiles(middles), last.quantiles(middles)).std())
        between = (self.share, first, last)
        return Distribution.model_validate({"law": "blend", "sd": sd, "between": between, **fields})

    def choice(self, first: Choice, last: Choice) -> Choice:
        """Every outcome of either, with the mix of its probabilities."""
        chances = {
            name: self.number(first.probabilities.get(name, 0.0), last.probabilities.get(name, 0.0))
            for name in dict.fromkeys((*first.probabilities, *last.probabilities))
        }
        return type(first)(probabilities=chances, **self.origin(first, last))

    def pigments(self, first: PigmentPath, last: PigmentPath, key: Key) -> PigmentPath:
        """The mix of the contents at every state at which either path has a knot."""
        states = sorted({state for path in (first, last) for state, _ in path.knots})
        contents = [path.at(states) for path in (first, last)]
        mixed = {name: self.number(contents[0][name], contents[1][name]) for name in Pigments.model_fields}
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
        return InputError(self.where, allowed, key=toml_key(key))
