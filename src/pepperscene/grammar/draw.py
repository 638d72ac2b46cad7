"""Drawing the parameters of one plant from a cultivar's distributions."""

from __future__ import annotations

import math
from statistics import NormalDist
from typing import Final

import numpy as np

from pepperscene.cultivar import Choice, Cultivar, Distribution, LeafShape
from pepperscene.grammar.parameters import (
    CutParameters,
    FruitParameters,
    LeafParameters,
    PhytomerParameters,
    PlantParameters,
    ShootParameters,
)

# Chosen, as habits of growth that photographs show and no table has:
_TWINE_PULL: Final = 0.7  # sd, rad, of a section's azimuth about the way back to the plant's own line
_YOUNG_LIFT: Final = math.radians(60.0)  # young blades are held up; at size 0 by so much
_YOUNG_PALE: Final = 0.35  # young blades are paler; at size 0 by so much in state
_CUT_INCLINATION: Final = math.radians(20.0)  # a peduncle's base points outwards and a little up
_HANG_ASIDE: Final = math.radians(15.0)  # sd of a fruit's azimuth about that of its peduncle

_STANDARD: Final = NormalDist()


def draw_parameters(cultivar: Cultivar, rng: np.random.Generator) -> PlantParameters:
    """All numbers of one plant; the same generator state gives the same plant.

    Every phytomer has its own child generator, so that a change in one leaves the others as they are.
    """
    return _Drawing(cultivar, rng).plant()


