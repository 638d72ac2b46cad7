"""One varied value of a recipe: a distribution, a weighted choice, or values in turn."""

from __future__ import annotations

import datetime
import hashlib
import json
import math
import os
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from pepperscene.cultivar import Distribution
from pepperscene.recipe.plan import FrameSpec, Stream

Level = Literal["set", "scene", "frame"]
LEVELS: Final[tuple[Level, ...]] = ("set", "scene", "frame")
MAX_CHECKED: Final = 128
"""Chosen: of more different values of a list, the limits and this number of others are checked together with
the rest of a recipe, which takes a millisecond each."""

Key = tuple[str | int, ...]
"""Where a value is in a recipe's tables: names of tables and keys, and positions in lists."""


def json_value(value: Any) -> Any:
    """A value of a recipe for JSON: dates and tables as text, and of a file's path only its name.

    A table becomes the text of a JSON object with sorted keys, as a column of the manifest holds it.
    """
    if isinstance(value, str) and os.path.isabs(value):
        return Path(value).stem
    if isinstance(value, list | tuple):
        return [json_value(item) for item in value]
    if isinstance(value, Mapping):
        return json.dumps({str(key): json_value(item) for key, item in value.items()}, sort_keys=True)
    return value if isinstance(value, bool | int | float | str) else str(value)


def distinct_values(values: Iterable[Any]) -> list[Any]:
    """The different values of a list, in the order of their first occurrence."""
    return list({(type(value), repr(value)): value for value in values}.values())


def _positions(values: Sequence[Any]) -> dict[Any, int]:
    """The position of each value of a list as JSON holds it, the first of several."""
    texts = [value if isinstance(value, bool | int | float | str) else str(value) for value in values]
    return {text: len(texts) - 1 - number for number, text in enumerate(reversed(texts))}


@dataclass(frozen=True)
class Varied(ABC):
    """A value of a recipe that differs between sets, scenes or frames.

    Attributes:
        key: of the value.
        per: what a value is drawn for.
        draw: name of the draw; values that share a name rise and fall together.
        reversed: whether the value falls where others of the same draw rise.
    """

    key: Key
    per: Level
    draw: str
    reversed: bool = field(default=False, kw_only=True)

    @property
    def name(self) -> str:
        """The dotted key."""
        return ".".join(map(str, self.key))

    @abstractmethod
    def value(self, probability: float, turn: int) -> Any:
        """The value for a probability in [0, 1) and the number of the set, scene or frame."""

    @property
    @abstractmethod
    def nominal(self) -> Any:
        """A typical value, for what needs a single one, such as the fields of a recipe."""

    @property
    @abstractmethod
    def extremes(self) -> tuple[Any, ...]:
        """The ends of the range, or all outcomes; if these are valid, the values between are too."""

    @abstractmethod
    def describe(self) -> str:
        """The range or the outcomes, for users."""

    @abstractmethod
    def identity(self) -> dict[str, Any]:
        """All that drawn values depend on, ready for JSON."""

    def _common_identity(self) -> dict[str, Any]:
        identity: dict[str, Any] = {"per": self.per, "draw": self.draw}
        return {**identity, "reversed": True} if self.reversed else identity


Kind = Literal["number", "integer", "date"]


@dataclass(frozen=True)
class VariedNumber(Varied):
    """A number, an integer or a date that follows a distribution, or whose logarithm does.

    Every integer or date of a uniform distribution is equally likely, its limits included.

    Attributes:
        distribution: of the number or its logarithm.
        kind: of the values.
        logarithmic: whether the distribution is that of the logarithm.
        limits: of the number; None for those of the distribution. On a logarithmic scale they are given
            apart, because the exponential of a limit's logarithm differs from it by rounding.
    """

    distribution: Distribution
    kind: Kind = "number"
    logarithmic: bool = False
    limits: tuple[float, float] | None = None

    def value(self, probability: float, turn: int) -> Any:
        """The quantile of a probability in [0, 1), as a number, an integer or a date."""
        if self._is_discrete_uniform:
            first, last = round(self.distribution.low), round(self.distribution.high)
            return self._convert(min(first + int(probability * (last - first + 1)), last))
        return self._convert(float(self.distribution.quantiles(probability)))

    @property
    def nominal(self) -> Any:
        """The median."""
        return self.value(0.5, 0)

    @property
    def extremes(self) -> tuple[Any, ...]:
        """The lowest and the highest value."""
        if self.limits is not None:
            return tuple(round(limit) if self.kind == "integer" else limit for limit in self.limits)
        return tuple(self._convert(limit) for limit in (self.distribution.low, self.distribution.high))

    def cumulative(self, values: Any) -> np.ndarray:
        """Probability that a drawn number is at most each of `values` `(n,)`."""
        if self._is_discrete_uniform:
            first, last = round(self.distribution.low), round(self.distribution.high)
            return np.clip((np.floor(values) - first + 1) / (last - first + 1), 0.0, 1.0)
        grid = np.linspace(0.0, 1.0, 4097)
        quantiles = self.distribution.quantiles(grid)
        numbers = np.asarray(values, dtype=float)
        return np.interp(np.log(numbers) if self.logarithmic else numbers, quantiles, grid)

    def describe(self) -> str:
        """The range and the distribution, for users."""
        low, high = self.extremes
        family = self.distribution.family
        scale = ", logarithmic scale" if self.logarithmic else ""
        limits = f"{low} to {high}" if self.kind != "number" else f"{low:g} to {high:g}"
        if family == "normal" and self.kind == "number" and not self.logarithmic:
            return f"{limits}, normal with mean {self.distribution.mean:g} and sd {self.distribution.sd:g}"
        return f"{limits}, {family}{scale}"

    def identity(self) -> dict[str, Any]:
        """All that drawn values depend on, ready for JSON."""
        numbers = self.distribution.model_dump(
            mode="json", include={"family", "mean", "sd", "low", "high", "bins"}
        )
        return {**self._common_identity(), **numbers, "kind": self.kind, "logarithmic": self.logarithmic}

    @property
    def _is_discrete_uniform(self) -> bool:
        return self.kind != "number" and self.distribution.family == "uniform" and not self.logarithmic

    def _convert(self, number: float) -> Any:
        number = math.exp(number) if self.logarithmic else number
        if self.limits is not None:
            number = min(max(number, self.limits[0]), self.limits[1])
        if self.kind == "date":
            return datetime.date.fromordinal(round(number))
        return round(number) if self.kind == "integer" else number


