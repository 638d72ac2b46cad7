"""The light that surfaces send out at the second hits of a frame's paths, kept in cells of a few centimetres.

Most noise of daylight among leaves arises after the second hit: whether a path finds the sky from there. That
light is nearly the same within a cell (`kernel.cells`), so the paths of a frame share it: some paths are
traced to their end, and what arrives from their second hits is averaged by cell. All other rays end at their
second hits with that mean.

What is kept is light over (albedo times light source), so that the place and the wavelengths of a sample keep
their own: each of a sample's four wavelengths lies in its own quarter of the distribution that they are drawn
from, and each quarter has its own mean. A mean with few samples is drawn to that of a larger cell: with n
samples and a weight of k, (sum + k parent) / (n + k). Larger cells are darker: most of their samples are deep
in the crop. So all means are multiplied by the light of the samples over its prediction from the other
samples (leave-one-out), some per cent.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.render.arrays import device_array
from pepperscene.render.kernel.cells import SurfaceCells
from pepperscene.render.variant import mitsuba_modules

_PARENT_SAMPLES: Final = 5.0
"""Weight of a larger cell's mean, in samples. Chosen: with 8, a frame of `greenhouse` has .4 % less error,
but foil, which sees cells with few samples, is .2 codes brighter."""
_WAVELENGTHS: Final = 4
_TINY: Final = 1e-30


@dataclass(frozen=True, eq=False)
class LightCache:
    """Light that the sides of cells send out, over their albedo and the light sources.

    Attributes:
        cells: of the scene.
        ratios: `(count * 4,)` on the device, by quarter of the wavelengths.
    """

    cells: SurfaceCells
    ratios: Any

    def outgoing(self, si: Any, hit: Any, expected: Any, active: Any) -> Any:
        """Light from surface interactions towards the viewer; `expected` as of `PathLight`."""
        mi, dr = mitsuba_modules()
        ratio = dr.gather(mi.Spectrum, self.ratios, self.cells.at(si, hit, active), active)
        return ratio * expected


@dataclass(frozen=True, eq=False)
class PathLight:
    """The light that leaves the second hits of paths.

    Attributes:
        cells: of the scene.
        side: `(n,)` sides of cells that the light leaves.
        light: `(4, n)` light at the wavelengths of the paths.
        expected: `(4, n)` albedo times light source there.
    """

    cells: SurfaceCells
    side: NDArray[np.uint32]
    light: NDArray[np.float32]
    expected: NDArray[np.float32]

    def half(self) -> PathLight:
        """Every second path."""
        return PathLight(self.cells, self.side[::2], self.light[:, ::2], self.expected[:, ::2])


def light_cache(paths: PathLight) -> LightCache:
    """Average the light of paths from each side of a cell.

    Sums are taken one path after the other, so that they have the same bits in each run.
    """
    cells, side, light, expected = paths.cells, paths.side, paths.light, paths.expected
    # The sums of each level, from the cells up, and the place of each sample in them.
    number, front = np.divmod(side.astype(np.intp), 2)
    numbers, counts, levels = [number], [cells.count], []
    for parent in cells.parents:
        numbers.append(parent[numbers[-1]].astype(np.intp))
        counts.append(int(parent.max()) + 1)
    for number, count in zip(numbers, counts, strict=True):
        index = 2 * number + front
        levels.append((index, *(_sums_by(index, part, 2 * count) for part in (light, expected))))
    # The means, from the whole scene down; and, for each sample, those of all others.
    light_sum, expected_sum = (part.sum(axis=1, dtype=np.float64) for part in (light, expected))
    weight = (_PARENT_SAMPLES * np.maximum(expected_sum, _TINY) / max(len(side), 1)).astype(np.float32)
    ratio = _ratio(light_sum, expected_sum)[None]
    of_others = _ratio(light_sum - light.T, expected_sum - expected.T)
    for level in range(len(levels) - 1, -1, -1):
        if level < len(cells.parents):
            ratio = ratio.reshape(-1, 2, 4)[cells.parents[level]].reshape(-1, 4)
        index, light_sum, expected_sum = levels[level]
        ratio = (light_sum + weight * ratio) / (expected_sum + weight)
        of_others = (light_sum[index] - light.T + weight * of_others) / (
            expected_sum[index] - expected.T + weight
        )
    # What the means predict for the light of the samples, each by the others.
    predicted = np.einsum("nk,kn->k", of_others, expected, dtype=np.float64)
    gain = np.divide(light.sum(axis=1, dtype=np.float64), predicted, out=np.ones(4), where=predicted > 0.0)
    return LightCache(cells, device_array(ratio * gain.astype(np.float32)))


def _ratio(light: NDArray[np.float64], expected: NDArray[np.float64]) -> NDArray[np.float32]:
    return (light / np.maximum(expected, _TINY)).astype(np.float32)


def _sums_by(index: NDArray[np.intp], values: NDArray[np.float32], count: int) -> NDArray[np.float32]:
    """`(count, 4)` sums of `(4, n)` values by their index."""
    sums = np.empty((count, _WAVELENGTHS), np.float32)
    for k, row in enumerate(values):
        sums[:, k] = np.bincount(index, row, count)
    return sums
