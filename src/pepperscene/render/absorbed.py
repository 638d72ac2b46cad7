"""The light that each organ of a scene absorbs, with standard errors."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import Instance, OrganClass
from pepperscene.errors import ArgumentError
from pepperscene.render.arrays import local_coordinates
from pepperscene.render.kernel.scene import light_scene
from pepperscene.render.transport.light_packets import (
    QUANTITIES,
    REPLICATES,
    band_range,
    packet_tables,
    trace_packets,
)
from pepperscene.scene import Scene, Sky
from pepperscene.spectra.wavebands import Waveband, parse_wavebands

DEFAULT_BANDS: Final = ("par",)
_ROUND: Final = 4096  # chosen: packets of a replicate between two checks; a quarter of a second of two cores
_MOST_ROUNDS: Final = 4096  # chosen: 500 million packets
_LEAST_ROUNDS: Final = 2
_LEAST_ERROR, _MOST_ERROR = 0.001, 1.0


@dataclass(frozen=True, eq=False)
class LightSums:
    """Light of organs or groups of these in each band.

    Attributes:
        absorbed_W, absorbed_umol_s: `(bands, n)` absorbed power, and photons.
        received_W, received_umol_s: all light that arrives at either side of the surfaces, also what was
            scattered before.
        errors: standard errors of the four, under their names.
    """

    absorbed_W: NDArray[np.float64]  # noqa: N815
    absorbed_umol_s: NDArray[np.float64]
    received_W: NDArray[np.float64]  # noqa: N815
    received_umol_s: NDArray[np.float64]
    errors: dict[str, NDArray[np.float64]]


_NAMES: Final = ("absorbed_W", "absorbed_umol_s", "received_W", "received_umol_s")


@dataclass(frozen=True, eq=False)
class AbsorbedLight:
    """Light that the instances of a scene absorb.

    Attributes:
        bands: of wavelengths.
        organs: the light of each instance of the mesh, in that order.
        entered_W: `(bands,)` power that enters the box around the scene.
        left_W: `(bands,)` power that leaves the scene.
        packets: number of light packets that were traced.
        replicates: `(4, bands, REPLICATES, i)` independent estimates of what `organs` has the means of.
    """

    bands: tuple[Waveband, ...]
    organs: LightSums
    entered_W: NDArray[np.float64]  # noqa: N815
    left_W: NDArray[np.float64]  # noqa: N815
    packets: int
    replicates: NDArray[np.float64]

    def grouped(self, group: NDArray[np.intp], count: int) -> LightSums:
        """Sums over groups of instances, with the standard errors of the sums.

        Args:
            group: `(i,)` number of each instance's group, -1 for none.
            count: of groups.
        """
        member = np.flatnonzero(group >= 0)
        flat = self.replicates.reshape(-1, len(group))[:, member]
        sums = np.stack([np.bincount(group[member], row, count) for row in flat])
        return _light_sums(sums.reshape(*self.replicates.shape[:3], count))

    def plus(self, other: AbsorbedLight, weights: tuple[float, float]) -> AbsorbedLight:
        """A weighted sum with the light of the same scene under another sky."""
        a, b = weights
        replicates = a * self.replicates + b * other.replicates
        return AbsorbedLight(
            self.bands,
            _light_sums(replicates),
            a * self.entered_W + b * other.entered_W,
            a * self.left_W + b * other.left_W,
            self.packets + other.packets,
            replicates,
        )


def _light_sums(replicates: NDArray[np.float64]) -> LightSums:
    means = replicates.mean(axis=2)
    errors = replicates.std(axis=2, ddof=1) / np.sqrt(REPLICATES)
    return LightSums(*means, dict(zip(_NAMES, errors, strict=True)))


def absorbed_light(
    scene: Scene,
    bands: Iterable[str | Waveband] = DEFAULT_BANDS,
    *,
    target_error: float = 0.02,
    seed: int = 0,
) -> AbsorbedLight:
    """Trace the light that each instance of a scene absorbs; for several skies keep a `LightTracer`.

    Args:
        scene: with surfaces. Its sky and sun light it, and not the flash of any camera. It is lit as it is:
            a row without neighbours has light from all sides.
        bands: names of `WAVEBANDS`, texts such as "red_edge=700-740", or bands.
        target_error: relative standard error of the photons that a leaf absorbs in the first band, at which
            tracing stops: the median over the leaves of the scene's own plants; without leaves, over all
            instances.
        seed: of the packets.

    Raises:
        ArgumentError: a band or the target is not valid.
        ValueError: the scene has no surfaces.
        SetupError: no JIT variant of Mitsuba runs on this machine.
    """
    return LightTracer(scene, bands).trace(target_error=target_error, seed=seed)


class LightTracer:
    """Traces absorbed light in a scene that is kept in the kernel.

    Args:
        scene: with surfaces.
        bands: as of `absorbed_light`.
    """

    def __init__(self, scene: Scene, bands: Iterable[str | Waveband] = DEFAULT_BANDS) -> None:
        self.scene, self.bands = scene, parse_wavebands(bands)
        self._coordinates = local_coordinates(scene.mesh)
        self._kernel = light_scene(scene, *band_range(self.bands))
        items = scene.mesh.instances
        has_triangles = np.bincount(scene.mesh.face_instance, minlength=len(items)) > 0
        leaves = np.array([_is_own(item) and item.organ_class == OrganClass.LEAF for item in items], bool)
        own = np.array([_is_own(item) for item in items], bool)
        self._near = (own if own.any() else np.ones(len(items), bool)) & has_triangles
        self._judged = (leaves if (leaves & has_triangles).any() else self._near) & has_triangles

    def trace(
        self,
        sky: Sky | Literal["scene"] | None = "scene",
        *,
        target_error: float = 0.02,
        seed: int = 0,
        on_progress: Callable[[float], None] | None = None,
    ) -> AbsorbedLight:
        """Trace light under a sky; `on_progress` gets the error that is reached so far. See `absorbed_light`.

        Raises:
            ArgumentError: the target is not valid.
        """
        if not _LEAST_ERROR <= target_error <= _MOST_ERROR:
            limits = f"{_LEAST_ERROR:g} to {_MOST_ERROR:g}"
            raise ArgumentError("target_error", f"must be {limits}, not {target_error}")
        scene = self.scene if sky == "scene" else replace(self.scene, sky=sky)
        tables = packet_tables(scene, self._kernel, self._coordinates, self.bands, self._near)
        count = len(self.scene.mesh.instances)
        sums, rounds = np.zeros((QUANTITIES * len(self.bands), REPLICATES, count + 2)), 0
        while tables is not None and rounds < _MOST_ROUNDS:
            sums += trace_packets(tables, rounds * _ROUND, _ROUND, seed)
            rounds += 1
            error = self._median_error(sums)
            if on_progress is not None:
                on_progress(error)
            if rounds >= _LEAST_ROUNDS and error <= target_error:
                break
        sums /= max(rounds * _ROUND, 1)
        sums = sums.reshape(QUANTITIES, len(self.bands), REPLICATES, count + 2)
        left, entered = (sums[2, :, :, count + at].mean(axis=1) for at in (0, 1))
        replicates = np.ascontiguousarray(sums[..., :count])
        organs = _light_sums(replicates)
        return AbsorbedLight(
            self.bands, organs, entered, left, rounds * _ROUND * REPLICATES, replicates
        )

    def _median_error(self, sums: NDArray[np.float64]) -> float:
        """Of the photons that organs absorb in the first band, relative."""
        photons = sums[len(self.bands), :, :-2][:, self._judged]
        mean, error = photons.mean(axis=0), photons.std(axis=0, ddof=1) / np.sqrt(REPLICATES)
        # Organs that no light reaches have no relative error.
        lit = mean > 0.0
        return float(np.median(error[lit] / mean[lit])) if lit.any() else 0.0


def _is_own(item: Instance) -> bool:
    """Whether an instance is an organ of the recipe's own plants."""
    return item.plant >= 0 and item.far_row < 0
