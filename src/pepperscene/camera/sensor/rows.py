"""The rows of an image: strips in which large images are computed, and when rows are exposed.

Time 0 is the middle of the exposure of the middle of the image. Row r of h is exposed for `exposure_s` about
(r + 1/2 - h/2) `line_time_s`: a rolling shutter exposes the rows one after the other, a global shutter, whose
line time is 0, all at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

LARGEST_WHOLE: Final = 1 << 21
"""Pixels of the largest image that is computed as a whole. Chosen: images of 1920 x 1080 and 1600 x 1200 are.
In two strips, the latter takes 1.5 instead of 2.8 GB, and 1.2 to 1.5 times the CPU time."""
STRIP_PIXELS: Final = 1 << 20
"""Pixels of a strip, at most, if that is two rows or more. Chosen: the light of a strip of 6000 x 170 pixels
takes 0.3 GB while it is traced; with half as many, neighbours would share more rows than a strip has."""
Array = NDArray[np.float64]


def row_strips(width: int, height: int) -> tuple[slice, ...]:
    """The rows of each strip of an image, from top to bottom; a small image is a single strip.

    Strips have even heights, but for the last one, so that a Bayer mosaic divides into whole quads.
    """
    if width * height <= LARGEST_WHOLE:
        return (slice(0, height),)
    count = -(-height * width // STRIP_PIXELS)
    rows = 2 * max(-(-height // (2 * count)), 1)  # even
    return tuple(slice(top, min(top + rows, height)) for top in range(0, height, rows))


def is_whole(width: int, height: int) -> bool:
    """Whether an image is a single strip."""
    return len(row_strips(width, height)) == 1


@dataclass(frozen=True, eq=False)
class RowWindows:
    """An interval of time for each row of an image.

    Attributes:
        begin_s: `(h,)`.
        length_s: `(h,)`, 0 for an instant or for an empty interval.
    """

    begin_s: Array
    length_s: Array

    @property
    def end_s(self) -> Array:
        """`(h,)` ends of the intervals."""
        return self.begin_s + self.length_s


@dataclass(frozen=True)
class Shutter:
    """The times of an image's rows.

    Attributes:
        exposure_s: of each row.
        line_time_s: from one row to the next; 0 for a global shutter.
        rows: of the image.
    """

    exposure_s: float
    line_time_s: float
    rows: int

    @property
    def readout_s(self) -> float:
        """Time from the exposure of the first row to that of the last."""
        return (self.rows - 1) * self.line_time_s

    def middle_at(self, v: ArrayLike) -> Array:
        """Middles of the exposures `(...)`, seconds, at continuous rows v `(...)`, clipped to the image."""
        return np.asarray((np.clip(v, 0.0, self.rows) - 0.5 * self.rows) * self.line_time_s)

    def middles(self) -> Array:
        """`(h,)` middles of the exposures of the rows."""
        return self.middle_at(np.arange(self.rows) + 0.5)

    def instants(self) -> RowWindows:
        """The middles of the exposures as windows of length 0."""
        return RowWindows(self.middles(), np.zeros(self.rows))

    def exposures(self) -> RowWindows:
        """The exposures of the rows."""
        return RowWindows(self.middles() - 0.5 * self.exposure_s, np.full(self.rows, self.exposure_s))

    def pulse_begin(self, pulse_s: float) -> float:
        """When a pulse of this duration starts, seconds.

        With the exposure of the last row, if there is a time at which all rows are exposed. If the readout
        takes longer than an exposure, there is none, and the pulse starts with the exposure of the first row;
        so does a pulse that lasts until the end of the last row's exposure.
        """
        begins = self.exposures().begin_s
        lasts = pulse_s >= self.readout_s + self.exposure_s
        return float(begins[-1] if self.exposure_s > self.readout_s and not lasts else begins[0])

    def flash_windows(self, pulse_s: float) -> RowWindows:
        """The part of the pulse in each row's exposure."""
        exposed, begin = self.exposures(), self.pulse_begin(pulse_s)
        start = np.clip(begin, exposed.begin_s, exposed.end_s)
        # Rounding of the middles must not take light from a global shutter.
        longest = min(pulse_s, self.exposure_s)
        length = np.minimum(exposed.end_s, begin + pulse_s) - start
        length[np.isclose(length, longest, rtol=1e-9, atol=0.0)] = longest
        return RowWindows(start, np.clip(length, 0.0, longest))

    def flash_fraction(self, pulse_s: float) -> Array:
        """`(h,)` fraction that each row sees of the longest possible overlap of pulse and exposure."""
        return self.flash_windows(pulse_s).length_s / min(pulse_s, self.exposure_s)
