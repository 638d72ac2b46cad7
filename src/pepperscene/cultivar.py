"""A cultivar: every parameter of its plants as a distribution with a unit and a source, read from TOML.

Lengths are millimetres and angles degrees in the file, where each key says so (`mean_mm`, `histogram_deg`),
and metres and radians here. The parameters are those of Barth et al. 2018, Table 1 and Fig. 3 to 5, and what
else a plant needs to stand, each with its `source`, or `chosen` and why.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property, partial
from itertools import pairwise
from pathlib import Path
from statistics import NormalDist
from typing import Annotated, Any, Final, Literal, Self, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BeforeValidator, Field, model_validator

from pepperscene.document import Document, read_toml, validated
from pepperscene.shipped import find

Unit = Literal["mm", "deg", ""]
Law = Literal["value", "normal", "uniform", "histogram"]
Bin = tuple[float, float, float]

_TO_SI: Final[dict[Unit, float]] = {"mm": 1e-3, "deg": math.pi / 180.0, "": 1.0}
_CALLED: Final[dict[Unit, str]] = {"mm": "a length", "deg": "an angle", "": "a plain number"}
_SUM_TOLERANCE: Final = 1e-6  # of weights and probabilities, which people write with few digits
_DEFAULT_REACH: Final = 3.0  # standard deviations to either side, where no bounds are stated


class Origin(Document):
    """Where a number comes from: a `source`, or `chosen` and why; one of them must be there."""

    source: str = ""
    chosen: str = ""
    as_printed: str = ""
    used: str = ""

    @model_validator(mode="after")
    def _has_origin(self) -> Self:
        if not (self.source.strip() or self.chosen.strip()):
            raise ValueError("needs a source, or chosen and why")
        return self


class Distribution(Origin):
    """One random parameter, in metres, radians or a plain number.

    Attributes:
        law: "value" (fixed), "normal" (truncated), "uniform" or "histogram" (uniform within each bin).
        mean: of the drawn values: for a normal law that of the truncated distribution, as is `sd`, so that a
            measured mean and standard deviation come back whatever the bounds cut off.
        sd: standard deviation of the drawn values.
        low: smallest value that can be drawn.
        high: largest value that can be drawn.
        bins: (from, to, probability) of a histogram, ascending.
    """

    law: Law
    mean: float
    sd: float
    low: float
    high: float
    bins: tuple[Bin, ...] = ()

    @overload
    def draw(self, rng: np.random.Generator) -> float: ...
    @overload
    def draw(self, rng: np.random.Generator, size: int | tuple[int, ...]) -> NDArray[np.float64]: ...
    def draw(
        self, rng: np.random.Generator, size: int | tuple[int, ...] | None = None
    ) -> float | NDArray[np.float64]:
        """Independent values in metres, radians or a plain number; a float when `size` is None."""
        if size is None:
            return self.quantile(rng.random())
        return self.quantiles(rng.random(size))

    def quantile(self, share: float) -> float:
        """The value that a share in [0, 1] of all draws lies below (the inverse distribution function)."""
        if self.law == "histogram":
            starts, lows, highs, weights = self._ladder
            step = int(np.searchsorted(starts, share, side="right")) - 1
            inside = (share - starts[step]) / weights[step]
            return float(lows[step] + min(inside, 1.0) * (highs[step] - lows[step]))
        if self.law == "normal" and self.sd > 0:
            normal, below, above = self._parent
            within = min(max(below + share * (above - below), 1e-300), 1.0 - 1e-16)
            return min(max(normal.inv_cdf(within), self.low), self.high)
        return self.low + share * (self.high - self.low)

    def quantiles(self, shares: ArrayLike) -> NDArray[np.float64]:
        """`quantile` of an array of any shape."""
        given = np.asarray(shares, dtype=float)
        return np.array([self.quantile(float(share)) for share in given.ravel()]).reshape(given.shape)

    @cached_property
    def _parent(self) -> tuple[NormalDist, float, float]:
        """The normal law before truncation, and its distribution function at both bounds."""
        normal = NormalDist(*_untruncated(self.mean, self.sd, self.low, self.high))
        return normal, normal.cdf(self.low), normal.cdf(self.high)

    @cached_property
    def _ladder(self) -> tuple[NDArray[np.float64], ...]:
        """Of the bins that can occur: cumulated probability at the start, ends, probability."""
        taken = [row for row in self.bins if row[2] > 0]
        lows, highs, weights = (np.array(column) for column in zip(*taken, strict=True))
        return np.concatenate(([0.0], np.cumsum(weights)[:-1])), lows, highs, weights


def truncated_moments(mean: float, sd: float, low: float, high: float) -> tuple[float, float]:
    """Mean and standard deviation of a normal law cut to [low, high].

    Johnson, Kotz & Balakrishnan 1994, Continuous Univariate Distributions 1, section 13.10.
    """
    a, b = (low - mean) / sd, (high - mean) / sd
    density = [math.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi) for x in (a, b)]
    # The upper tail is counted from above, or its probability would be lost in rounding.
    side = -1.0 if a > 0 else 1.0
    mass = 0.5 * side * (math.erfc(-side * b / math.sqrt(2.0)) - math.erfc(-side * a / math.sqrt(2.0)))
    shift = (density[0] - density[1]) / mass
    spread = 1.0 + (a * density[0] - b * density[1]) / mass - shift * shift
    return mean + sd * shift, sd * math.sqrt(max(spread, 0.0))


def _untruncated(mean: float, sd: float, low: float, high: float) -> tuple[float, float]:
    """Mean and standard deviation of the normal law that has `mean` and `sd` once cut to [low, high].

    Newton's method on both moments, with a numerical Jacobian.

    Raises:
        ValueError: no normal law has them.
    """
    found = np.array([mean, math.log(sd)])

    def missing(at: NDArray[np.float64]) -> NDArray[np.float64]:
        got = truncated_moments(float(at[0]), math.exp(float(at[1])), low, high)
        return np.array([got[0] - mean, got[1] - sd]) / sd

    for _ in range(60):
        off = missing(found)
        if np.abs(off).max() < 1e-10:
            return float(found[0]), math.exp(float(found[1]))
        steps = np.array([1e-6 * sd, 1e-6])
        jacobian = np.column_stack(
            [(missing(found + np.eye(2)[k] * steps[k]) - off) / steps[k] for k in (0, 1)]
        )
        try:
            move = np.linalg.solve(jacobian, -off)
        except np.linalg.LinAlgError:
            break
        if not np.isfinite(move).all():
            break
        # Short steps: far from the answer the cut law hardly depends on its parent.
        found = found + move * min(1.0, 0.5 / max(abs(move[0]) / sd, abs(move[1]), 1e-12))
        if abs(found[0] - mean) > 30 * sd or abs(found[1] - math.log(sd)) > 3:
            break
    raise ValueError("no normal distribution has this mean and sd between its bounds; move low, high or sd")


def _in_unit(unit: Unit, raw: Any) -> Any:
    """A distribution's table as it stands in the file -> the fields of `Distribution`, in SI units."""
    if isinstance(raw, Distribution):
        return raw
    if not isinstance(raw, Mapping):
        raise ValueError(
            f"must be a table such as {{ mean{_suffix(unit)} = 1, sd{_suffix(unit)} = 0.1, source = … }}"
        )
    table = dict(raw)
    fields: dict[str, Any] = {
        k: table.pop(k) for k in ("source", "chosen", "as_printed", "used") if k in table
    }
    numbers: dict[str, Any] = {}
    for key, value in table.items():
        stem, found = _split(key)
        if stem not in ("mean", "sd", "low", "high", "value", "uniform", "histogram"):
            raise ValueError(f"{key} is not a known key")
        if found != unit:
            raise ValueError(
                f"{key} has the wrong unit: this is {_CALLED[unit]}, so write {stem}{_suffix(unit)}"
            )
        numbers[stem] = value
    return fields | _law(numbers, unit)