class _Drawing:
    """The draws that a whole plant shares, and the draws of its parts."""

    def __init__(self, cultivar: Cultivar, rng: np.random.Generator) -> None:
        shape, self.cultivar = cultivar.plant, cultivar
        self.parts = shape.stem_parts
        self.generators = rng.spawn(self.parts)
        self.diameter = shape.stem_diameter.draw(rng)
        self.top = shape.top_diameter.draw(rng)
        self.lean = shape.lean.draw(rng)
        self.groove = shape.groove.draw(rng)
        self.period = cultivar.branching.flush_nodes.draw(rng)
        self.phase = rng.random()
        self.leaf_share = rng.random()
        # The plant's own line, from which the stem must not stray: it leans across the row.
        self.line = np.array([0.0, -math.sin(self.lean)])
        self.strayed = np.zeros(2)
        self.ripening_height = self._ripening_height()

    def plant(self) -> PlantParameters:
        """All phytomers from the ground up."""
        phytomers = tuple(self._phytomer(i, rng) for i, rng in enumerate(self.generators))
        return PlantParameters(self.cultivar.name, phytomers)

    def _phytomer(self, i: int, rng: np.random.Generator) -> PhytomerParameters:
        node, branching = self.cultivar.node, self.cultivar.branching
        size = self._size(i)
        length = size * node.internode_length.draw(rng)
        azimuth, inclination = self._stem_direction(length, rng)
        width, node_length = node.width.draw(rng), node.length.draw(rng)
        radius, radius_tip = self._stem_radius(i), self._stem_radius(i + 1)
        # The azimuths of what grows here, as shares of their cumulated distributions.
        around = self.cultivar.around
        self.leaf_share = (self.leaf_share + around.leaf_step.draw(rng)) % 1.0
        leaf_azimuth = around.leaf.quantile(self.leaf_share)
        shoot_azimuth = around.side_shoot.quantile((self.leaf_share + around.shoot_from_leaf.draw(rng)) % 1.0)
        fruit_azimuth = around.fruit.quantile((self.leaf_share + around.fruit_from_leaf.draw(rng)) % 1.0)
        # What grows here.
        leaf = shoot = None
        if _chosen(branching.node_leaf, rng) == "leaf":
            leaf = self._leaf(self.cultivar.leaf, leaf_azimuth, size, rng)
        if _chosen(branching.node_shoot, rng) == "side_shoot":
            shoot = self._shoot(shoot_azimuth, size, 1, rng)
        return PhytomerParameters(
            length=length,
            azimuth=azimuth,
            inclination=inclination,
            radius=radius,
            radius_tip=radius_tip,
            groove=self.groove * radius / (0.5 * self.diameter),
            seed=rng.random(),
            node_length=size * node_length,
            node_radius=max(0.5 * size * width, 1.1 * radius_tip),  # a node is never thinner than its stem
            leaf=leaf,
            shoot=shoot,
            fruit=self._fruit_or_cut(i, fruit_azimuth, size, rng),
        )

    def _height(self, i: int) -> float:
        """A phytomer's place along the stem, 0 at the lowest and 1 at the topmost."""
        return i / (self.parts - 1)

    def _ripening_height(self) -> float:
        """Mean height of the fruit that is grown and not harvested, about which ripeness is balanced."""
        heights = np.array([self._height(i) for i in range(self.parts) if self._size(i) == 1.0] or [1.0])
        left = np.array([1.0 - self._cut_share(h, self.cultivar.branching.cut_descent.mean) for h in heights])
        return float(np.average(heights, weights=left)) if left.sum() > 0 else 0.5

    def _cut_share(self, height: float, descent: float) -> float:
        """Share of the fruit set at a height that has been harvested, balanced about the plant's middle."""
        set_here = self.cultivar.branching.node_fruit
        fruiting = set_here.fruit + set_here.cut
        mean = set_here.cut / fruiting if fruiting else 0.0
        return mean + descent * (1.0 - 2.0 * height)

    def _size(self, i: int) -> float:
        """How large a phytomer has grown: 1 but for the young ones at the top, smaller one by one."""
        plant = self.cultivar.plant
        from_top = self.parts - 1 - i
        if from_top >= plant.young_nodes:
            return 1.0
        return plant.young_size + (1.0 - plant.young_size) * from_top / plant.young_nodes

    def _stem_radius(self, i: int) -> float:
        """The stem's radius below phytomer `i`: tapering about the drawn mean, thinner where it is young."""
        slope = 2.0 * (1.0 - self.top) / (1.0 + self.top)
        size = self._size(min(i, self.parts - 1))
        place = i / max(self.parts - self.cultivar.plant.young_nodes, 1)
        return 0.5 * self.diameter * (1.0 + slope * (0.5 - place)) * math.sqrt(size)

    def _stem_direction(self, length: float, rng: np.random.Generator) -> tuple[float, float]:
        """Azimuth and inclination of a section: aslant, and back to the line that the twine holds it to."""
        aslant = self.cultivar.plant.zigzag.draw(rng)
        back = (
            math.atan2(-self.strayed[0], self.strayed[1])
            if self.strayed.any()
            else 2 * math.pi * rng.random()
        )
        azimuth = back + _TWINE_PULL * rng.standard_normal()
        level = math.sin(aslant) * np.array([math.sin(azimuth), -math.cos(azimuth)])
        self.strayed = self.strayed + length * level
        level = level + self.line
        return math.atan2(level[0], -level[1]), math.acos(min(math.hypot(*level), 1.0))

    def _leaf(
        self, shape: LeafShape, azimuth: float, size: float, rng: np.random.Generator
    ) -> LeafParameters:
        blade = self.cultivar.blade
        length, width = _together((shape.length, shape.width), blade.size_correlation, rng)
        radius = 0.5 * size * shape.petiole_diameter.draw(rng)
        unfinished = 1.0 - size
        measures = {
            "fold_rad": blade.fold.draw(rng),
            "margin_wave_m": size * blade.margin_wave.draw(rng),
            "margin_waves": blade.margin_waves.draw(rng),
            "blister_m": size * blade.blister.draw(rng),
            "twist_rad": blade.twist.draw(rng),
            "curl_rad": blade.curl.draw(rng),
            "asymmetry": blade.asymmetry.draw(rng),
            "seed": rng.random(),
            "state_mean": max(blade.state_mean.draw(rng) - _YOUNG_PALE * unfinished, 0.0),
            "state_spread": blade.state_spread.draw(rng),
        }
        return LeafParameters(
            azimuth=azimuth,
            petiole_length=size * shape.petiole_length.draw(rng),
            petiole_radius=radius,
            petiole_radius_tip=radius * shape.petiole_tip.draw(rng),
            petiole_inclination=shape.petiole_inclination.draw(rng),
            length=size * length,
            width=size * width,
            inclination=shape.lamina_inclination.draw(rng) + _YOUNG_LIFT * unfinished,
            droop=blade.droop.draw(rng),
            sway=blade.sway.draw(rng),
            roll=blade.roll.draw(rng),
            shape=measures,
        )

    def _shoot(self, azimuth: float, size: float, depth: int, rng: np.random.Generator) -> ShootParameters:
        shape, branching = self.cultivar.side_shoot, self.cultivar.branching
        count = 1 + tuple(branching.shoot_ends.probabilities).index(_chosen(branching.shoot_ends, rng))
        # Fan the parts at the end out about the shoot's own azimuth.
        spread = shape.end_spread.draw(rng)
        aside = 0.5 * spread * rng.standard_normal()
        ends: list[LeafParameters | ShootParameters] = []
        for k in range(count):
            towards = azimuth + spread * (k - 0.5 * (count - 1)) + (aside if count == 1 else 0.25 * aside)
            if depth < branching.depth and _chosen(branching.shoot_end, rng) == "side_shoot":
                ends.append(self._shoot(towards, size, depth + 1, rng))
            else:
                ends.append(self._leaf(self.cultivar.shoot_leaf, towards, size, rng))
        radius = 0.5 * size * shape.diameter.draw(rng)
        return ShootParameters(
            azimuth=azimuth,
            length=size * shape.length.draw(rng),
            radius=radius,
            radius_tip=radius * shape.tip.draw(rng),
            inclination=shape.inclination.draw(rng),
            bend=shape.bend.draw(rng),
            ends=tuple(ends),
        )

    def _fruit_or_cut(
        self, i: int, azimuth: float, size: float, rng: np.random.Generator
    ) -> FruitParameters | CutParameters | None:
        branching = self.cultivar.branching
        set_here, rest = branching.node_fruit, rng.random()
        # Whether a fruit was set: more often in flushes, whose phase is uniform, so that the mean stays.
        wave = math.cos(2.0 * math.pi * (i / self.period + self.phase))
        fruiting = set_here.fruit + set_here.cut
        if rest >= fruiting * (1.0 + branching.flush_strength.draw(rng) * wave):
            return None
        # Whether it has been harvested: more often low on the plant.
        if rng.random() >= self._cut_share(self._height(i), branching.cut_descent.draw(rng)):
            return self._fruit(i, azimuth, size, rng)
        cut = self.cultivar.cut
        return CutParameters(
            azimuth, _CUT_INCLINATION, cut.length.draw(rng), 0.5 * size * cut.diameter.draw(rng)
        )

    def _fruit(self, i: int, azimuth: float, size: float, rng: np.random.Generator) -> FruitParameters:
        peduncle, fruit = self.cultivar.peduncle, self.cultivar.fruit
        radius = 0.5 * size * peduncle.diameter.draw(rng)
        diameter = size * fruit.diameter.draw(rng)
        measures = {
            "lobes": 3.0 if _chosen(fruit.lobes, rng) == "three" else 4.0,
            "lobe_depth": fruit.lobe_depth.draw(rng),
            "shoulder": fruit.shoulder.draw(rng),
            "taper": fruit.taper.draw(rng),
            "seed": rng.random(),
            "ripeness": self._ripeness(i, size, rng),
            "ripeness_spread": fruit.ripeness_spread.draw(rng),
        }
        return FruitParameters(
            azimuth=azimuth,
            peduncle_length=size * peduncle.length.draw(rng),
            peduncle_radius=radius,
            peduncle_radius_tip=radius * peduncle.tip.draw(rng),
            inclination=peduncle.inclination.draw(rng),
            end_inclination=peduncle.end_inclination.draw(rng),
            hang_azimuth=azimuth + _HANG_ASIDE * rng.standard_normal(),
            hang_inclination=fruit.inclination.draw(rng),
            calyx_radius=diameter * peduncle.calyx_radius.draw(rng),
            calyx_seed=rng.random(),
            length=diameter * fruit.slenderness.draw(rng),
            diameter=diameter,
            shape=measures,
        )

    def _ripeness(self, i: int, size: float, rng: np.random.Generator) -> float:
        """Ripeness of a fruit: ripe more often low on the plant, never where the plant still grows."""
        fruit = self.cultivar.fruit
        rise = 2.0 * (self.ripening_height - self._height(i))
        ripe = fruit.ripe_fraction.draw(rng) + fruit.ripe_descent.draw(rng) * rise
        breaker, rest = fruit.breaker_fraction.draw(rng), rng.random()
        values = fruit.ripe.draw(rng), fruit.breaker.draw(rng), fruit.unripe.draw(rng)
        if size < 1.0:
            return values[2]
        below, above = ripe - 0.5 * breaker, ripe + 0.5 * breaker
        return values[0] if rest < below else values[1] if rest < above else values[2]


def _chosen(choice: Choice, rng: np.random.Generator) -> str:
    """One outcome by its probability."""
    rest = rng.random()
    outcomes = choice.probabilities
    for name, probability in outcomes.items():
        rest -= probability
        if rest < 0:
            return name
    return max(outcomes, key=lambda name: outcomes[name])  # rounding left the sum a hair below 1


def _together(laws: tuple[Distribution, ...], correlation: float, rng: np.random.Generator) -> list[float]:
    """One value of each law, correlated by a Gaussian copula, so that each still follows its own law."""
    shared = math.sqrt(correlation) * rng.standard_normal()
    own = math.sqrt(1.0 - correlation)
    return [law.quantile(_STANDARD.cdf(shared + own * rng.standard_normal())) for law in laws]
