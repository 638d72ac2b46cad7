"""Topology of a plant: which organs grow from a cultivar's slots, level by level; no sizes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.cultivar import Cultivar, Distribution, Slot
from pepperscene.errors import InputError
from pepperscene.grammar.hashing import Addresses, FloatArray, child_addresses, name_number, uniforms
from pepperscene.grammar.plant import Indices

# Chosen from photographs: standard deviation of the azimuth of items at a shoot's end about their even fan,
# as a fraction of the angle between neighbours; a single item deviates more.
_DEVIATION_SINGLE: Final = 0.5
_DEVIATION: Final = 0.125

_ROUNDING: Final = 1e-9  # a smaller probability of nothing is rounding
_MAX_ORGANS: Final = 200_000  # chosen: a hundred times those of a sweet pepper of 200 nodes
_MAX_DRAWN: Final = 2_000_000
"""Chosen: items that are drawn together, most of which may become nothing; they take about 250 MB."""


@dataclass(frozen=True, eq=False)
class Phytomers:
    """The phytomers of a plant's stem, from the ground up."""

    key: Addresses  # `(1,)` address from which all others are hashed
    internodes: Addresses  # `(parts,)` addresses
    nodes: Addresses  # `(parts,)` addresses of the nodes above the internodes
    sizes: FloatArray  # `(parts,)` relative: 1 except for young ones, which become smaller towards the top
    positions: FloatArray  # `(parts,)` along the mature stem, 0 foot to 1 top; 1 for young ones
    heights: FloatArray  # `(parts,)` along the complete stem
    mature: int  # number of mature phytomers

    @classmethod
    def of(cls, cultivar: Cultivar, key: Addresses) -> Phytomers:
        """Phytomers of a plant with this key."""
        stem = cultivar.stem
        mature = max(stem.parts - stem.young_nodes, 0)
        order = np.arange(stem.parts)
        from_top = order[::-1]
        # The topmost has the smallest size; sizes reach 1 below the young ones.
        young_sizes = stem.young_size + (1.0 - stem.young_size) * from_top / max(stem.young_nodes, 1)
        return cls(
            key=key,
            internodes=child_addresses(key, 2 * order),
            nodes=child_addresses(key, 2 * order + 1),
            sizes=np.where(from_top < stem.young_nodes, young_sizes, 1.0),
            positions=np.minimum((order + 0.5) / max(mature, 1), 1.0),
            heights=(order + 0.5) / stem.parts,
            mature=mature,
        )

    def __len__(self) -> int:
        return len(self.sizes)

    def with_slot(self, slot: Slot) -> NDArray[np.bool_]:
        """`(parts,)` nodes that have this slot of the node kind."""
        order = np.arange(len(self))
        return np.asarray((order >= slot.first) & ((order - slot.first) % slot.every == 0))

    def descent(self, slot: Slot) -> FloatArray:
        """`(parts,)` linear decrease from 1 to -1 along the nodes that have a slot, of mean 0."""
        occupied = self.with_slot(slot)
        return np.where(occupied, 1.0 - (2.0 * np.cumsum(occupied) - 1.0) / max(int(occupied.sum()), 1), 0.0)


def slot_items(
    slot: Slot, slots: Addresses, positions: FloatArray
) -> tuple[Indices, Addresses, FloatArray, FloatArray]:
    """Draw the items in a slot of n organs, organ by organ and from base to tip.

    Args:
        slot: the same for all organs.
        slots: `(n,)` addresses of the slots.
        positions: `(n,)` of the organs along the stem.

    Returns:
        For each of `(m,)` items the index of its organ, its address, its position along the organ (0 base to
        1 tip), and its azimuth relative to the slot's, radians.
    """
    at = np.array(slot.at)
    groups = child_addresses(slots[:, None], np.arange(at.size)).ravel()
    numbers = draw_numbers(slot.count.numbers, uniforms(groups, "count"))
    # A group is all items at one position; `item` counts within it, and `rank` within one side of it.
    counts = numbers * (2 if slot.pairs else 1)
    group = np.repeat(np.arange(counts.size), counts)
    item = np.arange(group.size) - np.repeat(np.cumsum(counts) - counts, counts)
    row, index = np.divmod(group, at.size)
    address = child_addresses(groups[group], item)
    azimuth = np.zeros(group.size)
    if slot.spread is not None:
        rank = item // 2 if slot.pairs else item
        azimuth += _fan_azimuths(slot.spread, groups[group], rank, numbers[group], positions[row])
    if slot.aside is not None:
        # Pairs have an item on either side, others alternate along the organ; the first side is random.
        first = np.where(uniforms(slots, "side") < 0.5, 1.0, -1.0)[row]
        rotation = item if slot.pairs else index
        angle = slot.aside.quantiles(uniforms(address, "aside"), positions[row])
        azimuth += first * np.where(rotation % 2 == 0, 1.0, -1.0) * angle
    return row, address, at[index], azimuth


