"""Open Image Denoise on what is stochastic."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pepperscene.render.transport import Light


def denoised(light: Light) -> NDArray[np.float32]:
    """Sharp light as it is plus soft light denoised, `(h, w, 3)`, electrons s-1 m-2 sr-1.

    Only what is stochastic goes through the filter, guided by albedo and normal, so that the flash's texture
    and the highlights stay as rendered (Open Image Denoise, filter "RT", high dynamic range).
    """
    import pyoidn

    level = float(light.soft.mean())
    if level <= 0.0:
        return light.sharp + light.soft
    # The filter expects values about 1.
    soft = pyoidn.denoise(
        np.ascontiguousarray(light.soft / level, np.float32),
        albedo=np.ascontiguousarray(np.clip(light.albedo, 0.0, 1.0), np.float32),
        normal=np.ascontiguousarray(light.normal, np.float32),
        hdr=True,
    )
    return (light.sharp + np.maximum(soft, 0.0) * level).astype(np.float32)
