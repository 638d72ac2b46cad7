"""Open Image Denoise on the soft light; what is sharp is left alone.

Soft light is all that was scattered more than once or comes from the sky. The flash at the first hit has
highlights, veins and edges in it, and gets samples instead of a filter.

Before the sky, soft light ends where bodies do, and what the filter draws over that edge is missing from the
outermost pixels: a fifth to a third of it, a dark line round everything. So the filter is shown the light per
covered area, carried on past the edge, and the cover is multiplied back on.

Rare bright paths carry much of the energy, and the filter takes them for faults: 3 to 8 % of the soft light
were gone. What it made of each neighbourhood is therefore brought back to that neighbourhood's traced mean.

Measured on frame 125 of `barth2018`, 800x600: root mean square, in 8-bit codes, of what soft light alone adds
to the error, from the differences to two independent references multiplied, so that these references' noise
drops out; two frames each; CPU seconds:

| filter of soft light            | 4 samples | 8 samples | soft energy | CPU s |
|---------------------------------|-----------|-----------|-------------|-------|
| none                            | 11.2      | 8.4       |             |       |
| high, guided (as before)        | .96       | .79       | -4.0 %      | .62   |
| fast, energy brought back       | .98       | .82       | -.1 %       | .38   |
| high, energy brought back: this | .93       | .79       | -.2 %       | .63   |
| the same, guides taken as clean | .90       | .74       | -.2 %       | 1.4   |
| half resolution, joint bilateral| 1.13      | 1.05      | -.2 %       | .30   |

Worse at 4 samples, by 1 to 22 %: dividing by the albedo first, guides of albedo alone or none, the flash as a
guide, bright pixels spread over their neighbours before the filter. A filter for the share of the flash that
comes through in half-shadows takes the flash's error from 6.0 to 3.4 codes at 4 samples and from 2.4 to 1.7
at 16, but at 64 from .96 up to 1.2, and costs what four more samples cost.
"""

from __future__ import annotations

import sys
import threading
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from types import ModuleType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.render.transport.trace import TracedLight

_TORCH: Final = "torch"
_FLAG: Final = "TORCH_AVAILABLE"
_one_at_a_time = threading.RLock()


@cache
def open_image_denoise() -> ModuleType:
    """The package `pyoidn`, imported when first asked for.

    PyTorch takes a second and 180 MB, and arrays of NumPy do not need it. The package only tries whether it
    is there, and imports it again where it is used; so it is kept from it, and told what it would have found.
    """
    with _one_at_a_time:
        if "pyoidn" in sys.modules or _TORCH in sys.modules or find_spec(_TORCH) is None:
            import pyoidn

            return pyoidn
        modules: dict[str, Any] = sys.modules
        modules[_TORCH] = None  # what the import system takes for "not there"
        try:
            import pyoidn
        finally:
            del modules[_TORCH]
        for name, module in list(modules.items()):
            if name.startswith("pyoidn.") and hasattr(module, _FLAG):
                setattr(module, _FLAG, True)
        return pyoidn


Image = NDArray[np.float32]

_MARGIN: Final = 2
"""Pixels: how far to each side the background looks for bodies to carry on. Chosen among 1, 2, 4 and 12:
balls and fruit before the sky keep their outermost pixels' soft light within 2 %, with 4 it is 5 % less."""
_FRAME: Final = 8
"""Pixels: how far the picture is mirrored beyond its borders. Without, the filter makes corners of an even
picture up to a third too dark or too bright; with 4 they are off by 2 %, with 8 by less than 1 %."""
_NEIGHBOURHOOD: Final = 97
"""Pixels: the square whose mean is kept. Chosen among 15, 33, 65, 97 and 193: smaller ones bring noise back;
from 65 to 193 the error is the same within 1 %."""
_LEAST_GAIN, _MOST_GAIN = 0.5, 2.0
"""Chosen: a neighbourhood that differs more holds a single bright path, or nothing."""


def denoised(light: TracedLight) -> Image:
    """`(h, w, c)` all light with its stochastic part denoised, electrons s-1 m-2 sr-1."""
    return light.flash + light.sky + _soft(light)