def _fan_azimuths(
    spread: Distribution, group: Addresses, rank: Indices, number: Indices, positions: FloatArray
) -> FloatArray:
    """Azimuths of items that share a position: an even fan that deviates as a whole from the parent's."""
    from scipy.special import ndtri

    angle = spread.quantiles(uniforms(group, "spread"), positions)
    deviation = np.where(number == 1, _DEVIATION_SINGLE, _DEVIATION) * ndtri(uniforms(group, "stray"))
    return np.asarray(angle * (rank - 0.5 * (number - 1) + deviation))


def outcome_probabilities(
    slot: Slot,
    slots: Addresses,
    phytomer: Indices,
    exhausted: NDArray[np.bool_],
    phytomers: Phytomers,
    flush: Addresses,
) -> FloatArray:
    """`(n, k + 1)` probability of each kind, and last of nothing, in the same slot of n organs.

    Args:
        slot: the same for all organs.
        slots: `(n,)` addresses of the slots.
        phytomer: `(n,)` of the organs.
        exhausted: `(n, k)` whether a kind has reached its depth.
        phytomers: of the plant.
        flush: `(1,)` address of the slot's waves in this plant.
    """
    kinds = slot.kinds
    # Files give probabilities with few digits.
    base = np.array([slot.what.probabilities[kind] for kind in kinds])
    base = base / sum(slot.what.probabilities.values())
    filled = base.sum()
    result = np.empty((len(slots), len(kinds) + 1))
    result[:, :-1] = base
    if slot.descent is not None and filled > 0:
        by = slot.descent.by.quantiles(uniforms(slots, "descent"), phytomers.heights[phytomer])
        column = kinds.index(slot.descent.of)
        mean = base[column] / filled
        fraction = np.clip(mean + by * phytomers.descent(slot)[phytomer], 0.0, 1.0)
        if mean < 1.0:
            result[:, :-1] *= ((1.0 - fraction) / (1.0 - mean))[:, None]
            result[:, column] = fraction * filled
    if slot.flush is not None:
        # The phase is uniform, so the mean is unchanged.
        period = max(float(slot.flush.nodes.quantiles(uniforms(flush, "nodes"))[0]), 1e-3)
        wave = np.cos(2.0 * np.pi * (phytomer / period + uniforms(flush, "phase")[0]))
        strength = slot.flush.strength.quantiles(uniforms(slots, "strength"), phytomers.positions[phytomer])
        factor = 1.0 + strength * wave
        result[:, :-1] *= np.clip(factor, 0.0, 1.0 / filled if filled > 0 else 1.0)[:, None]
    remainder = 1.0 - result[:, :-1].sum(axis=1)
    result[:, -1] = np.where(remainder > _ROUNDING, remainder, 0.0)
    result[:, :-1][exhausted] = 0.0
    return result


def draw_outcomes(probabilities: FloatArray, rows: Indices, uniform: FloatArray) -> Indices:
    """`(m,)` index of one outcome each, from its row of probabilities, which need not sum to 1."""
    cumulative = np.cumsum(probabilities, axis=1)
    total = cumulative[:, -1]
    cumulative /= np.where(total > 0, total, 1.0)[:, None]
    return np.asarray((uniform[:, None] >= cumulative[rows]).sum(axis=1))


def draw_numbers(numbers: dict[int, float], uniform: FloatArray) -> Indices:
    """Draw numbers of items from their probabilities, for uniform numbers of any shape."""
    cumulative = np.cumsum(list(numbers.values()))
    index = np.searchsorted(cumulative / cumulative[-1], uniform, side="right")
    return np.array(list(numbers), dtype=np.intp)[index]


@dataclass(frozen=True, eq=False)
class OrganGroup:
    """`(n,)` organs of one kind: their addresses, and where they grow as in `KindParameters`."""

    kind: str
    address: Addresses
    number: Indices
    parent: Indices
    phytomer: Indices
    at: FloatArray
    lift: FloatArray
    azimuth: FloatArray
    sideways: FloatArray
    depths: Indices  # `(n, kinds)` organs of each depth-limited kind from the stem to here, inclusive


