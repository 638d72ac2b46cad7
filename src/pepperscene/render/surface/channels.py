"""Surfaces as a sensor's channels see them under one light, worked out before any ray is traced.

What a light sends over the first hit into the camera is an integral over wavelength of the light's spectrum,
the sensor's response and the surface's. Only the last changes from hit to hit, and the body's share in it is
linear between the surfaces' states, while the cuticle mirrors all wavelengths alike. So the integrals are
taken once for each row of the surfaces' spectra, and the first hit knows no wavelengths and none of their
noise:

    R_c = sum_l R(l) S_c(l) L(l) / sum_l S_c(l) L(l)

over the very grid on which scattered light is traced. A white body has R_c = 1 in every channel.
"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pepperscene.render.kernel.arrays import device_table
from pepperscene.render.surface.optics import Optics
from pepperscene.render.variant import mitsuba_modules


class ChannelOptics(Optics):
    """The surfaces of a scene under one light: colours of a sensor's channels take the place of spectra."""

    channels: int

    @classmethod
    def of(cls, optics: Optics, weights: NDArray[np.float64]) -> ChannelOptics:
        """The surfaces seen through the channels.

        Args:
            optics: with spectra over the grid of the weights.
            weights: `(n, c)` response times light on the grid, for c of 1 or 3; any scale.
        """
        mi, _ = mitsuba_modules()
        spectra = np.asarray(optics.spectra).reshape(-1, len(weights), 4)
        total = weights.sum(axis=0)
        shares = weights / np.where(total > 0.0, total, 1.0)
        seen = np.einsum("rls,lc->rcs", spectra.astype(np.float64), shares)
        found = cls.__new__(cls)
        found.__dict__.update(copy.copy(optics).__dict__)
        found.channels = weights.shape[1]
        found.columns = mi.UInt32(found.channels)
        found.spectra = device_table(seen)
        return found

    def _body(self, wavelengths: Any, surface: Any, state: Any, active: Any) -> Any:
        """Front and back reflectance and transmittance in each channel."""
        mi, dr = mitsuba_modules()
        last_state = dr.gather(mi.Float, self.last_state, surface, active)
        place = state * last_state
        low = dr.floor(place)
        columns = self.channels
        here = (dr.gather(mi.UInt32, self.first_row, surface, active) + mi.UInt32(low)) * columns
        up = here + mi.UInt32(dr.minimum(low + 1.0, last_state) - low) * columns
        colour = mi.Color3f if columns == 3 else mi.Color1f
        front, back, through = colour(0.0), colour(0.0), colour(0.0)
        for c in range(columns):
            a = dr.gather(mi.Vector4f, self.spectra, here + c, active)
            b = dr.gather(mi.Vector4f, self.spectra, up + c, active)
            front[c] = dr.lerp(a.x, b.x, place - low)
            back[c] = dr.lerp(a.y, b.y, place - low)
            through[c] = dr.lerp(a.z, b.z, place - low)
        return front, back, through
