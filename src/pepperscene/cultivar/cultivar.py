"""All parameters of a cultivar's plants, read from a TOML file or interpolated between two growth stages."""

from __future__ import annotations

import copy
import datetime
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from pydantic import Field, model_validator

from pepperscene.cultivar.distribution import Distribution, Origin
from pepperscene.cultivar.inheritance import (
    check_no_scans,
    defining_file,
    merge_chain,
    read_chain,
    resolve_curves,
)
from pepperscene.cultivar.notation import Choice
from pepperscene.cultivar.organs import DEFAULT_KINDS, AnyOrgan, OrganKind
from pepperscene.cultivar.slot import Slot
from pepperscene.cultivar.structure import (
    CALYX,
    Key,
    MeasuredCurve,
    PigmentPath,
    Pigments,
    Stem,
    check_structure,
)
from pepperscene.document import Document, toml_key, validate
from pepperscene.errors import InputError


class Cultivar(Document):
    """Parameters of a cultivar's plants.

    Attributes:
        name, species: common and botanical name.
        source: of the numbers.
        date: of the growth stage.
        stem: the main stem.
        organs: kind -> its parameters and its slots.
        pigments: surface -> its path through pigment space.
        spectra: surface -> its measured curve, which replaces the colour that the pigments give.
    """

    name: str
    species: str
    source: str
    date: datetime.date | None = None
    stem: Stem
    organs: dict[str, AnyOrgan]
    pigments: dict[str, PigmentPath]
    spectra: dict[str, MeasuredCurve] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _check_structure(self) -> Self:
        check_structure(self.stem, self.organs, self.pigments, self.spectra)
        return self

    @property
    def kinds(self) -> dict[str, OrganKind]:
        """Every kind of organ that a plant can have, including the fruit's calyx."""
        kinds = {name: organ.kind for name, organ in self.organs.items()}
        if any(getattr(organ, "calyx", False) for organ in self.organs.values()):
            kinds[CALYX] = DEFAULT_KINDS["calyx"]
        return kinds

    @property
    def present_kinds(self) -> tuple[str, ...]:
        """Kinds with a probability above 0, in the file's order."""
        reached, queue = set(), [self.stem.internode, self.stem.node]
        while queue:
            kind = queue.pop()
            if kind not in reached:
                reached.add(kind)
                slots = self.organs[kind].bears
                queue.extend(k for slot in slots for k in slot.kinds if slot.what.probabilities[k] > 0)
        if any(getattr(self.organs[kind], "calyx", False) for kind in reached):
            reached.add(CALYX)
        return tuple(kind for kind in self.kinds if kind in reached)


CHANGES: Final = "changes"
"""In errors about the `changes` of `load_cultivar`, instead of a file name."""


def load_cultivar(name_or_path: str | Path, changes: Mapping[str, Any] | None = None) -> Cultivar:
    """Read a shipped cultivar by its name, or one from a TOML file, with everything that it inherits.

    Args:
        name_or_path: of the cultivar.
        changes: tables that override those of the file, in its notation; they name no scans, and
            measured curves relative to the current folder.

    Raises:
        InputError: not found, not TOML, or a parameter is missing, unknown or not allowed; for an error in
            `changes`, the file name is `CHANGES`.
    """
    files = read_chain(name_or_path)
    if changes:
        check_no_scans(CHANGES, changes)
        changed = copy.deepcopy(dict(changes))
        resolve_curves(changed, Path())
        files = [(Path(CHANGES), changed), *files]
    tables = merge_chain(files)
    try:
        return validate(Cultivar, tables, files[0][0])
    except InputError as error:
        file = defining_file(files, tables, error.key)
        raise InputError(file, error.problem, key=error.key, value=error.value) from None


_TEXT_KEYS: Final = (*Origin.model_fields, "name")
"""Texts that may differ between two stages."""
_SAMPLES: Final = 4096
"""Number of quantiles from which a blend's standard deviation is computed."""


def interpolate_cultivars(first: Cultivar, last: Cultivar, fraction: float) -> Cultivar:
    """Interpolate between two growth stages.

    Quantile functions, probabilities, plain numbers, pigments and dates are interpolated linearly; integers
    are rounded.

    Args:
        first: the stage at fraction 0.
        last: the stage at fraction 1; with the same kinds, forms and slots.
        fraction: from 0 to 1.

    Raises:
        InputError: kinds, forms, slots or other texts differ.
        ValueError: `fraction` is not in [0, 1], or an interpolated probability or ripeness is not allowed.
    """
    if not 0.0 <= fraction <= 1.0:
        raise ValueError(f"fraction must be between 0 and 1, not {fraction}")
    if fraction in (0.0, 1.0):
        return last if fraction else first
    interpolation = _Interpolation(f"{first.name} and {last.name}", fraction)
    fields = {
        name: interpolation.value(getattr(first, name), getattr(last, name), (name,))
        for name in Cultivar.model_fields
    }
    if first.name != last.name:
        fields["name"] = f"{first.name} to {last.name}, {fraction:.2f}"
    return Cultivar(**fields)


