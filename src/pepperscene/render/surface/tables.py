"""Surfaces packed into a few flat arrays, so that one BSDF without branches serves a whole scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.materials import Surface
from pepperscene.materials.gloss import NODES, cuticle_transmittance

STEP_NM: Final = 1.0
"""Spacing of the packed spectra. The kernel takes the nearest entry: with wavelengths spread over a pixel's
samples that is the midpoint rule, whose error at this step is below 2e-4 for all shipped surfaces."""

LEAST_ALPHA: Final = 1e-3
"""Smoother cuticles are packed as this: a mirror for every lens here, and fit for single precision."""


@dataclass(frozen=True, eq=False)
class SurfaceTables:
    """All surfaces of a scene in the order of the mesh's `surfaces`.

    Attributes:
        first_nm: wavelength of the first column.
        columns: wavelengths per row, `STEP_NM` apart.
        spectra: `(rows * columns * 4,)` float32: reflectance of front and back, transmittance, 0.
        first_row: `(k,)` uint32, where a surface's states begin.
        last_state: `(k,)` float32, number of its states minus 1.
        sides: `(k * 2 * 4,)` float32, of front and back: the cuticle's GGX alpha, its index of refraction,
            the cosine-weighted mean of its openness, and which share of the body's transmittance is let
            out on the other side (the rest is thrown back).
        openness: `(k * 2 * NODES * 2,)` float32, of front and back: the cuticle's openness 1 - E at the
            nodes over its mean, and the step to the next node.
        details: `(texels * 2,)` float32: offset to the state, relief in the kernel's unit.
        first_texel, width, height: `(k,)` uint32, a surface's part of `details`.
    """

    first_nm: float
    columns: int
    spectra: NDArray[np.float32]
    first_row: NDArray[np.uint32]
    last_state: NDArray[np.float32]
    sides: NDArray[np.float32]
    openness: NDArray[np.float32]
    details: NDArray[np.float32]
    first_texel: NDArray[np.uint32]
    width: NDArray[np.uint32]
    height: NDArray[np.uint32]


def pack(surfaces: Sequence[Surface], first_nm: float, last_nm: float, unit: float = 1.0) -> SurfaceTables:
    """The surfaces' spectra on a common grid over [first_nm, last_nm]; end values hold beyond their range.

    Args:
        surfaces: in the order of the mesh's.
        first_nm: where the range begins.
        last_nm: where it ends.
        unit: that the kernel's coordinates and reliefs count in, metres.
    """
    grid = np.arange(first_nm, last_nm + STEP_NM, STEP_NM)
    blocks = [spectra_rows(surface, grid) for surface in surfaces]
    details = [_details(surface, unit) for surface in surfaces]
    states = np.array([len(block) for block in blocks])
    texels = np.array([detail.shape[0] * detail.shape[1] for detail in details])
    cuticles = [cuticle_tables(surface) for surface in surfaces]
    return SurfaceTables(
        first_nm=first_nm,
        columns=grid.size,
        spectra=np.concatenate(blocks).ravel().astype(np.float32),
        first_row=_starts(states),
        last_state=(states - 1).astype(np.float32),
        sides=np.concatenate([sides.ravel() for sides, _ in cuticles]).astype(np.float32),
        openness=np.concatenate([table.ravel() for _, table in cuticles]).astype(np.float32),
        details=np.concatenate([detail.ravel() for detail in details]),
        first_texel=_starts(texels),
        width=np.array([detail.shape[1] for detail in details], np.uint32),
        height=np.array([detail.shape[0] for detail in details], np.uint32),
    )


def spectra_rows(surface: Surface, grid: NDArray[np.float64]) -> NDArray[np.float64]:
    """A surface's part of the spectra, `(s, columns, 4)`: front and back reflectance, transmittance, 0."""

    def at(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.stack([np.interp(grid, surface.wavelength_nm, row) for row in values])

    front, back = at(surface.reflectance[:, 0]), at(surface.reflectance[:, 1])
    through = at(surface.transmittance)
    return np.stack([front, back, through, np.zeros_like(front)], axis=-1)


def cuticle_tables(surface: Surface) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """`(2, 4)` constants of a surface's sides and `(2, NODES, 2)` tables of their openness."""
    ior = max(float(surface.ior), 1.0)
    alphas = [max(float(alpha), LEAST_ALPHA) for alpha in surface.roughness]
    tables, means = zip(*(cuticle_transmittance(ior, alpha) for alpha in alphas), strict=True)
    least = min(means)
    sides = np.array([(alpha, ior, mean, least / mean) for alpha, mean in zip(alphas, means, strict=True)])
    relative = np.stack([table / mean for table, mean in zip(tables, means, strict=True)])
    steps = np.diff(relative, axis=1, append=relative[:, -1:])
    packed = np.stack([relative, steps], axis=-1)
    assert packed.shape == (2, NODES, 2)
    return sides, packed


def _details(surface: Surface, unit: float) -> NDArray[np.float32]:
    """`(h, w, 2)`: pattern and relief; a single zero texel where a surface has neither."""
    sizes = [image.shape for image in (surface.pattern, surface.relief_mm) if image is not None]
    if len(set(sizes)) > 1:
        raise ValueError(f"{surface.name}: pattern and relief differ in size: {sizes}")
    packed = np.zeros((*(sizes[0] if sizes else (1, 1)), 2), np.float32)
    if surface.pattern is not None:
        packed[..., 0] = surface.pattern
    if surface.relief_mm is not None:
        packed[..., 1] = surface.relief_mm * (1e-3 / unit)
    return packed


def _starts(counts: NDArray[np.int_]) -> NDArray[np.uint32]:
    """Where each block begins when blocks of these lengths lie one behind the other."""
    return (np.cumsum(counts) - counts).astype(np.uint32)
