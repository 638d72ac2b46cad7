"""Estimate of the memory that a render takes, before anything is allocated.

The numbers were measured with `barth2018` on two cores, as the peak of the resident memory of processes that
render one frame, from 320x240 to 6000x4000 pixels. Stages that follow each other share memory, so a frame
takes what its largest stage takes. What the denoiser and Dr.Jit have allocated, they keep for the next frame.
"""

from __future__ import annotations

import os
from collections.abc import Collection
from typing import Final

import numpy as np

from pepperscene.camera import Camera, DepthCamera
from pepperscene.camera.sensor.row_strips import is_whole, row_strips
from pepperscene.outputs import BAND_OUTPUTS, DEPTH_CAMERA_OUTPUTS, OUTPUTS, TRAIT_OUTPUTS, needs_surfaces
from pepperscene.render.quality import Quality
from pepperscene.render.transport.exposure import exposure_parts
from pepperscene.render.transport.strips import SURROUNDINGS, TILE_PIXELS
from pepperscene.render.variant import requested_variant, wanted_threads

_MARGIN: Final = 1.07
"""Chosen: measured peaks are at most 7 % above the sum of the parts below, and at most 15 % under it."""

_PROCESS: Final = 150e6
"""Bytes: the interpreter, the libraries and compiled kernels; measured 120 to 170 MB."""

_GPU_DRIVER: Final = 330e6
"""Bytes of a process that renders on a GPU: CUDA, OptiX, and the host's part of their memory. Measured on an
NVIDIA H200 (driver 580): 250 to 300 MB with labels, 340 to 370 MB with colours."""

_COMPILER: Final = 100e6
"""Bytes of Numba and the contacts between organs that it compiles; measured 102 MB."""

_PER_TRIANGLE: Final = 185.0
"""Bytes per triangle of the scene as it is built: the mesh and its copies while it is assembled, and Embree's
tree of what is left of it; measured 180 to 190 for 13 to 100 plants."""

_TEXTURES: Final = 135e6
"""Bytes of the textures of a scene's surfaces where light is traced: 3.3 million texels of 2 to 4 values, the
device's copy with 4, and a third of that for the filtered slopes, twice; 131 MB are the
sum of these arrays for `kaite`, not a measured peak."""

_WAVEFRONT: Final = 1 << 20
"""Samples that are traced at a time, at most: `_LANES` of `pepperscene.render.transport.wavefront`."""
_BAND_WAVEFRONT, _BAND_VALUES = 1 << 18, 1 << 24
"""The same of a sensor with bands, and its samples times bands; see `render.transport.band_light`."""
_SHARED_VALUES: Final = 80
"""Values of a sample that all bands share: 20 of each of four vertices of a path."""

_PER_BOUNCE: Final = 30e6  # bytes of the code for one more scattering event, and of compiling it; measured

_TRACED_HELD, _TRACED_PEAK = 225.0, 315.0
"""Bytes per pixel of a sensor with three channels, after light was traced, and at most meanwhile: 2.8 and 3.9
times the 80 that the sums over samples take; measured 210 to 230 and 290 to 315."""
_BAND_SHARE: Final = 1.15
"""Further factor of a sensor with bands: a frame of 30 bands of 800x600 pixels took 2.3 GB."""
_PER_PART: Final = 96.0
"""Bytes per pixel of a sensor with three channels that the light of an exposure's first part takes while the
second is traced: 21 values of `TracedLight`, and 3 of the image."""
_PER_SITE: Final = 10.0  # bytes per photosite of reading the sensor out: 4 of the mosaic, and its copies

_MENON: Final = 85.0  # further bytes per photosite of demosaicing in two directions; measured 83

_DEMOSAIC: Final = 40.0
"""Further bytes per photosite of a mode that averages areas; chosen: three colours, twice, and their sums."""

