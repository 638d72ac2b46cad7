"""The light that each organ of a scene absorbs, with standard errors."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import Instance, OrganClass
from pepperscene.errors import ArgumentError
from pepperscene.render.kernel.scene import light_scene
from pepperscene.render.transport.light_meters import (
    REPLICATES,
    Measured,
    OrganMeters,
    band_range,
    meter_tables,
)
from pepperscene.scene import Scene, Sky
from pepperscene.spectra.wavebands import Waveband, parse_wavebands

DEFAULT_BANDS: Final = ("par",)
_ROUND: Final = 8  # chosen: samples of a replicate that are traced at a time
_PILOT_ROUNDS: Final = 2
"""Chosen: rare light is seldom taken for missing light."""
_PILOT_SALT: Final = 0x3C6EF372  # chosen: the pilot has other random numbers than the samples that count
_MOST_ROUNDS: Final = 256  # chosen: 65,536 samples of an organ
_OTHERS: Final = 4.0  # chosen: error of organs that are neither leaves nor fruit, over that of these
_LEAST_ERROR, _MOST_ERROR = 0.001, 1.0


@dataclass(frozen=True, eq=False)
class LightAmounts:
    """Light of organs, or of groups of organs, in each band.

    Attributes:
        watts, umol_s: `(bands, n)` power, and photons.
        watts_error, umol_s_error: their standard errors.
    """

    watts: NDArray[np.float64]
    umol_s: NDArray[np.float64]
    watts_error: NDArray[np.float64]
    umol_s_error: NDArray[np.float64]

    @classmethod
    def of(cls, replicates: NDArray[np.float64]) -> LightAmounts:
        """Means of `(2, bands, REPLICATES, n)` independent estimates."""
        return cls(*replicates.mean(axis=2), *(replicates.std(axis=2, ddof=1) / np.sqrt(REPLICATES)))


@dataclass(frozen=True, eq=False)
class AbsorbedLight:
    """Light that instances of a scene absorb, or receive.

    Attributes:
        bands: of wavelengths.
        instances: `(n,)` numbers of the instances, ascending: the organs of the scene's own plants; all
            instances, if it has no plants.
        area_m2: `(n,)` area of their triangles: one side of a leaf, the whole surface of a fruit.
        samples: `(n,)` light paths that began on each.
        replicates: `(2, bands, REPLICATES, n)` independent estimates of W, and of umol s-1.
    """

    bands: tuple[Waveband, ...]
    instances: NDArray[np.intp]
    area_m2: NDArray[np.float64]
    samples: NDArray[np.intp]
    replicates: NDArray[np.float64]

    @property
    def amounts(self) -> LightAmounts:
        """The light of each instance."""
        return LightAmounts.of(self.replicates)

    def grouped(self, group: NDArray[np.intp], count: int) -> LightAmounts:
        """The light of groups of instances; `group` is `(n,)` the number of each one's, -1 for none."""
        member = np.flatnonzero(group >= 0)
        rows = self.replicates.reshape(-1, len(group))[:, member]
        sums = np.stack([np.bincount(group[member], row, count) for row in rows])
        shape = *self.replicates.shape[:3], count
        return LightAmounts.of(np.asarray(sums, np.float64).reshape(shape))


def add_light(parts: Sequence[AbsorbedLight], weights: Sequence[float]) -> AbsorbedLight:
    """A weighted sum of light in the same scene at different times, for instance J of W and s."""
    total = sum(weight * part.replicates for part, weight in zip(parts, weights, strict=True))
    samples = sum(part.samples for part in parts)
    return replace(parts[0], replicates=np.asarray(total), samples=np.asarray(samples))


def absorbed_light(
    scene: Scene,
    bands: Iterable[str | Waveband] = DEFAULT_BANDS,
    *,
    measured: Measured = "absorbed",
    target_error: float = 0.02,
    seed: int = 0,
) -> AbsorbedLight:
    """Trace the light that organs absorb; for several skies keep a `LightTracer`.

    Args:
        scene: with surfaces. Its sky, sun and lamps light it, but no lamp that flashes or moves with a
            camera. It is lit as it is: a row without neighbours has light from all sides.
        bands: names of `WAVEBANDS`, texts such as "red_edge=700-740", or bands.
        measured: "absorbed", or "received": all light that arrives at both sides of the surfaces.
        target_error: standard error that tracing aims at, over the photons that a leaf or fruit measures in
            the first band, or over the median of these if that is more. Other organs have four times that.
        seed: of the samples.

    Raises:
        ArgumentError: a band or the target is not valid.
        ValueError: the scene has no surfaces.
        SetupError: no JIT variant of Mitsuba runs on this machine.
    """
    return LightTracer(scene, bands).trace(measured=measured, target_error=target_error, seed=seed)


