"""Blades with given measures, and random ones as on a plant."""

from __future__ import annotations

import numpy as np

from pepperscene.geometry.blade.blades import mesh_blades
from pepperscene.grammar.plant import Organ

LENGTH, WIDTH = 0.135, 0.112
FLAT = {"length_m": LENGTH, "width_m": WIDTH, "seed": 0.37, "state_mean": 0.6, "state_spread": 0.1}
LOBED = {"lobes": 5.0, "lobe_depth": 0.35}
KAITE = {  # about the means and standard deviations of Kaite's leaves
    "fold_rad": (0.28, 0.19), "curl_rad": (0.09, 0.38), "twist_rad": (0.0, 0.28),
    "margin_wave_m": (0.003, 0.0016), "margin_waves": (4.0, 1.2), "blister_m": (0.0016, 0.0006),
    "vein_m": (0.0004, 0.0002), "asymmetry": (0.0, 0.04), "widest": (0.35, 0.03), "base": (0.8, 0.06),
}  # fmt: skip


def organ(curve=None, **measures):
    """A blade in the xy plane that points along y, upper side up, unless it has another curve."""
    measures = FLAT | measures
    line = np.array([[0.0, 0, 0], [0.0, measures["length_m"], 0.0]]) if curve is None else curve
    return Organ("lamina", -1, 0, line, np.array([0.0, 0.0, 1.0]), measures)


def blade(curve=None, detail=1.0, **measures):
    return mesh_blades([organ(curve, **measures)], detail)


def random_organ(rng, factor=1.0, **measures):
    """A blade with the distributions of Kaite, their standard deviations scaled by a factor."""
    drawn = {name: mean + factor * sd * rng.standard_normal() for name, (mean, sd) in KAITE.items()}
    return organ(droop(float(rng.uniform(0.2, 1.2))), **(drawn | {"seed": rng.random()} | measures))


def droop(angle, points=14, length=LENGTH):
    """A midrib that bends down evenly by `angle` from base to tip."""
    slope = angle * (np.arange(points - 1) + 0.5) / (points - 1)
    steps = np.stack([0.0 * slope, np.cos(slope), -np.sin(slope)], axis=1) * length / (points - 1)
    return np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


def edges(faces):
    return faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)


def areas(batch):
    a, b, c = (batch.vertices[:, batch.faces[:, corner]] for corner in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=2)


def signed_areas(points, faces):
    """Areas of triangles of plane points `(..., v, 2)`, negative if inverted."""
    a, b, c = (points[..., faces[:, corner], :] for corner in range(3))
    (p, q), (r, s) = np.moveaxis(b - a, -1, 0), np.moveaxis(c - a, -1, 0)
    return 0.5 * (p * s - q * r)


def margin(points, faces):
    """The edge of a blade `(m, ...)` as a closed polygon from the base, along the right margin to the tip."""
    directed = edges(faces).tolist()
    opposite = {(b, a) for a, b in directed}
    successor = {a: b for a, b in directed if (a, b) not in opposite}
    line = [0]
    while (point := successor[line[-1]]) != 0:
        line.append(point)
    assert len(line) == len(successor)
    return points[line]


def polygon_area(line):
    x, y = line.T
    return 0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))
