"""The pigment state of tissue at places of surfaces, and which texture an organ has."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.materials.surface import AGEING_RANGE, Surface
from pepperscene.spectra.spectrum import FloatArray


def texture_count(surface: Surface) -> int:
    """Number of textures of a surface, at least 1."""
    return max((len(images) for images in surface.textures.values()), default=1)


def choose_texture(count: ArrayLike, variant: ArrayLike) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Number of the texture of organs with a `variant`, out of `count`, and whether it is mirrored in u.

    The variant modulo the count chooses the texture; in a stack of several, the next bit mirrors it.
    """
    t, v = np.asarray(count), np.asarray(variant)
    return np.asarray(v % t), np.asarray((t > 1) & (v // t % 2 == 1))


def tissue_states(
    surface: Surface, state: FloatArray, uv: FloatArray, variant: NDArray[np.int64], ageing: FloatArray
) -> FloatArray:
    """`(n,)` pigment states of tissue, as the renderer looks them up: with the pattern, and aged.

    States `(n,)` and surface coordinates `(n, 2)` are those of points, variant (which chooses the texture)
    and ageing `(n,)` those of the organs.
    """
    texels = SurfaceTexels.of(surface, uv, variant)
    if surface.pattern is not None:
        state = state + texels.bilinear(surface.pattern)
    healthy = np.clip(state, 0.0, 1.0)
    if surface.first_state == 0.0:
        return healthy
    aged = ageing
    if surface.ageing_order is not None:
        aged = (ageing - texels.bilinear(surface.ageing_order)) / AGEING_RANGE
    return np.asarray(healthy - np.clip(aged, 0.0, 1.0) * (1.0 + healthy))


@dataclass(frozen=True, eq=False)
class SurfaceTexels:
    """The four texels around each of n points, as the renderer finds them."""

    index: NDArray[np.int64]  # `(2, 2, n)` in a stack of textures: above and below, to the left and the right
    across: FloatArray  # `(n,)` weight of those on the right
    down: FloatArray  # `(n,)` weight of those below

    @classmethod
    def of(cls, surface: Surface, uv: FloatArray, variant: NDArray[np.int64]) -> SurfaceTexels:
        """Find the texels at surface coordinates `(n, 2)` of organs with a variant `(n,)`."""
        height, width = next((images.shape[1:] for images in surface.textures.values()), (1, 1))
        texture, mirrored = choose_texture(texture_count(surface), variant)
        x = np.where(mirrored, 1.0 - uv[:, 0], uv[:, 0]) * width - 0.5
        y = uv[:, 1] * height - 0.5
        left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
        # Textures are periodic in u.
        columns = np.stack([left % width, (left + 1) % width])
        rows = texture * height + np.clip([top, top + 1], 0, height - 1)
        return cls(rows[:, None] * width + columns, x - left, y - top)

    def bilinear(self, images: NDArray[np.float32]) -> FloatArray:
        """`(n,)` values of a stack of textures `(t, h, w)`."""
        left, right = np.moveaxis(np.take(images, self.index), 1, 0)
        above, below = (1.0 - self.across) * left + self.across * right
        return np.asarray((1.0 - self.down) * above + self.down * below)
