"""What a frame's JSON tells, as far as it can be read: a damaged one must not stop the check."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray


def table(facts: Mapping[str, Any], name: str) -> dict[str, Any]:
    """The object of a name, empty where there is none."""
    found = facts.get(name)
    return found if isinstance(found, dict) else {}


def instances(facts: Mapping[str, Any]) -> dict[int, dict[str, Any]]:
    """The entries of the instances by their number."""
    entries = table(facts, "instances").items()
    return {int(name): entry for name, entry in entries if name.isdecimal() and isinstance(entry, dict)}


def pose(facts: Mapping[str, Any]) -> NDArray[np.float64] | None:
    """`(4, 4)`, camera to world."""
    try:
        found = np.asarray(table(facts, "camera").get("pose"), dtype=float)
    except (TypeError, ValueError):
        return None
    return found if found.shape == (4, 4) and np.isfinite(found).all() else None


def number(facts: Mapping[str, Any], name: str, default: int = 0) -> int:
    """A whole number of the camera."""
    found = table(facts, "camera").get(name)
    return found if isinstance(found, int) else default


KINDS: Final[Mapping[str, str]] = {
    "damaged": "a JSON file cannot be read, or is not what was written",
    "missing": "a file that a frame's JSON names is not there",
    "incomplete": "a frame that must be there is not",
    "unreadable": "an image cannot be decoded, though it is what was written",
    "checksum": "a file has other bytes than the frame's JSON says",
    "shape": "an image has another size or type than its output",
    "contradiction": "JSON says otherwise than the images, the recipe's plan or the manifest",
    "label": "a class id outside 0 to 7",
    "instance": "an instance that the frame's JSON does not know, or of another class than its pixels",
    "unlabelled": "something is hit but has no instance, or an instance but no distance",
    "edges": "label edges lie off the colour edges",
    "encoding": "a derived image does not belong to the image that it is made of",
    "value": "a measured value that cannot be: nan, infinite, negative, of the wrong length",
    "black": "a picture without light",
    "dark": "a picture with hardly any light",
    "saturated": "a picture that is burnt out",
    "constant": "a picture of one value",
    "duplicate": "two frames that are the same",
    "drift": "the set, or a frame, lies outside what the recipe expects",
    "extra": "a file that does not belong there",
}
"""All kinds of fault, the most serious first."""


@dataclass(frozen=True)
class Finding:
    """One fault of a data set.

    Attributes:
        kind: out of `KINDS`.
        index: of the frame, or None when it is not a single frame's.
        file: inside the data set, with forward slashes; "" for the set as a whole.
        what: is wrong, in one sentence.
    """

    kind: str
    index: int | None
    file: str
    what: str

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"{self.kind!r} is no kind of finding")


@dataclass(frozen=True)
class CheckResult:
    """What a check found.

    Attributes:
        findings: the faults, the most serious kind first and then by frame; empty when all is well.
        frames: how many were examined.
        notes: what is odd but no fault.
    """

    findings: tuple[Finding, ...]
    frames: int
    notes: tuple[str, ...] = ()

    @property
    def good(self) -> bool:
        """Whether there is no fault."""
        return not self.findings

    def counts(self) -> dict[str, int]:
        """Number of findings of each kind that was found, the most serious first."""
        found = Counter(finding.kind for finding in self.findings)
        return {kind: found[kind] for kind in KINDS if found[kind]}

    def as_json(self) -> dict[str, Any]:
        """The same, ready for JSON."""
        return {
            "good": self.good,
            "frames": self.frames,
            "counts": self.counts(),
            "findings": [
                {"kind": one.kind, "index": one.index, "file": one.file, "what": one.what}
                for one in self.findings
            ],
            "notes": list(self.notes),
        }


def in_order(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Findings by kind, the most serious first, then by frame and file."""
    rank = {kind: place for place, kind in enumerate(KINDS)}
    return tuple(
        sorted(findings, key=lambda one: (rank[one.kind], -1 if one.index is None else one.index, one.file))
    )