class LightTracer:
    """Traces the light of organs in a scene that is kept in the kernel.

    Args:
        scene: with surfaces.
        bands: as of `absorbed_light`.
    """

    def __init__(self, scene: Scene, bands: Iterable[str | Waveband] = DEFAULT_BANDS) -> None:
        self.scene, self.bands = scene, parse_wavebands(bands)
        self._kernel = light_scene(scene, *band_range(self.bands))
        self._meters = OrganMeters(scene.mesh, self.bands)
        items = scene.mesh.instances
        own = np.array([_is_own(item) for item in items], bool)
        chosen = (own if own.any() else np.ones(len(items), bool)) & (self._meters.area_m2 > 0.0)
        self.instances = np.flatnonzero(chosen)
        classes = np.array([items[k].organ_class for k in self.instances])
        precise = (classes == OrganClass.LEAF) | (classes == OrganClass.PEPPER)
        self._tolerance = np.where(precise | ~precise.any(), 1.0, _OTHERS)

    def trace(
        self,
        sky: Sky | Literal["scene"] | None = "scene",
        *,
        measured: Measured = "absorbed",
        target_error: float = 0.02,
        seed: int = 0,
        on_progress: Callable[[float], None] | None = None,
    ) -> AbsorbedLight:
        """Trace light under a sky, or under that of the scene; see `absorbed_light` for other arguments.

        `on_progress` gets the share of the samples that are done.

        Raises:
            ArgumentError: the target is not valid.
        """
        check_target(target_error)
        scene = self.scene if sky == "scene" else replace(self.scene, sky=sky)
        tables, count, bands = meter_tables(self._kernel, scene, self.bands), len(self.instances), self.bands
        sums, samples = np.zeros((2 * len(bands), REPLICATES, count)), np.zeros(count, np.intp)
        # Samples that decide how many are taken do not count: where by chance they found little light, they
        # also found little error, so that both would be too low.
        rounds = np.zeros(count, np.intp)
        if tables.has_lights:
            size, pilot_seed = _PILOT_ROUNDS * _ROUND, (seed ^ _PILOT_SALT) & 0xFFFFFFFF
            pilot = self._meters.measure(tables, self.instances, 0, size, pilot_seed, measured)
            rounds = self._needed_rounds(pilot[len(bands)] / size, target_error)
        for number in range(int(rounds.max(initial=0))):
            left = np.flatnonzero(rounds > number)
            more = self._meters.measure(tables, self.instances[left], number * _ROUND, _ROUND, seed, measured)
            sums[:, :, left] += more
            samples[left] += _ROUND
            if on_progress is not None:
                on_progress(float(samples.sum() / (_ROUND * rounds.sum())))
        area = self._meters.area_m2[self.instances]
        sums *= area / np.maximum(samples, 1)
        shape = 2, len(bands), REPLICATES, count
        return AbsorbedLight(bands, self.instances, area, samples * REPLICATES, sums.reshape(shape))

    def _needed_rounds(self, density: NDArray[np.float64], target_error: float) -> NDArray[np.intp]:
        """`(n,)` rounds until the error is about the target, from photons of a pilot `(REPLICATES, n)`."""
        mean, error = density.mean(axis=0), density.std(axis=0, ddof=1) / np.sqrt(REPLICATES)
        target = target_error * self._tolerance * np.maximum(mean, np.median(mean[self._tolerance == 1.0]))
        ratio = np.divide(error, target, out=np.zeros_like(error), where=target > 0.0)
        rounds = np.ceil(_PILOT_ROUNDS * ratio**2)
        return np.asarray(np.clip(rounds, 1, _MOST_ROUNDS), np.intp)


def check_target(target_error: float) -> None:
    """Raise `ArgumentError` unless tracing can reach an error."""
    if not _LEAST_ERROR <= target_error <= _MOST_ERROR:
        limits = f"{_LEAST_ERROR:g} to {_MOST_ERROR:g}"
        raise ArgumentError("target_error", f"must be {limits}, not {target_error}")


def _is_own(item: Instance) -> bool:
    """Whether an instance is an organ of the recipe's own plants."""
    return item.plant >= 0 and item.far_row < 0
