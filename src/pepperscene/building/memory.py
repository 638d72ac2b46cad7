"""Memory: a bound for frames and plants, the limits of this machine, and errors when memory runs out.

The bound refuses what is absurd before anything is computed. Peaks that were measured with `barth2018` are
between 40 % below it and 10 % above.
"""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import psutil

from pepperscene.camera import Camera, DepthCamera
from pepperscene.camera.sensor.rows import row_strips
from pepperscene.errors import ArgumentError, InputError, PepperError, SetupError, is_out_of_memory
from pepperscene.outputs import DEPTH_CAMERA_OUTPUTS, OUTPUTS

MEMORY: Final = "PEPPERSCENE_MEMORY"
"""Environment variable: the memory that a build may use ("40 GB"), or "off" for no check."""

PER_TRIANGLE: Final = 400.0
"""Bytes per triangle of a plant while its contacts are resolved; measured 390."""

# Bytes, fitted to peaks of frames from 320x240 to 6000x4000 pixels.
_PROCESS, _LIGHT = 300e6, 350e6  # of any frame, and further ones where light is traced
_PER_SCENE_TRIANGLE: Final = 200.0  # of the mesh, its copies while it is assembled, and the search tree
_PER_LABEL, _PER_LIGHT = 200.0, 1000.0  # per pixel that is computed at a time; light of three channels
_PER_SITE: Final = 15.0  # per pixel or photosite of the whole image, while it is developed
_PER_PROCESSED: Final = 80.0  # per pixel of the whole image, in an image signal processor
_COPIES: Final = 3  # of an image that is encoded while the next one is rendered
_PER_DISPARITY: Final = 4.0  # per pixel and disparity of the depth camera's matching
_ADDRESS_SPACE: Final = 1e9  # that a process reserves but never uses: libraries, stacks of threads

_SIZE: Final = re.compile(r"(\d+(?:\.\d+)?) ?([kMGT]?)(i?)B?", re.ASCII | re.IGNORECASE)
_MAX_BYTES: Final = 1e15  # chosen: more than any machine has


class MemoryLimit(NamedTuple):
    """Bytes, what sets the limit as the end of "are ...", and whether all processes of a build share it."""

    size: float
    reason: str
    is_shared: bool = True


def frame_memory(
    camera: Camera,
    outputs: Collection[str],
    triangles: int,
    depth_camera: DepthCamera | None = None,
    *,
    in_strips: bool = True,
) -> float:
    """Bytes that a process takes to render and write frames.

    Args:
        camera: of the frames; its pose does not matter.
        outputs: names from `OUTPUTS`.
        triangles: of the scene.
        depth_camera: for its outputs, or None.
        in_strips: whether large images are computed in strips; "path" computes them as a whole.
    """
    sensor, pixels = camera.sensor, camera.width * camera.height
    needed = _PROCESS + _PER_SCENE_TRIANGLE * triangles
    at_a_time = camera.width * row_strips(camera.width, camera.height)[0].stop if in_strips else pixels
    per_pixel = _PER_LABEL
    if any(OUTPUTS[name].traced for name in outputs):
        # Half of the values of a sample have one entry for each channel.
        per_pixel = _PER_LIGHT * (3 + sensor.channels) / 6
        needed += _LIGHT + _PER_SITE * max(pixels, int(np.prod(sensor.site_shape)))
        needed += _PER_PROCESSED * pixels if camera.developing.isp is not None else 0.0
    needed += per_pixel * at_a_time
    if depth_camera is not None and DEPTH_CAMERA_OUTPUTS.intersection(outputs):
        left, disparities = depth_camera.left, depth_camera.matching.disparities
        needed += left.width * left.height * (_PER_LIGHT + _PER_DISPARITY * disparities)
    return float(needed + _COPIES * sum(_image_size(name, camera) for name in outputs))


