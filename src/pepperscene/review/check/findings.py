"""Findings of a check, and values of a frame's JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
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
        content = {"passed": self.passed, "frames": self.frames, "counts": self.counts()}
        return {**content, "findings": [asdict(item) for item in self.findings], "notes": list(self.notes)}


def sort_findings(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Findings by kind, the most serious first, then by frame and file."""
    rank = list(KINDS).index

    def key(finding: Finding) -> tuple[int, int, str]:
        return rank(finding.kind), -1 if finding.index is None else finding.index, finding.file

    return tuple(sorted(findings, key=key))


def json_object(metadata: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """The object of a key, empty if there is none."""
    value = metadata.get(key)
    return value if isinstance(value, Mapping) else {}


def camera_integer(metadata: Mapping[str, Any], key: str, default: int = 0) -> int:
    """An integer of the camera."""
    value = json_object(metadata, "camera").get(key)
    return value if isinstance(value, int) else default


def camera_centres(metadata: Mapping[str, Any], rows: int) -> NDArray[np.float64]:
    """Projection centres of the labels of an image, `(3,)`, or `(rows, 1, 3)` if its rows have poses."""
    camera = metadata["camera"]
    centre: NDArray[np.float64] = np.array(camera["pose"], float)[:3, 3]
    motion, line_time_s = camera.get("motion"), camera.get("line_time_s")
    if not motion or not line_time_s or not motion.get("labels_per_row", True):
        return centre
    times = (np.arange(rows) + 0.5 - 0.5 * rows) * float(line_time_s)
    return np.asarray(centre + times[:, None, None] * np.array(motion["velocity_m_s"], float))