def _law(numbers: dict[str, Any], unit: Unit) -> dict[str, Any]:
    """The law that a table's numbers stand for, in SI units."""
    factor, suffix, keys = _TO_SI[unit], _suffix(unit), set(numbers)
    if keys == {"value"}:
        value = factor * _number(numbers["value"], f"value{suffix}")
        return {"law": "value", "mean": value, "sd": 0.0, "low": value, "high": value}
    if keys == {"uniform"}:
        low, high = (factor * x for x in _row(numbers["uniform"], 2, f"uniform{suffix}"))
        if not low < high:
            raise ValueError(f"uniform{suffix} must run from a smaller to a larger number")
        sd = (high - low) / math.sqrt(12.0)
        return {"law": "uniform", "mean": 0.5 * (low + high), "sd": sd, "low": low, "high": high}
    if keys == {"histogram"}:
        return _histogram(numbers["histogram"], factor, f"histogram{suffix}")
    if {"mean", "sd"} <= keys <= {"mean", "sd", "low", "high"}:
        return _normal({key: factor * _number(value, key + suffix) for key, value in numbers.items()}, unit)
    raise ValueError(
        f"must hold value{suffix}, or mean{suffix} and sd{suffix} (and low{suffix}, high{suffix}), "
        f"or uniform{suffix}, or histogram{suffix}, and only one of them"
    )