class TopologyBuilder:
    """Draws all organs of a plant except its stem, which has the first numbers; parents come first."""

    def __init__(self, cultivar: Cultivar, phytomers: Phytomers) -> None:
        self.organs, self.phytomers, self.node = cultivar.organs, phytomers, cultivar.stem.node
        self.cultivar = cultivar.name
        self.limits = {
            name: model.depth for name, model in cultivar.organs.items() if model.depth is not None
        }
        self.count = 2 * len(phytomers)

    def build(self) -> list[OrganGroup]:
        """Draw breadth first, so that a level's organs of one kind are drawn together.

        Raises:
            InputError: the plant has more than 200,000 organs.
        """
        level, groups = list(self._draw_node_items()), list[OrganGroup]()
        while level:
            groups += level
            level = [
                group
                for parents in level
                for index, slot in enumerate(self.organs[parents.kind].bears)
                for group in self._draw_items(parents, slot, index, np.zeros(len(parents.number)))
            ]
        return groups

    def _draw_node_items(self) -> Iterator[OrganGroup]:
        """Organs on nodes, each slot at its azimuth around the stem."""
        nodes, positions = self.phytomers.nodes, self.phytomers.positions
        levels: dict[str, FloatArray] = {}
        for index, slot in enumerate(self.organs[self.node].bears):
            uniform = uniforms(child_addresses(nodes, index), "azimuth")
            level = levels[slot.name] = self._azimuth_levels(slot, uniform, levels)
            azimuth = (
                2.0 * np.pi * level if slot.azimuth is None else slot.azimuth.quantiles(level, positions)
            )
            order = np.flatnonzero(self.phytomers.with_slot(slot))
            if order.size:
                number, zeros = 2 * order + 1, np.zeros(order.size)
                depths = np.zeros((order.size, len(self.limits)), dtype=np.intp)
                parents = OrganGroup(
                    self.node, nodes[order], number, number - 1, order, zeros, zeros, zeros, zeros, depths
                )
                yield from self._draw_items(parents, slot, index, azimuth[order])

    def _azimuth_levels(self, slot: Slot, uniform: FloatArray, others: dict[str, FloatArray]) -> FloatArray:
        """`(parts,)` quantile levels of the slot's azimuth, uniform at every node whatever the steps."""
        if slot.step is None:
            return uniform
        step = slot.step.quantiles(uniform, self.phytomers.positions)
        if slot.after is not None:
            return np.asarray((others[slot.after] + step) % 1.0)
        # Relative to the node below, whether or not it is occupied; random at the foot.
        start = uniforms(child_addresses(self.phytomers.key, name_number(slot.name)), "azimuth")
        return np.asarray((start + np.cumsum(step)) % 1.0)

    def _draw_items(
        self, parents: OrganGroup, slot: Slot, index: int, azimuth: FloatArray
    ) -> Iterator[OrganGroup]:
        """Organs in slot number `index` of organs of one kind, at `(n,)` azimuths, kind by kind."""
        kinds, slots = slot.kinds, child_addresses(parents.address, index)
        # Items are counted before they are drawn, because their arrays may not fit into memory.
        items = len(slots) * len(slot.at) * max(slot.count.numbers) * (2 if slot.pairs else 1)
        if items > _MAX_DRAWN:
            problem = f"draws up to {items:,} organs of a plant; at most {_MAX_DRAWN:,} are allowed"
            raise InputError(self.cultivar, problem, key=f"organs.{parents.kind}.bears.{index}")
        row, address, at, rotation = slot_items(slot, slots, self.phytomers.positions[parents.phytomer])
        exhausted = np.zeros((len(slots), len(kinds)), dtype=bool)
        for column, (name, depth) in enumerate(self.limits.items()):
            if name in kinds:
                exhausted[:, kinds.index(name)] = parents.depths[:, column] >= depth
        flush = child_addresses(child_addresses(self.phytomers.key, name_number(parents.kind)), index)
        probabilities = outcome_probabilities(slot, slots, parents.phytomer, exhausted, self.phytomers, flush)
        outcome = draw_outcomes(probabilities, row, uniforms(address, "what"))
        for column, name in enumerate(kinds):
            selected = np.flatnonzero(outcome == column)
            if selected.size:
                columns = {"at": at[selected], "azimuth": azimuth[row[selected]] + rotation[selected]}
                yield self._make_group(
                    name, parents, slot, row[selected], address=address[selected], **columns
                )

    def _make_group(
        self, name: str, parents: OrganGroup, slot: Slot, row: Indices, **columns: Any
    ) -> OrganGroup:
        """Organs of one kind on the parents of these rows, with the next free numbers."""
        # A fruit's calyx has the number before.
        width = 2 if getattr(self.organs[name], "calyx", False) else 1
        number = self.count + width * np.arange(row.size) + width - 1
        self.count += width * row.size
        if self.count > _MAX_ORGANS:
            problem = f"grows more than {_MAX_ORGANS:,} organs on a plant; its slots must bear fewer"
            raise InputError(self.cultivar, problem, key=f"organs.{name}")
        depths = parents.depths[row]
        if name in self.limits:
            depths[:, list(self.limits).index(name)] += 1
        return OrganGroup(
            kind=name,
            number=number,
            parent=parents.number[row],
            phytomer=parents.phytomer[row],
            lift=np.full(row.size, slot.lift),
            sideways=np.full(row.size, float(slot.aside is not None)),
            **columns,
            depths=depths,
        )
