"""What of a frame is remembered, to be compared with other frames, the manifest and the recipe."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.dataset.check import told
from pepperscene.dataset.check.pictures import flat, tone
from pepperscene.dataset.rows import row_of
from pepperscene.dataset.store import CHECKSUM, Standing
from pepperscene.frame import OUTPUTS
from pepperscene.truth import class_pixels

_JOURNALS: Final = ("render_s", "write_s", "worker")
"""Of the manifest's columns those that do not come out of the frame."""


@dataclass(frozen=True)
class Traits:
    """What of a frame is compared with other frames, the manifest and the recipe.

    Digests are of 64 bits, and 0 where there is nothing to compare: of a million frames, two that differ have
    the same one with a probability of 3e-8.

    Attributes:
        index: of the frame.
        scene: its set and rotation as one number, or None where the JSON does not say.
        picture: digest of its first traced image that is not flat.
        content: digest of all its files, unless all images are flat.
        view: digest of pose and seed.
        row: digest of what the manifest must say of it.
        shares: of the eight classes, or None without a class image.
        mean: grey value of the photograph, or None without one.
        saturated: share of its pixels.
    """

    index: int
    scene: int | None = None
    picture: int = 0
    content: int = 0
    view: int = 0
    row: int = 0
    shares: tuple[float, ...] | None = None
    mean: float | None = None
    saturated: float = 0.0


def traits_of(
    index: int, facts: Mapping[str, Any], digests: Mapping[str, str], images: Mapping[str, Any]
) -> Traits:
    """What of a frame is compared with others.

    Args:
        index: of the frame.
        facts: its JSON.
        digests: SHA-256 of its files by output name.
        images: by output name, those that could be read.
    """
    # A frame of flat images (all sky, no light) may look like another one.
    varied = [name for name, image in images.items() if OUTPUTS[name].is_image and not flat(image)]
    traced = next((name for name in varied if OUTPUTS[name].traced), None)
    light = tone(images["colour"]) if "colour" in images else None
    pose, seed = told.pose(facts), facts.get("seed")
    outputs = {name: one for name, one in told.table(facts, "outputs").items() if name in OUTPUTS}
    return Traits(
        index,
        scene=_scene(facts.get("set"), facts.get("rotation")),
        picture=_digest(np.ascontiguousarray(images[traced]).data) if traced else 0,
        content=_digest(json.dumps(digests, sort_keys=True).encode()) if varied else 0,
        view=0 if pose is None or seed is None else _digest(json.dumps([pose.tolist(), seed]).encode()),
        row=_row_digest(facts, outputs),
        shares=_shares(images.get("class")),
        mean=light.mean if light else None,
        saturated=light.saturated if light else 0.0,
    )


def _scene(group: Any, rotation: Any) -> int | None:
    known = isinstance(group, int) and isinstance(rotation, int)
    # The recipe allows at most 1000 rotations.
    return group * 1000 + rotation if known else None


def _shares(classes: NDArray[np.uint8] | None) -> tuple[float, ...] | None:
    if classes is None or classes.max() >= len(OrganClass):
        return None
    return tuple(count / classes.size for count in class_pixels(classes).values())


def _row_digest(facts: Mapping[str, Any], outputs: dict[str, Any]) -> int:
    rest = {key: value for key, value in facts.items() if key not in (CHECKSUM, "outputs")}
    try:
        return manifest_digest(row_of(Standing(rest, outputs, str(facts.get(CHECKSUM)))))
    except (AttributeError, IndexError, KeyError, TypeError):
        # Such JSON is damaged, and told so.
        return 0


def manifest_digest(row: Mapping[str, Any]) -> int:
    """Digest of what a row of the manifest says of a frame, without what only the journal knows."""
    known = {name: value for name, value in row.items() if value is not None and name not in _JOURNALS}
    return _digest(json.dumps(known, sort_keys=True, default=str).encode())


def _digest(content: bytes | memoryview) -> int:
    return int.from_bytes(hashlib.blake2b(content, digest_size=8).digest())