def check_fits(needed: float, subject: str, advice: str, processes: int = 1) -> None:
    """Check that processes which take `needed` bytes each fit into the memory of this machine.

    Args:
        needed: bytes.
        subject: what needs them, as the begin of the sentence.
        advice: how to need less.
        processes: that run at the same time.

    Raises:
        ArgumentError: fewer processes would fit.
        SetupError: not even one process fits.
        InputError: the environment variable `MEMORY` is not valid.
    """
    estimate = f", or set {MEMORY} if the estimate is wrong"
    for size, reason, is_shared in sorted(memory_limits()):
        available = f"and {format_size(size)} are {reason}"
        if needed > size:
            raise SetupError(
                f"{subject} needs about {format_size(needed)} of memory, {available}; {advice}{estimate}"
            )
        if is_shared and needed * processes > size:
            raise ArgumentError(
                "workers",
                f"{processes} need about {format_size(processes * needed)} of memory, {format_size(needed)} "
                f"each, {available}; use at most {size // needed:.0f}{estimate}",
            )


def memory_limits() -> list[MemoryLimit]:
    """The limits of this process and its children; none if `MEMORY` is "off".

    Raises:
        InputError: `MEMORY` is neither a size nor "off".
    """
    text = os.environ.get(MEMORY, "").strip()
    if text.lower() == "off":
        return []
    if text:
        return [MemoryLimit(_parse_size(text), f"allowed by {MEMORY}")]
    limits = [MemoryLimit(psutil.virtual_memory().available, "available on this machine")]
    limits += control_group_limits()
    with suppress(ImportError):
        import resource

        space = resource.getrlimit(resource.RLIMIT_AS)[0]
        if space != resource.RLIM_INFINITY:
            limits.append(MemoryLimit(max(space - _ADDRESS_SPACE, 0), "left by `ulimit -v`", False))
    return limits


def control_group_limits(
    groups: Path = Path("/proc/self/cgroup"), mount: Path = Path("/sys/fs/cgroup")
) -> list[MemoryLimit]:
    """Limits of the control groups of this process, of both versions: of a container, or of a batch job.

    Neither psutil nor Python reads them.
    """
    limits = []
    with suppress(OSError):
        for line in groups.read_text().splitlines():
            _, controllers, path = line.split(":", 2)
            if controllers and "memory" not in controllers.split(","):
                continue
            root, name = (mount / "memory", "memory.limit_in_bytes") if controllers else (mount, "memory.max")
            # In a container the path can be that of the host, and only the root is mounted.
            for folder in (inside := root / path.lstrip("/"), *inside.parents):
                with suppress(OSError, ValueError):
                    if (size := int((folder / name).read_text())) < _MAX_BYTES:
                        limits.append(MemoryLimit(size, f"allowed by the control group {folder}"))
    return limits


def format_size(size: float) -> str:
    """Bytes in GB with two or three digits."""
    return f"{size / 1e9:.0f} GB" if size >= 99.5e9 else f"{size / 1e9:.1f} GB"


@contextmanager
def report_memory_errors(instead: PepperError | None = None) -> Iterator[None]:
    """Raise another error instead of those by which Python and the libraries report missing memory.

    `instead` is a `SetupError` by default.
    """
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        if not is_out_of_memory(error):
            raise
        raise instead or SetupError(
            "memory ran out; complete frames are kept: use fewer pixels, fewer outputs or fewer plants, or a "
            "machine with more memory"
        ) from None


def _parse_size(text: str) -> float:
    match, size = _SIZE.fullmatch(text), 0.0
    if match is not None:
        size = float(match[1]) * (1024 if match[3] else 1000) ** " kmgt".index(match[2].lower() or " ")
    if not 1 <= size <= _MAX_BYTES:
        raise InputError(MEMORY, f'must be a size such as "40 GB", or "off", not {text!r}')
    return size


def _image_size(name: str, camera: Camera) -> float:
    """Bytes of the array of one output."""
    output = OUTPUTS[name]
    if not output.is_image:
        return 0.0
    rows, columns = camera.sensor.site_shape if name == "raw" else (camera.height, camera.width)
    channels = (camera.sensor.channels,) if output.has_channels else output.channels
    return float(rows) * columns * int(np.prod(channels or (1,))) * np.dtype(output.dtype).itemsize
