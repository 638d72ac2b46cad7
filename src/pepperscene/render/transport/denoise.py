"""Open Image Denoise on the indirect light; direct light is not filtered.

The guides are albedo and normals of the first hits, with their relief: else the filter takes the shading of
the relief by the sky for noise, and leaves in daylight look flat.

The flash at the first hit has highlights, veins and edges in it, and gets samples instead of a filter.

In front of the sky, indirect light ends where surfaces end, and what the filter spreads over that edge is
missing from the outermost pixels: a fifth to a third, a dark line around everything. So the filter gets the
light per covered area, extended past the edge, and its result is multiplied by the coverage.

Rare bright paths carry much of the energy, and the filter takes them for outliers: 3 to 8 % of the indirect
light were lost. So each neighbourhood of the result is scaled to the traced mean of that neighbourhood.
By daylight the light of leaves spreads over thin stems. So there each surface is scaled to its own mean, too.

Measured on frame 125 of `barth2018`, 800x600: root mean square, in 8-bit codes, of the error that indirect
light alone adds, from the products of the differences to two independent references, in which the references'
noise cancels; two frames each; CPU seconds:

| filter of indirect light          | 4 samples | 8 samples | energy | CPU s |
|-----------------------------------|-----------|-----------|--------|-------|
| none                              | 11.2      | 8.4       |        |       |
| high, guided                      | .96       | .79       | -4.0 % | .62   |
| fast, local means restored        | .98       | .82       | -.1 %  | .38   |
| high, local means restored (used) | .93       | .79       | -.2 %  | .63   |
| the same, noise-free guides       | .90       | .74       | -.2 %  | 1.4   |
| half resolution, joint bilateral  | 1.13      | 1.05      | -.2 %  | .30   |

Worse at 4 samples, by 1 to 22 %: dividing by the albedo first, guides of albedo alone or none, the flash as a
guide, bright pixels spread over their neighbours before the filter. A filter for the fraction of the flash
that arrives in penumbras reduces the flash's error from 6.0 to 3.4 codes at 4 samples and from 2.4 to 1.7 at
16, but increases it from .96 to 1.2 at 64, and costs as much as four more samples.

Where indirect light is much of the image, the filter assumes guides without noise (`clean_aux`), because
they have all samples of a pixel. It is then a larger network, which takes 1.7 instead of .7 CPU seconds. By
daylight, on frame 0 of `greenhouse` with 8 samples of the light of sky and leaves, its error is then 5.3
instead of 5.7 codes, of which 3.8 are the same for all seeds: six tenths of their square at borders of
organs, which share their colour, and a quarter within four pixels of these. Tried there, without gain:
albedo or normals that differ from organ to organ (5.5 to 9.3), smooth normals (5.3), distance as a guide
(5.7), regression of what the filter removes on albedo and normals (5.6 to 7.2). By flash, the error of the
image falls by 1 % only. Where indirect light is little, as by flash, and has few samples, the fast network
saves an eighth of a draft's time for .5 % more error.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from types import ModuleType
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pepperscene.render.transport.accumulate import GuidedLight, Surfaces, TracedLight, indirect_share
from pepperscene.render.transport.band_denoise import (
    MAX_GAIN,
    MIN_GAIN,
    band_levels,
    broad_images,
    denoise_bands,
)

Image = NDArray[np.float32]

_EXTENSION: Final = 2
"""Pixels by which surfaces are extended into the background. Chosen among 1, 2, 4 and 12: spheres and fruit
in front of the sky keep the indirect light of their outermost pixels within 2 %; with 4 it is 5 % less."""
_PADDING: Final = 8
"""Pixels by which the image is mirrored beyond its borders. Without it, the filter makes the corners of a
uniform image up to a third too dark or too bright; with 4 they are off by 2 %, with 8 by less than 1 %."""
_NEIGHBOURHOOD: Final = 97
"""Pixels: the square whose mean is restored. Chosen among 15, 33, 65, 97 and 193: smaller ones bring noise
back; from 65 to 193 the error is the same within 1 %."""
_CLEAN_FROM: Final = 0.2
"""Chosen: share of indirect light, in electrons, from which guides count as free of noise."""
_CLEAN_SAMPLES: Final = 4
"""Chosen: samples of indirect light from which on the larger network is worth its time. With 2, the error of
a draft of `greenhouse` is 6.49 instead of 6.33 codes without it, in 3.7 instead of 4.9 s of CPU time."""
_SURFACE_BIAS: Final = 0.03
"""Typical error of the light of a surface in a filtered image. Chosen: twice that of stems of `greenhouse`,
whose light is 1.5 %, a code, too much."""
_DARK_WEIGHT: Final = 0.4
"""Chosen: power of the light that means are divided by. The slope of the tone curve has .58, but noise that
the filter has left makes pixels dark and heavy at the same time: with .7, leaves are .2 codes darker."""
_LEAST_LIGHT: Final = 1e-3  # of the image's mean; chosen: darker pixels weigh no more
_AREA: Final = 16  # pixels; as in the filter itself
_DARK: Final = 1e-8  # areas without light have no logarithm; as in the filter itself
_MIDDLE_GREY: Final = 0.18  # as in the filter itself


@cache
def open_image_denoise() -> ModuleType:
    """Import the package `pyoidn` without PyTorch, which NumPy arrays do not need: saves 2 s and 185 MiB.

    The package only tests whether PyTorch is there, and imports it again where it uses it. So PyTorch is
    hidden during the import, and the result of the test is corrected.
    """
    torch, flag = "torch", "TORCH_AVAILABLE"
    if "pyoidn" in sys.modules or torch in sys.modules or find_spec(torch) is None:
        import pyoidn

        return pyoidn
    modules: dict[str, Any] = sys.modules
    modules[torch] = None  # for the import system: there is no such module
    try:
        import pyoidn
    finally:
        del modules[torch]
    for name, module in list(modules.items()):
        if name.startswith("pyoidn.") and hasattr(module, flag):
            setattr(module, flag, True)
    return pyoidn


def denoised(light: TracedLight) -> Image:
    """`(h, w, c)` all light, with the indirect light denoised; electrons s-1 m-2 sr-1."""
    return light.flash + light.sky_and_sun + denoised_indirect(light)


class _Network(NamedTuple):
    """The network of the filter."""

    clean_guides: bool  # guides count as free of noise
    quality: Literal["fast", "high"]


@dataclass(frozen=True, eq=False)
class FilterSetting:
    """What the filter takes from the whole image.

    Attributes:
        level: mean indirect light, electrons s-1 m-2 sr-1; the filter gets the light over it.
        network: that of the filter.
        exposures: factors by which the filter brings its input to the brightness that it was trained for, one
            for each image of three channels that is filtered; none let it choose.
        band_levels: `(c,)` mean light of each band about 1; None for that of the light that is filtered.
    """

    level: float
    network: _Network
    exposures: tuple[float, ...] = ()
    band_levels: NDArray[np.float64] | None = None


def denoised_indirect(light: TracedLight) -> Image:
    """The indirect light, denoised with albedo and normal as guides."""
    level = float(light.indirect.mean(dtype=np.float64))
    if level <= 0.0:
        return light.indirect
    return filtered_indirect(light, FilterSetting(level, _network(light)))


def _network(light: TracedLight) -> _Network:
    """Where indirect light is much of the image, guides count as free of noise.

    Where it is little, few samples are filtered by the fastest network.
    """
    has_few = light.variance.indirect_samples < _CLEAN_SAMPLES
    is_much = indirect_share(light.indirect, light.flash + light.sky_and_sun) > _CLEAN_FROM
    return _Network(is_much and not has_few, "fast" if has_few and not is_much else "high")


def setting_of_part(light: TracedLight) -> FilterSetting:
    """The setting of an image, from the light of some of its rows."""
    level = float(light.indirect.mean(dtype=np.float64))
    if level <= 0.0:
        return FilterSetting(level, _network(light))
    traced, levels = np.asarray(light.indirect / level, np.float32), None
    images: Iterable[Image] = [traced]
    if _has_bands(light):
        levels = band_levels(traced)
        images = broad_images(traced, levels)
    exposures = tuple(_exposure(image) for image in images)
    return FilterSetting(level, _network(light), exposures, levels)


def _exposure(image: Image) -> float:
    """As the filter computes it: from the geometric mean of the brightness of small areas."""
    luminance = image.mean(axis=-1)
    areas = np.add.reduceat(luminance, np.arange(0, luminance.shape[1], _AREA), axis=1) / _AREA
    areas = areas[areas > _DARK]
    return _MIDDLE_GREY / float(np.exp(np.log(areas).mean())) if areas.size else 1.0


def _has_bands(light: GuidedLight | TracedLight) -> bool:
    """Whether the light is that of bands, with an albedo in broad channels."""
    return light.indirect.shape[-1] != light.albedo.shape[-1]


def filtered_indirect(light: GuidedLight | TracedLight, setting: FilterSetting) -> Image:
    """The indirect light of an image or of a part of one, denoised with albedo and normal as guides."""
    # Guides and indirect light may come from different samples, so their coverage may differ.
    fractions = light.coverage[..., :1], light.coverage[..., 1:]
    of_guides = _Coverage.of(fractions[0])
    of_light = of_guides if np.array_equal(*fractions) else _Coverage.of(fractions[1])
    albedo, normal = np.clip(of_guides.extend(light.albedo), 0.0, 1.0), of_guides.extend(light.normal)

    def denoise(image: Image, number: int) -> Image:
        filtered = _apply_filter(of_light.extend(image), albedo, normal, setting, number)
        filtered *= of_guides.fraction
        restored = _restore_local_mean(filtered, image)
        return restored if light.surface is None else _restore_surfaces(restored, image, light.surface)

    # The filter and its albedo expect values about 1.
    traced = np.asarray(light.indirect / setting.level, np.float32)
    has_bands = _has_bands(light)
    result = denoise_bands(traced, denoise, setting.band_levels) if has_bands else denoise(traced, 0)
    return result * np.float32(setting.level)


def _restore_local_mean(filtered: Image, traced: Image) -> Image:
    """Scale each neighbourhood of a filtered image to its traced mean."""
    from scipy.ndimage import uniform_filter

    size = (_NEIGHBOURHOOD, _NEIGHBOURHOOD, 1)
    mean = uniform_filter(filtered, size)
    gain = np.divide(uniform_filter(traced, size), mean, out=np.ones_like(mean), where=mean > 0.0)
    return filtered * np.clip(gain, MIN_GAIN, MAX_GAIN)


def _restore_surfaces(filtered: Image, traced: Image, surface: Surfaces) -> Image:
    """Scale the light of each surface in a filtered image to its traced mean, as far as that is known.

    In codes, dark pixels of a surface count for more: so they do in the means.
    """
    number, kinds = surface.ravel(), int(surface.max()) + 1
    pixels = np.maximum(np.bincount(number), 1)
    gains = []
    for before, after in zip(np.moveaxis(traced, -1, 0), np.moveaxis(filtered, -1, 0), strict=True):
        weight = np.maximum(after, _LEAST_LIGHT) ** -_DARK_WEIGHT
        error, light = (weight * (before - after)).ravel(), (weight * after).ravel()
        mean = np.bincount(number, light, kinds) / pixels
        missing, square = (np.bincount(number, part, kinds) / pixels for part in (error, error * error))
        known = (_SURFACE_BIAS * mean) ** 2
        # The mean of a surface has noise: it counts for its part of both variances.
        share = np.divide(known, mean * (known + square / pixels), out=np.zeros(kinds), where=mean > 0.0)
        gains.append(1.0 + missing * share)
    return filtered * np.stack(gains, axis=-1).astype(np.float32)[surface]


@dataclass(frozen=True, eq=False)
class _Coverage:
    """The area of each pixel that surfaces cover."""

    fraction: Image  # `(h, w, 1)` in [0, 1]
    inverse: Image  # `(h, w, 1)` its inverse, 0 where nothing is covered
    rim: NDArray[np.intp]  # `(m, 2)` rows and columns of uncovered pixels close to surfaces

    @classmethod
    def of(cls, fraction: Image) -> _Coverage:
        """Find the rim of a coverage `(h, w, 1)`."""
        from scipy.ndimage import maximum_filter

        covered = fraction > 0.0
        inverse = np.asarray(covered / np.where(covered, fraction, np.float32(1.0)), np.float32)
        if covered.all():
            return cls(fraction, inverse, np.empty((0, 2), np.intp))
        nearby = maximum_filter(covered[..., 0].view(np.uint8), 2 * _EXTENSION + 1).view(bool)
        return cls(fraction, inverse, np.argwhere(nearby & ~covered[..., 0]))

    def extend(self, image: Image) -> Image:
        """`(h, w, k)` an image of surfaces per covered area, extended into the rim.

        Pixels of the rim take the mean of the surfaces around them; other uncovered pixels are 0.
        """
        per_area = image * self.inverse
        if len(self.rim):
            last = np.array(self.fraction.shape[:2]) - 1
            sums, areas = np.zeros((len(self.rim), image.shape[-1]), np.float32), np.float32(0.0)
            for step in np.ndindex(2 * _EXTENSION + 1, 2 * _EXTENSION + 1):
                near = tuple(np.clip(self.rim + step - np.array(_EXTENSION), 0, last).T)
                sums += image[near]
                areas = areas + self.fraction[near]
            per_area[tuple(self.rim.T)] = sums / areas
        return per_area


def _apply_filter(image: Image, albedo: Image, normal: Image, setting: FilterSetting, number: int) -> Image:
    """Apply the "RT" filter of Open Image Denoise, which takes three channels; a single one is repeated.

    `number` is that of the exposure.
    """
    h, w, c = image.shape
    images = tuple(_pad_image(part) for part in (image, albedo, normal))
    if not setting.exposures:
        clean_guides, quality = setting.network
        result = open_image_denoise().denoise(*images, hdr=True, clean_aux=clean_guides, quality=quality)
    else:
        result = _exposed_filter(images, setting.network, setting.exposures[number])
    inner = np.asarray(result, np.float32)[_PADDING : _PADDING + h, _PADDING : _PADDING + w]
    return np.maximum(inner if c == 3 else inner.mean(axis=-1, keepdims=True), np.float32(0.0))


def _exposed_filter(images: tuple[Image, ...], network: _Network, exposure: float) -> Image:
    """Apply the filter to light, albedo and normals with a given exposure, which `denoise` does not take."""
    oidn, result = open_image_denoise(), np.empty_like(images[0])
    device = _filter_device()
    image_filter = oidn.Filter(device, "RT")
    for name, image in zip(("color", "albedo", "normal", "output"), (*images, result), strict=True):
        image_filter.set_image(name, image, oidn.OIDN_FORMAT_FLOAT3)
    image_filter.set_bool("hdr", True)
    image_filter.set_bool("cleanAux", network.clean_guides)
    image_filter.set_quality(oidn.OIDN_QUALITY_FAST if network.quality == "fast" else oidn.OIDN_QUALITY_HIGH)
    image_filter.set_float("inputScale", exposure)
    image_filter.commit()
    image_filter.execute()
    image_filter.release()
    if problem := device.get_error():
        raise RuntimeError(f"Open Image Denoise failed: {problem}")
    return result


@cache
def _filter_device() -> Any:
    device = open_image_denoise().Device()
    device.commit()
    return device


def _pad_image(image: Image) -> Image:
    """Three channels, mirrored beyond the borders of the image."""
    three = np.broadcast_to(image, (*image.shape[:2], 3))
    widths = ((_PADDING, _PADDING), (_PADDING, _PADDING), (0, 0))
    return np.ascontiguousarray(np.pad(three, widths, mode="symmetric"), np.float32)
