"""Fruit that hangs free: poses that run through the stem or other fruit are drawn again.

Barth et al. 2018 (section 2.3) looked for such plants by hand and replaced them. Here a fruit is two spheres,
the stem, shoots, petioles and midribs are segments with a radius, and the first pose that is free is taken.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from pepperscene.cultivar import Cultivar
from pepperscene.grammar.build import NodeFrame, fruit_centres
from pepperscene.grammar.curves import FloatArray
from pepperscene.grammar.parameters import CutParameters, FruitParameters, PlantParameters
from pepperscene.grammar.plant import Organ, Plant

_TRIES: Final = 24  # chosen: more hardly free any further fruit
_NEAR: Final = 0.25  # m; nothing farther from a node than this meets a fruit that hangs from it
_TURN: Final = 0.5  # rad, chosen: sd of a redrawn azimuth about the drawn one
_PUSH: Final = 0.6  # rad, chosen: by how much the last try holds the fruit out from the stem
_HARD: Final = 10.0  # running into stem or fruit counts so many times as much as into a blade
_BLADE_LINES: Final = (-0.3, 0.0, 0.3)  # lines along a blade, in widths from the midrib


@dataclass(frozen=True, eq=False)
class _Segments:
    """Obstacles: `(n, 3)` starts and spans, `(n,)` radii, and `(n,)` weights of running into them."""

    start: FloatArray
    span: FloatArray
    radius: FloatArray
    weight: FloatArray

    def near(self, point: FloatArray) -> _Segments:
        """Those that a fruit near `point` can meet."""
        off = self.start + 0.5 * self.span - point
        kept = np.einsum("ij,ij->i", off, off) < _NEAR**2
        return _Segments(self.start[kept], self.span[kept], self.radius[kept], self.weight[kept])

    def distance(self, points: FloatArray) -> FloatArray:
        """`(..., n)` from points `(..., 3)` to the surfaces; negative inside."""
        squared = np.maximum(np.einsum("ij,ij->i", self.span, self.span), 1e-18)
        # |p - s - t d|^2 written out, so that only (..., n) arrays are made.
        to_start = points @ self.span.T - np.einsum("ij,ij->i", self.start, self.span)
        t = np.clip(to_start / squared, 0.0, 1.0)
        square = (points**2).sum(-1)[..., None] - 2.0 * points @ self.start.T + (self.start**2).sum(-1)
        return np.sqrt(np.maximum(square - 2.0 * t * to_start + t * t * squared, 0.0)) - self.radius


def settle(
    parameters: PlantParameters,
    organs: list[Organ],
    frames: list[NodeFrame],
    cultivar: Cultivar,
    rng: np.random.Generator,
) -> list[FruitParameters | CutParameters | None]:
    """What each node carries, fruit turned and bent anew where it ran into something.

    Args:
        parameters: the plant's, whose fruit is to be settled.
        organs: the plant without fruit.
        frames: where its nodes stand.
        cultivar: whose distributions a new pose is drawn from.
        rng: for new poses; every fruit has its own child generator.
    """
    obstacles = _obstacles(organs)
    found: list[FruitParameters | CutParameters | None] = []
    spheres, radii = np.empty((0, 3)), np.empty(0)
    generators = rng.spawn(len(frames))
    for phytomer, frame, own in zip(parameters.phytomers, frames, generators, strict=True):
        one = phytomer.fruit
        if isinstance(one, FruitParameters):
            one, centres, radius = _settled(
                one, frame, obstacles.near(frame.centre), spheres, radii, cultivar, own
            )
            spheres = np.concatenate((spheres, centres))
            radii = np.concatenate((radii, np.full(len(centres), radius)))
        found.append(one)
    return found


def touching_fruit(plant: Plant, tolerance_m: float = 1e-4) -> int:
    """How many of a plant's fruits run into its main stem or into another of its fruits.

    A fruit counts as two spheres of its diameter on its axis (one, if it is wider than long).
    """
    stem = _segments([organ for organ in plant.organs if organ.kind in ("internode", "node")])
    fruits = plant.of_kind("fruit")
    if not fruits:
        return 0
    radii = np.array([0.5 * organ.measures["diameter_m"] for organ in fruits])
    axes = np.stack([organ.curve[1] - organ.curve[0] for organ in fruits])
    lengths = np.linalg.norm(axes, axis=1)
    middle = np.stack([organ.curve.mean(axis=0) for organ in fruits])
    pairs = _spheres(middle, axes / lengths[:, None], lengths, radii)
    into_stem = stem.distance(pairs).min(axis=(1, 2)) < radii - tolerance_m
    apart = np.linalg.norm(pairs[:, :, None, None] - pairs[None, None], axis=-1).min(axis=(1, 3))
    np.fill_diagonal(apart, np.inf)
    into_fruit = (apart < radii[:, None] + radii - tolerance_m).any(axis=1)
    return int((into_stem | into_fruit).sum())


def _settled(
    one: FruitParameters,
    frame: NodeFrame,
    obstacles: _Segments,
    spheres: FloatArray,
    radii: FloatArray,
    cultivar: Cultivar,
    rng: np.random.Generator,
) -> tuple[FruitParameters, FloatArray, float]:
    """A fruit in the first free pose of its tries, or the least bad; and its spheres and their radius."""
    poses = _poses(one, cultivar, rng)
    middle, axis = fruit_centres(frame, one, *poses.values())
    radius = 0.5 * one.diameter
    pairs = _spheres(middle, axis, np.full(_TRIES, one.length), np.full(_TRIES, radius))
    # How deep each pose runs into the nearest thing.
    depth = np.maximum(radius - obstacles.distance(pairs), 0.0) * obstacles.weight
    badness = depth.max(axis=(1, 2), initial=0.0)
    if len(spheres):
        apart = np.linalg.norm(pairs[:, :, None] - spheres, axis=-1) - radii
        badness = np.maximum(badness, _HARD * np.maximum(radius - apart, 0.0).max(axis=(1, 2)))
    best = int(np.argmin(badness))
    pose: dict[str, Any] = {name: float(values[best]) for name, values in poses.items()}
    return replace(one, **pose), pairs[best], radius


def _poses(one: FruitParameters, cultivar: Cultivar, rng: np.random.Generator) -> dict[str, FloatArray]:
    """The drawn pose first, then others ever farther from its azimuth, by the names of their parameters."""
    turn = _TURN * np.linspace(0.0, 2.0, _TRIES) * rng.standard_normal(_TRIES)
    azimuth = one.azimuth + turn
    # What touches the stem is pushed away from it.
    pushed = _PUSH * np.linspace(0.0, 1.0, _TRIES) ** 2
    bend, hang = cultivar.peduncle, cultivar.fruit
    poses = {
        "azimuth": azimuth,
        "inclination": bend.inclination.draw(rng, _TRIES),
        "end_inclination": bend.end_inclination.draw(rng, _TRIES) + pushed,
        "hang_azimuth": azimuth + (one.hang_azimuth - one.azimuth) * np.linspace(1.0, 0.0, _TRIES),
        "hang_inclination": hang.inclination.draw(rng, _TRIES) + pushed,
    }
    for name, values in poses.items():
        values[0] = getattr(one, name)
    return poses


def _spheres(middle: FloatArray, axis: FloatArray, length: FloatArray, radius: FloatArray) -> FloatArray:
    """`(k, 2, 3)` centres of the two spheres that stand for each of `k` fruits."""
    off = np.maximum(0.5 * length - radius, 0.0)[:, None] * axis
    return np.stack((middle - off, middle + off), axis=1)


def _obstacles(organs: list[Organ]) -> _Segments:
    """Everything of a plant without fruit that a fruit can run into."""
    wood = _segments([organ for organ in organs if organ.kind != "lamina"])
    blades = [organ for organ in organs if organ.kind == "lamina"]
    if not blades:
        return wood
    # A few lines along each blade, bent as its midrib and narrowing to its tip: (blades, lines, points, 3).
    midrib = np.stack([organ.curve for organ in blades])[:, ::3]
    tangent = midrib[:, 1] - midrib[:, 0]
    aside = np.cross(tangent, np.stack([organ.up for organ in blades]))
    width = np.array([organ.measures["width_m"] for organ in blades])
    aside *= (width / np.linalg.norm(aside, axis=1))[:, None]
    narrowing = np.linspace(1.0, 0.3, midrib.shape[1])
    lines = midrib[:, None] + np.einsum("l,p,bx->blpx", _BLADE_LINES, narrowing, aside)
    start = lines[:, :, :-1].reshape(-1, 3)
    span = np.diff(lines, axis=2).reshape(-1, 3)
    return _Segments(
        np.concatenate((wood.start, start)),
        np.concatenate((wood.span, span)),
        np.concatenate((wood.radius, np.zeros(len(start)))),
        np.concatenate((wood.weight, np.ones(len(start)))),
    )


def _segments(organs: list[Organ]) -> _Segments:
    """The centrelines of tubes, with their base radius."""
    counts = [len(organ.curve) - 1 for organ in organs]
    start = np.concatenate([organ.curve[:-1] for organ in organs])
    end = np.concatenate([organ.curve[1:] for organ in organs])
    radius = np.repeat([organ.measures["radius_m"] for organ in organs], counts)
    return _Segments(start, end - start, radius, np.full(len(start), _HARD))
