"""Surfaces whose directions are drawn from one state of them while another is evaluated.

A direction that is drawn from what is to be differentiated moves with it, over edges and behind obstacles,
and a picture of it jumps. So directions and their densities are those of the surfaces as they are, fixed, and
only the values of the BSDF follow the parameters. Value (of the parameters) over density stays without bias
and is as smooth as the BSDF itself, so that its derivative is exact without any care for visibility
("detached sampling", Zeltner et al. 2021, ACM TOG 40(4)). The noise grows with the distance between the two
states; where they are one, it is the renderer's own.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.render.kernel.arrays import device_number
from pepperscene.render.quality import Quality
from pepperscene.render.surface.optics import Optics, SurfacePoint
from pepperscene.render.transport.samples import FrameTables, Samples, SpectralTables
from pepperscene.render.transport.trace import all_light
from pepperscene.render.variant import mitsuba_modules

_LEAST_COSINE = 1e-5  # as of `pepperscene.render.surface.optics`, which lets nothing pass there


@dataclass(frozen=True, eq=False)
class DetachedOptics:
    """In the place of `Optics`.

    Attributes:
        values: the surfaces that are evaluated.
        drawn: those that directions are drawn from; None where none are.
    """

    values: Optics
    drawn: Optics | None = None

    def at(self, si: Any, surface: Any, state: Any, active: Any) -> DetachedPoint:
        """The optical state at surface interactions, as of `Optics.at`."""
        point = self.values.at(si, surface, state, active)
        drawn = None if self.drawn is None else self.drawn.at(si, surface, state, active)
        return DetachedPoint(**vars(point), drawn=drawn, there=active)


@dataclass(frozen=True, eq=False)
class DetachedPoint(SurfacePoint):
    """The optical state at a hit.

    Attributes:
        drawn: the state that directions are drawn from.
        there: where there is a hit at all.
    """

    drawn: SurfacePoint | None = None
    there: Any = True

    def sample(self, sample1: Any, sample2: Any) -> Any:
        """A direction and its density of the one state, with the weight that it has in the other."""
        _, dr = mitsuba_modules()
        assert self.drawn is not None
        wo, density, _, lobe = self.drawn.sample(sample1, sample2)
        good = density > 0.0
        value, _ = self.eval_pdf(wo)
        return wo, density, dr.select(good, value / dr.select(good, density, 1.0), 0.0), lobe

    def _eval_pdf(self, wo: Any, active: Any) -> Any:
        """As of any point, but in lanes without a value along the normal.

        There directions can be anything, and slopes that are not finite stay so even times nothing.
        """
        mi, dr = mitsuba_modules()
        good = self.there & active & (self.wi.z > _LEAST_COSINE) & (dr.abs(wo.z) > _LEAST_COSINE)
        upwards = mi.Vector3f(0.0, 0.0, 1.0)
        safe = SurfacePoint(**{**_point(self), "wi": dr.select(good, self.wi, upwards)})
        return safe._eval_pdf(dr.select(good, wo, upwards), good)


def _point(point: DetachedPoint) -> dict[str, Any]:
    return {name: value for name, value in vars(point).items() if name not in ("drawn", "there")}


_LANES: Final = 1 << 17
"""Chosen: samples of a pass. Sums over a pass are in single precision, those over passes in double."""


class Passes:
    """The samples of all pixels, some of these at a time.

    Args:
        frame: what the kernel reads, with everything that is drawn from it.
        pixels: of the picture.
        effort: its samples in every pixel, and its bounces.
        seed: of all that is random.

    Attributes:
        samples: in every pixel.
    """

    def __init__(self, frame: FrameTables, pixels: int, effort: Quality, seed: int) -> None:
        self._frame, self._spectra = frame, SpectralTables(frame)
        self._pixels, self._seed = pixels, seed & 0xFFFFFFFF
        self.samples, self._bounces = effort.samples, effort.bounces

    @property
    def blocks(self) -> list[range]:
        """Pixels of each pass: equally many, as Dr.Jit compiles anew for another number.

        The last pass can go on beyond the picture, with its last pixel over and over.
        """
        block = min(max(_LANES // self.samples, 1), self._pixels)
        return [range(start, start + block) for start in range(0, self._pixels, block)]

    def place(self, block: range) -> Any:
        """The pixel of each sample, counted from the block's first."""
        mi, dr = mitsuba_modules()
        return dr.arange(mi.UInt32, len(block) * self.samples) // device_number(self.samples, whole=True)

    def lanes(self, leaves: Mapping[str, Any], block: range) -> list[Any]:
        """Light of each sample by channel: what the tables make of it, along paths that they do not turn.

        Args:
            leaves: of `DiffTables.tables`, on the device.
            block: the pixels, out of `blocks`.
        """
        mi, dr = mitsuba_modules()
        frame, spectra = copy.copy(self._frame), copy.copy(self._spectra)
        cuticles = {name: leaves[name] for name in ("sides", "openness")}
        own = frame.scene.optics
        values = _changed(own, spectra=leaves["spectra"], **cuticles)
        frame.scene = replace(frame.scene, optics=DetachedOptics(values, own))  # type: ignore[arg-type]
        for name in ("lit", "sunlit"):
            if name in leaves:
                seen = _changed(getattr(frame, name), spectra=leaves[name], **cuticles)
                setattr(frame, name, DetachedOptics(seen))
        lanes = len(block) * self.samples
        if "colour" in leaves:
            # Fetched lane by lane: a number alone would sum up its derivatives in a kernel of its own.
            entries = [dr.opaque(mi.UInt32, k, lanes) for k in range(frame.channels)]
            colour = (mi.Color3f if frame.channels == 3 else mi.Color1f)(
                *(dr.gather(mi.Float, leaves["colour"], entry) for entry in entries)
            )
            frame.lamps, spectra.flash = replace(frame.lamps, flash=colour), leaves["flash"]
        place = self.place(block)
        index = dr.arange(mi.UInt32, lanes) - place * device_number(self.samples, whole=True)
        last = device_number(self._pixels - 1, whole=True)
        pixel = dr.minimum(place + device_number(block.start, whole=True), last)
        samples = Samples(frame, pixel, index, device_number(self._seed, whole=True))
        return all_light(frame, spectra, samples, self._bounces)

    def sums(self, lanes: list[Any]) -> NDArray[np.float64]:
        """`(n, k)` sums over the samples of each pixel."""
        _, dr = mitsuba_modules()
        dr.eval(lanes)
        sums = [dr.block_reduce(dr.ReduceOp.Add, lane, self.samples) for lane in lanes]
        dr.eval(sums)
        return np.stack([np.asarray(one, np.float64) for one in sums], axis=-1)


def _changed(optics: Optics, **tables: Any) -> Optics:
    """The same optics with other tables."""
    found = copy.copy(optics)
    found.__dict__.update(tables)
    return found
