"""Colours of rendered images matched to those of photographs without labels."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.errors import InputError
from pepperscene.review.report.data import evenly_spaced

Colours = NDArray[np.uint8]
Floats = NDArray[np.float64]

_MOST_PHOTOS: Final = 500  # chosen: kept in memory, at `_WIDTH`
_WIDTH: Final = 320  # chosen: statistics of colours need no more pixels
_LEAST_VARIANCE: Final = 1e-6  # chosen: of linear maps, far below that of the rounding of 8 bits


def match_statistics(image: Colours, photo: Colours) -> Floats:
    """Mean and standard deviation of each channel of CIELAB as in the photograph (Reinhard et al. 2001)."""
    from skimage.color import lab2rgb, rgb2lab

    lab, target = rgb2lab(image), rgb2lab(photo)
    axes = (0, 1)
    scale = target.std(axes) / np.maximum(lab.std(axes), _LEAST_VARIANCE**0.5)
    return np.asarray(lab2rgb((lab - lab.mean(axes)) * scale + target.mean(axes)) * 255.0)


def match_histogram(image: Colours, photo: Colours) -> Floats:
    """The histogram of each channel of sRGB as in the photograph."""
    from skimage.exposure import match_histograms

    return np.asarray(match_histograms(image, photo, channel_axis=-1), np.float64)


def match_transport(image: Colours, photo: Colours) -> Floats:
    """Mean and covariance of sRGB as in the photograph, by the linear map that moves colours least.

    It is the optimal transport between normal distributions (Pitié and Kokaram 2007).
    """
    from scipy.linalg import sqrtm

    source, target = (item.reshape(-1, 3).astype(np.float64) for item in (image, photo))
    root = np.real(sqrtm(np.cov(source.T) + _LEAST_VARIANCE * np.eye(3)))
    inverse = np.linalg.inv(root)
    linear = inverse @ np.real(sqrtm(root @ np.cov(target.T) @ root)) @ inverse
    return np.asarray((source - source.mean(0)) @ linear.T + target.mean(0)).reshape(image.shape)


MATCHES: Final[Mapping[str, Callable[[Colours, Colours], Floats]]] = MappingProxyType(
    {"statistics": match_statistics, "histogram": match_histogram, "transport": match_transport}
)
"""Ways to match colours, by name; each takes an image and a photograph, `(h, w, 3)` sRGB."""


@final
class ColourMatching:
    """Matches each image to one photograph, drawn at random, wholly or in part.

    Args:
        photos: sets of photographs; masks are not read.
        kind: key of `MATCHES`.

    Raises:
        InputError: a set has no photographs, or one without colours.
    """

    def __init__(self, photos: Sequence[ImageSet], kind: str) -> None:
        self._match = MATCHES[kind]
        self._photos: list[Colours] = []
        for images in photos:
            for image in images.select("colour").take(evenly_spaced(len(images), _MOST_PHOTOS)):
                if image.colour is None:
                    raise InputError(images.name, f"{image.name} has no colours to match")
                step = max(1, image.size[1] // _WIDTH)
                self._photos.append(image.colour[::step, ::step])
        if not self._photos:
            raise InputError("match", "holds no photographs")

    def __call__(self, colour: Colours, rng: np.random.Generator) -> Colours:
        """The image `(h, w, 3)` with colours between its own and those of a photograph."""
        photo, part = self._photos[rng.integers(len(self._photos))], rng.random()
        matched = self._match(colour, photo)
        return np.rint(np.clip(colour + part * (matched - colour), 0, 255)).astype(np.uint8)