def _normal(numbers: dict[str, float], unit: Unit) -> dict[str, Any]:
    mean, sd, suffix = numbers["mean"], numbers["sd"], _suffix(unit)
    if sd <= 0:
        raise ValueError(f"sd{suffix} must be greater than 0")
    low = numbers.get("low", mean - _DEFAULT_REACH * sd)
    high = numbers.get("high", mean + _DEFAULT_REACH * sd)
    if not low < mean < high:
        raise ValueError(f"mean{suffix} must lie between low{suffix} and high{suffix}")
    if unit == "mm" and low < 0 <= mean and "low" not in numbers:
        raise ValueError("needs low_mm, since three standard deviations below the mean is a negative length")
    _untruncated(mean, sd, low, high)
    return {"law": "normal", "mean": mean, "sd": sd, "low": low, "high": high}


def _histogram(raw: Any, factor: float, key: str) -> dict[str, Any]:
    if not isinstance(raw, (list, tuple)) or not raw:
        raise ValueError(f"{key} must be a list of [from, to, weight]")
    bins = [_row(row, 3, key) for row in raw]
    if any(not low < high for low, high, _ in bins) or any(weight < 0 for _, _, weight in bins):
        raise ValueError(f"{key}: each bin must run upwards and have a weight of at least 0")
    if any(after[0] < before[1] for before, after in pairwise(bins)):
        raise ValueError(f"{key}: bins must ascend without overlap")
    total = math.fsum(weight for _, _, weight in bins)
    if abs(total - 1.0) > _SUM_TOLERANCE:
        raise ValueError(f"{key}: the weights sum to {total:g} and must sum to 1")
    scaled = tuple((factor * low, factor * high, weight / total) for low, high, weight in bins)
    mean = math.fsum(0.5 * (low + high) * weight for low, high, weight in scaled)
    # Second moment of a uniform bin: the square of its middle plus a twelfth of the square of its width.
    square = math.fsum(
        ((low + high) ** 2 / 4 + (high - low) ** 2 / 12) * weight for low, high, weight in scaled
    )
    taken = [row for row in scaled if row[2] > 0]
    sd = math.sqrt(max(square - mean * mean, 0.0))
    return {
        "law": "histogram", "mean": mean, "sd": sd, "low": taken[0][0], "high": taken[-1][1], "bins": scaled
    }  # fmt: skip


def _split(key: str) -> tuple[str, str]:
    for unit in ("mm", "deg"):
        if key.endswith(f"_{unit}"):
            return key.removesuffix(f"_{unit}"), unit
    # A unit that is none of ours still marks the key as one of the known ones, wrongly written.
    stem, _, unit = key.partition("_")
    return stem, unit


def _suffix(unit: Unit) -> str:
    return f"_{unit}" if unit else ""


def _number(raw: Any, key: str) -> float:
    if isinstance(raw, bool) or not isinstance(raw, (int, float)) or not math.isfinite(raw):
        raise ValueError(f"{key} must be a finite number")
    return float(raw)


def _row(raw: Any, length: int, key: str) -> list[float]:
    if not isinstance(raw, (list, tuple)) or len(raw) != length:
        raise ValueError(f"{key} must have {length} numbers")
    return [_number(value, key) for value in raw]


Length = Annotated[Distribution, BeforeValidator(partial(_in_unit, "mm"))]
Angle = Annotated[Distribution, BeforeValidator(partial(_in_unit, "deg"))]
Ratio = Annotated[Distribution, BeforeValidator(partial(_in_unit, ""))]
Probability = Annotated[float, Field(ge=0.0, le=1.0)]


