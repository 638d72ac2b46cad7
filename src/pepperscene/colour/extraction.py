"""From the pixels of a region in a picture to a patch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import decode
from pepperscene.colour.chart import Calibration
from pepperscene.colour.patch import Patch, evenly
from pepperscene.colour.statistics import encoded, hue_counts_of

Clipped = Literal["keep", "leave_out"]
PatchTone = Literal["srgb", "linear"]


@dataclass(frozen=True)
class Extraction:
    """How pixels become patches.

    Attributes:
        tone: of the codes: "srgb", or "linear" where they are proportional to light.
        clipped: whether pixels with a channel at 0 or 255 are kept. What a clipped pixel's colour was nobody
            knows; leaving it out darkens and dulls what shines, keeping it does so less.
        erode_px: pixels nearer than this to what is not of the region are left out: hand-drawn borders are
            coarse, and every lens mixes what meets there.
        most_px: of one patch that are kept, evenly spread; enough for a mean and a covariance (chosen).
    """

    tone: PatchTone = "srgb"
    clipped: Clipped = "keep"
    erode_px: int = 0
    most_px: int = 20_000

    def patch(
        self,
        picture: NDArray[np.uint8],
        region: NDArray[np.bool_],
        *,
        name: str,
        kind: str,
        of: str,
        within: tuple[slice, slice] = (slice(None), slice(None)),
        calibration: Calibration | None = None,
    ) -> Patch | None:
        """The patch of a region, or None where no pixel is left.

        Where there is a calibration, the patch's codes are those of the calibrated colours.

        Args:
            picture: `(h, w, 3)` uint8.
            region: `(h, w)`, which pixels it has.
            name: of the patch.
            kind: of what it shows.
            of: name of the picture.
            within: part of the picture that counts.
            calibration: of this picture's colours, or None.
        """
        inner = eroded(region, self.erode_px)[within]
        codes = picture[within][inner]
        if not len(codes):
            return None
        clipped = ((codes == 0) | (codes == 255)).any(axis=1)
        counted = codes if self.tone == "srgb" and calibration is None else self._codes(codes, calibration)

        # All that count in the hues; fewer, evenly spread over the region, for everything else.
        kept = np.flatnonzero(~clipped) if self.clipped == "leave_out" else np.arange(len(codes))
        kept = kept[evenly(len(kept), self.most_px)]
        if not len(kept):
            return None
        return Patch(
            name,
            kind,
            of,
            self._linear(codes[kept], calibration),
            counted[kept],
            hues=hue_counts_of(counted),
            pixels=len(codes),
            clipped=int(clipped.sum()),
            border=int(region[within].sum()) - len(codes),
        )

    def _linear(self, codes: NDArray[np.uint8], calibration: Calibration | None) -> NDArray[np.float64]:
        linear = decode(codes, self.tone)
        return linear if calibration is None else calibration.apply(linear)

    def _codes(self, codes: NDArray[np.uint8], calibration: Calibration | None) -> NDArray[np.uint8]:
        """What a picture in sRGB would have; pieces of a million pixels at a time."""
        pieces = np.array_split(codes, max(1, len(codes) // 1_000_000))
        return np.concatenate([encoded(self._linear(piece, calibration)) for piece in pieces])


def eroded(region: NDArray[np.bool_], by_px: int) -> NDArray[np.bool_]:
    """A region without the pixels that have others than its own within so many rows and columns.

    What lies beyond the picture's border counts as of the region.
    """
    if by_px == 0:
        return region
    from scipy.ndimage import binary_erosion

    square = np.ones((3, 3), bool)
    return np.asarray(binary_erosion(region, square, iterations=by_px, border_value=1))
