"""Scanned meshes that a fruit kind uses in place of a generated body: files, weights, axis, unit, colour."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Final, Literal

from pydantic import BeforeValidator, Field

ScanAxis = Literal["x", "y", "z", "-x", "-y", "-z"]
ScanUnit = Literal["m", "cm", "mm", "in"]

SCAN_SUFFIXES: Final = (".glb", ".obj", ".ply", ".stl")

UNIT_M: Final[Mapping[ScanUnit, float]] = MappingProxyType({"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254})
"""Metres of each unit that a file can be in."""


@dataclass(frozen=True)
class FruitScans:
    """The scans of a fruit kind.

    Attributes:
        files: mesh files; each fruit uses one of them.
        weights: relative frequency of each file, above 0; empty for equal ones.
        up: axis of the files that points to the stalk end; None for that of the format, y for GLB, else z.
        unit: of the files; None if it is not known.
        colour: whether the fruit have the colours of the files instead of those of their pigments.
        diameter_m: mean diameter of the kind, which the size of a file of known unit is compared with.
    """

    files: tuple[Path, ...]
    weights: tuple[float, ...] = ()
    up: ScanAxis | None = None
    unit: ScanUnit | None = None
    colour: bool = False
    diameter_m: float = 0.08


def _as_list(raw: Any) -> Any:
    """One path as a list of one."""
    if isinstance(raw, str | Path):
        return (raw,)
    if isinstance(raw, list | tuple) and all(isinstance(item, str | Path) for item in raw):
        return raw
    raise ValueError("must be a path, or a list of paths")


ScanFiles = Annotated[tuple[Path, ...], BeforeValidator(_as_list)]
ScanWeights = tuple[Annotated[float, Field(gt=0.0, le=1e6)], ...]