class Choice(Origin):
    """One of several outcomes; the subclasses' probabilities are at least 0 and sum to 1."""

    @model_validator(mode="after")
    def _sums_to_one(self) -> Self:
        total = math.fsum(self.probabilities.values())
        if abs(total - 1.0) > _SUM_TOLERANCE:
            raise ValueError(f"the probabilities sum to {total:g} and must sum to 1")
        return self

    @property
    def probabilities(self) -> dict[str, float]:
        """Outcome -> probability, in the order of the fields."""
        names = [name for name in type(self).model_fields if name not in Origin.model_fields]
        return {name: getattr(self, name) for name in names}


class LeafChoice(Choice):
    """Whether a node carries a leaf of its own."""

    leaf: Probability
    none: Probability


class ShootChoice(Choice):
    """Whether a node carries a side shoot."""

    side_shoot: Probability
    none: Probability


class FruitChoice(Choice):
    """What a node has of fruit, averaged over the plant: one on its peduncle, the scar of one, or nothing."""

    fruit: Probability
    cut: Probability
    none: Probability


class EndCount(Choice):
    """How many leaves or further shoots stand at the end of a side shoot."""

    one: Probability
    two: Probability
    three: Probability


class EndChoice(Choice):
    """What each of them is."""

    leaf: Probability
    side_shoot: Probability


class LobeChoice(Choice):
    """Number of a fruit's lobes."""

    three: Probability
    four: Probability


class Branching(Document):
    """What grows from what (Barth et al. 2018, Fig. 3a and 5).

    Attributes:
        node_leaf: the leaf at a node of the main stem.
        node_shoot: the side shoot at a node of the main stem.
        node_fruit: fruit or cut at a node, averaged over nodes and plants.
        shoot_ends: how many parts end a side shoot.
        shoot_end: what each of them is; a leaf when `depth` is reached.
        depth: how many side shoots can follow one another.
        flush_nodes: nodes from one flush of fruit to the next.
        flush_strength: 0 for evenly set fruit, 1 for none between the flushes.
        cut_descent: how much the cuts' share of fruit positions exceeds its mean at the foot, and falls short
            of it at the top.
    """

    node_leaf: LeafChoice
    node_shoot: ShootChoice
    node_fruit: FruitChoice
    shoot_ends: EndCount
    shoot_end: EndChoice
    depth: Annotated[int, Field(ge=1, le=6)]
    flush_nodes: Ratio
    flush_strength: Ratio
    cut_descent: Ratio

    @model_validator(mode="after")
    def _modulations_fit(self) -> Self:
        fruiting = self.node_fruit.fruit + self.node_fruit.cut
        if fruiting * (1.0 + self.flush_strength.high) > 1.0 or self.flush_strength.low < 0:
            raise ValueError(
                "flush_strength must be 0 or more and leave every node's chance of fruit at most 1"
            )
        share = self.node_fruit.cut / fruiting if fruiting else 0.5
        if not -1e-9 <= self.cut_descent.low <= self.cut_descent.high <= min(share, 1.0 - share) + 1e-9:
            raise ValueError(
                "cut_descent must lie between 0 and the smaller of the cuts' and the fruits' share"
            )
        return self


class PlantShape(Document):
    """The main stem: P-1 (stem diameter) and P-2 (lean across the row), and how the top is younger."""

    stem_parts: Annotated[int, Field(ge=2, le=200)]
    stem_diameter: Length
    top_diameter: Ratio
    lean: Angle
    zigzag: Angle
    groove: Length
    young_nodes: Annotated[int, Field(ge=0)]
    young_size: Annotated[float, Field(gt=0.0, le=1.0)]
    chosen: str


class NodeShape(Document):
    """I-1 and I-2."""

    internode_length: Length
    width: Length
    length: Length


class LeafShape(Document):
    """A leaf: its stem (petiole), its blade (lamina), how they are posed and how the blade is bent.

    Inclinations are above the horizontal, positive upwards, in the vertical plane that the leaf grows in.
    """

    petiole_length: Length
    length: Length
    width: Length
    petiole_inclination: Angle
    lamina_inclination: Angle
    petiole_diameter: Length
    petiole_tip: Ratio


class Blade(Document):
    """How blades bend, for leaves of the stem and of shoots alike."""

    size_correlation: Annotated[float, Field(ge=0.0, le=1.0)]
    droop: Angle
    sway: Angle
    roll: Angle
    fold: Angle
    curl: Angle
    twist: Angle
    margin_wave: Length
    margin_waves: Ratio
    blister: Length
    asymmetry: Ratio
    state_mean: Ratio
    state_spread: Ratio
    chosen: str