def preload_denoiser() -> None:
    """Load the libraries and the filter's weights; changes nothing but the time of the first picture."""
    grey = np.full((_FRAME, _FRAME, 3), 0.5, np.float32)
    _with_mean_of(grey, _filtered(grey, grey, grey))


def _soft(light: TracedLight) -> Image:
    """The soft light, guided by albedo and normal."""
    level = float(light.soft.mean(dtype=np.float64))
    if level <= 0.0:
        return light.soft
    # Guides and soft light may come from different samples, so a pixel's cover may differ.
    shares = light.covered[..., :1], light.covered[..., 1:]
    sharp = _Cover.of(shares[0])
    soft = sharp if np.array_equal(*shares) else _Cover.of(shares[1])
    # The filter and its albedo expect values about 1.
    traced = np.asarray(light.soft / level, np.float32)
    albedo = np.clip(sharp.carried_on(light.albedo), 0.0, 1.0)
    smooth = _filtered(soft.carried_on(traced), albedo, sharp.carried_on(light.normal))
    smooth *= sharp.share
    return _with_mean_of(traced, smooth) * np.float32(level)


def _with_mean_of(traced: Image, smooth: Image) -> Image:
    """A filtered image, each neighbourhood of it as bright as it was traced."""
    from scipy.ndimage import uniform_filter

    size = (_NEIGHBOURHOOD, _NEIGHBOURHOOD, 1)
    found = uniform_filter(smooth, size)
    gain = np.divide(uniform_filter(traced, size), found, out=np.ones_like(found), where=found > 0.0)
    return smooth * np.clip(gain, _LEAST_GAIN, _MOST_GAIN)


@dataclass(frozen=True, eq=False)
class _Cover:
    """How much of each pixel bodies cover.

    Attributes:
        share: `(h, w, 1)` in [0, 1].
        per_share: `(h, w, 1)` its inverse, 0 where there is none.
        rim: `(m, 2)` rows and columns of pixels without any that have bodies nearby.
    """

    share: Image
    per_share: Image
    rim: NDArray[np.intp]

    @classmethod
    def of(cls, share: Image) -> _Cover:
        """From the share `(h, w, 1)`."""
        from scipy.ndimage import maximum_filter

        bodies = share > 0.0
        per_share = np.asarray(bodies / np.where(bodies, share, np.float32(1.0)), np.float32)
        if bodies.all():
            return cls(share, per_share, np.empty((0, 2), np.intp))
        nearby = maximum_filter(bodies[..., 0].view(np.uint8), 2 * _MARGIN + 1).view(bool)
        return cls(share, per_share, np.argwhere(nearby & ~bodies[..., 0]))

    def carried_on(self, image: Image) -> Image:
        """An image of what bodies send out, `(h, w, k)`, per area that they cover.

        Pixels without any take the mean of the bodies about them, or 0 where there are none.
        """
        per_area = image * self.per_share
        if len(self.rim):
            last = np.array(self.share.shape[:2]) - 1
            sums, areas = np.zeros((len(self.rim), image.shape[-1]), np.float32), np.float32(0.0)
            for step in np.ndindex(2 * _MARGIN + 1, 2 * _MARGIN + 1):
                near = tuple(np.clip(self.rim + step - np.array(_MARGIN), 0, last).T)
                sums += image[near]
                areas = areas + self.share[near]
            per_area[tuple(self.rim.T)] = sums / areas
        return per_area


def _filtered(image: Image, albedo: Image, normal: Image) -> Image:
    """Filter "RT" of Open Image Denoise, which wants three channels; one is shown to it three times."""
    pyoidn = open_image_denoise()

    h, w, c = image.shape
    found = pyoidn.denoise(_framed(image), _framed(albedo), _framed(normal), hdr=True)
    inner = np.asarray(found, np.float32)[_FRAME : _FRAME + h, _FRAME : _FRAME + w]
    return np.maximum(inner if c == 3 else inner.mean(axis=-1, keepdims=True), np.float32(0.0))


def _framed(image: Image) -> Image:
    """Three channels, with the picture mirrored beyond its borders."""
    three = np.broadcast_to(image, (*image.shape[:2], 3))
    around = ((_FRAME, _FRAME), (_FRAME, _FRAME), (0, 0))
    return np.ascontiguousarray(np.pad(three, around, mode="symmetric"), np.float32)