_LABELS: Final = 50.0
"""Bytes per pixel of the first hits, with classes, instances and distances; measured 41 to 50."""
_FURTHER: Final = {
    "normal": 10.0,
    "depth_z": 65.0,
    "position": 80.0,
    "uv": 65.0,
    "coverage": 55.0,
    "flow": 165.0,
    "stereo": 165.0,
    **dict.fromkeys(TRAIT_OUTPUTS, 65.0),
    "leaf_age": 30.0,
}
"""Further bytes per pixel that one of these outputs takes while it is computed; measured."""
_PER_BAND: Final = 32.0
"""Bytes per pixel and band of the outputs of a sensor with bands: the signal, the electrons in double
precision, what is measured of them, and the white reference; the sum of these arrays, not a measured peak."""
_BESIDES: Final = {"albedo": 80e6, "amodal": 100e6}
"""Bytes of one of these outputs that hardly depend on the image: rays and code of `albedo`, whose images are
gone before there are labels, and for `amodal` 4,096 organs that are kept, of 25 KB. Measured peaks of 4k
images are 6 % and 14 % below the estimates."""
_ROW_POSES: Final = 90.0
"""Further bytes per pixel of the outputs above if the rows of the image have poses of their own; measured 85
to 90 for normals and flow."""
_UV_PIXELS, _PER_UV_PIXEL, _PER_TRAIT_PIXEL = 1 << 20, 350.0, 420.0
"""Pixels whose surface coordinates are computed at a time, as in `pepperscene.render.aov.labels`, and bytes
of each, measured 330 to 380; and bytes of each for the contents of tissue."""

_PER_CORNER: Final = 8.0  # bytes per pixel of a large image: the slopes of its corners on the device
_PER_RAY: Final = 50.0
"""Bytes per pixel of a strip: its rays in double precision, and what computing them takes; chosen."""
_PER_BAND_IN_TILE: Final = 12.0
"""Bytes per pixel and band of a tile of the denoiser: the light, in parts, and the result."""
_PER_STRAY: Final = 22.0
"""Bytes per pixel of stray light in a large image: five planes in single precision; measured."""
_PER_DEVELOPED: Final = 100.0
"""Bytes per pixel of a strip that is developed: 25 values; measured 70 to 120 with its photosites."""
_FILES: Final = 1.0  # bytes of the encoded files of a large frame, at most, over those of its images
_WHOLE_LABELS: Final = {"coverage": 55.0}
"""Bytes per pixel of a large image that one of these outputs takes, as it is not computed in strips."""

_PER_IMAGER: Final = 60.0
"""Bytes per pixel of the light of the first imager while the second is traced, and of both images; chosen:
fifteen values."""
_PER_DISPARITY: Final = 4.0
"""Bytes per pixel and disparity of semi-global matching: its costs are two 16-bit numbers."""

_DENOISER_TILE: Final = 2160 * 2160
"""Pixels that Open Image Denoise filters at a time, at most: it divides larger images into tiles."""
_DENOISER_OVERLAP: Final = 192
"""Pixels by which neighbouring tiles overlap, from the reach of its filter."""
_PER_DENOISED: Final = 560.0  # bytes per pixel of a tile; measured 555 to 580
_PER_DENOISED_BY_DAYLIGHT: Final = 725.0  # of the larger filter of frames by daylight alone; measured
_DENOISER_IMAGES: Final = 12.0  # bytes per pixel of the denoiser's result

_ADDRESS_SPACE: Final = 900e6
"""Bytes of address space that a process reserves beyond its memory: libraries, and pages that are never used;
measured 460 to 1000 MB."""
_ADDRESS_SPACE_PER_THREAD: Final = 30e6
"""The same for each thread: its stack, and its part of the allocator; measured 26 MB."""


