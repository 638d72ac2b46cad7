"""Findings of a check, and safe access to the JSON of frames, which may be damaged."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

KINDS: Final[Mapping[str, str]] = {
    "damaged": "a JSON file cannot be read, or is not what was written",
    "missing": "a file that a frame's JSON names does not exist",
    "incomplete": "a required frame does not exist",
    "unreadable": "an image cannot be decoded, although its bytes are those that were written",
    "checksum": "a file has other bytes than the frame's JSON says",
    "shape": "an image has another size or type than its output",
    "contradiction": "JSON disagrees with the images, the recipe's plan or the manifest",
    "label": "a class id outside 0 to 7",
    "instance": "an instance that is not in the frame's JSON, or of another class than its pixels",
    "unlabelled": "a pixel with a distance but no instance, or with an instance but no distance",
    "edges": "label edges are not on the colour edges",
    "encoding": "a derived image does not match the image that it is derived from",
    "value": "an impossible measured value: nan, infinite, negative, of the wrong length",
    "black": "a photograph without light",
    "dark": "a photograph with hardly any light",
    "saturated": "an overexposed photograph",
    "constant": "a photograph of one value",
    "duplicate": "two identical frames",
    "drift": "statistics of the set, or of a frame, are outside the ranges that the recipe expects",
    "extra": "a file that does not belong to the data set",
}
"""All kinds of findings, the most serious first."""


@dataclass(frozen=True)
class Finding:
    """One problem of a data set.

    Attributes:
        kind: in `KINDS`.
        index: of the frame, or None if it does not concern a single frame.
        file: inside the data set, with forward slashes; "" for the data set as a whole.
        problem: its description, one sentence.
    """

    kind: str
    index: int | None
    file: str
    problem: str

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"{self.kind!r} is not a kind of finding")


@dataclass(frozen=True)
class CheckResult:
    """Result of a check.

    Attributes:
        findings: the problems, the most serious kind first and then by frame.
        frames: number of checked frames.
        notes: unusual but valid values.
    """

    findings: tuple[Finding, ...]
    frames: int
    notes: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether there are no findings."""
        return not self.findings

    def counts(self) -> dict[str, int]:
        """Number of findings of each kind that occurs, the most serious first."""
        counter = Counter(finding.kind for finding in self.findings)
        return {kind: counter[kind] for kind in KINDS if counter[kind]}

    def to_json(self) -> dict[str, Any]:
        """The result as an object for JSON."""
        return {
            "good": self.passed,
            "frames": self.frames,
            "counts": self.counts(),
            "findings": [
                {"kind": item.kind, "index": item.index, "file": item.file, "what": item.problem}
                for item in self.findings
            ],
            "notes": list(self.notes),
        }


def sort_findings(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Findings by kind, the most serious first, then by frame and file."""
    rank = {kind: number for number, kind in enumerate(KINDS)}

    def key(finding: Finding) -> tuple[int, int, str]:
        return rank[finding.kind], -1 if finding.index is None else finding.index, finding.file

    return tuple(sorted(findings, key=key))


def json_object(metadata: Mapping[str, Any], key: str) -> dict[str, Any]:
    """The object of a key, empty if there is none."""
    value = metadata.get(key)
    return value if isinstance(value, dict) else {}


def instance_entries(metadata: Mapping[str, Any]) -> dict[int, dict[str, Any]]:
    """The entries of the instances by their number."""
    entries = json_object(metadata, "instances").items()
    return {int(key): entry for key, entry in entries if key.isdecimal() and isinstance(entry, dict)}


def camera_pose(metadata: Mapping[str, Any]) -> NDArray[np.float64] | None:
    """`(4, 4)`, camera to world; None if there is no valid one."""
    try:
        pose = np.asarray(json_object(metadata, "camera").get("pose"), dtype=float)
    except (TypeError, ValueError):
        return None
    return pose if pose.shape == (4, 4) and np.isfinite(pose).all() else None


def camera_centres(metadata: Mapping[str, Any], rows: int) -> NDArray[np.float64] | None:
    """Projection centres of the labels of an image, `(3,)`, or `(rows, 1, 3)` if its rows have poses.

    None if the camera's JSON is not valid.
    """
    pose, camera = camera_pose(metadata), json_object(metadata, "camera")
    motion, line_time_s = json_object(camera, "motion"), camera.get("line_time_s", 0.0)
    if pose is None or not motion or not line_time_s or motion.get("labels_per_row") is False:
        return None if pose is None else pose[:3, 3]
    try:
        times = (np.arange(rows) + 0.5 - 0.5 * rows) * float(line_time_s)
        velocity = np.asarray(motion.get("velocity_m_s"), dtype=float).reshape(3)
    except (TypeError, ValueError):
        return None
    return np.asarray(pose[:3, 3] + times[:, None, None] * velocity)


def camera_integer(metadata: Mapping[str, Any], key: str, default: int = 0) -> int:
    """An integer of the camera."""
    value = json_object(metadata, "camera").get(key)
    return value if isinstance(value, int) else default