class Around(Document):
    """Angles around the stem, counter-clockwise seen from above, 0 towards the aisle (Fig. 3b).

    Attributes:
        leaf: L-1.
        side_shoot: S-1.
        fruit: F-1.
        leaf_step: from one leaf to the next, in turns of the cumulated L-1 distribution: leaves avoid the
            previous one and all the same follow L-1 as a whole. So for the next two:
        shoot_from_leaf: from a node's leaf to its side shoot.
        fruit_from_leaf: from a node's leaf to its fruit or cut.
    """

    leaf: Angle
    side_shoot: Angle
    fruit: Angle
    leaf_step: Ratio
    shoot_from_leaf: Ratio
    fruit_from_leaf: Ratio


class ShootShape(Document):
    """A side shoot: S-1 (length), S-3 (inclination), and how the parts at its end spread."""

    length: Length
    diameter: Length
    tip: Ratio
    inclination: Angle
    bend: Angle
    end_spread: Angle


class PeduncleShape(Document):
    """P-1 (length) and its bend from the node to the fruit."""

    length: Length
    diameter: Length
    tip: Ratio
    inclination: Angle
    end_inclination: Angle
    calyx_radius: Ratio


class FruitShape(Document):
    """F-2 and the form of a blocky sweet pepper.

    Attributes:
        diameter: F-2, of a grown fruit.
        slenderness: length divided by diameter.
        inclination: of the axis from stalk end to blossom end, about -90 degrees.
        ripe_fraction: share of the grown fruit that is ripe; that of a young top is green.
        ripe_descent: how much that share rises towards the foot, where fruit is older, and falls to the top,
            over half the plant's height.
        breaker_fraction: share of fruit that is turning, taken from both sides alike.
        unripe, breaker, ripe: ripeness of such fruit, 0 green to 1 ripe.
    """

    diameter: Length
    slenderness: Ratio
    inclination: Angle
    lobes: LobeChoice
    lobe_depth: Ratio
    shoulder: Ratio
    taper: Ratio
    ripe_fraction: Ratio
    ripe_descent: Ratio
    breaker_fraction: Ratio
    unripe: Ratio
    breaker: Ratio
    ripe: Ratio
    ripeness_spread: Ratio

    @model_validator(mode="after")
    def _shares_fit(self) -> Self:
        ripe, breaker, descent = self.ripe_fraction, self.breaker_fraction, self.ripe_descent
        if min(ripe.low, breaker.low, descent.low) < 0 or max(ripe.high, breaker.high) > 1:
            raise ValueError("ripe_fraction, breaker_fraction and ripe_descent must lie in [0, 1]")
        if ripe.high + descent.high > 1 or ripe.low - descent.high < 0:
            raise ValueError(
                "ripe_descent must leave the share of ripe fruit within [0, 1] at both ends of the plant"
            )
        return self


class CutShape(Document):
    """The scar of a harvested peduncle."""

    diameter: Length
    length: Length


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


class PigmentTable(Document):
    """The surfaces whose colour comes from pigments."""

    leaf: PigmentPath
    petiole: PigmentPath
    stem: PigmentPath
    fruit: PigmentPath
    calyx: PigmentPath


class Cultivar(Document):
    """All that is known about a cultivar's plants."""

    name: str
    species: str
    source: str
    plant: PlantShape
    node: NodeShape
    around: Around
    branching: Branching
    leaf: LeafShape
    shoot_leaf: LeafShape
    blade: Blade
    side_shoot: ShootShape
    peduncle: PeduncleShape
    fruit: FruitShape
    cut: CutShape
    pigment: PigmentTable = Field(alias="pigments")

    @property
    def pigments(self) -> dict[str, PigmentPath]:
        """Surface name -> its path through pigment space."""
        return {name: getattr(self.pigment, name) for name in PigmentTable.model_fields}


def load_cultivar(name_or_path: str | Path) -> Cultivar:
    """A shipped cultivar by its name, or one from a TOML file.

    Raises:
        InputError: not found, not TOML, or a parameter is missing, unknown or not allowed.
    """
    path = find("plants", name_or_path)
    return validated(Cultivar, read_toml(path), path)