def frame_memory(camera: Camera, outputs: Collection[str], quality: Quality, triangles: int) -> int:
    """Bytes that a process takes at most to render frames.

    Args:
        camera: of the frames; its pose does not matter.
        outputs: names out of `OUTPUTS`.
        quality: of the frames.
        triangles: of the scene, before those that no camera sees are left out.
    """
    in_strips = not is_whole(camera.width, camera.height)
    return _frame_memory(camera, outputs, quality, triangles, in_strips=in_strips)


def _frame_memory(
    camera: Camera, outputs: Collection[str], quality: Quality, triangles: int, *, in_strips: bool
) -> int:
    total = _PROCESS + _COMPILER + _PER_TRIANGLE * triangles
    if requested_variant().startswith("cuda"):
        total += _GPU_DRIVER
    is_traced = any(OUTPUTS[name].traced for name in set(outputs) - DEPTH_CAMERA_OUTPUTS)
    if needs_surfaces(set(outputs) - DEPTH_CAMERA_OUTPUTS):
        total += _TEXTURES
    if is_traced:
        # The loop of longer paths has the code of one bounce.
        total += _PER_BOUNCE * (quality.bounces + (quality.most_bounces > 0) - 1)
    total += sum(_BESIDES.get(name, 0.0) for name in outputs)
    if in_strips and not (is_traced and quality.integrator == "path"):
        total += _strips_memory(camera, outputs, quality, is_traced=is_traced)
    else:
        total += _whole_memory(camera, outputs, quality, is_traced=is_traced)
    return int(_MARGIN * total)


def _whole_memory(camera: Camera, outputs: Collection[str], quality: Quality, *, is_traced: bool) -> float:
    """Bytes of the images of a frame whose stages compute the whole image at a time."""
    pixels, labels = camera.width * camera.height, [name for name in outputs if not OUTPUTS[name].traced]
    total = per_pixel = 0.0
    if is_traced:
        total += _device_memory(camera, quality, pixels)
        if quality.denoise:
            total += _denoiser_memory(camera.width, camera.height, _per_denoised(camera))
        share = _channel_share(camera)
        sites = _PER_SITE * np.prod(camera.sensor.site_shape) / pixels
        held = _TRACED_HELD * share
        is_divided = len(exposure_parts(camera, has_daylight=True)) > 1
        first_part = _PER_PART * share if is_divided else 0.0
        per_pixel = first_part + max(_TRACED_PEAK * share, held + sites)
        if (
            camera.sensor.channels == 3
            and camera.sensor.binning == 1
            and camera.developing.demosaic == "menon"
        ):
            per_pixel += _MENON * np.prod(camera.sensor.site_shape) / pixels
        if camera.sensor.channels == 3 and camera.sensor.reduction is not None:
            per_pixel += _DEMOSAIC * np.prod(camera.sensor.site_shape) / pixels
    else:
        held = 0.0
    if bands := BAND_OUTPUTS.intersection(outputs):
        per_pixel += (_PER_BAND if "reflectance" in bands else 0.5 * _PER_BAND) * camera.sensor.channels
    if labels:
        further = max(_FURTHER.get(name, 0.0) for name in labels)
        further += _ROW_POSES if camera.rows_move and further else 0.0
        per_pixel = max(per_pixel, held + _LABELS + further)
    total += _points_memory(labels, pixels)
    return total + per_pixel * pixels + sum(_image_size(name, camera) for name in outputs)