@dataclass(frozen=True)
class VariedChoice(Varied):
    """One of several outcomes, with probabilities that sum to 1."""

    outcomes: tuple[Any, ...]
    probabilities: tuple[float, ...]

    def value(self, probability: float, turn: int) -> Any:
        """The outcome in whose interval of probabilities a probability in [0, 1) is."""
        ends = np.cumsum(self.probabilities)
        number = int(np.searchsorted(ends, probability * ends[-1], side="right"))
        return self.outcomes[min(number, len(self.outcomes) - 1)]

    @property
    def nominal(self) -> Any:
        """The most probable outcome."""
        return self.outcomes[int(np.argmax(self.probabilities))]

    @property
    def extremes(self) -> tuple[Any, ...]:
        """All outcomes."""
        return self.outcomes

    @cached_property
    def positions(self) -> dict[Any, int]:
        """The position of each outcome."""
        return _positions(self.outcomes)

    def describe(self) -> str:
        """The outcomes and their probabilities, for users."""
        pairs = zip(self.outcomes, self.probabilities, strict=True)
        return ", ".join(f"{outcome} {100 * probability:.3g} %" for outcome, probability in pairs)

    def identity(self) -> dict[str, Any]:
        """All that drawn values depend on, ready for JSON."""
        values = map(json_value, self.outcomes)
        outcomes = [list(pair) for pair in zip(values, self.probabilities, strict=True)]
        return {**self._common_identity(), "outcomes": outcomes}


@dataclass(frozen=True)
class VariedInTurn(Varied):
    """The values of a list in turn, by the number of the set, scene or frame."""

    values: tuple[Any, ...]

    def value(self, probability: float, turn: int) -> Any:
        """The value at the number of the set, scene or frame; the probability has no effect."""
        return self.values[turn % len(self.values)]

    @property
    def nominal(self) -> Any:
        """The first value."""
        return self.values[0]

    @property
    def extremes(self) -> tuple[Any, ...]:
        """All different values; of many that are no names, the limits and some between them."""
        distinct = distinct_values(self.values)
        if len(distinct) <= MAX_CHECKED or any(isinstance(value, str) for value in distinct):
            return tuple(distinct)
        with suppress(TypeError):
            distinct.sort()
        return tuple(distinct[i] for i in np.linspace(0, len(distinct) - 1, MAX_CHECKED).astype(int))

    @cached_property
    def positions(self) -> dict[Any, int]:
        """The position of each value, the first of several."""
        return _positions(self.values)

    def describe(self) -> str:
        """The values in their order, for users; of many, the first ones and their number."""
        text = f"in turn {', '.join(map(str, self.values[:MAX_CHECKED]))}"
        return text if len(self.values) <= MAX_CHECKED else f"{text}, ... ({len(self.values):,} values)"

    def identity(self) -> dict[str, Any]:
        """All that drawn values depend on, ready for JSON."""
        return {"per": self.per, "in_turn": [json_value(value) for value in self.values]}


Draws = tuple[tuple[Varied, Any], ...]
"""Varied values, each with the value that was drawn."""


def draw_values(variation: Iterable[Varied], seed: int, spec: FrameSpec) -> Draws:
    """The varied values of a recipe with the values of one frame.

    A value depends on the seed, its own draw and the frame's set, scene or moment, and on nothing else: a
    changed distribution leaves all other values as they were. Frames of the same moment, by other cameras of
    a rig or as twins, have the same values.
    """
    return tuple((varied, varied.value(*_draw(varied, seed, spec))) for varied in variation)


def _draw(varied: Varied, seed: int, spec: FrameSpec) -> tuple[float, int]:
    """Probability in [0, 1) of a value, and the number of the set, scene or moment."""
    address = {"set": (spec.set,), "scene": (spec.set, spec.rotation), "frame": (spec.moment,)}[varied.per]
    turn = {"set": spec.set, "scene": spec.scene, "frame": spec.moment}[varied.per]
    words = np.frombuffer(hashlib.sha256(varied.draw.encode()).digest()[:16], "<u4")
    key = (int(Stream.VARIATION), LEVELS.index(varied.per), *address, *(int(word) for word in words))
    probability = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key)).random()
    return (1.0 - probability if varied.reversed else probability), turn


def as_json(draws: Draws) -> dict[str, Any]:
    """Drawn values by dotted key, ready for JSON."""
    return {varied.name: json_value(value) for varied, value in draws}
