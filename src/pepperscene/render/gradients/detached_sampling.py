"""Detached sampling: directions are sampled from one state of the surfaces while another is evaluated.

A direction that is sampled from the tuned surfaces moves with them, over edges and behind occluders, so the
image is not continuous. Therefore directions and their densities are those of the original surfaces, fixed,
and only the values of the BSDF follow the parameters. Value over density stays unbiased and is as smooth as
the BSDF itself, so its derivative is exact without any treatment of visibility (Zeltner et al. 2021, ACM TOG
40(4)). The noise grows with the difference between the two states; if they are equal, it is the renderer's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.render.arrays import device_uint
from pepperscene.render.quality import Quality
from pepperscene.render.surface.optics import Optics
from pepperscene.render.surface.scattering import MIN_COSINE, SurfacePoint
from pepperscene.render.transport.channel_light import total_light
from pepperscene.render.transport.lights import FrameTables
from pepperscene.render.transport.samples import Samples
from pepperscene.render.variant import mitsuba_modules


@dataclass(frozen=True, eq=False)
class DetachedOptics:
    """Two states of the surfaces, used in place of `Optics`."""

    evaluated: Optics  # state whose values are used
    sampled: Optics | None = None  # state that directions are sampled from; None if none are

    def point(
        self, si: Any, organ: Any, state: Any, active: Any, footprint: Any | None = 0.0
    ) -> DetachedPoint:
        """Look up the optical states at surface interactions; see `Optics.point`."""
        at_hit = si, organ, state, active, footprint
        evaluated = self.evaluated.point(*at_hit)
        sampled = None if self.sampled is None else self.sampled.point(*at_hit)
        return DetachedPoint(evaluated, sampled, active)


@dataclass(frozen=True, eq=False)
class DetachedPoint:
    """Two optical states at a hit, used in place of `SurfacePoint`."""

    evaluated: SurfacePoint  # state whose values are used
    sampled: SurfacePoint | None  # state that directions are sampled from
    active: Any  # mask of valid hits

    @property
    def reflectance(self) -> Any:
        """Of the evaluated state."""
        return self.evaluated.reflectance

    @property
    def frame(self) -> Any:
        """Of the evaluated state; the relief is the same in both."""
        return self.evaluated.frame

    def albedo(self) -> Any:
        """Of the evaluated state."""
        return self.evaluated.albedo()

    def sample(self, sample1: Any, sample2: Any) -> Any:
        """Sample a direction and its density from one state, with its weight in the other."""
        _, dr = mitsuba_modules()
        assert self.sampled is not None
        wo, density, _, lobe = self.sampled.sample(sample1, sample2)
        valid = density > 0.0
        value, _ = self.eval_pdf(wo)
        return wo, density, dr.select(valid, value / dr.select(valid, density, 1.0), 0.0), lobe

    def eval_pdf(self, wo: Any) -> Any:
        """See `SurfacePoint.eval_pdf`; lanes without a value are evaluated along the normal.

        Their directions can be anything, and derivatives that are not finite stay so even times 0.
        """
        mi, dr = mitsuba_modules()
        wi, (local, same_side) = self.evaluated.wi, self.evaluated.to_relief(wo)
        valid = self.active & same_side & (wi.z > MIN_COSINE) & (dr.abs(local.z) > MIN_COSINE)
        up = mi.Vector3f(0.0, 0.0, 1.0)
        safe = replace(self.evaluated, wi=dr.select(valid, wi, up))
        return safe.eval_pdf_in_relief(dr.select(valid, local, up), valid)


_LANES: Final = 1 << 17
"""Chosen: samples of a pass. Sums over a pass are in single precision, those over passes in double."""


class SamplePasses:
    """The samples of all pixels, in passes of equally many pixels.

    Args:
        frame: kernel data of the original surfaces and lights.
        pixels: of the image.
        quality: its samples in every pixel, and its bounces.
        seed: of all random numbers.
    """

    def __init__(self, frame: FrameTables, pixels: int, quality: Quality, seed: int) -> None:
        self._frame, self._pixels, self._seed = frame, pixels, seed & 0xFFFFFFFF
        self.samples, self._bounces = quality.samples, quality.bounces

    @property
    def blocks(self) -> list[range]:
        """Pixels of each pass, equally many, because Dr.Jit compiles again for another number.

        The last pass can extend beyond the image, and repeats its last pixel there.
        """
        block = min(max(_LANES // self.samples, 1), self._pixels)
        return [range(start, start + block) for start in range(0, self._pixels, block)]

    def pixel_in_block(self, block: range) -> Any:
        """The pixel of each sample, counted from the block's first."""
        mi, dr = mitsuba_modules()
        return dr.arange(mi.UInt32, len(block) * self.samples) // device_uint(self.samples)

    def lanes(self, tables: Mapping[str, Any], block: range) -> list[Any]:
        """Light of each sample by channel, along paths that do not depend on the tables.

        Args:
            tables: from `DiffTables.tables`, on the device.
            block: out of `blocks`.
        """
        mi, dr = mitsuba_modules()
        frame = self._frame
        cuticles = {name: tables[name] for name in ("sides", "openness")}
        original = frame.scene.optics
        evaluated = replace(original, spectra=tables["spectra"], **cuticles)
        detached: Any = DetachedOptics(evaluated, original)
        changes: dict[str, Any] = {"scene": replace(frame.scene, optics=detached)}
        for name in ("flash_optics", "sun_optics"):
            if name in tables:
                evaluated = replace(getattr(frame, name), spectra=tables[name], **cuticles)
                changes[name] = DetachedOptics(evaluated)
        lanes = len(block) * self.samples
        if "flash_colour" in tables:
            # Gathered by each lane: as plain numbers, they would get their derivatives in a kernel each.
            entries = [dr.opaque(mi.UInt32, k, lanes) for k in range(frame.channels)]
            colour = (mi.Color3f if frame.channels == 3 else mi.Color1f)(
                *(dr.gather(mi.Float, tables["flash_colour"], entry) for entry in entries)
            )
            changes["colours"] = replace(frame.colours, flash=colour)
            changes["spectra"] = replace(frame.spectra, flash=tables["flash"])
        frame = replace(frame, **changes)
        number = self.pixel_in_block(block)
        index = dr.arange(mi.UInt32, lanes) - number * device_uint(self.samples)
        pixel = dr.minimum(number + device_uint(block.start), device_uint(self._pixels - 1))
        samples = Samples(frame, pixel, index, device_uint(self._seed))
        return total_light(frame, samples, self._bounces)

    def sums(self, lanes: list[Any]) -> NDArray[np.float64]:
        """`(n, k)` sums over the samples of each pixel."""
        _, dr = mitsuba_modules()
        dr.eval(lanes)
        sums = [dr.block_reduce(dr.ReduceOp.Add, lane, self.samples) for lane in lanes]
        dr.eval(sums)
        return np.stack([np.asarray(lane_sums, np.float64) for lane_sums in sums], axis=-1)