def _strips_memory(camera: Camera, outputs: Collection[str], quality: Quality, *, is_traced: bool) -> float:
    """Bytes of the images of a frame whose stages compute one strip of rows after the other."""
    pixels, channels = camera.width * camera.height, camera.sensor.channels
    rows = row_strips(camera.width, camera.height)[0].stop
    strip, share = rows * camera.width, _channel_share(camera)
    labels = [name for name in outputs if not OUTPUTS[name].traced]
    photographs = sum(_image_size(name, camera) for name in outputs if OUTPUTS[name].traced)
    stages = [0.0]
    # The rays through the corners of the pixels stay on the device.
    held = _PER_CORNER * pixels
    if is_traced:
        signal = 4.0 * channels * pixels
        parts = 2 if len(exposure_parts(camera, has_daylight=True)) > 1 else 1
        traced = _device_memory(camera, quality, strip) + _TRACED_PEAK * share * strip
        traced += (parts - 1) * _PER_PART * share * strip
        if quality.denoise:
            known = camera.width * (2 * rows + SURROUNDINGS)
            traced += parts * 4.0 * (3 * channels + 5) * known
            held += _per_denoised(camera) * TILE_PIXELS
            if camera.sensor.pattern == "bands":
                held += _PER_BAND_IN_TILE * channels * TILE_PIXELS
        stages.append(signal + traced)
        developed = _developing_memory(camera, strip)
        if "reflectance" in outputs:
            # From the electrons that are measured, which may not be an output.
            developed += signal + _PER_BAND * channels * strip
        stages.append(signal + photographs + developed)
    if labels:
        further = max(_FURTHER.get(name, 0.0) for name in labels)
        further += _ROW_POSES if camera.rows_move and further else 0.0
        images = sum(_image_size(name, camera) for name in labels)
        # Of each pixel its instance and its distance are computed in any case.
        images = max(images, 6.0 * pixels)
        whole = max(_WHOLE_LABELS.get(name, 0.0) for name in labels) * pixels
        stages.append(photographs + images + whole + (_LABELS + further + _PER_RAY) * strip)
        stages[-1] += _points_memory(labels, strip)
    sizes = [_image_size(name, camera) for name in outputs]
    # The image that is encoded is copied once.
    stages.append((1.0 + _FILES) * sum(sizes) + max(sizes, default=0.0))
    return held + max(stages)


def _points_memory(labels: Collection[str], pixels: int) -> float:
    """Bytes of the points in triangles behind pixels that are computed together."""
    if TRAIT_OUTPUTS.intersection(labels) - {"leaf_age"}:
        return _PER_TRAIT_PIXEL * min(pixels, _UV_PIXELS)
    return _PER_UV_PIXEL * min(pixels, _UV_PIXELS) if "uv" in labels else 0.0


def _developing_memory(camera: Camera, strip: int) -> float:
    """Bytes of developing a large image from its electrons, beside these and the images."""
    pixels, sensor = camera.width * camera.height, camera.sensor
    stray = _PER_STRAY * pixels if camera.developing.stray_light else 0.0
    sites = float(np.prod(sensor.site_shape))
    per_strip = (_PER_DEVELOPED + _PER_SITE * sites / pixels) * strip
    has_colours = sensor.pattern not in ("mono", "bands")
    if sensor.areas is None and (sensor.binning > 1 or not has_colours):
        return max(stray, per_strip)
    # The mosaic is kept as a whole.
    per_site = _DEMOSAIC + (_MENON if camera.developing.demosaic == "menon" else 0.0)
    per_strip += per_site * sites / pixels * strip
    # Bands are read out one after the other.
    channels = 3 if has_colours else 1
    spread = 0.0 if sensor.areas is None else 8.0 * channels * pixels + 8.0 * sites
    return max(stray, 4.0 * sites + max(per_strip, spread))


def depth_memory(
    depth_camera: DepthCamera, outputs: Collection[str], quality: Quality, triangles: int
) -> int:
    """Bytes that a process takes at most for the outputs of a depth camera; 0 without such outputs."""
    if not DEPTH_CAMERA_OUTPUTS.intersection(outputs):
        return 0
    left = depth_camera.left
    pixels = left.width * left.height
    # Images of this camera are traced as a whole.
    traced = _frame_memory(left, ("colour",), quality, triangles, in_strips=False)
    if any(OUTPUTS[name].traced for name in set(outputs) - DEPTH_CAMERA_OUTPUTS):
        # The scene of the photograph, with its textures, is kept beside that of the imagers.
        traced += int(_TEXTURES + _PER_TRIANGLE * triangles)
    return int(traced + pixels * (_PER_IMAGER + _PER_DISPARITY * depth_camera.matching.disparities))