@dataclass(frozen=True)
class _Interpolation:
    """Interpolation between two values of the same type; errors name both cultivars and the key."""

    where: str
    fraction: float

    def value(self, first: Any, last: Any, key: Key) -> Any:
        if key[-1] == "date" and (first is None or last is None):
            return None
        if key[-1] in _TEXT_KEYS and isinstance(first, str):
            return first if first == last else "; ".join(text for text in (first, last) if text)
        if type(first) is not type(last):
            raise self.error(key, "must be set in both or in neither")
        match first:
            case Distribution():
                return first if first == last else self.distribution(first, last)
            case PigmentPath():
                return self.pigments(first, last, key)
            case Choice():
                return self.choice(first, last)
            case Slot() if first.name != last.name:
                raise self.error((*key, "name"), "must be the same in both")
            case Document():
                return type(first)(**self.fields(first, last, key, type(first).model_fields))
            case dict():
                if different := sorted(set(first) ^ set(last)):
                    raise self.error(key, f"must have the same names in both: {', '.join(different)}")
                return {name: self.value(value, last[name], (*key, name)) for name, value in first.items()}
            case tuple():
                if len(first) != len(last):
                    raise self.error(key, "must have the same length in both")
                pairs = enumerate(zip(first, last, strict=True))
                return tuple(self.value(a, b, (*key, i)) for i, (a, b) in pairs)
            case datetime.date():
                return datetime.date.fromordinal(round(self.number(first.toordinal(), last.toordinal())))
            case float():
                return self.number(first, last)
            case int() if not isinstance(first, bool):
                return round(self.number(first, last))
        if first != last:
            raise self.error(key, "must be the same in both")
        return first

    def number(self, first: Any, last: Any) -> Any:
        """Interpolate numbers or arrays; exact if both are equal."""
        return first + self.fraction * (last - first)

    def fields(self, first: Document, last: Document, key: Key, names: Any) -> dict[str, Any]:
        return {n: self.value(getattr(first, n), getattr(last, n), (*key, n)) for n in names}

    def distribution(self, first: Distribution, last: Distribution) -> Distribution:
        """The distribution whose quantiles are interpolated between both distributions' quantiles."""
        mean, sd, low, high = (
            self.number(getattr(first, name), getattr(last, name)) for name in ("mean", "sd", "low", "high")
        )
        origin = self.fields(first, last, (), Origin.model_fields)
        if first.family == last.family == "value":
            return Distribution(family="value", mean=mean, sd=sd, low=low, high=high, **origin)
        if not (first.needs_position or last.needs_position):
            midpoints = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
            sd = float(self.number(first.quantiles(midpoints), last.quantiles(midpoints)).std())
        between = (self.fraction, first, last)
        return Distribution(family="blend", mean=mean, sd=sd, low=low, high=high, between=between, **origin)

    def choice(self, first: Choice, last: Choice) -> Choice:
        """Every outcome of either, with interpolated probabilities."""
        probabilities = {
            name: self.number(first.probabilities.get(name, 0.0), last.probabilities.get(name, 0.0))
            for name in dict.fromkeys((*first.probabilities, *last.probabilities))
        }
        origin = self.fields(first, last, (), Origin.model_fields)
        return type(first)(probabilities=probabilities, **origin)

    def pigments(self, first: PigmentPath, last: PigmentPath, key: Key) -> PigmentPath:
        """The interpolated contents at every state at which either path has a knot."""
        states = sorted({state for path in (first, last) for state, _ in path.knots})
        contents = [path.at(states) for path in (first, last)]
        values = {name: self.number(contents[0][name], contents[1][name]) for name in Pigments.model_fields}
        knots = [Pigments(**{n: float(v[i]) for n, v in values.items()}) for i in range(len(states))]
        changed = PigmentPath.fields_of(tuple(zip(states, knots, strict=True)))
        others = sorted(set(PigmentPath.model_fields) - set(changed))
        return PigmentPath(**changed, **self.fields(first, last, key, others))

    def error(self, key: Key, allowed: str) -> InputError:
        """Error for values that differ and cannot be interpolated."""
        return InputError(self.where, allowed, key=toml_key(key))
