"""Light of a picture pass by pass, over blocks of pixels so that memory is bounded, out of tables that can be
differentiated: the same paths each time, drawn for the scene's own.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.render.frozen import FrozenOptics
from pepperscene.render.optics import Optics
from pepperscene.render.quality import Quality
from pepperscene.render.samples import FrameTables, Samples, SpectralTables
from pepperscene.render.transport import all_light
from pepperscene.render.upload import device_number
from pepperscene.render.variant import kernel

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
        mi, dr = kernel()
        return dr.arange(mi.UInt32, len(block) * self.samples) // device_number(self.samples, whole=True)

    def lanes(self, leaves: Mapping[str, Any], block: range) -> list[Any]:
        """Light of each sample by channel: what the tables make of it, along paths that they do not turn.

        Args:
            leaves: of `Leaves.tables`, on the device.
            block: the pixels, out of `blocks`.
        """
        mi, dr = kernel()
        frame, spectra = copy.copy(self._frame), copy.copy(self._spectra)
        cuticles = {name: leaves[name] for name in ("sides", "openness")}
        own = frame.scene.optics
        values = _changed(own, spectra=leaves["spectra"], **cuticles)
        frame.scene = replace(frame.scene, optics=FrozenOptics(values, own))  # type: ignore[arg-type]
        for name in ("lit", "sunlit"):
            if name in leaves:
                seen = _changed(getattr(frame, name), spectra=leaves[name], **cuticles)
                setattr(frame, name, FrozenOptics(seen))
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
        _, dr = kernel()
        dr.eval(lanes)
        sums = [dr.block_reduce(dr.ReduceOp.Add, lane, self.samples) for lane in lanes]
        dr.eval(sums)
        return np.stack([np.asarray(one, np.float64) for one in sums], axis=-1)


def _changed(optics: Optics, **tables: Any) -> Optics:
    """The same optics with other tables."""
    found = copy.copy(optics)
    found.__dict__.update(tables)
    return found
