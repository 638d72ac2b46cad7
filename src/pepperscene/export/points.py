"""Points on the surfaces of a scene, and files of points.

Format: G. Turk, "The PLY polygon file format", Stanford University, 1994,
https://paulbourke.net/dataformats/ply/.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.export.job import ExportJob, training_frames
from pepperscene.export.surface import read_colour, read_label, read_surface, valid_pixels

LABELS: Final = ("class", "instance")
_SEED_POINTS: Final = 20_000
"""Of a scene. Chosen: COLMAP finds some tens of thousands in a few hundred images."""
_TYPES: Final = {"f4": "float", "u1": "uchar", "u2": "ushort"}


@dataclass(frozen=True, eq=False)
class SeedPoints:
    """Points on the surfaces of a scene.

    Attributes:
        position: `(n, 3)` world metres, whole micrometres.
        colour: `(n, 3)` uint8, of the pixel in which a point was found.
        labels: `(n,)` class and instance of that pixel, by name, as far as the data set has them.
    """

    position: NDArray[np.float64]
    colour: NDArray[np.uint8]
    labels: Mapping[str, NDArray[Any]]

    def file(self, numbers: NDArray[np.int64], *, has_normals: bool) -> bytes:
        """A PLY file of some of them; all normals are 0, as they are not known."""
        normals = dict.fromkeys(("nx", "ny", "nz") if has_normals else (), np.zeros(len(numbers), np.float32))
        labels = {name: values[numbers] for name, values in self.labels.items()}
        return point_file(self.position[numbers], self.colour[numbers], **normals, **labels)


def seed_points(job: ExportJob, indices: Sequence[int]) -> SeedPoints:
    """Pixels with a surface, drawn evenly from a scene's frames for training; the same for the same frames.

    There are 20,000, or fewer if there are fewer pixels. Ignored pixels, and those outside the foreground of
    the export, have none.
    """
    frames = training_frames(job, indices)
    positions, colours = [np.empty((0, 3))], [np.empty((0, 3), np.uint8)]
    labels: dict[str, list[NDArray[Any]]] = {name: [] for name in job.common_outputs(LABELS)}
    for number, frame in enumerate(frames):
        surface = read_surface(frame)
        is_candidate = np.isfinite(surface.distance)
        if job.has_masks:
            is_candidate &= valid_pixels(frame, surface, job.images.foreground)
        candidates = np.flatnonzero(is_candidate)
        share = _SEED_POINTS * (number + 1) // len(frames) - _SEED_POINTS * number // len(frames)
        # By the index of the frame, so that its points do not depend on what else is exported.
        rng = np.random.default_rng(frame.index)
        chosen = np.sort(rng.choice(candidates, min(share, len(candidates)), replace=False, shuffle=False))
        rows, columns = np.unravel_index(chosen, surface.distance.shape)
        positions.append(np.round(surface.points(rows, columns), 6))
        colours.append(read_colour(frame, surface)[rows, columns])
        for name, values in labels.items():
            values.append(read_label(frame, name, surface)[rows, columns])
    joined = {name: np.concatenate(values) for name, values in labels.items()}
    return SeedPoints(np.concatenate(positions), np.concatenate(colours), joined)


def point_file(
    position: NDArray[np.floating[Any]], colour: NDArray[np.uint8], **extra: NDArray[Any]
) -> bytes:
    """A binary PLY file of points.

    Args:
        position: `(n, 3)` metres, stored in single precision.
        colour: `(n, 3)` uint8.
        extra: more properties by name, each `(n,)` of float32, uint8 or uint16.
    """
    columns = dict(zip("xyz", np.asarray(position, "<f4").T, strict=True))
    columns |= dict(zip(("red", "green", "blue"), colour.T, strict=True))
    columns |= {name: values.astype(values.dtype.newbyteorder("<")) for name, values in extra.items()}
    properties = [f"property {_TYPES[values.dtype.str[1:]]} {name}" for name, values in columns.items()]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(position)}", *properties]
    table = np.empty(len(position), [(name, values.dtype) for name, values in columns.items()])
    for name, values in columns.items():
        table[name] = values
    return "\n".join([*header, "end_header", ""]).encode("ascii") + table.tobytes()