def written_memory(camera: Camera, outputs: Collection[str]) -> int:
    """Bytes of a frame that is encoded while the next one is rendered: its images, and their files twice."""
    return int(3 * sum(_image_size(name, camera) for name in outputs))


def reserved_address_space() -> int:
    """Bytes of address space that a rendering process reserves beyond its memory."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return int(_ADDRESS_SPACE + _ADDRESS_SPACE_PER_THREAD * (wanted_threads() or cores))


def _channel_share(camera: Camera) -> float:
    """Memory of light that is traced over that of three channels."""
    # Half of the arrays have one entry for each channel of the sensor.
    share = (3 + camera.sensor.channels) / 6
    return _BAND_SHARE * share if camera.sensor.pattern == "bands" else share


def _per_denoised(camera: Camera) -> float:
    """Bytes per pixel of a tile of the denoiser."""
    return _PER_DENOISED if camera.flash is not None else _PER_DENOISED_BY_DAYLIGHT


def _device_memory(camera: Camera, quality: Quality, pixels: int) -> float:
    """Bytes of the values and sums of wavefronts that Dr.Jit keeps; it rounds sizes up to powers of two."""
    channels, total = camera.sensor.channels, 0.0
    if camera.sensor.pattern == "bands":
        # Long paths carry their light and its factor in each band.
        lanes = min(_BAND_WAVEFRONT, _BAND_VALUES // channels)
        return 4.0 * _rounded(lanes) * (_SHARED_VALUES + (2 * channels if quality.most_bounces else 0))
    first = min(quality.soft, quality.samples)
    # Numbers of values as of the functions `_all_light` and `_direct_light` of the integrator.
    passes = ((first, 4 * channels + 6), (quality.samples - first, 3 * channels + 5))
    sizes: dict[float, int] = {}
    for samples, values in passes:
        if samples:
            lanes = min(max(_WAVEFRONT // samples, 1), pixels) * samples
            size = _rounded(lanes)
            # Both kinds of passes use the same arrays if these have the same size.
            sizes[size] = max(sizes.get(size, 0), values)
            total += 4.0 * values * _rounded(lanes // samples)
    if quality.target is not None:
        # Refinements trace fewer samples at a time, in arrays of several smaller sizes.
        total += 4.0 * (3 * channels + 5) * _rounded(min(pixels, _WAVEFRONT))
    return total + sum(4.0 * values * size for size, values in sizes.items())


def _rounded(count: int) -> float:
    return float(2 ** int(np.ceil(np.log2(max(count, 1)))))


def _denoiser_memory(width: int, height: int, per_denoised: float) -> float:
    """Bytes that Open Image Denoise keeps, with so many for each pixel of a tile.

    It halves the longer side of its tiles until they are small.
    """
    tiles = [1, 1]
    tile = [width, height]
    while tile[0] * tile[1] > _DENOISER_TILE:
        longer = 0 if tile[0] >= tile[1] else 1
        tiles[longer] += 1
        length = (width, height)[longer]
        tile[longer] = -(-(length - _DENOISER_OVERLAP) // tiles[longer]) + _DENOISER_OVERLAP
    return per_denoised * tile[0] * tile[1] + _DENOISER_IMAGES * width * height


def _image_size(name: str, camera: Camera) -> float:
    """Bytes of the array of one output."""
    output = OUTPUTS[name]
    if not output.is_image:
        return 0.0
    rows, columns = camera.sensor.site_shape if name == "raw" else (camera.height, camera.width)
    channels = (camera.sensor.channels,) if output.has_channels else output.channels
    return float(rows) * columns * int(np.prod(channels or (1,))) * np.dtype(output.dtype).itemsize
